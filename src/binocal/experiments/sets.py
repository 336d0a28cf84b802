"""The sets of the paper's table 4 where no real ones are given: streets as KITTI's and Cityscapes' rigs see them, boards before ours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binocal.boards import Board
from binocal.cameras import Camera, StereoRig
from binocal.datasets import StereoPair
from binocal.experiments.boards import FILL, LOOKS
from binocal.geometry import SE3
from binocal.images.png import encode_png
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


def render_street(street: StreetRig, n_pairs: int, seed: int, folder: Path) -> list[StereoPair]:
    """Pairs of a street that the rig drives along, as PNG files."""
    scene_seed, image_seed = np.random.SeedSequence([seed, 8]).spawn(2)
    rig = street.rig()
    scene = draw_textured_scene("street", rig, n_pairs, np.random.default_rng(scene_seed))
    for pair, side, pixels in render_scene_pairs(rig, scene, SceneOptions(0.8, 3.0, 0.0), image_seed):
        (folder / f"{side}_{pair:03d}.png").write_bytes(encode_png(pixels))
    return [
        StereoPair(f"{pair:03d}", folder / f"left_{pair:03d}.png", folder / f"right_{pair:03d}.png")
        for pair in range(n_pairs)
    ]


def render_boards(board: Board, n_pairs: int, seed: int, folder: Path) -> None:
    """left_*.png and right_*.png of a board before the rig of the paper's table 2."""
    pose_seed, image_seed = np.random.SeedSequence([seed, 9]).spawn(2)
    rig = table2_rig()
    poses = sample_board_poses(rig, board, n_pairs, np.random.default_rng(pose_seed), PoseOptions(fill=FILL))
    for view, side, pixels in render_pairs(StereoScene(rig, board, poses), (LOOKS, LOOKS), image_seed):
        (folder / f"{side}_{view:04d}.png").write_bytes(encode_png(pixels))
