"""Rendered pairs of a board as files, as a user's camera writes them."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray

from binocal.datasets.folder import ImagePair
from binocal.detection import detect_pairs
from binocal.evidence import Detections
from binocal.images.encoding import encode_image
from binocal.images.preprocessing import Preparation
from binocal.metrics.held_out import is_inside
from binocal.shapes import Float
from binocal.simulation import RenderOptions, StereoScene, render_pairs


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class RenderedFiles:
    """The images of a scene in a folder of their own, which is gone with this; a view's name is its place in the scene."""

    scene: StereoScene
    pairs: Sequence[ImagePair]

    def corners(self, preparation: Preparation | None = None) -> Detections:
        """The corners as a user's images give them.

        Raises:
            DetectionError: As in :func:`binocal.detection.detect_pairs`.
        """
        return detect_pairs(self.pairs, self.scene.board, preparation=preparation).detections

    def exact_px(self) -> tuple[Float[ndarray, "views n 2"], Float[ndarray, "views n 2"]]:
        """The exact corners, left and right (of colour images: green's), NaN outside an image."""
        rig, poses = self.scene.rig, self.scene.T_left_board
        sides = []
        for camera, placed in ((rig.left, poses), (rig.right, rig.T_right_left @ poses)):
            pixels = camera.project(placed.apply(self.scene.board.object_points_m))
            pixels[~is_inside(pixels, camera.size_wh)] = np.nan
            sides.append(pixels)
        return sides[0], sides[1]


def render_files(
    scene: StereoScene,
    looks: RenderOptions | tuple[RenderOptions, RenderOptions],
    seed: np.random.SeedSequence,
    *,
    aberration_px: float | None = None,
) -> RenderedFiles:
    """Render a scene as :func:`binocal.simulation.render_pairs` does; with an aberration in colour."""
    folder = tempfile.mkdtemp(prefix="binocal-experiment-")
    pairs: dict[int, dict[str, Path]] = {}
    for view, side, pixels in render_pairs(scene, looks, seed, aberration_px=aberration_px):
        path = Path(folder) / f"{side}_{view:03d}.png"
        path.write_bytes(encode_image(pixels))
        pairs.setdefault(view, {})[side] = path
    listed = [ImagePair(f"{v:03d}", pairs[v]["left"], pairs[v]["right"]) for v in sorted(pairs)]
    files = RenderedFiles(scene, listed)
    weakref.finalize(files, shutil.rmtree, folder, ignore_errors=True)
    return files
