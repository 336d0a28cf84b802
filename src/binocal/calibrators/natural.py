"""Rotation and direction of translation from natural images: matches of many pairs, intrinsics held.

Starts compete (:mod:`binocal.calibrators.natural_start`): the old rig, what matches alone give, two plain guesses. An old rig bounds
the choice, since structured wrong matches may well have the lower cost elsewhere. What the scene does not tell stays as it was.
The length of the translation is never told by matches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.calibrators.natural_cameras import (
    asked,
    assumed_covariance,
    intrinsics_covariance,
    is_of_other_cameras,
    parameters_asked_for,
    refuse_other_cameras,
    slopes_of,
)
from binocal.calibrators.natural_checks import (
    MIN_MATCHES,
    clear_sides,
    contradicting_pairs,
    is_mixed_up,
    pairs_disagree,
    pairs_left_out,
    pairs_of_several_poses,
    refuse_knocked,
    refuse_other_rig,
    refuse_rectified,
    refuse_torn,
    refuse_whole_rows,
    refuse_wrong,
    unlike_file,
)
from binocal.calibrators.natural_start import BestStart, Guess, best_start
from binocal.calibrators.natural_untold import (
    as_seen_from,
    limited_to_kept,
    untold_finding,
    untold_part,
    with_untold_kept,
)
from binocal.cameras import Camera, StereoRig
from binocal.cameras.models import camera_model
from binocal.errors import CalibrationError
from binocal.evidence.point_matches import PointMatches
from binocal.findings import Finding, finding, refusal
from binocal.geometry import SE3, so3
from binocal.progress import ProgressCallback
from binocal.result import Covariance, ResidualSummary, StereoCalibration, ViewResult
from binocal.shapes import Bool, Float
from binocal.solvers.epipolar import NOISE_FLOOR_PX, EpipolarEquations, EpipolarProblem, parallax_and_sides
from binocal.solvers.epipolar_covariance import (
    covariance_between_pairs,
    covariance_by_regions,
    covariance_of_noise,
    pairs_apart,
    regions_of,
    steps_by_intrinsics,
)
from binocal.solvers.epipolar_descent import NEAR_PX, finish
from binocal.solvers.epipolar_diagnosis import camera_misfit, clearest_ask
from binocal.solvers.relative_pose import RelativePose, tangents

MIN_SIDE_SHARE = 0.1  # of clear points: with fewer on either side, they do not lie on both
NEAR_NOISE = 3.0
BEHIND_PX, BEHIND_NOISE = 8.0, 20.0
"""Parallax of a point, in pixels and of the noise, at which no error of the pose makes it lie behind a camera."""
MOST_BEHIND_SHARE = 0.2  # of the clear ones that fit; where 40 % of all matches are wrong it is 0.05
KEPT_ROUNDS = 3
MIN_PAIRS_FOR_SCATTER = 3
MIN_PAIRS_OF_A_STATE = 2  # of one pair alone nothing says that it is of one moment
CLEAR_PARALLAX, MIN_CLEAR = 10.0, 20
"""Of the noise, and so many matches, for the direction of the translation to be told at all."""


@dataclass(frozen=True, slots=True, eq=False)
class NaturalRequest:
    """What is known beside the matches.

    ``intrinsics`` is the covariance of the cameras' parameters by name (those of a rig file); None: assumed. ``baseline_m`` is the
    length of the translation and ``length_from`` who said so.
    """

    cameras: tuple[Camera, Camera]
    old: SE3 | None = None
    baseline_m: float | None = None
    baseline_sigma_m: float = 0.0
    length_from: str = "nothing: lengths are in baselines"
    intrinsics: Covariance | None = None
    guess: Guess | None = None
    """A first guess from matches alone (:mod:`binocal.matching.relative_pose`)."""
    seed: int = 0
    progress: ProgressCallback | None = None
    filed: SE3 | None = None
    """The pose that a rig's file has where it is no start (``old`` is None): what no other mounting explains is named."""
    calibrator: str = "drl"
    """Who closes the kernel from an old rig: see :func:`binocal.calibrators.natural_solves.solves_of`."""

    @property
    def given(self) -> SE3 | None:
        """The pose of the rig that was given, be it the start or not."""
        return self.filed if self.old is None else self.old


def calibrate_from_matches(matches: PointMatches, request: NaturalRequest) -> StereoCalibration:
    """The rig whose rotation and direction of translation fit the matches; pairs that contradict the others are left out.

    Raises:
        TooFewPointsError, InconsistentViewsError, DegenerateGeometryError: The matches tell no rig, or not that of the request; the
            text says why.
    """
    solved = _solve(matches, request)
    findings: list[Finding] = []
    odd = contradicting_pairs(solved.problem, solved.matches, solved.estimate, solved.noise_px)
    if odd and matches.n_pairs > 1:
        _refuse_knocked(solved, sorted(odd), request)
        findings.append(pairs_left_out(solved.matches, odd, request.old is not None))
        solved = _solve(matches.of_pairs([i for i in range(matches.n_pairs) if i not in odd]), request)
    return _judged(solved, request, findings)


def _refuse_knocked(solved: _Solved, odd: Sequence[int], request: NaturalRequest) -> None:
    """Raises InconsistentViewsError: two and more pairs that contradict the others agree on another pose, near to theirs."""
    if len(odd) < MIN_PAIRS_OF_A_STATE:
        return
    others = solved.matches.of_pairs(list(odd))
    try:
        state = _solve(others, request)
    except CalibrationError:
        return
    if not contradicting_pairs(state.problem, state.matches, state.estimate, state.noise_px):
        refuse_knocked(others.names, solved.matches.n_pairs, state.estimate, solved.estimate)


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """A minimum, and which matches it is of."""

    problem: EpipolarProblem
    matches: PointMatches
    estimate: RelativePose
    equations: EpipolarEquations
    noise_px: float
    best: BestStart

    @property
    def is_right(self) -> Bool[ndarray, "n"]:
        """Which matches have a part in it."""
        right: Bool[ndarray, "n"] = self.equations.weights > 0
        return right


def _solve(matches: PointMatches, request: NaturalRequest) -> _Solved:
    """The minimum from the best start; what no minimum is found for is refused."""
    problem, has_rays = EpipolarProblem.of_matches(request.cameras, matches)
    n_seen = int(has_rays.sum())
    if n_seen < MIN_MATCHES:
        raise refusal(finding("matches-too-few", n_matches=n_seen, n_pairs=matches.n_pairs, n_needed=MIN_MATCHES))
    matches = matches.select(has_rays)
    refuse_whole_rows(matches)
    rng = np.random.default_rng(request.seed)
    best = best_start(problem, matches, request.old, request.guess, rng, request.calibrator)
    minimum = finish(problem, best.estimate)
    noise_px = max(float(minimum.scale_px), NOISE_FLOOR_PX)
    estimate = _on_the_visible_side(problem, minimum.estimate, noise_px, request.old)
    is_seen = ~_behind(problem, estimate, noise_px)
    if not is_seen.all():
        problem = replace(problem, counts=is_seen.astype(float))
        minimum = finish(problem, estimate)
        noise_px, estimate = max(float(minimum.scale_px), NOISE_FLOOR_PX), minimum.estimate
    equations = problem.linearize(estimate, np.asarray(noise_px), "tukey")
    refuse_rectified(problem, matches, request.given, noise_px)
    solved = _Solved(problem, matches, estimate, equations, noise_px, best)
    refuse_wrong(matches, solved.is_right, noise_px)
    return solved


def _at_own_poses(solved: _Solved) -> EpipolarEquations:
    """The equations with each pair at the minimum of its own matches; a pair that has too few near by counts nothing."""
    equations, pair = solved.equations, solved.matches.pair
    residuals, jacobian = equations.residuals_px.copy(), equations.jacobian.copy()
    weights = np.zeros_like(equations.weights)
    for k in np.unique(pair):
        here = np.flatnonzero(pair == k)
        part = solved.problem.select(here)
        if (np.abs(part.residuals_px(solved.estimate)) < NEAR_PX).sum() < MIN_MATCHES:
            continue
        own = finish(part, solved.estimate)
        scale_px = np.maximum(own.scale_px, NOISE_FLOOR_PX)
        found = part.linearize(own.estimate, scale_px, "tukey")
        residuals[here], jacobian[here], weights[here] = found.residuals_px, found.jacobian, found.weights
    return replace(equations, residuals_px=residuals, jacobian=jacobian, weights=weights)


def _judged(solved: _Solved, request: NaturalRequest, findings: list[Finding]) -> StereoCalibration:
    """The minimum with its covariance, held against the old rig and the cameras."""
    problem, matches, estimate, noise_px = solved.problem, solved.matches, solved.estimate, solved.noise_px
    of_cameras = intrinsics_covariance(request.cameras, request.intrinsics)
    slopes = _slopes(solved, request.cameras, of_cameras)
    rng = np.random.default_rng(request.seed)
    covariance, random = _covariance(solved, request, of_cameras, slopes)
    kept: list[Finding] = []
    untold = untold_part(covariance)
    if untold is not None and request.old is None:
        raise refusal(untold_finding(covariance, untold, estimate, is_kept=False))
    if not is_mixed_up(estimate, request.given):
        allowed = assumed_covariance(request.cameras, of_no_lens=True)
        allowed += of_cameras if request.intrinsics is not None else 0.0
        misfit = camera_misfit(solved.equations, matches.pair, slopes, allowed)
        if (
            is_of_other_cameras(misfit) and matches.n_pairs > 1
        ):  # or of pairs far apart, whose weights are those of no pose
            misfit = camera_misfit(_at_own_poses(solved), matches.pair, slopes, allowed)
            if not is_of_other_cameras(misfit):
                raise refusal(pairs_of_several_poses(matches.n_pairs))
        refuse_other_cameras(misfit)
    regions = regions_of(matches.left_px, request.cameras[0].size_wh)
    refuse_torn(pairs_apart(solved.equations, matches.pair, regions), matches.n_pairs)
    if untold is not None and request.old is not None:
        old = RelativePose.of(request.old)
        held, of_held = as_seen_from(untold, estimate, old), covariance
        for _ in range(KEPT_ROUNDS):  # what a scene tells depends on the pose at which it is asked
            untold = untold_part(covariance)
            if untold is not None:
                held, of_held = as_seen_from(untold, estimate, old), covariance
            estimate = with_untold_kept(problem, held, old, noise_px)
            equations = problem.linearize(estimate, np.asarray(noise_px), "tukey")
            solved = replace(solved, estimate=estimate, equations=equations)
            refuse_wrong(matches, solved.is_right, noise_px)
            slopes = _slopes(solved, request.cameras, of_cameras)
            covariance, random = _covariance(solved, request, of_cameras, slopes)
        kept.append(untold_finding(of_held, held, old, is_kept=True))
        covariance = limited_to_kept(covariance)
    told_of = slopes * (np.diagonal(of_cameras) > 0)
    ask = clearest_ask(solved.equations, regions, parameters_asked_for(request.cameras, told_of), rng)
    direction_sigma_deg = float(np.degrees(np.sqrt(np.diagonal(covariance)[3:5].max())))
    refuse_other_rig(estimate, request.old, direction_sigma_deg, ask, noise_px)
    if request.old is None and request.filed is not None:
        findings += unlike_file(estimate, request.filed, direction_sigma_deg)
    if ask is not None:
        findings.append(
            finding("matches-ask-for-other-cameras", what=asked(ask), saved_percent=100 * ask.fall, parameter=ask.name)
        )
    findings += pairs_disagree(pairs_apart(solved.equations, matches.pair, regions))
    return _calibration(solved, request, (covariance, random), (*findings, *kept))


def _slopes(
    solved: _Solved, cameras: tuple[Camera, Camera], of_cameras: Float[ndarray, "p p"]
) -> Float[ndarray, "n p"]:
    """By all parameters, those of which a rig file says that they are exact too."""
    sigma = np.sqrt(np.diagonal(of_cameras))
    assumed = np.sqrt(np.diagonal(assumed_covariance(cameras, of_no_lens=True)))
    step = np.where(sigma > 0, sigma, assumed)
    return slopes_of(solved.problem, solved.matches, solved.estimate, cameras, step)


def _all_far(problem: EpipolarProblem, estimate: RelativePose, noise_px: float) -> bool:
    """Whether hardly a point is nearer than noise would make it seem: the equations then take noise for parallax."""
    parallax_px, _ = parallax_and_sides(problem, estimate)
    return int((parallax_px > CLEAR_PARALLAX * noise_px).sum()) < MIN_CLEAR


def _on_the_visible_side(
    problem: EpipolarProblem, estimate: RelativePose, noise_px: float, old: SE3 | None
) -> RelativePose:
    """The sign of the translation by which points lie in front of both cameras; the old rig's where they lie on both sides."""
    near = np.abs(problem.residuals_px(estimate)) < NEAR_NOISE * noise_px
    is_clear, is_in_front = clear_sides(problem.select(near), estimate, noise_px)
    n_clear, n_front = int(is_clear.sum()), int(is_in_front[is_clear].sum())
    is_reversed = n_front < n_clear / 2
    if old is not None and MIN_SIDE_SHARE * n_clear < n_front < (1 - MIN_SIDE_SHARE) * n_clear:
        is_reversed = bool(estimate.t @ old.t < 0)
    return RelativePose(estimate.R, -estimate.t) if is_reversed else estimate


def _behind(problem: EpipolarProblem, estimate: RelativePose, noise_px: float) -> Bool[ndarray, "n"]:
    """Which matches are wrong although they fit, their points lying behind a camera.

    Of simulated wrong matches that pass for right, most of them repeats along the row, this names a third. None where many of those
    that fit would be: then the pose is wrong, or hardly told.
    """
    parallax_px, side = parallax_and_sides(problem, estimate)
    is_clear = parallax_px > max(BEHIND_PX, BEHIND_NOISE * noise_px)
    fits = is_clear & (np.abs(problem.residuals_px(estimate)) < NEAR_NOISE * noise_px)
    if (side[fits] < 0).sum() > MOST_BEHIND_SHARE * fits.sum():
        return np.zeros(len(side), dtype=bool)
    behind: Bool[ndarray, "n"] = is_clear & (side < 0)
    return behind


def _covariance(
    solved: _Solved,
    request: NaturalRequest,
    of_cameras: Float[ndarray, "p p"],
    slopes: Float[ndarray, "n p"],
) -> tuple[Float[ndarray, "q q"], Float[ndarray, "5 5"]]:
    """Of the five unknowns and both cameras' parameters together; and of the former what other matches of these pairs would have anew."""
    own = covariance_by_regions(
        solved.equations,
        regions_of(solved.matches.left_px, request.cameras[0].size_wh),
        np.random.default_rng(request.seed),
    )
    noise = covariance_of_noise(solved.equations, solved.noise_px)
    own = _grown(own, noise)
    between = covariance_between_pairs(solved.equations, solved.matches.pair)
    A = steps_by_intrinsics(solved.equations, slopes)
    whole = np.zeros((5 + len(of_cameras), 5 + len(of_cameras)))
    whole[:5, :5] = (own if between is None else _grown(own, between)) + A @ of_cameras @ A.T
    whole[:5, 5:] = A @ of_cameras
    whole[5:, :5] = whole[:5, 5:].T
    whole[5:, 5:] = of_cameras
    if _all_far(solved.problem.select(solved.is_right), solved.estimate, solved.noise_px):
        whole[[3, 4], [3, 4]] += np.radians(90.0) ** 2
    return whole, own


def _grown(covariance: Float[ndarray, "5 5"], least: Float[ndarray, "5 5"]) -> Float[ndarray, "5 5"]:
    """The covariance with no variance below that of ``least``, its correlations kept."""
    grow = np.sqrt(np.maximum(np.diagonal(least) / np.maximum(np.diagonal(covariance), 1e-300), 1.0))
    return covariance * np.outer(grow, grow)


def _pair_scatter(solved: _Solved, random: Float[ndarray, "5 5"]) -> Float[ndarray, "3"]:
    """Variances of the rotation that single pairs have beside those of their matches; 0 with too few pairs to tell."""
    between = covariance_between_pairs(solved.equations, solved.matches.pair)
    n = solved.matches.n_pairs
    if between is None or n < MIN_PAIRS_FOR_SCATTER:
        return np.zeros(3)
    excess: Float[ndarray, "3"] = n * np.maximum(np.diagonal(between - random)[:3], 0.0)
    return excess


def _calibration(
    solved: _Solved,
    request: NaturalRequest,
    covariances: tuple[Float[ndarray, "q q"], Float[ndarray, "5 5"]],
    findings: tuple[Finding, ...],
) -> StereoCalibration:
    matches, estimate, is_right, (covariance, random) = solved.matches, solved.estimate, solved.is_right, covariances
    length = request.baseline_m if request.baseline_m is not None else 1.0
    rig = StereoRig(
        *request.cameras, SE3(so3.project_to_rotation(estimate.R), length * estimate.t), request.baseline_m is not None
    )
    residuals = solved.equations.residuals_px
    views = []
    for pair, name in enumerate(matches.names):
        own = (matches.pair == pair) & is_right
        rms = float(np.sqrt(np.mean(residuals[own] ** 2))) if own.any() else float("nan")
        views.append(ViewResult(name, rms, rms, rms, int((matches.pair == pair).sum())))
    rms = float(np.sqrt(np.mean(residuals[is_right] ** 2)))
    names = tuple(
        f"{side}.{n}"
        for side, c in zip(("left", "right"), request.cameras, strict=True)
        for n in camera_model(c.model).parameter_names
    )
    across = np.stack([np.cross(axis, estimate.t) for axis in tangents(estimate.t).T], axis=1)
    basis = length * across
    between = covariance_between_pairs(solved.equations, matches.pair)
    of_pairs = random if between is None else _grown(random, between)
    to_rig = np.zeros((len(names) + 6, len(covariance)))
    to_rig[: len(names), 5:] = np.eye(len(names))
    to_rig[len(names) : len(names) + 3, :3] = np.eye(3)
    to_rig[len(names) + 3 :, 3:5] = basis
    full = to_rig @ covariance @ to_rig.T
    full[-3:, -3:] += request.baseline_sigma_m**2 * np.outer(estimate.t, estimate.t)
    told = [i for i, name in enumerate(names) if full[i, i] > 0] + list(range(len(names), len(names) + 6))
    all_names = (*names, *(f"rotation.{a}" for a in "xyz"), *(f"translation.{a}" for a in "xyz"))
    return StereoCalibration(
        rig=rig,
        covariance=Covariance(tuple(all_names[i] for i in told), full[np.ix_(told, told)]),
        rms=ResidualSummary(rms, rms, rms),
        noise_px=solved.noise_px,
        views=tuple(views),
        findings=findings,
        provenance={
            "method": "natural images",
            "start": solved.best.start,
            "agent": dict(solved.best.led_by),
            "n_matches": len(matches),
            "n_right": int(is_right.sum()),
            "random_rotation_covariance_rad2": random[:3, :3].tolist(),
            "random_direction_covariance": (across @ of_pairs[3:, 3:] @ across.T).tolist(),
            "pair_scatter_rad2": _pair_scatter(solved, random).tolist(),
            "length_from": request.length_from,
            "intrinsics_sigma": "rig file" if request.intrinsics is not None else "assumed",
        },
    )
