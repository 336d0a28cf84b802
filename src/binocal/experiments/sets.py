"""The sets of the paper's table 4 where no real ones are given: streets as KITTI's and Cityscapes' rigs see them, boards before ours."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy import ndarray

from binocal.boards import parse_board
from binocal.cameras import Camera, StereoRig
from binocal.datasets import StereoPair
from binocal.experiments.boards import FILL, LOOKS
from binocal.geometry import SE3
from binocal.images.png import encode_png
from binocal.shapes import Float
from binocal.simulation import (
    PoseOptions,
    SceneOptions,
    StereoScene,
    draw_textured_scene,
    render_pairs,
    render_scene_pairs,
    sample_board_poses,
    table2_rig,
)
from binocal.simulation.scene_renderer import render_scene_light
from binocal.simulation.textured_scenes import TexturedScene
from binocal.threads import n_threads


@dataclass(frozen=True, slots=True)
class StreetRig:
    """A rectified rig that drives: size of its images, focal length, baseline."""

    size_wh: tuple[int, int]
    focal_px: float
    baseline_m: float

    def rig(self) -> StereoRig:
        """Its cameras, without distortion, principal points in the middle."""
        width, height = self.size_wh
        parameters = np.array([self.focal_px, self.focal_px, (width - 1) / 2, (height - 1) / 2, 0, 0, 0, 0, 0])
        camera = Camera("brown4", self.size_wh, parameters)
        return StereoRig(camera, camera, SE3(np.eye(3), np.array([-self.baseline_m, 0.0, 0.0])))


STREETS = {
    "KITTI": StreetRig((1242, 375), 721.5, 0.537),
    "Cityscapes": StreetRig((2048, 1024), 2262.5, 0.209),
}
"""Figures of both sets' own calibration files, rounded."""


MEASURED = "measured"
N_STREETS = 6  # of the paper's measured set
PAIRS_A_STREET = 16
MEASURED_BOARDS = ("chessboard:11x8:10mm", "chessboard:11x8:20mm")
PAIRS_A_PLACE = 20  # of a board, before one view of a street


def rig_of_street(name: str) -> StereoRig:
    """The rig of a set of streets: KITTI's, Cityscapes', or that of the paper's table 2."""
    return table2_rig() if name == MEASURED else STREETS[name].rig()


def render_streets(name: str, n_pairs: int, seed: int, folder: Path) -> list[StereoPair]:
    """Pairs of streets that the rig of a set drives along, as PNG files: six in the measured set, as many as it takes in the others."""
    rig = rig_of_street(name)
    n_streets = min(N_STREETS, n_pairs) if name == MEASURED else -(-n_pairs // PAIRS_A_STREET)
    pairs = []
    for number, part in enumerate(np.array_split(np.arange(n_pairs), n_streets)):
        scene_seed, image_seed = np.random.SeedSequence([seed, 8, number]).spawn(2)
        scene = draw_textured_scene("street", rig, len(part), np.random.default_rng(scene_seed))
        for place, side, pixels in render_scene_pairs(rig, scene, SceneOptions(0.8, 3.0, 0.0), image_seed):
            (folder / f"{side}_{part[place]:03d}.png").write_bytes(encode_png(pixels))
        pairs += [StereoPair(f"{i:03d}", folder / f"left_{i:03d}.png", folder / f"right_{i:03d}.png") for i in part]
    return pairs


def repeated(pairs: Sequence[StereoPair], n_pairs: int) -> list[StereoPair]:
    """So many pairs, the given ones over and over under names of their own; all of them where they are more."""
    n_rounds = -(-n_pairs // len(pairs))
    many = [replace(pair, name=f"{pair.name}.{k}" if k else pair.name) for k in range(n_rounds) for pair in pairs]
    return many[: max(n_pairs, len(pairs))]


def render_measured(n_pairs: int, seed: int, folder: Path) -> dict[str, Path]:
    """The paper's measured set: half of the pairs show the one board, half the other, at random in the field, before six streets.

    A folder with left_*.png and right_*.png by each board's specification.
    """
    rig, folders = table2_rig(), {}
    behind = _Streets(rig, n_pairs, seed)
    for number, spec in enumerate(MEASURED_BOARDS):
        pose_seed, image_seed = np.random.SeedSequence([seed, 9, number]).spawn(2)
        board, n = parse_board(spec), len(range(number, n_pairs, 2))
        poses = sample_board_poses(rig, board, n, np.random.default_rng(pose_seed), PoseOptions(fill=FILL))
        folders[spec] = folder / spec.rpartition(":")[2]
        folders[spec].mkdir()
        for view, side, pixels in render_pairs(
            StereoScene(rig, board, poses), (LOOKS, LOOKS), image_seed, behind=behind
        ):
            (folders[spec] / f"{side}_{view:04d}.png").write_bytes(encode_png(pixels))
    return folders


class _Streets:
    """What a rig sees of six streets from some places in each, without noise; view after view in turn. Each is rendered once."""

    def __init__(self, rig: StereoRig, n_pairs: int, seed: int) -> None:
        n_places = max(1, min(n_pairs // PAIRS_A_PLACE, 4 * N_STREETS))
        n_streets = min(N_STREETS, n_places)
        views = []
        for number, part in enumerate(np.array_split(np.arange(n_places), n_streets)):
            rng = np.random.default_rng(np.random.SeedSequence([seed, 19, number]))
            scene = draw_textured_scene("street", rig, len(part), rng)
            views += [(scene, place) for place in range(len(part))]

        def light(job: tuple[TexturedScene, int, int]) -> Float[ndarray, "h w"]:
            scene, place, side = job
            camera = (rig.left, rig.right)[side]
            T = scene.T_left_world[place] if side == 0 else rig.T_right_left @ scene.T_left_world[place]
            return render_scene_light(camera, T, scene.patches_at(place, 0.0), scene.grain, LOOKS.blur_px)

        with ThreadPoolExecutor(n_threads()) as pool:
            self._lights = list(pool.map(light, [(*view, side) for view in views for side in range(2)]))

    def __call__(self, view: int, side: int) -> Float[ndarray, "h w"]:
        """What is behind the board of a view, in the left (0) or right (1) image."""
        return self._lights[2 * (view % (len(self._lights) // 2)) + side]
