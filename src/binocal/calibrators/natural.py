"""Rotation and direction of translation from natural images: matches of many pairs, intrinsics held.

Starts compete (:mod:`binocal.calibrators.natural_start`): the old rig, what matches alone give, two plain guesses. An old rig bounds
the choice, since structured wrong matches may well have the lower cost elsewhere. What the scene does not tell stays as it was.
The length of the translation is never told by matches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.calibrators.natural_start import Guess, best_start
from binocal.cameras import Camera, StereoRig
from binocal.cameras.models import camera_model
from binocal.evidence.point_matches import PointMatches
from binocal.findings import Finding, finding, refusal
from binocal.geometry import SE3, so3
from binocal.progress import ProgressCallback
from binocal.result import Covariance, ResidualSummary, StereoCalibration, ViewResult
from binocal.shapes import Bool, Float
from binocal.solvers.epipolar import (
    NOISE_FLOOR_PX,
    SCHEDULE_PX,
    EpipolarProblem,
    Rays,
    RelativePose,
    finish,
    parallax_and_sides,
    tangents,
)
from binocal.solvers.epipolar_covariance import (
    covariance_by_regions,
    covariance_of_noise,
    regions_of,
    steps_by_intrinsics,
)

MIN_MATCHES = 30
MIN_RIGHT_SHARE = 0.15  # of the matches; unfiltered ones of self-similar scenes keep 0.2 and more
UNTOLD_TURN_DEG, UNTOLD_DIRECTION_DEG = 1.0, 12.0
"""Standard deviations above which a scene does not tell a direction of the pose."""
ASSUMED_FOCAL_SHARE, ASSUMED_ASPECT_SHARE, ASSUMED_CENTRE_PX = 4e-4, 2e-4, 0.25
ASSUMED_DISTORTION = {"k1": 8e-4, "k2": 1.6e-3, "p1": 5e-5, "p2": 5e-5}
"""What intrinsics are uncertain by where nobody says: as a good calibration from a board leaves them."""
WHOLE_ROWS_SHARE = 0.5  # of the matches on equal rows to a thousandth of a pixel: a grid's, not a scene's
CONTRARY_SHARE = 0.5  # of the pooled share of right matches, below which a pair contradicts the others
NEAR_NOISE = 3.0
KEPT_ROUNDS = 3
KEPT_STEPS = 5  # pairs of steps under the last kernel
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


def calibrate_from_matches(matches: PointMatches, request: NaturalRequest) -> StereoCalibration:
    """The rig whose rotation and direction of translation fit the matches.

    Raises:
        TooFewPointsError, InconsistentViewsError, DegenerateGeometryError: The matches tell no rig; the text says why.
    """
    if len(matches) < MIN_MATCHES:
        raise refusal(finding("matches-too-few", n_matches=len(matches), n_pairs=matches.n_pairs, n_needed=MIN_MATCHES))
    problem, has_rays = EpipolarProblem.of_matches(request.cameras, matches)
    if has_rays.sum() < MIN_MATCHES:
        raise refusal(
            finding("matches-too-few", n_matches=int(has_rays.sum()), n_pairs=matches.n_pairs, n_needed=MIN_MATCHES)
        )
    matches = matches.select(has_rays)
    _refuse_whole_rows(matches)
    rng = np.random.default_rng(request.seed)
    start, name = best_start(problem, matches, request.old, request.guess, rng)
    minimum = finish(problem, start)
    estimate, noise_px = minimum.estimate, max(float(minimum.scale_px), NOISE_FLOOR_PX)
    estimate = _on_the_visible_side(problem, estimate, noise_px)
    equations = problem.linearize(estimate, np.asarray(noise_px), "tukey")
    is_right = equations.weights > 0
    _refuse_wrong(matches, is_right, noise_px)
    findings: list[Finding] = list(_pairs_apart(matches, is_right))
    covariance, random = _covariance(problem, matches, estimate, noise_px, request)
    untold = _untold_part(covariance)
    if untold is not None:
        findings.append(_untold_finding(covariance, is_kept=request.old is not None))
        if request.old is None:
            raise refusal(findings[-1])
        for _ in range(KEPT_ROUNDS):  # what a scene tells depends on the pose at which it is asked
            estimate = _kept(problem, untold, RelativePose.of(request.old), noise_px)
            covariance, random = _covariance(problem, matches, estimate, noise_px, request)
            again = _untold_part(covariance)
            untold = untold if again is None else again
        covariance = _limited(covariance)
    return _calibration(matches, request, estimate, (covariance, random), (noise_px, name), tuple(findings))


def _refuse_whole_rows(matches: PointMatches) -> None:
    """Raises InconsistentViewsError: rows are those of a pixel grid."""
    on_grid = np.abs(matches.left_px[:, 1] - matches.right_px[:, 1]) < 1e-3
    if on_grid.mean() > WHOLE_ROWS_SHARE:
        raise refusal(finding("matches-on-whole-rows", share_percent=100 * float(on_grid.mean())))


def _refuse_wrong(matches: PointMatches, is_right: Bool[ndarray, "n"], noise_px: float) -> None:
    n_right = int(is_right.sum())
    if n_right < MIN_MATCHES or n_right < MIN_RIGHT_SHARE * len(matches):
        raise refusal(finding("matches-contradict", n_right=n_right, n_matches=len(matches), noise_px=noise_px))


def _pairs_apart(matches: PointMatches, is_right: Bool[ndarray, "n"]) -> list[Finding]:
    """Pairs of which far fewer matches fit than of all."""
    usual = is_right.mean()
    found = []
    for pair, name in enumerate(matches.names):
        own = matches.pair == pair
        if own.sum() >= MIN_MATCHES and matches.n_pairs > 1 and is_right[own].mean() < CONTRARY_SHARE * usual:
            share, usual_share = 100 * float(is_right[own].mean()), 100 * float(usual)
            found.append(finding("pair-contradicts", pair=name, share_percent=share, usual_percent=usual_share))
    return found


def _all_far(problem: EpipolarProblem, estimate: RelativePose, noise_px: float) -> bool:
    """Whether hardly a point is nearer than noise would make it seem: the equations then take noise for parallax."""
    parallax_px, _ = parallax_and_sides(problem, estimate)
    return int((parallax_px > CLEAR_PARALLAX * noise_px).sum()) < MIN_CLEAR


def _on_the_visible_side(problem: EpipolarProblem, estimate: RelativePose, noise_px: float) -> RelativePose:
    """The sign of the translation by which points lie in front of both cameras."""
    near = np.abs(problem.residuals_px(estimate)) < NEAR_NOISE * noise_px
    parallax_px, side = parallax_and_sides(problem.select(near), estimate)
    clear = parallax_px > 3.0
    return estimate if side[clear].sum() >= 0 else RelativePose(estimate.R, -estimate.t)


def _covariance(
    problem: EpipolarProblem,
    matches: PointMatches,
    estimate: RelativePose,
    noise_px: float,
    request: NaturalRequest,
) -> tuple[Float[ndarray, "q q"], Float[ndarray, "5 5"]]:
    """Of the five unknowns and both cameras' parameters together; and the part of the former that other images would have anew."""
    equations = problem.linearize(estimate, np.asarray(noise_px), "tukey")
    regions = regions_of(matches.left_px, request.cameras[0].size_wh)
    own = covariance_by_regions(equations, regions, np.random.default_rng(request.seed))
    noise = covariance_of_noise(equations, noise_px)
    grow = np.sqrt(np.maximum(np.diagonal(noise) / np.maximum(np.diagonal(own), 1e-300), 1.0))
    own = own * np.outer(grow, grow)
    of_cameras = intrinsics_covariance(request.cameras, request.intrinsics)
    n_left = len(request.cameras[0].parameters)
    sigma = np.sqrt(np.diagonal(of_cameras))

    def of_other_cameras(cameras: tuple[Camera, Camera]) -> EpipolarProblem:
        left, right = (Rays.of_points(c, p) for c, p in zip(cameras, (matches.left_px, matches.right_px), strict=True))
        return EpipolarProblem(left, right)

    A = np.hstack(
        steps_by_intrinsics(equations, of_other_cameras, request.cameras, estimate, (sigma[:n_left], sigma[n_left:]))
    )
    whole = np.zeros((5 + len(sigma), 5 + len(sigma)))
    whole[:5, :5] = own + A @ of_cameras @ A.T
    whole[:5, 5:] = A @ of_cameras
    whole[5:, :5] = whole[:5, 5:].T
    whole[5:, 5:] = of_cameras
    if _all_far(problem.select(equations.weights > 0), estimate, noise_px):
        whole[[3, 4], [3, 4]] += np.radians(90.0) ** 2
    return whole, own


def intrinsics_covariance(cameras: tuple[Camera, Camera], known: Covariance | None) -> Float[ndarray, "p p"]:
    """Covariance of all parameters of both cameras, left first: what a rig file says of them, or what is assumed."""
    names = [
        f"{side}.{n}"
        for side, c in zip(("left", "right"), cameras, strict=True)
        for n in camera_model(c.model).parameter_names
    ]
    out = np.zeros((len(names), len(names)))
    if known is not None and any(name in known.names for name in names):
        place = {name: i for i, name in enumerate(known.names)}
        here = [i for i, name in enumerate(names) if name in place]
        there = [place[names[i]] for i in here]
        out[np.ix_(here, here)] = known.matrix[np.ix_(there, there)]
        return out
    first = 0
    for camera in cameras:
        f = float(camera.parameters[0])
        out[first, first] = out[first + 1, first + 1] = out[first, first + 1] = out[first + 1, first] = (
            ASSUMED_FOCAL_SHARE * f
        ) ** 2
        out[first + 1, first + 1] += (ASSUMED_ASPECT_SHARE * f) ** 2
        out[first + 2, first + 2] = out[first + 3, first + 3] = ASSUMED_CENTRE_PX**2
        for i, name in enumerate(camera_model(camera.model).distortion_names):
            is_known_zero = not camera.distortion.any()  # rectified images: what is left of the lens is not said
            out[first + 5 + i, first + 5 + i] = 0.0 if is_known_zero else ASSUMED_DISTORTION.get(name, 0.0) ** 2
        first += len(camera.parameters)
    return out


UNIT = np.radians([UNTOLD_TURN_DEG] * 3 + [UNTOLD_DIRECTION_DEG] * 2)


def _untold_part(covariance: Float[ndarray, "q q"]) -> Float[ndarray, "5 k"] | None:
    """Directions of the five unknowns, in :data:`UNIT`, that the scene does not tell, at right angles; None if it tells all."""
    values, vectors = np.linalg.eigh(covariance[:5, :5] / np.outer(UNIT, UNIT))
    return vectors[:, values > 1.0] if values[-1] > 1.0 else None


def _untold_finding(covariance: Float[ndarray, "q q"], *, is_kept: bool) -> Finding:
    _, vectors = np.linalg.eigh(covariance[:5, :5] / np.outer(UNIT, UNIT))
    sigma = np.degrees(np.sqrt(np.diagonal(covariance)[:5]))
    words = ("pitch", "yaw", "roll", "the direction of T", "the direction of T")
    code = "scene-tells-too-little-kept" if is_kept else "scene-tells-too-little"
    what = words[int(np.argmax(np.abs(vectors[:, -1])))]
    return finding(code, what=what, turn_sigma_deg=float(sigma[:3].max()), direction_sigma_deg=float(sigma[3:].max()))


def _kept(problem: EpipolarProblem, untold: Float[ndarray, "5 k"], old: RelativePose, noise_px: float) -> RelativePose:
    """The best pose that agrees with the old one in what the scene does not tell."""
    told = np.linalg.svd(untold, full_matrices=True)[0][:, untold.shape[1] :]
    return _refined_along(problem, old, UNIT[:, None] * told, noise_px)


def _limited(covariance: Float[ndarray, "q q"]) -> Float[ndarray, "q q"]:
    """What was kept is taken to be known to one unit: the old rig's own uncertainty is not asked for."""
    values, vectors = np.linalg.eigh(covariance[:5, :5] / np.outer(UNIT, UNIT))
    scaled = UNIT[:, None] * vectors
    limited = np.array(covariance)
    limited[:5, :5] = scaled @ np.diag(np.minimum(values, 1.0)) @ scaled.T
    return limited


def _refined_along(
    problem: EpipolarProblem, start: RelativePose, told: Float[ndarray, "5 k"], noise_px: float
) -> RelativePose:
    """The best estimate reached by steps in some directions only, the kernel closing as ever."""
    current = start
    if told.shape[1] == 0:
        return current
    for scale_px in (*SCHEDULE_PX, *([noise_px] * KEPT_STEPS)):
        kernel = "tukey" if scale_px == noise_px else "geman"
        for _ in range(2):
            equations = problem.linearize(current, np.asarray(scale_px), kernel)
            J = equations.jacobian @ told
            H = J.T @ (equations.weights[:, None] * J)
            g = -J.T @ (equations.weights * equations.residuals_px)
            current = current.stepped(told @ np.linalg.solve(H + 1e-9 * (np.trace(H) + 1e-9) * np.eye(len(H)), g))
    return current


def _calibration(
    matches: PointMatches,
    request: NaturalRequest,
    estimate: RelativePose,
    covariances: tuple[Float[ndarray, "q q"], Float[ndarray, "5 5"]],
    known: tuple[float, str],
    findings: tuple[Finding, ...],
) -> StereoCalibration:
    (noise_px, start), (covariance, random) = known, covariances
    length = request.baseline_m if request.baseline_m is not None else 1.0
    rig = StereoRig(
        *request.cameras, SE3(so3.project_to_rotation(estimate.R), length * estimate.t), request.baseline_m is not None
    )
    problem, _ = EpipolarProblem.of_matches(request.cameras, matches)
    residuals = problem.residuals_px(estimate)
    is_right = np.abs(residuals) < 4.685 * noise_px
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
    basis = length * np.stack([np.cross(axis, estimate.t) for axis in tangents(estimate.t).T], axis=1)
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
        noise_px=noise_px,
        views=tuple(views),
        findings=findings,
        provenance={
            "method": "natural images",
            "start": start,
            "n_matches": len(matches),
            "n_right": int(is_right.sum()),
            "random_rotation_covariance_rad2": random[:3, :3].tolist(),
            "length_from": request.length_from,
            "intrinsics_sigma": "rig file" if request.intrinsics is not None else "assumed",
        },
    )
