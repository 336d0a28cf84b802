"""The last judge: is a solved rig a result, or only a number?

Each check either raises with the culprit's name or adds a sentence to the warnings. None of them changes the rig.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.errors import DegenerateGeometryError, InconsistentViewsError, NotConvergedError
from binocal.evidence import Detections
from binocal.result import StereoCalibration
from binocal.shapes import Float

MAX_NOISE_SHARE = 0.08
"""Corner noise over corner spacing.

Real images reach 0.02 (270x180); a wrong corner order or board leaves 0.3 and more.
"""
MAX_FOCAL_SIGMA_SHARE = 0.05
"""Relative standard deviation of a focal length.

Fronto-parallel views leave 0.07-0.6 at 0.1-0.5 px, three good views 0.001-0.004.
"""
WARN_FOCAL_SIGMA_SHARE = 0.01
MAX_ROTATION_SIGMA_DEG = 1.0
"""Standard deviation of the rotation between the cameras. Six weak views leave 0.05-0.3, three 0.1-0.7; a degree is 17 mm per metre."""
MAX_BASELINE_SIGMA_SHARE = 0.2
"""Standard deviation of the translation over the baseline. One pose repeated leaves 0.4-3, six weak views 0.01-0.05."""
MIN_NORMAL_SPREAD_DEG = 2.0
"""Spread of the board's directions below which views count as parallel.

Unless the focal lengths are known in spite of it.
"""
PARALLEL_FOCAL_SIGMA_SHARE = 0.002
MAX_SPACING_VIEWS = 12  # evenly chosen; the median spacing of eight real sets is then within 2.5 % of all views'
MAX_OUTLIER_SHARE = 0.3  # a robust fit that drops more than this has chosen one story among several

MAX_CENTRE_OFFSET_SHARE = 0.25
"""Distance of a principal point from the image's middle over the image's size. Lenses sit within 0.1, KITTI's crops within 0.05; a fit
to boards that stay in one part of the image, at one tilt, runs off to 0.3 and more."""
CENTRE_OFFSET_SIGNIFICANCE = 5.0  # standard deviations; a poorly known principal point is not thereby a wrong one

SHORT_OF_MIDDLE_SHARE = 0.04
LEAST_SHORT_OF_MIDDLE_SHARE = 0.02
"""Both principal points this far short of the middle along an axis, on average and each: lenses scatter by 1.5 % either way, an image size
stated 12 % too large moves both by 5.5 % the same way."""

_ADD_TILTS = "add views with the board tilted 20-45 deg about both axes, at different distances"


def judged(calibration: StereoCalibration, *, is_converged: bool) -> StereoCalibration:
    """The calibration with the warnings of this room put first.

    Raises:
        InconsistentViewsError: The corners cannot be images of this board.
        DegenerateGeometryError: The views do not determine the rig.
        NotConvergedError: The solver did not reach a minimum.
    """
    check_fit(calibration)
    warnings = check_observability(calibration)
    if not is_converged:
        raise NotConvergedError(
            f"the joint solve did not reach a minimum in {calibration.n_iterations} iterations; "
            f"the views may leave parameters undetermined: {_ADD_TILTS}.",
            describe_views(calibration),
        )
    return replace(calibration, warnings=(*warnings, *calibration.warnings))


def check_fit(calibration: StereoCalibration) -> None:
    """Raises InconsistentViewsError where the corners cannot be images of this board."""
    if calibration.evidence is None:
        return
    spacing_px = corner_spacing_px(calibration.evidence.detections)
    if calibration.noise_px > MAX_NOISE_SHARE * spacing_px:
        raise InconsistentViewsError(
            f"the corners do not fit the board: residuals of {calibration.noise_px:.2f} px where corners are "
            f"{spacing_px:.1f} px apart; check the board's columns, rows and corner order, and that left and right images "
            "were taken together.",
            describe_views(calibration),
        )
    n_outliers = sum(v.n_outliers for v in calibration.views)
    n_corners = sum(v.n_corners for v in calibration.views)
    if n_outliers > MAX_OUTLIER_SHARE * n_corners:
        raise InconsistentViewsError(
            f"{n_outliers} of {n_corners} corners contradict the rest; "
            "check the corner order, the pairing of left and right, and the camera model.",
            describe_views(calibration),
        )


def check_observability(calibration: StereoCalibration) -> tuple[str, ...]:
    """Warnings about weak geometry.

    Raises:
        DegenerateGeometryError: The views do not determine the rig; ``rejected`` says what each of them shows.
    """
    sigma = calibration.covariance.sigma
    warnings = []
    spread_deg = normal_spread_deg(board_normals(calibration))
    for side, camera in (("left", calibration.rig.left), ("right", calibration.rig.right)):
        share = max(sigma[f"{side}.fx"] / camera.parameters[0], sigma[f"{side}.fy"] / camera.parameters[1])
        is_parallel = spread_deg < MIN_NORMAL_SPREAD_DEG and share > PARALLEL_FOCAL_SIGMA_SHARE
        if share > MAX_FOCAL_SIGMA_SHARE or is_parallel:
            raise DegenerateGeometryError(
                f"the views do not determine the {side} focal length (standard deviation {100 * share:.1f} %): "
                f"the board's directions differ by only {spread_deg:.1f} deg; {_ADD_TILTS}.",
                describe_views(calibration),
            )
        if share > WARN_FOCAL_SIGMA_SHARE:
            warnings.append(
                f"the {side} focal length is known only to {100 * share:.1f} % (one standard deviation); {_ADD_TILTS}."
            )
        size, centre = np.array(camera.size_wh), camera.parameters[2:4]
        offset = np.abs(centre - (size - 1) / 2)
        sigma_centre = np.array([sigma[f"{side}.cx"], sigma[f"{side}.cy"]])
        if np.any((offset > MAX_CENTRE_OFFSET_SHARE * size) & (offset > CENTRE_OFFSET_SIGNIFICANCE * sigma_centre)):
            raise DegenerateGeometryError(
                f"the {side} principal point ({centre[0]:.0f}, {centre[1]:.0f}) comes out far from the middle of the "
                f"{size[0]}x{size[1]} image, which no lens does: the boards say too little about the camera, or the "
                f"images are cropped; move the board over the whole image and {_ADD_TILTS}.",
                describe_views(calibration),
            )
    sigma_deg = float(np.degrees(max(sigma[f"rotation.{axis}"] for axis in "xyz")))
    if sigma_deg > MAX_ROTATION_SIGMA_DEG:
        raise DegenerateGeometryError(
            "the views do not determine the rotation between the cameras (standard deviation "
            f"{sigma_deg:.1f} deg); move the board over the whole of both images and {_ADD_TILTS}.",
            describe_views(calibration),
        )
    sigma_t = float(np.sqrt(sum(sigma[f"translation.{axis}"] ** 2 for axis in "xyz")))
    baseline = calibration.rig.baseline_m
    if sigma_t > MAX_BASELINE_SIGMA_SHARE * baseline:
        raise DegenerateGeometryError(
            "the views do not determine the translation between the cameras (standard deviation "
            f"{100 * sigma_t / baseline:.0f} % of the baseline); {_ADD_TILTS}.",
            describe_views(calibration),
        )
    return (*warnings, *size_warnings(calibration))


def size_warnings(calibration: StereoCalibration) -> tuple[str, ...]:
    """A sentence where the stated images look larger than those in which the corners were measured.

    Along an axis both principal points lie short of the middle, and no corner lies beyond the size that would put them there.
    """
    if calibration.evidence is None:
        return ()
    detections, rig = calibration.evidence.detections, calibration.rig
    sizes = np.array([rig.left.size_wh, rig.right.size_wh], dtype=float)
    centres = np.array([rig.left.parameters[2:4], rig.right.parameters[2:4]])
    short = 0.5 - (centres + 0.5) / sizes
    implied = 2 * centres + 1
    is_short = (short.mean(axis=0) > SHORT_OF_MIDDLE_SHARE) & (short.min(axis=0) > LEAST_SHORT_OF_MIDDLE_SHARE)
    if not is_short.any():
        return ()
    far = np.array([np.nanmax(px, axis=(0, 1)) for px in (detections.left_px, detections.right_px)])
    is_suspect = is_short & np.all(far < 1.01 * implied, axis=0)
    if not is_suspect.any():
        return ()
    width, height = np.where(is_suspect, implied.mean(axis=0), sizes[0])
    return (
        f"both principal points lie short of the middle of the {sizes[0, 0]:.0f}x{sizes[0, 1]:.0f} images and no corner "
        f"lies beyond: check the image size, about {width:.0f}x{height:.0f} would fit.",
    )


def describe_views(calibration: StereoCalibration) -> dict[str, str]:
    """What each used view shows, for a refusal: tilt, place and residual. Views that were rejected before keep their reasons."""
    described = {view.name: view.reason for view in calibration.rejected}
    if calibration.evidence is None:
        return described
    evidence = calibration.evidence.detections
    width, height = evidence.left_size_wh
    tilt_deg = np.degrees(np.arccos(np.clip(np.abs(board_normals(calibration)[:, 2]), 0, 1)))
    for index, view in enumerate(calibration.views):
        px = evidence.left_px[index]
        seen = px[np.isfinite(px[:, 0])]
        place = ""
        if len(seen):
            share = np.ptp(seen, axis=0) / (width, height)
            x, y = seen.mean(axis=0)
            place = f", {100 * share[0]:.0f} % x {100 * share[1]:.0f} % of the left image around ({x:.0f}, {y:.0f})"
        described[view.name] = (
            f"not used, the set is refused: board tilted {tilt_deg[index]:.0f} deg{place}, residual {view.rms_px:.2f} px"
        )
    return described


def board_normals(calibration: StereoCalibration) -> Float[ndarray, "views 3"]:
    """The board's direction in the left frame, one per used view; empty without evidence."""
    return calibration.evidence.T_left_board.R[:, :, 2] if calibration.evidence else np.empty((0, 3))


def normal_spread_deg(normals: Float[ndarray, "views 3"]) -> float:
    """RMS angle between the directions and their mean."""
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    mean = unit.sum(axis=0)
    mean /= np.linalg.norm(mean)
    chords = np.minimum(np.linalg.norm(unit - mean, axis=1), 2.0)
    return float(np.degrees(np.sqrt(np.mean((2 * np.arcsin(chords / 2)) ** 2))))


def corner_spacing_px(detections: Detections, most_views: int = MAX_SPACING_VIEWS) -> float:
    """Median distance in the images of corners that are neighbours on the board; NaN where none are seen."""
    points = detections.object_points_m
    half = 0.5 * np.square(points).sum(axis=1)
    distance2 = half - points @ points.T  # half of it, short of a constant for each row
    np.fill_diagonal(distance2, np.inf)
    nearest = np.argmin(distance2, axis=1)
    n_some = min(detections.n_views, most_views)
    some = np.arange(n_some) * (detections.n_views - 1) // max(n_some - 1, 1)
    px = np.concatenate([detections.left_px[some], detections.right_px[some]])
    steps = px[:, nearest] - px
    gaps2 = np.vecdot(steps, steps).ravel()
    gaps2 = gaps2[np.isfinite(gaps2)]
    return float(np.sqrt(np.partition(gaps2, len(gaps2) // 2)[len(gaps2) // 2])) if len(gaps2) else float("nan")
