"""Figures that images or the truth tell, rather than the calibration itself."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.errors import DegenerateGeometryError
from binocal.evidence import Detections
from binocal.metrics.image import PixelError, row_differences, triangulate
from binocal.requirements.figures import COVERAGE, NOTHING_COMMON, Figure, check_unit, sensitivity_of
from binocal.requirements.requirement import Requirement
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.uncertainty import common_field
from binocal.uncertainty.derivatives import variance_of

COLUMNS, ROWS = 4, 3
LEAST_CORNERS = 20  # of a region of the image, for its mean row error to count
LEAST_VIEWS = 3  # whose means tell how well that is known; of fewer, the corners do


def reprojection_figure(error: PixelError, names: tuple[str, ...]) -> Figure:
    """The RMS of corners that the calibration has not seen, and the view where it is largest."""
    where = ""
    if np.isfinite(error.view_rms_px).any():
        worst = int(np.nanargmax(error.view_rms_px))
        where = f"in view {names[worst]} ({error.view_rms_px[worst]:.3g} px)"
    guard = COVERAGE * error.all_px / np.sqrt(max(4 * error.n_corners, 1))
    return Figure(error.all_px, guard, "the RMS of these images' corners", where)


def row_figure(rig: StereoRig, detections: Detections) -> Figure:
    """The largest mean row error in any of 3 x 4 regions of the left image: what is left once the corners' noise is averaged out.

    A region's mean is known as its views scatter. NaN where no region has enough corners.
    """
    what = "the mean row error after rectification"
    try:
        difference = row_differences(rig, detections)
    except DegenerateGeometryError as error:
        return Figure(np.nan, np.nan, what, why=str(error).rstrip("."))
    known = np.isfinite(difference)
    with np.errstate(invalid="ignore"):
        place = np.floor((detections.left_px + 0.5) / np.array(rig.left.size_wh) * (COLUMNS, ROWS))
    found: list[tuple[float, float, str]] = []
    for row in range(ROWS):
        for column in range(COLUMNS):
            own = known & (place[..., 0] == column) & (place[..., 1] == row)
            if own.sum() < LEAST_CORNERS:
                continue
            mean = float(difference[own].mean())
            x, y = detections.left_px[own].mean(axis=0)
            found.append((abs(mean), _standard_error(difference, own), f"about ({x:.0f}, {y:.0f}) of the left image"))
    if not found:
        return Figure(
            np.nan, np.nan, what, why=f"no part of the image has {LEAST_CORNERS} corners that both cameras saw"
        )
    value, error, where = max(found)
    return Figure(value, COVERAGE * error, what, where)


def _standard_error(difference: Float[ndarray, "views n"], own: ndarray) -> float:
    """Of the mean over the chosen corners: from their views' means, weighed by their corners, where there are enough views."""
    count = own.sum(axis=1)
    seen = count > 0
    sums = np.where(own, difference, 0.0).sum(axis=1)[seen]
    count = count[seen]
    if len(count) < LEAST_VIEWS:
        return float(difference[own].std() / np.sqrt(max(own.sum() - 1, 1)))
    rest = sums - count * sums.sum() / count.sum()
    return float(np.sqrt(len(count) / (len(count) - 1) * np.sum(rest**2)) / count.sum())


def shifted_figure(
    calibration: StereoCalibration,
    requirement: Requirement,
    names: tuple[str, ...],
    shift: Float[ndarray, "p"],
    covariance: Float[ndarray, "p p"],
) -> Figure:
    """The error that a rig has which is off by ``shift``, known to ``covariance``, both of the named parameters."""
    check_unit(calibration.rig, requirement)
    try:
        sensitivity = sensitivity_of(calibration, requirement)
    except DegenerateGeometryError as error:
        return Figure(np.nan, np.nan, requirement.quantity, why=str(error).rstrip("."))
    if not len(sensitivity.gradients):
        return Figure(np.nan, np.nan, requirement.quantity, why=NOTHING_COMMON, is_impossible=True)
    G = sensitivity.gradients[:, [calibration.covariance.names.index(name) for name in names]]
    off = np.abs(G @ shift)
    worst = int(np.argmax(off))
    guard = COVERAGE * float(np.sqrt(variance_of(G[worst], covariance)))
    what = sensitivity.what.replace("the 95 % error", "the error").replace("the 95 % row", "the row")
    return Figure(float(off[worst]), guard, f"{what}, by these images,", sensitivity.places[worst])


def true_figure(calibration: StereoCalibration, truth: StereoRig, requirement: Requirement) -> Figure:
    """The error that the rig has against the truth, exactly: nothing is left to chance."""
    rig = calibration.rig
    check_unit(rig, requirement)
    quantity = requirement.quantity
    if quantity == "reprojection":
        return Figure(calibration.rms.all_px, 0.0, "the RMS of the calibration's own corners")
    if quantity == "baseline":
        error = abs(rig.baseline_m - truth.baseline_m)
        return Figure(error / truth.baseline_m if requirement.is_relative else error, 0.0, "the error of the baseline")
    if quantity == "focal":
        errors = {}
        for side in ("left", "right"):
            found, true = getattr(rig, side).parameters[:2], getattr(truth, side).parameters[:2]
            for axis, a, b in zip(("fx", "fy"), found, true, strict=True):
                errors[f"{axis} of the {side} camera"] = abs(a - b) / (b if requirement.is_relative else 1.0)
        where = max(errors, key=lambda name: errors[name])
        return Figure(float(errors[where]), 0.0, "the error of the focal length", where)
    range_m = requirement.range_m if requirement.range_m else 1e3 * truth.baseline_m
    field = common_field(truth, range_m)
    if not field.is_common.any():
        return Figure(np.nan, np.nan, quantity, why=NOTHING_COMMON, is_impossible=True)
    points, px = field.points[field.is_common], field.left_px[field.is_common]
    left, right = truth.left.project(points), truth.right.project(truth.T_right_left.apply(points))
    if quantity == "depth":
        measured, _ = triangulate(rig, left, right)
        off = np.abs(np.linalg.norm(measured, axis=1) / np.linalg.norm(points, axis=1) - 1)
        off = np.where(np.isnan(off), np.inf, off) * (1.0 if requirement.is_relative else range_m)
        what = "the error of depth"
    else:
        exact = Detections.from_arrays(
            points, left[None], right[None], rig.left.size_wh, right_image_size_wh=rig.right.size_wh
        )
        off, what = np.abs(np.nan_to_num(row_differences(rig, exact)[0])), "the row error after rectification"
    x, y = px[int(np.argmax(off))]
    return Figure(float(off.max()), 0.0, what, f"at ({x:.0f}, {y:.0f}) of the left image")
