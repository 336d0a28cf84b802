"""``binocal uncertainty``: how far a calibrated rig's depth, rows and projection can be trusted, by range and place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocal.calibrators.registry import evidence_of
from binocal.errors import DataError
from binocal.result import StereoCalibration
from binocal.uncertainty.maps import ProjectionMap, RangeMap, projection_map, range_map

WITHOUT_POSES = ("opencv", "absolute-orientation", "zoom")  # calibrators that pass no errors of board poses on
N_RANGES = 6  # from the nearest to the farthest, in equal ratios


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyRun:
    """Maps at rising ranges, and of both cameras' projection at infinity and at the farthest range.

    ``notes`` say what could not be told, and why.
    """

    ranges: tuple[RangeMap, ...]
    projection_far: tuple[ProjectionMap, ...]
    projection_near: tuple[ProjectionMap, ...]
    matching_px: float
    is_metric: bool
    notes: tuple[str, ...] = ()


def tell_uncertainty(
    calibration: StereoCalibration, nearest: float, farthest: float, *, matching_px: float
) -> UncertaintyRun:
    """Uncertainty between two ranges, metres (board pitches without a scale).

    Raises:
        DataError: The calibration states no covariance, or its cameras see nothing together at any of the ranges.
    """
    covariance, rig = calibration.stated_covariance, calibration.rig
    n = 1 if farthest == nearest else N_RANGES
    maps = tuple(
        range_map(
            rig,
            covariance,
            float(depth),
            matching_px=matching_px,
            board_scale_sigma=calibration.board_scale_sigma,
        )
        for depth in np.geomspace(nearest, farthest, n)
    )
    unit = "m" if rig.is_metric else "board pitches"
    if not any(m.field.is_common.any() for m in maps):
        raise DataError(
            f"the cameras see nothing together from {nearest:g} to {farthest:g} {unit}; give another --range."
        )
    notes = []
    if any(not m.field.is_common.any() for m in maps):
        empty = [f"{m.field.depth_m:.3g}" for m in maps if not m.field.is_common.any()]
        notes.append(f"the cameras see nothing together at {', '.join(empty)} {unit}.")
    if not any(np.isfinite(m.row_px).any() for m in maps):
        notes.append("no row error: the rig cannot be rectified.")
    mean_pose = calibration.mean_board_pose
    far: tuple[ProjectionMap, ...] = ()
    near: tuple[ProjectionMap, ...] = ()
    if mean_pose is None:
        notes.append(f"no projection uncertainty: {_why_no_poses(calibration)}.")
    else:
        far, near = (
            tuple(projection_map(rig, covariance, mean_pose, side, distance) for side in ("left", "right"))
            for distance in (np.inf, nearest)
        )
    return UncertaintyRun(maps, far, near, matching_px, rig.is_metric, tuple(notes))


def _why_no_poses(calibration: StereoCalibration) -> str:
    """Why the calibration does not say how the poses of a board err along with the cameras."""
    calibrator = str(calibration.provenance.get("calibrator", ""))
    if evidence_of(calibrator) == "rectangles":
        return "it is of a board's poses, and no board was seen: rectangles told how the cameras turned"
    if calibrator in WITHOUT_POSES:
        return f"calibrator {calibrator!r} does not say how the board poses err with the cameras; lm and drl do"
    return (
        "the file does not say how the board poses err with the cameras (another program or an older release wrote it); "
        "calibrate anew"
    )
