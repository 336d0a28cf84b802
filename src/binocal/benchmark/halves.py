"""How two calibrations of one rig differ, each from half of the views, and whether their stated sigmas say so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.errors import BinocalError
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.metrics.image import row_differences, triangulate
from binocal.result import StereoCalibration
from binocal.shapes import Float, Int
from binocal.uncertainty import common_field, depth_sigma

GROUPS = {"baseline": slice(0, 1), "rotation": slice(1, 4), "focal": slice(4, 8), "centre": slice(8, 12)}
"""Places in the vector of compared figures: baseline (m), rotation vector (rad), focal lengths and principal points (px)."""
N_FIGURES = 12
DEPTH_RANGES = (1.0, 3.0)  # times the boards' median distance
_INTRINSICS = tuple(
    f"{side}.{name}" for pair in (("fx", "fy"), ("cx", "cy")) for side in ("left", "right") for name in pair
)


def split_halves(
    n_views: int, used: Int[ndarray, "k"], n_splits: int, seed: Sequence[int]
) -> list[tuple[Int[ndarray, "a"], Int[ndarray, "b"]]]:
    """Random halves of the ``used`` ones of ``n_views`` views, as places in ``used``; the second has one more where they are odd.

    All views are put in a random order and the used ones cut in two, so that one view more or less hardly changes the halves.
    """
    rng, place = np.random.default_rng(list(seed)), np.full(n_views, -1)
    place[used] = np.arange(len(used))
    halves = []
    for _ in range(n_splits):
        order = place[rng.permutation(n_views)]
        order = order[order >= 0]
        middle = len(order) // 2
        halves.append((np.sort(order[:middle]), np.sort(order[middle:])))
    return halves


def differences(a: StereoRig, b: StereoRig) -> Float[ndarray, "12"]:
    """First minus second rig, see :data:`GROUPS`.

    The rotation vector takes the second's ``R`` to the first's, from the left: it lives in the right camera's frame.
    """
    intrinsics = [
        getattr(x, side).parameters[2 * i : 2 * i + 2] for x in (a, b) for i in (0, 1) for side in ("left", "right")
    ]
    turn_rad = so3.log(a.T_right_left.R @ b.T_right_left.R.T)
    return np.r_[a.baseline_m - b.baseline_m, turn_rad, np.ravel(intrinsics[:4]) - np.ravel(intrinsics[4:])]


def stated_sigmas(calibration: StereoCalibration) -> Float[ndarray, "12"]:
    """Standard deviations that a calibration states of the figures of :data:`GROUPS`; NaN where it states none."""
    sigma = calibration.covariance.sigma
    rotation = [sigma.get(f"rotation.{axis}", np.nan) for axis in "xyz"]
    return np.r_[
        baseline_sigma_without_board_scale(calibration), rotation, [sigma.get(name, np.nan) for name in _INTRINSICS]
    ]


def baseline_sigma_without_board_scale(calibration: StereoCalibration) -> float:
    """The baseline's standard deviation for a comparison between halves, which share the board and so any error of its size.

    A result that counts the board's scale in its covariance has that part taken out here.
    """
    return calibration.baseline_sigma_m


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What a method made of a half: its rig, the sigmas it states if any, codes of its findings; or why it made none."""

    rig: StereoRig | None = None
    sigmas: Float[ndarray, "12"] | None = None
    findings: tuple[str, ...] = ()
    failure: str = ""
    calibration: StereoCalibration | None = None
    """Of a method of ours: what it states of depth."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutRows:
    """Row errors of a rig on views that it was not computed from, px: RMS of all corners, and that of the median view.

    NaN where the rig cannot be rectified. ``n_without_ray`` corners count in neither: the camera model has no ray for them.
    """

    rms_px: float
    median_view_px: float
    n_without_ray: int


def held_out_rows(rig: StereoRig, detections: Detections) -> HeldOutRows:
    """Row errors on views that the rig was not computed from."""
    try:
        error = row_differences(rig, detections)
    except BinocalError:
        return HeldOutRows(np.nan, np.nan, 0)
    both = detections.left_is_seen & detections.right_is_seen
    per_view = np.array([rms(view) for view in error])
    median_px = float(np.nanmedian(per_view)) if np.isfinite(per_view).any() else np.nan
    return HeldOutRows(rms(error), median_px, int((both & np.isnan(error)).sum()))


def differences_by_split(pairs: Sequence[tuple[Estimate, Estimate]]) -> dict[str, Float[ndarray, "splits"]]:
    """Differences of the halves of each split; NaN where one of them failed.

    Angle of the rotation (deg), baseline (% of the mean of both, signed), RMS over the focal lengths and principal points (px).
    """
    delta = np.full((len(pairs), N_FIGURES), np.nan)
    mean_m = np.full(len(pairs), np.nan)
    for i, (a, b) in enumerate(pairs):
        if a.rig is not None and b.rig is not None:
            delta[i] = differences(a.rig, b.rig)
            mean_m[i] = (a.rig.baseline_m + b.rig.baseline_m) / 2
    return {
        "rotation_deg": np.degrees(np.linalg.norm(delta[:, GROUPS["rotation"]], axis=1)),
        "baseline_percent": 100 * delta[:, 0] / mean_m,
        "focal_centre_px": np.sqrt(np.mean(delta[:, 4:] ** 2, axis=1)),
    }


def z_scores(pairs: Sequence[tuple[Estimate, Estimate]]) -> Float[ndarray, "splits 12"]:
    """Differences of halves over the stated sigma of the difference; splits in which a half failed or states none are left out."""
    scores = [
        differences(a.rig, b.rig) / np.sqrt(a.sigmas**2 + b.sigmas**2)
        for a, b in pairs
        if a.rig is not None and b.rig is not None and a.sigmas is not None and b.sigmas is not None
    ]
    return np.array(scores).reshape(-1, N_FIGURES)


def depth_scores(pairs: Sequence[tuple[Estimate, Estimate]]) -> list[Float[ndarray, "_"]]:
    """Differences of the halves' depths over their stated sigma, split by split, over the image at :data:`DEPTH_RANGES`.

    What the first half's rig sees at a place and range, the second's measures from the same pixels. The size of the board, which
    both share, does not count. Splits in which a half failed, or no place is seen by both cameras, are left out.
    """
    scores = []
    for a, b in pairs:
        if a.calibration is None or b.calibration is None:
            continue
        z = [_depth_differences(a.calibration, b.calibration, share) for share in DEPTH_RANGES]
        known = np.concatenate([part[np.isfinite(part)] for part in z])
        if len(known):
            scores.append(known)
    return scores


def _depth_differences(a: StereoCalibration, b: StereoCalibration, share: float) -> Float[ndarray, "k"]:
    assert a.T_left_board is not None
    field = common_field(a.rig, share * float(np.median(np.linalg.norm(a.T_left_board.t, axis=-1))))
    points = field.points[field.is_common]
    pixels = a.rig.left.project(points), a.rig.right.project(a.rig.T_right_left.apply(points))
    measured, _ = triangulate(b.rig, *pixels)
    difference = np.linalg.norm(measured, axis=-1) / np.linalg.norm(points, axis=-1) - 1
    told = [depth_sigma(c.rig, c.stated_covariance, points) for c in (a, b)]
    return difference / np.hypot(*(t.calibration_m / t.depth_m for t in told))


def summarise_depth(scores: Sequence[Float[ndarray, "_"]]) -> dict[str, float]:
    """RMS and shares within 1 and 2 over all splits, each of which counts alike."""
    if not scores:
        return {"rms": np.nan, "within_1": np.nan, "within_2": np.nan, "n": 0}
    return {
        "rms": float(np.sqrt(np.mean([np.mean(z**2) for z in scores]))),
        "within_1": float(np.mean([np.mean(np.abs(z) < 1) for z in scores])),
        "within_2": float(np.mean([np.mean(np.abs(z) < 2) for z in scores])),
        "n": len(scores),
    }


def summarise_z(scores: Float[ndarray, "splits 12"]) -> dict[str, dict[str, float]]:
    """RMS and shares within 1 and 2 of each group of figures and of ``all``; figures without a stated sigma do not count."""
    groups = {name: scores[:, place] for name, place in GROUPS.items()} | {"all": scores}
    summary = {}
    for name, group in groups.items():
        z = np.abs(group[np.isfinite(group)])
        within = (np.nan, np.nan) if not len(z) else (float(np.mean(z < 1)), float(np.mean(z < 2)))
        summary[name] = {"rms": rms(z), "within_1": within[0], "within_2": within[1], "n": len(z)}
    return summary


def rms(values: ndarray) -> float:
    """Root of the mean square of what is not NaN; NaN of nothing."""
    known = np.asarray(values)[~np.isnan(values)]
    return float(np.sqrt(np.mean(np.square(known)))) if known.size else np.nan
