"""Where a board's corners must be in one camera's image, by what the other camera sees of it and the rig."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig
from binocal.errors import BinocalError
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.shapes import Float

LEAST_CORNERS = 8  # of the other camera: its pose must hold beyond what it sees
LEAST_NOISE_PX = 0.1
MOST_SIGMA = 0.05  # of the distance to the next corner: a part is named to a quarter of it (place_near)
_STEP = 1e-6


def expected_corners(
    detections: Detections, parts: Sequence[tuple[int, str]], *, rig: StereoRig | None = None
) -> list[Float[ndarray, "n 2"] | None]:
    """For each view and camera, pixels: where the board's corners must lie, NaN where that is not known to a twentieth of a square.

    Without a ``rig`` it is calibrated from the views in which both cameras' corners have names; None for all where they do not do.
    """
    sigma_rad = sigma_m = 0.0
    if rig is None:
        both = np.flatnonzero(detections.left_is_seen.any(axis=1) & detections.right_is_seen.any(axis=1))
        from binocal.calibrators import calibrate

        try:
            calibration = calibrate(detections.select(both), calibrator="lm")
        except BinocalError:
            return [None] * len(parts)
        rig, sigma = calibration.rig, calibration.covariance.sigma
        sigma_rad = float(np.linalg.norm([sigma[f"rotation.{axis}"] for axis in "xyz"]))
        sigma_m = float(np.linalg.norm([sigma[f"translation.{axis}"] for axis in "xyz"]))
    return [_expected(detections, view, side, rig, (sigma_rad, sigma_m)) for view, side in parts]


def _expected(
    detections: Detections, view: int, side: str, rig: StereoRig, rig_sigma: tuple[float, float]
) -> Float[ndarray, "n 2"] | None:
    from binocal.solvers.poses import estimate_board_poses

    posed = estimate_board_poses(rig, detections.select(np.array([view])))
    known = detections.left_is_seen[view] if side == "right" else detections.right_is_seen[view]
    if not posed.is_found[0] or known.sum() < LEAST_CORNERS:
        return None
    points = detections.object_points_m
    T_left_board = SE3(posed.T_left_board.R[0], posed.T_left_board.t[0])
    T_right_board = rig.T_right_left @ T_left_board
    (camera, T), (other, T_other) = (
        ((rig.right, T_right_board), (rig.left, T_left_board))
        if side == "right"
        else ((rig.left, T_left_board), (rig.right, T_right_board))
    )
    T_between = T @ T_other.inverse()
    expected = _seen_by(camera, T.apply(points))
    # What the other camera's corners leave open of the pose moves its view, and by that this one's.
    J_other = _derivatives(other, points[known], T_other, SE3.identity())
    J = _derivatives(camera, points, T_other, T_between)
    r2 = np.concatenate([posed.left_r2_px2[0], posed.right_r2_px2[0]])
    noise_px = max(LEAST_NOISE_PX, float(np.sqrt(np.nanmean(r2) / 2)))
    pose = noise_px**2 * np.linalg.pinv(np.einsum("ncp,ncq->pq", J_other, J_other))
    variance = np.einsum("ncp,pq,ncq->n", J, pose, J)
    depth = np.maximum(T.apply(points)[:, 2], 1e-9)
    variance += (camera.parameters[0] * (rig_sigma[0] + rig_sigma[1] / depth)) ** 2
    step = np.linalg.norm(expected[:, None] - expected, axis=-1)
    np.fill_diagonal(step, np.inf)
    step = np.where(np.isfinite(step), step, np.inf).min(axis=1)
    with np.errstate(invalid="ignore"):
        is_known = np.sqrt(variance) < MOST_SIGMA * step
    return np.where(is_known[:, None], expected, np.nan)


def _seen_by(camera: Camera, points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 2"]:
    """Pixels, NaN where the camera does not see that far aside."""
    px = camera.project(points)
    reach = np.array(camera.size_wh, dtype=float)
    with np.errstate(invalid="ignore"):
        is_near = ((px > -reach) & (px < 2 * reach)).all(axis=1) & (points[:, 2] > 0)
    return np.where(is_near[:, None], px, np.nan)


def _derivatives(
    camera: Camera, points: Float[ndarray, "n 3"], T_board: SE3, T_between: SE3
) -> Float[ndarray, "n 2 6"]:
    """Of the pixels with respect to left steps of the pose before the other camera, by central differences."""
    columns = []
    for axis in range(6):
        moved = []
        for sign in (1.0, -1.0):
            xi = np.zeros(6)
            xi[axis] = sign * _STEP
            T = T_between @ SE3(so3.exp(xi[:3]), xi[3:]) @ T_board
            moved.append(camera.project(T.apply(points)))
        columns.append((moved[0] - moved[1]) / (2 * _STEP))
    return np.stack(columns, axis=-1)
