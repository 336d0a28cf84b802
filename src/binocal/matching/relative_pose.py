"""A first guess of the pose between two cameras, from matches alone: OpenCV's MAGSAC on rays."""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.geometry import SE3, so3
from binocal.shapes import Float

THRESHOLD_PX = 0.7
CONFIDENCE, MAX_ITERATIONS = 0.999, 5000
MIN_MATCHES = 8


def estimate_relative_pose(
    cameras: tuple[Camera, Camera], left_px: Float[ndarray, "n 2"], right_px: Float[ndarray, "n 2"]
) -> SE3 | None:
    """``T_right_left`` with a translation of length 1, or None where the matches give none.

    Source: Barath et al. 2020, "MAGSAC++"; the sign by which most points lie in front of both cameras. Good to a few tenths of a
    degree, never to be taken for a result.
    """
    rays = [camera.unproject(px) for camera, px in zip(cameras, (left_px, right_px), strict=True)]
    is_in_front = np.logical_and(*(np.isfinite(r).all(axis=1) & (r[:, 2] > 0.1) for r in rays))
    if is_in_front.sum() < MIN_MATCHES:
        return None
    left, right = (np.ascontiguousarray(r[is_in_front, :2] / r[is_in_front, 2:]) for r in rays)
    focal_px = float(np.mean([camera.parameters[:2].mean() for camera in cameras]))
    try:
        E, mask = cv2.findEssentialMat(
            left,
            right,
            np.eye(3),
            method=cv2.USAC_MAGSAC,
            prob=CONFIDENCE,
            threshold=THRESHOLD_PX / focal_px,
            maxIters=MAX_ITERATIONS,
        )
        if E is None or E.shape[0] < 3:
            return None
        _, R, t, _ = cv2.recoverPose(E[:3], left, right, np.eye(3), mask=mask)
    except cv2.error:
        return None
    length = float(np.linalg.norm(t))
    return SE3(so3.project_to_rotation(R), t.ravel() / length) if length > 0 and np.isfinite(R).all() else None
