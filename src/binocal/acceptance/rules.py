"""The table of rules: each a finding's code, its limits with their measured reasons, and the check."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from binocal.acceptance import variety
from binocal.acceptance.figures import (
    board_normals,
    common_factor,
    corner_spacing_px,
    focal_sigma_share,
    normal_spread_deg,
    translation_sigma,
)
from binocal.acceptance.views import describe_views
from binocal.cameras.ray_coverage import pixels_without_ray
from binocal.findings import KINDS, TILTS, Finding, Severity, finding, refusal
from binocal.result import StereoCalibration
from binocal.solvers import robust


@dataclass(frozen=True, slots=True)
class Limit:
    """A threshold: what is compared with it, its value in that unit, and why there."""

    what: str
    value: float
    unit: str
    reason: str


Figures = Iterator[dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Rule:
    """A check of a solved rig. ``check`` yields the figures of each finding; ``limits`` are all that it compares with."""

    code: str
    check: Callable[[StereoCalibration], Figures]
    limits: tuple[Limit, ...]

    def findings(self, calibration: StereoCalibration) -> list[Finding]:
        """What the check has to say; advice that asks for tilts asks for what else is missing where they are there."""
        found = list(self.check(calibration))
        remedy = variety.advise(calibration) if found and KINDS[self.code].remedy == TILTS else None
        return [finding(self.code, remedy=remedy, **figures) for figures in found]


NOISE_SHARE = Limit(
    "corner noise over corner spacing",
    0.12,
    "",
    "real images reach 0.02 (270x180), 1 px of noise at 11 px 0.09, a wrong board or corner order 0.3 and more",
)
OUTLIER_SHARE = Limit(
    "share of corners without weight", 0.3, "", "a robust fit that drops more has chosen one explanation among several"
)
FOCAL_SHARE = Limit(
    "standard deviation of a focal length over it", 0.05, "",
    "fronto-parallel sets leave 0.07-0.6 at 0.1-0.5 px, three good views 0.001-0.004",
)  # fmt: skip
PARALLEL_SPREAD_DEG = Limit(
    "RMS angle between the board's directions", 2.0, "deg", "below it views count as parallel, unless the focal lengths are known all the same"
)  # fmt: skip
PARALLEL_FOCAL_SHARE = Limit(
    "standard deviation of a focal length over it, of parallel views", 0.002, "", "parallel views at very low noise look certain"
)  # fmt: skip
CENTRE_SHARE = Limit(
    "distance of a principal point from the middle over the image's size", 0.25, "",
    "lenses sit within 0.1, KITTI's crops within 0.05; a fit to boards that stay in one part of the image runs off to 0.3 and more",
)  # fmt: skip
CENTRE_SIGMAS = Limit(
    "the same over its standard deviation", 5.0, "", "a poorly known principal point is not thereby a wrong one"
)
ROTATION_DEG = Limit(
    "standard deviation of the rotation between the cameras", 1.0, "deg",
    "six weak views leave 0.05-0.3, three 0.1-0.7; a degree is 17 mm per metre",
)  # fmt: skip
BASELINE_SHARE = Limit(
    "standard deviation of the translation over the baseline",
    0.2,
    "",
    "one pose repeated leaves 0.4-3, six weak views 0.01-0.05",
)
FOCAL_WARNING_SHARE = Limit("standard deviation of a focal length over it", 0.01, "", "good sets stay below 0.005")
SHORT_MEAN_SHARE = Limit(
    "mean distance of both principal points short of the middle over the image's size", 0.04, "",
    "lenses scatter by 0.015 either way; an image size stated 12 % too large moves both by 0.055",
)  # fmt: skip
SHORT_EACH_SHARE = Limit(
    "the same of each principal point", 0.02, "", "both must be short, not one far and one in the middle"
)
SHORT_SIGMAS = Limit(
    "mean distance of both principal points short of the middle over its standard deviation", 4.0, "",
    "views that leave principal points open, as of blurred images, lie 0.08 short by chance",
)  # fmt: skip
RAYLESS_SHARE = Limit(
    "share of the image without ray",
    0.002,
    "",
    "less is a few pixels in a corner; fits that are free there lose 0.01 to 0.4",
)
USUAL_OUTLIER_SHARE = Limit(
    "share of corners without weight", 0.01, "", "a few wild corners are every real set's share"
)


def _residuals(calibration: StereoCalibration) -> Figures:
    if calibration.evidence is None:
        return
    spacing_px = corner_spacing_px(calibration.evidence.detections)
    if calibration.noise_px > NOISE_SHARE.value * spacing_px:
        yield {"noise_px": calibration.noise_px, "spacing_px": spacing_px}


def _count_outliers(calibration: StereoCalibration) -> tuple[int, int]:
    """Corners that would have no weight on a board as drawn either, and all corners of the used views.

    Once the board is measured the kernel closes on a noise two to four times smaller, and corners of images that are merely worse
    lose their weight too; that is no fault of theirs.
    """
    least_px = 0.0
    if calibration.nominal_noise_px is not None and calibration.nominal_noise_px > calibration.noise_px:
        least_px = robust.HAMPEL_END * calibration.nominal_noise_px
    n_outliers = sum(sum(o.distance_px >= least_px for o in v.outliers) for v in calibration.views)
    return n_outliers, sum(v.n_corners for v in calibration.views)


def _outliers(calibration: StereoCalibration) -> Figures:
    n_outliers, n_corners = _count_outliers(calibration)
    if n_outliers > OUTLIER_SHARE.value * n_corners:
        yield {"n_outliers": n_outliers, "n_corners": n_corners}


def _focal_length(calibration: StereoCalibration) -> Figures:
    """What the views' geometry leaves open, at the noise of single corners; that errors are alike within views is warned of."""
    for side in ("left", "right"):
        share = focal_sigma_share(calibration, side) / common_factor(calibration)
        if share <= PARALLEL_FOCAL_SHARE.value:
            continue
        spread_deg = normal_spread_deg(board_normals(calibration))
        if share > FOCAL_SHARE.value or spread_deg < PARALLEL_SPREAD_DEG.value:
            yield {"camera": side, "sigma_percent": 100 * share, "spread_deg": spread_deg}


def _principal_point(calibration: StereoCalibration) -> Figures:
    sigma = calibration.covariance.sigma
    for side in ("left", "right"):
        camera = getattr(calibration.rig, side)
        size, centre = np.array(camera.size_wh), camera.parameters[2:4]
        offset = np.abs(centre - (size - 1) / 2)
        sigma_centre = np.array([sigma.get(f"{side}.cx", 0.0), sigma.get(f"{side}.cy", 0.0)])
        if np.any((offset > CENTRE_SHARE.value * size) & (offset > CENTRE_SIGMAS.value * sigma_centre)):
            x, y = centre.tolist()
            yield {"camera": side, "x_px": x, "y_px": y, "width_px": int(size[0]), "height_px": int(size[1])}


def _rotation(calibration: StereoCalibration) -> Figures:
    sigma = calibration.covariance.sigma
    sigma_deg = float(np.degrees(max(sigma.get(f"rotation.{axis}", 0.0) for axis in "xyz"))) / common_factor(
        calibration
    )
    if sigma_deg > ROTATION_DEG.value:
        yield {"sigma_deg": sigma_deg}


def _translation(calibration: StereoCalibration) -> Figures:
    share = translation_sigma(calibration) / calibration.rig.baseline_m / common_factor(calibration)
    if share > BASELINE_SHARE.value:
        yield {"sigma_percent": 100 * share}


def _weak_focal_length(calibration: StereoCalibration) -> Figures:
    for side in ("left", "right"):
        share = focal_sigma_share(calibration, side)
        if share > FOCAL_WARNING_SHARE.value:
            yield {"camera": side, "sigma_percent": 100 * share}


def _image_size(calibration: StereoCalibration) -> Figures:
    """The stated images look larger than those in which the corners were measured.

    Along an axis both principal points lie short of the middle, by more than chance, and no corner lies beyond the size that would
    put them there.
    """
    if calibration.evidence is None:
        return
    detections, rig = calibration.evidence.detections, calibration.rig
    sizes = np.array([rig.left.size_wh, rig.right.size_wh], dtype=float)
    centres = np.array([rig.left.parameters[2:4], rig.right.parameters[2:4]])
    short = 0.5 - (centres + 0.5) / sizes
    implied = 2 * centres + 1
    sigma = calibration.covariance.sigma
    sigmas = np.array([[sigma.get(f"{side}.{axis}", 0.0) for axis in ("cx", "cy")] for side in ("left", "right")])
    sigma_mean = 0.5 * np.hypot(*(sigmas / sizes))
    is_short = (short.mean(axis=0) > SHORT_MEAN_SHARE.value) & (short.min(axis=0) > SHORT_EACH_SHARE.value)
    is_short &= short.mean(axis=0) > SHORT_SIGMAS.value * sigma_mean
    if not is_short.any():
        return
    far = np.array([np.nanmax(px, axis=(0, 1)) for px in (detections.left_px, detections.right_px)])
    is_suspect = is_short & np.all(far < 1.01 * implied, axis=0)
    if is_suspect.any():
        width, height = np.where(is_suspect, implied.mean(axis=0), sizes[0]).tolist()
        yield {
            "width_px": int(sizes[0, 0]),
            "height_px": int(sizes[0, 1]),
            "implied_width_px": width,
            "implied_height_px": height,
        }


def _folds(calibration: StereoCalibration) -> Figures:
    """The lens model folds back inside the image; ``reach_px`` is how far from the principal point corners were seen."""
    for side in ("left", "right"):
        camera = getattr(calibration.rig, side)
        found = pixels_without_ray(camera)
        if found is None or not found.share > RAYLESS_SHARE.value:
            continue
        reach_px = float("nan")
        if calibration.evidence is not None:
            px = getattr(calibration.evidence.detections, f"{side}_px") - camera.parameters[2:4]
            reach_px = float(np.sqrt(np.nanmax(np.vecdot(px, px))))
        yield {
            "camera": side,
            "share_percent": 100 * found.share,
            "radius_px": found.radius_px,
            "reach_px": reach_px,
        }


def _unusual_outliers(calibration: StereoCalibration) -> Figures:
    n_outliers, n_corners = _count_outliers(calibration)
    if n_outliers > USUAL_OUTLIER_SHARE.value * n_corners:
        view, worst = max(((v, o) for v in calibration.views for o in v.outliers), key=lambda pair: pair[1].distance_px)
        yield {
            "n_outliers": n_outliers,
            "n_corners": n_corners,
            "share_percent": 100 * n_outliers / n_corners,
            "camera": worst.camera,
            "corner": worst.corner,
            "view": view.name,
            "distance_px": worst.distance_px,
        }


FIT = (
    Rule("corners-do-not-fit", _residuals, (NOISE_SHARE,)),
    Rule("too-many-outliers", _outliers, (OUTLIER_SHARE,)),
)
OBSERVABILITY = (
    Rule("focal-length-undetermined", _focal_length, (FOCAL_SHARE, PARALLEL_SPREAD_DEG, PARALLEL_FOCAL_SHARE)),
    Rule("principal-point-impossible", _principal_point, (CENTRE_SHARE, CENTRE_SIGMAS)),
    Rule("rotation-undetermined", _rotation, (ROTATION_DEG,)),
    Rule("translation-undetermined", _translation, (BASELINE_SHARE,)),
    Rule("focal-length-uncertain", _weak_focal_length, (FOCAL_WARNING_SHARE,)),
    Rule("image-size-doubtful", _image_size, (SHORT_MEAN_SHARE, SHORT_EACH_SHARE, SHORT_SIGMAS)),
    Rule("lens-model-folds", _folds, (RAYLESS_SHARE,)),
)
OUTLIERS = (Rule("corners-without-weight", _unusual_outliers, (USUAL_OUTLIER_SHARE,)),)
RULES = (*FIT, *OBSERVABILITY, *OUTLIERS)
"""All rules, in the order in which they are applied; refusals stand before warnings."""


def findings_of_rules(calibration: StereoCalibration, rules: tuple[Rule, ...]) -> tuple[Finding, ...]:
    """What these rules have to say of a solved rig."""
    return tuple(found for rule in rules for found in rule.findings(calibration))


def apply_rules(
    calibration: StereoCalibration, *, is_converged: bool, solver: str = "the joint solve", else_use: str = ""
) -> StereoCalibration:
    """The calibration with the findings of all rules, the gravest first, before those that it has.

    ``solver`` is what did or did not converge, ``else_use`` what to do where another would, in place of advice on the views.

    Raises:
        InconsistentViewsError: The corners cannot be images of this board.
        DegenerateGeometryError: The views do not determine the rig.
        NotConvergedError: The solver did not reach a minimum.
    """
    warnings: list[Finding] = []
    if (one_pose := variety.find_one_pose(calibration, is_converged=is_converged)) is not None:
        raise refusal(one_pose, describe_views(calibration))
    for rule in (*FIT, *OBSERVABILITY):
        for found in rule.findings(calibration):
            if KINDS[found.code].severity is Severity.REFUSAL:
                raise refusal(found, describe_views(calibration))
            warnings.append(found)
    if not is_converged:
        n = calibration.n_iterations
        ended = f" in {n} iteration{'s' * (n != 1)}" if n else ""
        stuck = finding(
            "not-converged", remedy=else_use or variety.advise(calibration), solver=solver, ended=ended, n_iterations=n
        )
        raise refusal(stuck, describe_views(calibration))
    after = findings_of_rules(calibration, OUTLIERS)
    return replace(calibration, findings=(*warnings, *calibration.findings, *after))
