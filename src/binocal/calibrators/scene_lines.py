"""Focal length and principal point of one camera from segments of streets and rooms (section 3.2.1, eqs 7-10).

The lines of what people build run in three directions at right angles. Their vanishing points tell the focal length where two of
them are finite, and the principal point where three are. What the lines do not tell is not a number here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.calibrators.scene_solution import START_FLOOR_PX, SceneImage, SceneSolution, best_solution
from binocal.evidence.line_segments import LineSegments
from binocal.findings import Finding, finding, refusal
from binocal.geometry.vanishing import PencilForms
from binocal.initialization.scene_families import distinct_lines, find_families
from binocal.result import Covariance
from binocal.shapes import Bool, Float
from binocal.solvers.epipolar_covariance import regions_of
from binocal.solvers.manhattan import SharedPrior
from binocal.solvers.manhattan_covariance import shared_covariance

NAMES = ("f", "cx", "cy")
MIN_SEGMENTS = 20  # of an image
FAMILY_FLOORS_PX = (0.25, START_FLOOR_PX)  # few but straight edges, and many crooked ones
CENTRE_SIGMA = 0.015  # of the image's diagonal; KITTI, EuRoC, Cityscapes, Middlebury lie within 0.8 to 1.2 %
EXPECTED_FOCAL, EXPECTED_LOG_SIGMA = (
    1.6,
    0.8,
)  # in half diagonals: 64 degrees across the diagonal, within 31 to 109 at one sigma
RIGHT_ANGLE_SIGMA_DEG = 0.3  # of what is built
TOLD_FOCAL_SHARE = 0.10  # standard deviations above these tell nothing
TOLD_CENTRE_SHARE = 1 / 3  # of the assumed standard deviation
AGREEING_SHARE = 0.5  # of the images with two families, that one camera must explain


@dataclass(frozen=True, slots=True, eq=False)
class SceneRequest:
    """What is known beside the segments.

    ``centre_px`` is where the principal point is expected (None: the image's middle), ``centre_sigma_px`` how surely.
    ``right_angle_sigma_deg`` says by how much the scene's right angles may be off. ``are_right_angles`` states that two families of
    one image are at right angles where neither a third one nor another view checks it.
    """

    centre_px: tuple[float, float] | None = None
    centre_sigma_px: float | None = None
    right_angle_sigma_deg: float = RIGHT_ANGLE_SIGMA_DEG
    are_right_angles: bool = False
    seed: int = 0


@dataclass(frozen=True, slots=True)
class ImageFamilies:
    """How many segments of an image belong to each of its three families, and to none; its ``reason`` if it was left out."""

    name: str
    in_family: tuple[int, int, int]
    n_others: int
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class SceneIntrinsics:
    """Focal length and principal point of a camera with square pixels and no skew; NaN what the lines do not tell.

    ``values`` are f, cx, cy in pixels, ``covariance`` theirs (those that are told). ``assumed_centre_px`` and its standard deviation
    are what the principal point was held near. ``noise_px`` is what ends are off by beyond what their edges state.
    """

    values: Float[ndarray, "3"]
    covariance: Covariance
    assumed_centre_px: tuple[float, float]
    assumed_centre_sigma_px: float
    noise_px: float
    images: tuple[ImageFamilies, ...]
    findings: tuple[Finding, ...] = ()

    @property
    def focal_px(self) -> float:
        """Focal length; NaN if untold."""
        return float(self.values[0])

    @property
    def is_told(self) -> Bool[ndarray, "3"]:
        """Which of f, cx, cy the lines tell."""
        return np.isfinite(self.values)


def calibrate_from_segments(segments: LineSegments, request: SceneRequest | None = None) -> SceneIntrinsics:
    """Focal length and principal point by maximum likelihood from the segments of one camera's images.

    Pixels are taken for square, skew for 0, the principal point for near the image's middle, and two or more families of lines in
    each scene for orthogonal.

    Raises:
        DegenerateGeometryError, InconsistentViewsError: The lines tell neither focal length nor principal point; the text says why.
    """
    request = request or SceneRequest()
    prior = _prior(segments.size_wh, request)
    images = _images_with_families(segments, np.random.default_rng(request.seed))
    pairs = [image for image in images if len(image.families) > 1]
    best = best_solution(segments, pairs, prior)
    if best is None or len(best.images) < AGREEING_SHARE * len(pairs):
        agreeing = 0 if best is None else len(best.images)
        raise refusal(finding("lines-not-at-right-angles", n_images=len(pairs), n_agreeing=agreeing))
    covariance = shared_covariance(
        best.problem,
        best.minimum.estimate,
        best.minimum.equations,
        regions_of(best.used.middles_px, best.used.size_wh),
        float(np.radians(request.right_angle_sigma_deg)),
    )
    found = _result(segments, best, covariance, prior)
    if not (request.are_right_angles or best.is_checked):
        raise refusal(finding("right-angles-unchecked", images=", ".join(image.name for image in best.images)))
    return found


def _prior(size_wh: tuple[int, int], request: SceneRequest) -> SharedPrior:
    diagonal = float(np.hypot(*size_wh))
    centre = request.centre_px or (0.5 * (size_wh[0] - 1), 0.5 * (size_wh[1] - 1))
    sigma = request.centre_sigma_px or CENTRE_SIGMA * diagonal
    return SharedPrior(0.5 * EXPECTED_FOCAL * diagonal, EXPECTED_LOG_SIGMA, np.array(centre, dtype=float), sigma)


def _images_with_families(segments: LineSegments, rng: np.random.Generator) -> list[SceneImage]:
    """Images with enough segments.

    Raises DegenerateGeometryError where none has two families.
    """
    counts = np.bincount(segments.image, minlength=len(segments.names))
    if not len(counts) or counts.max() < MIN_SEGMENTS:
        most = int(counts.max()) if len(counts) else 0
        raise refusal(finding("lines-too-few", n_segments=most, n_images=len(counts), n_needed=MIN_SEGMENTS))
    images = []
    for index in np.flatnonzero(counts >= MIN_SEGMENTS):
        own = segments.select(segments.image == index)
        own = own.select(distinct_lines(own.ends_px))
        tried = [
            find_families(PencilForms.of(own.ends_px, own.covariance_px2, floor), rng) for floor in FAMILY_FLOORS_PX
        ]
        families = max(tried, key=lambda found: sum(family.log_odds for family in found))
        forms = PencilForms.of(own.ends_px, own.covariance_px2, START_FLOOR_PX)
        images.append(SceneImage(segments.names[index], int(index), forms, families))
    most = max(len(image.families) for image in images)
    if most == 0:
        raise refusal(finding("lines-without-families", n_segments=int(counts.max()), n_images=len(counts)))
    if most == 1:
        fullest = max(images, key=lambda image: image.single)
        own = fullest.families[0]
        raise refusal(
            finding("lines-in-one-family", image=fullest.name, n_segments=own.n_segments, n_images=len(images))
        )
    return images


def _result(
    segments: LineSegments, solution: SceneSolution, covariance: Float[ndarray, "3 3"], prior: SharedPrior
) -> SceneIntrinsics:
    """Raises DegenerateGeometryError: nothing is told."""
    estimate, equations = solution.minimum.estimate, solution.minimum.equations
    chosen = [image.index for image in solution.images]
    sigma = np.sqrt(np.diagonal(covariance))
    is_told = sigma < np.array([TOLD_FOCAL_SHARE, *(2 * (TOLD_CENTRE_SHARE * prior.centre_sigma_px,))])
    figures: dict[str, Any] = {
        "focal_sigma_percent": 100 * float(sigma[0]),
        "cx_sigma_px": float(sigma[1]),
        "cy_sigma_px": float(sigma[2]),
        "assumed_sigma_px": prior.centre_sigma_px,
    }
    if not is_told.any():
        raise refusal(finding("vanishing-points-far", **figures))
    findings = []
    if not is_told[0]:
        what = " and ".join(name for name, told in zip(NAMES, is_told, strict=True) if told)
        findings.append(finding("vanishing-points-far-focal-untold", what=what, **figures))
    scale = np.array([estimate.focal_px, 1.0, 1.0])
    full = covariance * np.outer(scale, scale)
    values = np.where(is_told, np.r_[estimate.focal_px, estimate.centre_px], np.nan)
    names = tuple(name for name, told in zip(NAMES, is_told, strict=True) if told)
    return SceneIntrinsics(
        values,
        Covariance(names, full[np.ix_(is_told, is_told)]),
        (float(prior.centre_px[0]), float(prior.centre_px[1])),
        prior.centre_sigma_px,
        solution.floor_px,
        _image_families(segments, chosen, equations.family, equations.weights),
        tuple(findings),
    )


def _image_families(
    segments: LineSegments, chosen: Sequence[int], family: ndarray, weights: Float[ndarray, "n"]
) -> tuple[ImageFamilies, ...]:
    place = np.isin(segments.image, chosen)
    of_used = segments.image[place]
    out = []
    for index, name in enumerate(segments.names):
        if index not in chosen:
            n = int((segments.image == index).sum())
            out.append(ImageFamilies(name, (0, 0, 0), n, "shows no two families at right angles for this camera"))
            continue
        own = of_used == index
        counts = [int((own & (family == k) & (weights > 0)).sum()) for k in range(3)]
        out.append(ImageFamilies(name, (counts[0], counts[1], counts[2]), int(own.sum()) - sum(counts)))
    return tuple(out)
