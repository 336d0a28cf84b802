"""How well the pose between the cameras carries boards from one image to the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from binocal.cameras import StereoRig
from binocal.evidence import Detections
from binocal.solvers.poses import estimate_board_poses


def binocular_error_px(rig: StereoRig, detections: Detections) -> float:
    """The binocular mean reprojection error, pixels: mean distance of corners from where the other camera's view puts them.

    The board's pose of each view is estimated in one camera alone, carried over by ``T_right_left`` and compared with the other
    camera's corners; both ways, over all corners that both cameras saw. NaN where no view has both cameras. It holds the error of
    single-camera poses, so it is larger than a joint reprojection error.
    Source: the figure that Wang, Li, Liu, Huang & Chen 2020 report; their text leaves the formula open, this is our reading.
    """
    unseen = np.full(detections.left_px.shape, np.nan)
    from_left = estimate_board_poses(rig, replace(detections, right_px=unseen))
    from_right = estimate_board_poses(rig, replace(detections, left_px=unseen))
    distances = []
    for found, camera, T, px in (
        (from_left, rig.right, rig.T_right_left @ from_left.T_left_board, detections.right_px),
        (from_right, rig.left, from_right.T_left_board, detections.left_px),
    ):
        predicted = camera.project(T.apply(detections.object_points_m))
        distance = np.linalg.norm(px - predicted, axis=-1)
        distances.append(distance[found.is_found[:, None] & np.isfinite(distance)])
    together = np.concatenate(distances)
    return float(together.mean()) if len(together) else float("nan")
