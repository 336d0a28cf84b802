"""The figure of a rig that a requirement asks for: how large, how well known, where it is worst.

What a calibration states of itself is a standard deviation; its figure is the error that 95 % of such rigs stay below, two of them
(expanded uncertainty, k = 2). How well that is known follows from the degrees of freedom behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.errors import DataError, DegenerateGeometryError
from binocal.requirements.requirement import Requirement
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.uncertainty import CommonField, common_field
from binocal.uncertainty.depth import depth_gradients
from binocal.uncertainty.derivatives import pair_derivatives, variance_of
from binocal.uncertainty.rows import row_gradients

COVERAGE = 2.0  # standard deviations of the expanded uncertainty, 95 %
NOTHING_COMMON = "the cameras see nothing together there"


@dataclass(frozen=True, slots=True)
class Figure:
    """``value`` and ``guard`` are in the requirement's unit (shares, pixels, metres): the figure is within ± guard with 95 %.

    ``what`` names it, ``where`` the worst place, ``why`` what a NaN is for, or what else to know. ``is_impossible``: no rig of these
    cameras can meet it.
    """

    value: float
    guard: float
    what: str
    where: str = ""
    why: str = ""
    is_impossible: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """A requirement's figure as linear forms of the rig's parameters, one for each place: the largest standard deviation counts.

    ``gradients`` are in the figure's unit; ``floor`` is the variance that no calibration lowers (matching, the board's size), place
    by place; ``places`` name them.
    """

    gradients: Float[ndarray, "n p"]
    floor: Float[ndarray, "n"]
    places: tuple[str, ...]
    what: str

    def sigmas(self, matrix: Float[ndarray, "p p"]) -> Float[ndarray, "n"]:
        """Standard deviations under a covariance of the parameters."""
        return np.sqrt(variance_of(self.gradients, matrix) + self.floor)


def figure_of_calibration(calibration: StereoCalibration, requirement: Requirement) -> Figure:
    """What the calibration states of itself.

    Raises:
        DataError: The requirement is in metres and the rig in board pitches, or the other way round.
    """
    check_unit(calibration.rig, requirement)
    if requirement.quantity == "reprojection":
        return _reprojection(calibration)
    try:
        covariance = calibration.stated_covariance
    except DataError:
        return Figure(np.nan, np.nan, requirement.quantity, why="the calibration states no covariance; calibrate anew")
    try:
        sensitivity = sensitivity_of(calibration, requirement)
    except DegenerateGeometryError as error:
        return Figure(np.nan, np.nan, requirement.quantity, why=str(error).rstrip("."))
    if not len(sensitivity.gradients):
        return Figure(np.nan, np.nan, requirement.quantity, why=NOTHING_COMMON, is_impossible=True)
    sigmas = sensitivity.sigmas(covariance.matrix)
    worst = int(np.argmax(sigmas))
    value = COVERAGE * float(sigmas[worst])
    floor = COVERAGE * float(np.sqrt(sensitivity.floor[worst]))
    why = ""
    if floor > requirement.limit:
        why = f"{requirement.shown(floor)} of it is not the calibration's (matching, the board's size): no more views help"
    return Figure(value, value * guard_share(calibration), sensitivity.what, sensitivity.places[worst], why)


def sensitivity_of(calibration: StereoCalibration, requirement: Requirement) -> Sensitivity:
    """A requirement's figure as linear forms of the rig's parameters, in the order of its covariance's names.

    Raises:
        DegenerateGeometryError: It is about rows, and the rig cannot be rectified.
        ValueError: It is about reprojection, which is no function of the rig's parameters.
    """
    rig, names = calibration.rig, calibration.covariance.names
    if requirement.quantity == "depth":
        return _depth(calibration, requirement, names)
    if requirement.quantity == "row":
        return _row(calibration, requirement, names)
    if requirement.quantity == "baseline":
        return _baseline(calibration, requirement, names)
    if requirement.quantity != "focal":
        raise ValueError(f"{requirement.quantity} is no function of the rig's parameters")
    gradients, places = [], []
    for side in ("left", "right"):
        for i, axis in enumerate(("fx", "fy")):
            if (name := f"{side}.{axis}") in names:
                size = getattr(rig, side).parameters[i] if requirement.is_relative else 1.0
                gradients.append((np.array(names) == name) / size)
                places.append(f"{axis} of the {side} camera")
    if not gradients:  # all are held
        gradients, places = [np.zeros(len(names))], [""]
    return Sensitivity(
        np.array(gradients), np.zeros(len(gradients)), tuple(places), "the 95 % error of the focal length"
    )


def check_unit(rig: StereoRig, requirement: Requirement) -> None:
    """Raises DataError: the requirement is in metres and the rig in board pitches, or the other way round."""
    if requirement.is_metric is not None and requirement.is_metric != rig.is_metric:
        rig_unit, given = ("metres", "board pitches") if rig.is_metric else ("board pitches", "metres")
        raise DataError(
            f"requirement {requirement.text!r} is in {given}, the rig in {rig_unit}: they cannot be compared."
        )


def freedom_of(calibration: StereoCalibration, more_views: int = 0) -> float:
    """Degrees of freedom behind the stated standard deviations, ``more_views`` added to those of the calibration."""
    n_used = max(len(calibration.views), 2)
    factor = float(calibration.provenance.get("views_in_common", {}).get("sigma_factor", 1.0))
    n_corners = sum(view.n_corners - view.n_outliers for view in calibration.views) * (1 + more_views / n_used)
    return sigma_freedom(n_used + more_views, n_corners, len(calibration.covariance.names), factor)


def sigma_freedom(n_views: int, n_corners: float, n_parameters: int, factor: float) -> float:
    """Degrees of freedom of a standard deviation from so many views and corners.

    Where it was widened by a factor f by what views have in common, the views alone tell that share of the variance, 1 - 1 / f²; all
    corners tell the rest.
    """
    of_corners = max(2 * n_corners - 6 * n_views - n_parameters, 1)
    shared = 1 - 1 / max(factor, 1.0) ** 2
    return float(1 / (shared**2 / max(n_views - 1, 1) + (1 - shared) ** 2 / of_corners))


def guard_share(calibration: StereoCalibration, more_views: int = 0) -> float:
    """Half the 95 % band of a stated standard deviation, over it: sqrt(2 / freedom), at most 1."""
    return float(min(COVERAGE / np.sqrt(2 * freedom_of(calibration, more_views)), 1.0))


def usual_range(calibration: StereoCalibration) -> float:
    """Median distance of the boards; infinite where it is not known."""
    poses = calibration.T_left_board
    return float(np.median(np.linalg.norm(poses.t, axis=-1))) if poses is not None and len(poses.t) else np.inf


def _depth(calibration: StereoCalibration, requirement: Requirement, names: tuple[str, ...]) -> Sensitivity:
    rig = calibration.rig
    assert requirement.range_m is not None  # the parser saw to it
    field = common_field(rig, requirement.range_m)
    points, places = _common(field)
    derivatives = pair_derivatives(rig, names, points)
    gradients, match = depth_gradients(rig, derivatives, points)
    floor = (requirement.matching_px * np.linalg.norm(match, axis=-1)) ** 2 + calibration.board_scale_sigma**2
    scale = 1.0 if requirement.is_relative else requirement.range_m
    keep = np.isfinite(gradients).all(axis=-1)
    what = f"the 95 % error of depth at {_length(rig, requirement.range_m)}"
    return Sensitivity(
        scale * gradients[keep],
        scale**2 * floor[keep],
        tuple(f"at ({x:.0f}, {y:.0f}) of the left image" for x, y in places[keep].tolist()),
        what,
    )


def _row(calibration: StereoCalibration, requirement: Requirement, names: tuple[str, ...]) -> Sensitivity:
    """Over the field at the range that is asked for; where none is, at the boards' distance and at infinity."""
    rig = calibration.rig
    ranges = [requirement.range_m] if requirement.range_m else [usual_range(calibration), np.inf]
    gradients, places = [], []
    for range_m in dict.fromkeys(ranges):
        depth_m = range_m if np.isfinite(range_m) else 1e6 * max(rig.baseline_m, 1e-9)
        points, px = _common(common_field(rig, depth_m))
        own = row_gradients(rig, names, px, np.linalg.norm(points, axis=-1))
        keep = np.isfinite(own).all(axis=-1)
        gradients.append(own[keep])
        away = _length(rig, range_m) + " away" if np.isfinite(range_m) else "far away"
        places += [f"at ({x:.0f}, {y:.0f}) of the left image, {away}" for x, y in px[keep].tolist()]
    stacked = np.concatenate(gradients)
    return Sensitivity(stacked, np.zeros(len(stacked)), tuple(places), "the 95 % row error after rectification")


def _baseline(calibration: StereoCalibration, requirement: Requirement, names: tuple[str, ...]) -> Sensitivity:
    rig = calibration.rig
    along = rig.T_right_left.t / rig.baseline_m
    gradient = np.zeros((1, len(names)))
    for value, axis in zip(along, "xyz", strict=True):
        if (name := f"translation.{axis}") in names:
            gradient[0, names.index(name)] = value
    scale = 1 / rig.baseline_m if requirement.is_relative else 1.0
    floor = np.array([(calibration.board_scale_sigma * rig.baseline_m * scale) ** 2])
    return Sensitivity(scale * gradient, floor, ("",), "the 95 % error of the baseline")


def _reprojection(calibration: StereoCalibration) -> Figure:
    rms_px = calibration.rms.all_px
    n_corners = sum(view.n_corners - view.n_outliers for view in calibration.views)
    seen = [view for view in calibration.views if np.isfinite(view.rms_px)]
    worst = max(seen, key=lambda view: view.rms_px, default=None)
    where = "" if worst is None else f"in view {worst.name} ({worst.rms_px:.3g} px)"
    return Figure(
        rms_px, COVERAGE * rms_px / np.sqrt(max(4 * n_corners, 1)), "the RMS of the calibration's own corners", where
    )


def _common(field: CommonField) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 2"]]:
    return field.points[field.is_common], field.left_px[field.is_common]


def _length(rig: StereoRig, length_m: float) -> str:
    return f"{length_m:.3g} m" if rig.is_metric else f"{length_m:.3g} pitches"
