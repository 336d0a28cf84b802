"""Focal length and principal point of one camera from segments of streets and rooms (section 3.2.1, eqs 7-10).

The lines of what people build run in three directions at right angles. Their vanishing points tell the focal length where two of
them are finite, and the principal point where three are. What the lines do not tell is not a number here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.evidence.line_segments import LineSegments
from binocal.findings import Finding, finding, refusal
from binocal.geometry.vanishing import PencilForms
from binocal.initialization.scene_families import (
    SURE,
    Family,
    FrameAt,
    best_frame,
    distinct_lines,
    find_families,
    focal_steps,
)
from binocal.result import Covariance
from binocal.shapes import Bool, Float
from binocal.solvers.manhattan import ManhattanEstimate, ManhattanMinimum, ManhattanProblem, SharedPrior, solve_manhattan
from binocal.solvers.manhattan_covariance import regions_of, shared_covariance

NAMES = ("f", "cx", "cy")
MIN_SEGMENTS = 20  # of an image
START_FLOOR_PX = 1.0
FLOORS_PX = np.r_[0.0, np.geomspace(0.02, 5.0, 40)]  # of ends beyond what their edges state: walls and lenses are not straight
ROUNDS = 3  # of solving and finding that floor
N_STARTS = 4
CENTRE_SIGMA = 0.015  # of the image's diagonal; KITTI, EuRoC, Cityscapes, Middlebury lie within 0.8 to 1.2 %
EXPECTED_FOCAL, EXPECTED_LOG_SIGMA = 1.6, 0.8  # in half diagonals: 64 degrees across the diagonal, within 31 to 109 at one sigma
RIGHT_ANGLE_SIGMA_DEG = 0.3  # of what is built
TOLD_FOCAL_SHARE = 0.10  # standard deviations above these tell nothing
TOLD_CENTRE_SHARE = 1 / 3  # of the assumed standard deviation
AGREEING_SHARE = 0.5  # of the images with two families, that one camera must explain


@dataclass(frozen=True, slots=True, eq=False)
class SceneRequest:
    """What is known beside the segments.

    ``centre_px`` is where the principal point is expected (None: the image's middle), ``centre_sigma_px`` how surely.
    ``right_angle_sigma_deg`` says by how much the scene's right angles may be off.
    """

    centre_px: tuple[float, float] | None = None
    centre_sigma_px: float | None = None
    right_angle_sigma_deg: float = RIGHT_ANGLE_SIGMA_DEG
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


@dataclass(frozen=True, slots=True, eq=False)
class _Image:
    """An image's segments that are distinct, its families, and the evidence of the best one."""

    name: str
    index: int
    forms: PencilForms
    families: Sequence[Family]

    @property
    def single(self) -> float:
        return max((family.log_odds for family in self.families), default=0.0)

    def frame(self, focal_px: float, centre_px: Float[ndarray, "2"]) -> FrameAt | None:
        """The best frame, if it explains surely more than one family does."""
        if len(self.families) < 2:
            return None
        found = best_frame(self.families, self.forms, focal_px, centre_px)
        return found if found is not None and found.log_odds > self.single + SURE else None


def calibrate_from_segments(segments: LineSegments, request: SceneRequest | None = None) -> SceneIntrinsics:
    """Focal length and principal point by maximum likelihood from the segments of one camera's images.

    Pixels are taken for square, skew for 0, the principal point for near the image's middle, and two or more families of lines in
    each scene for orthogonal.

    Raises:
        DegenerateGeometryError, InconsistentViewsError: The lines tell neither focal length nor principal point; the text says why.
    """
    request = request or SceneRequest()
    rng = np.random.default_rng(request.seed)
    prior = _prior(segments.size_wh, request)
    images = _images_with_families(segments, rng)
    pairs = [image for image in images if len(image.families) > 1]
    half = 0.5 * float(np.hypot(*segments.size_wh))
    steps = focal_steps([image.families for image in pairs], prior.centre_px, half)
    frames = [[image.frame(f, prior.centre_px) for f in steps] for image in pairs]
    best: tuple[float, ManhattanMinimum, ManhattanProblem, LineSegments, float, list[int]] | None = None
    for k in _peaks(pairs, frames):
        chosen = [i for i, own in enumerate(frames) if own[k] is not None]
        solved = _solve(segments, [pairs[i] for i in chosen], [frames[i][k] for i in chosen], float(steps[k]), prior)
        gained = solved[0] + sum(image.single for i, image in enumerate(pairs) if i not in chosen)
        if best is None or gained > best[0]:
            best = (gained, *solved[1:], [pairs[i].index for i in chosen])
    if best is None or len(best[-1]) < AGREEING_SHARE * len(pairs):
        agreeing = 0 if best is None else len(best[-1])
        raise refusal(finding("lines-not-at-right-angles", n_images=len(pairs), n_agreeing=agreeing))
    _, minimum, problem, used, floor_px, chosen = best
    covariance = shared_covariance(
        problem,
        minimum.estimate,
        minimum.equations,
        regions_of(used.middles_px, used.size_wh),
        float(np.radians(request.right_angle_sigma_deg)),
    )
    return _result(segments, chosen, minimum, covariance, prior, floor_px)


def _prior(size_wh: tuple[int, int], request: SceneRequest) -> SharedPrior:
    diagonal = float(np.hypot(*size_wh))
    centre = request.centre_px or (0.5 * (size_wh[0] - 1), 0.5 * (size_wh[1] - 1))
    sigma = request.centre_sigma_px or CENTRE_SIGMA * diagonal
    return SharedPrior(0.5 * EXPECTED_FOCAL * diagonal, EXPECTED_LOG_SIGMA, np.array(centre, dtype=float), sigma)


def _images_with_families(segments: LineSegments, rng: np.random.Generator) -> list[_Image]:
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
        forms = PencilForms.of(own.ends_px, own.covariance_px2, START_FLOOR_PX)
        images.append(_Image(segments.names[index], int(index), forms, find_families(forms, rng)))
    most = max(len(image.families) for image in images)
    if most == 0:
        raise refusal(finding("lines-without-families", n_segments=int(counts.max()), n_images=len(counts)))
    if most == 1:
        fullest = max(images, key=lambda image: image.single)
        own = fullest.families[0]
        raise refusal(finding("lines-in-one-family", image=fullest.name, n_segments=own.n_segments, n_images=len(images)))
    return images


def _peaks(images: Sequence[_Image], frames: Sequence[Sequence[FrameAt | None]]) -> list[int]:
    """Focal lengths at which the images' frames explain most, by themselves best among their neighbours."""
    odds = np.array(
        [[image.single if f is None else f.log_odds for f in own] for image, own in zip(images, frames, strict=True)]
    )
    has_any = np.array([[f is not None for f in own] for own in frames]).any(axis=0)
    total = np.where(has_any, odds.sum(axis=0), -np.inf)
    chosen: list[int] = []
    for k in np.argsort(-total):
        if len(chosen) == N_STARTS or not np.isfinite(total[k]):
            break
        if all(abs(int(k) - other) > 3 for other in chosen):
            chosen.append(int(k))
    return chosen


def _solve(
    segments: LineSegments, images: Sequence[_Image], frames: Sequence[FrameAt], focal_px: float, prior: SharedPrior
) -> tuple[float, ManhattanMinimum, ManhattanProblem, LineSegments, float]:
    """Log odds explained, the minimum and its problem, the segments that it is of, and the floor of their ends."""
    place = np.full(len(segments.names), -1)
    place[[image.index for image in images]] = np.arange(len(images))
    used = segments.select(place[segments.image] >= 0)
    image = place[used.image]
    estimate = ManhattanEstimate(focal_px, prior.centre_px, np.stack([frame.R_camera_scene for frame in frames]))
    floor_px = START_FLOOR_PX
    for round_ in range(ROUNDS):
        forms = PencilForms.of(used.ends_px, used.covariance_px2, floor_px)
        problem = ManhattanProblem(forms, image, len(images), prior)
        minimum = solve_manhattan(problem, estimate) if round_ == 0 else solve_manhattan(problem, estimate, ())
        estimate = minimum.estimate
        if round_ < ROUNDS - 1:
            floor_px = _likeliest_floor(used, problem, estimate)
    odds = 0.0
    for k, own in enumerate(images):
        points = estimate.points[k]
        odds += float(own.forms.evidence((own.forms.distances(points) ** 2).min(axis=0), 3).sum())
    return odds, minimum, problem, used, floor_px


def _likeliest_floor(used: LineSegments, problem: ManhattanProblem, estimate: ManhattanEstimate) -> float:
    """What ends are off by beyond their edges' covariance, by maximum likelihood with segments of no family among them."""
    odds = []
    for floor in FLOORS_PX:
        forms = PencilForms.of(used.ends_px, used.covariance_px2, float(floor))
        (r2,) = replace(problem, forms=forms).residual_lengths2(estimate)
        odds.append(float(forms.evidence(r2, 3).sum()))
    return float(FLOORS_PX[int(np.argmax(odds))])


def _result(
    segments: LineSegments,
    chosen: Sequence[int],
    minimum: ManhattanMinimum,
    covariance: Float[ndarray, "3 3"],
    prior: SharedPrior,
    floor_px: float,
) -> SceneIntrinsics:
    """Raises DegenerateGeometryError: nothing is told."""
    estimate, equations = minimum.estimate, minimum.equations
    sigma = np.sqrt(np.diagonal(covariance))
    is_told = sigma < np.array([TOLD_FOCAL_SHARE, *(2 * (TOLD_CENTRE_SHARE * prior.centre_sigma_px,))])
    figures = {
        "focal_sigma_percent": 100 * float(sigma[0]),
        "cx_sigma_px": float(sigma[1]),
        "cy_sigma_px": float(sigma[2]),
        "assumed_sigma_px": prior.centre_sigma_px,
    }
    if not is_told.any():
        raise refusal(finding("vanishing-points-far", **figures))
    findings = []
    if not is_told[0]:
        told = " and ".join(name for name, told in zip(NAMES, is_told, strict=True) if told)
        findings.append(finding("vanishing-points-far-focal-untold", told=told, **figures))
    scale = np.array([estimate.focal_px, 1.0, 1.0])
    full = covariance * np.outer(scale, scale)
    values = np.where(is_told, np.r_[estimate.focal_px, estimate.centre_px], np.nan)
    names = tuple(name for name, told in zip(NAMES, is_told, strict=True) if told)
    return SceneIntrinsics(
        values,
        Covariance(names, full[np.ix_(is_told, is_told)]),
        (float(prior.centre_px[0]), float(prior.centre_px[1])),
        prior.centre_sigma_px,
        floor_px,
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
