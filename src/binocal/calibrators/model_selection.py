"""Choose the camera model by what views that were left out show: rectified rows and lengths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import MIN_VIEWS, CalibrationRequest, Calibrator
from binocal.calibrators.joint import NominalSolve, solve_as_they_were, solve_clean, solve_diagnosed
from binocal.calibrators.left_out_views import LeftOutErrors, left_out_errors
from binocal.calibrators.summary import joint_problem, rig_of
from binocal.cameras import CAMERA_MODELS, camera_model
from binocal.cameras.ray_coverage import pixels_without_ray
from binocal.errors import CalibrationError, DataError
from binocal.evidence import Detections
from binocal.findings import finding
from binocal.initialization.model_start import fit_intrinsics
from binocal.result import StereoCalibration
from binocal.shapes import Bool, Float
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem
from binocal.solvers.covariance import inliers, shared_covariance
from binocal.solvers.minimization import LoopOptions, minimize
from binocal.solvers.principal_points import CentrePrior, has_centre_prior

PLAIN = "brown4"
STAGES = ((PLAIN, "brown5"), ("brown8",), ("fisheye4",))
BASES = (PLAIN, "fisheye4")  # whose nominal solve gives views, poses and start; a strong lens needs the second
MAX_VIEWS = 36  # evenly chosen; more would tell smaller differences apart than matter for rows and lengths
MIN_VIEWS_FOR_CHOICE = 2 * MIN_VIEWS  # below that the rigs without a block would be degenerate
SAME_SCALE = 0.95  # of the noise: a better fit than that is measured with its own corners
START_CORNERS = 200  # evenly chosen, for the start of another model
OPTIONS = LoopOptions(max_iterations=40, tolerance_sigma=0.3)
BASE_OUTLIERS = 0.02  # share of corners without weight beyond which another base is tried


@dataclass(frozen=True, slots=True)
class Advantage:
    """What a model must be better by to be taken in place of a simpler one: standard errors, and the share of the squared error."""

    standard_errors: float
    share: float

    def exceeds(self, needed: Advantage, factor: float = 1.0) -> bool:
        """Whether it is more in both; ``factor`` multiplies the standard errors needed."""
        return self.standard_errors > factor * needed.standard_errors and self.share > needed.share


OF_USE, STRONG = Advantage(1.5, 0.001), Advantage(1.0, 0.05)
"""brown5, so that brown8 is worth trying; any of Brown's models, so that fisheye4 is: rows of which brown4 leaves a twentieth."""
RICHER = Advantage(2.5, 0.003)
"""A Brown model with more coefficients: taken in vain it costs little, left out it biases the rig by more than its sigmas."""
IN_BOTH = Advantage(2.0, 0.1)
"""The same where rows and lengths gain, each by that share: the standard errors are those of both tests taken together. A wide lens
whose boards left 58 % of the image empty had 1.9 and 1.4; scenes of the same rig then had rows of 0.10 px, not of 0.17."""
OTHER_KIND = Advantage(4.0, 0.2)
"""fisheye4, on a lens that Brown's models describe nearly as well: 11 % of the error."""
FOLDED = Advantage(4.0, 0.2)
"""A model that lacks rays for some of the image, against one that has them all."""
PLAINLY = Advantage(2.0, 0.3)
"""Any model where the simpler one cannot describe the lens: a share that chance does not leave asks for fewer standard errors."""
EQUAL = Advantage(-1.0, -0.02)
"""As good: with a ray for every pixel, where the other lacks some."""
COMPARABLE, COMPARABLE_LENGTHS = -0.35, -1.5
"""Shares of the squared errors of rows and lengths. Nearly as good: with rays where the other lacks many; on rows, with half of the
coefficients on a lens that needs many. Between halves of one recording of such a lens, the change from one model to another moved
rows by twice what it fitted them better by."""
LACKS_MANY = 0.05  # of the image
CLEARLY_WORSE = -3.0  # standard errors
COVERS_MORE = 0.5  # of the share of the image without ray
LENGTH_FACTOR = 1.6  # of the standard errors needed: lengths are one number a view, and chance has heavier tails there
LARGEST_RATIO = 5.0  # of a view's length error over the typical one: one odd view must not choose the model
DECISIVE_BIC = 10.0  # "very strong" evidence (Kass & Raftery 1995, section 3.2)


@dataclass(frozen=True, slots=True, eq=False)
class ModelTrial:
    """One model's fit to the views: its errors on views left out, the share of the image without ray, or why it failed."""

    model: str
    errors: LeftOutErrors
    share_without_ray: float = 0.0
    failure: str = ""
    information_criterion: float = np.inf

    @property
    def row_rms_px(self) -> float:
        """RMS over the corners of the views left out."""
        return _rms(self.errors.rows_px)

    @property
    def length_rms_percent(self) -> float:
        """RMS over the views left out."""
        return 100 * _rms(self.errors.lengths)

    @property
    def is_tested(self) -> bool:
        """Whether views were left out."""
        return not self.failure and bool(np.isfinite(self.errors.rows_px).any())


def calibrate_with_best_model(
    detections: Detections,
    method: Calibrator,
    request: CalibrationRequest,
) -> StereoCalibration:
    """Choose the camera model from nominal solves, then calibrate once with it.

    All models are fitted to the same views, corners and weights, and compared on views left out (:mod:`.left_out_views`): no
    rule of acceptance takes part, so that none wins because the others were refused. The simplest model is kept unless
    another is decisively better (:func:`choose_model`). Where the plain model is chosen and refused, so are the views. Where a
    richer one is refused, whose coefficients the views may leave open, the next choice stands in if it is not decisively worse.
    With fewer than six usable views nothing can be left out; the Bayesian information criterion decides then, which is said in
    a warning. The reason is in the provenance under ``model_choice``.

    Raises:
        CalibrationError: The views determine no rig, or the chosen model's is not trustworthy.
    """
    request.report("camera models", 0, len(CAMERA_MODELS) + 1)
    base = _base(_spread(detections), request)
    trials = _trials(base, request)
    few = base.views.n_views < MIN_VIEWS_FOR_CHOICE
    refused: list[tuple[ModelTrial, CalibrationError]] = []
    while True:
        chosen, reason = choose_by_information(trials, base.views.n_views) if few else choose_model(trials)
        if any(chosen.failure or is_decisively_better(better, chosen) for better, _ in refused):
            raise refused[0][1]
        try:
            calibration = method(detections, replace(request, model=chosen.model))
            break
        except CalibrationError as error:
            if chosen.model == PLAIN:
                raise refused[0][1] if refused else error from None
            refused.append((chosen, error))
            trials = [replace(t, failure=str(error)) if t is chosen else t for t in trials]
    request.report("camera models", len(CAMERA_MODELS) + 1, len(CAMERA_MODELS) + 1)
    tested = [t for t in trials if t.is_tested]
    choice = {
        "model": chosen.model,
        "reason": reason,
        "n_views": base.views.n_views,
        "held_out_row_rms_px": {t.model: t.row_rms_px for t in tested},
        "held_out_length_rms_percent": {t.model: t.length_rms_percent for t in tested},
        "share_without_ray": {t.model: t.share_without_ray for t in trials if not t.failure},
        "failures": {t.model: t.failure for t in trials if t.failure},
    }
    findings = calibration.findings + ((finding("model-choice-weak", reason=reason),) if few else ())
    return replace(calibration, provenance={**calibration.provenance, "model_choice": choice}, findings=findings)


def is_decisively_better(a: ModelTrial, b: ModelTrial) -> bool:
    """Whether the evidence for the first would make up for its being of another kind."""
    return bool(_decisive(b, a, OTHER_KIND) or _decisive(b, a, PLAINLY))


def choose_model(trials: list[ModelTrial]) -> tuple[ModelTrial, str]:
    """The simplest trial that no other beats decisively, and the sentence that says so.

    Models are compared in their order, each with the one kept so far (:func:`gain`). See :data:`RICHER`, :data:`OTHER_KIND` and
    :data:`FOLDED` for how much better one must be. A lens that is decisively beyond brown4 and brown5 is no ordinary one: there
    fisheye4, with half of brown8's coefficients, need only be as good. Of models that are equally good the one is kept that has
    a ray for every pixel.
    """
    tested = [t for t in trials if t.is_tested]
    if not tested:
        only = next((t for t in trials if not t.failure), trials[0])
        return only, f"{only.model} is taken; nothing could be held out"
    kept, why = tested[0], "no other is decisively better"
    for other in tested[1:]:
        if taken := _why_taken(kept, other, tested):
            kept, why = other, taken
    rows = ", ".join(f"{t.model} {t.row_rms_px:.4f}" for t in tested)
    lengths = ", ".join(f"{t.length_rms_percent:.3f}" for t in tested)
    failed = [t.model for t in trials if t.failure]
    reason = f"{kept.model}: {why} (held-out rows, px: {rows}; lengths, %: {lengths})"
    return kept, reason + (f"; {', '.join(failed)} could not be fitted" if failed else "")


def _why_taken(kept: ModelTrial, other: ModelTrial, tested: list[ModelTrial]) -> str:
    """Why the other model is taken in place of the one kept so far; empty if it is not."""
    is_other_kind = camera_model(other.model).sees_behind
    needed = OTHER_KIND if is_other_kind else RICHER
    if other.share_without_ray > 0 and not kept.share_without_ray > 0:
        needed = max(needed, FOLDED, key=lambda a: a.share)
    if words := _decisive(kept, other, needed) or _decisive(kept, other, PLAINLY):
        return words
    rows, lengths = gains(kept, other)
    both = (rows.standard_errors + lengths.standard_errors) / np.sqrt(2)
    if needed is RICHER and both > IN_BOTH.standard_errors and min(rows.share, lengths.share) > IN_BOTH.share:
        return (
            f"its squared errors of rows and of lengths are {100 * rows.share:.2g} and {100 * lengths.share:.2g} % below those of "
            f"{kept.model} ({both:.1f} standard errors together)"
        )
    is_equal = rows.exceeds(EQUAL) and lengths.exceeds(EQUAL)
    is_comparable = rows.share > COMPARABLE and lengths.share > COMPARABLE_LENGTHS
    lacks_many = kept.share_without_ray > LACKS_MANY
    if other.share_without_ray < COVERS_MORE * kept.share_without_ray and (is_equal or (lacks_many and is_comparable)):
        return f"about as good as {kept.model}, which has no ray for {100 * kept.share_without_ray:.1f} % of the image"
    if is_other_kind and 2 * _n_coefficients(other) <= _n_coefficients(kept) and rows.share > COMPARABLE:
        simpler = [t for t in tested if t is not other and _n_coefficients(t) < _n_coefficients(kept)]
        if not simpler or gains(simpler[0], other)[0].share > PLAINLY.share:
            return f"about as good as {kept.model}, with fewer coefficients, on a lens that {PLAIN} does not describe"
    return ""


def _n_coefficients(trial: ModelTrial) -> int:
    return len(camera_model(trial.model).distortion_names)


def _decisive(kept: ModelTrial, other: ModelTrial, needed: Advantage) -> str:
    """Where the other is better by all that is needed, in words; empty if nowhere, or if it is clearly worse in something."""
    rows, lengths = gains(kept, other)
    if min(rows.standard_errors, lengths.standard_errors) < CLEARLY_WORSE:
        return ""
    return " and ".join(
        f"its squared error of {what} is {100 * found.share:.2g} % below that of {kept.model} ({found.standard_errors:.1f} standard errors)"
        for what, found, factor in (("rows", rows, 1.0), ("lengths", lengths, LENGTH_FACTOR))
        if found.exceeds(needed, factor)
    )


def gains(kept: ModelTrial, other: ModelTrial) -> tuple[Advantage, Advantage]:
    """By how much the other's squared errors of rows and of lengths are lower; corners and views are the same for both."""
    limit = LARGEST_RATIO * min(float(np.nanmedian(np.abs(t.errors.lengths))) for t in (kept, other))
    lengths = [np.clip(t.errors.lengths, -limit, limit)[:, None] for t in (kept, other)]
    return advantage(kept.errors.rows_px, other.errors.rows_px), advantage(lengths[0], lengths[1])


def advantage(a: Float[ndarray, "views m"], b: Float[ndarray, "views m"]) -> Advantage:
    """What b's squares are lower than a's by.

    With e the errors of the better one and d those by which the worse one differs, the squares differ by d² + 2 d e: only the
    second part is chance. It is summed view by view before it is squared, since errors of one view are alike. Source: Clark & West
    2007, "Approximately normal tests for equal predictive accuracy in nested models", for the idea.
    """
    both = np.isfinite(a) & np.isfinite(b)
    a, b = np.where(both, a, 0.0), np.where(both, b, 0.0)
    before, after = float(np.sum(a * a)), float(np.sum(b * b))
    chance = 2 * np.sum((a - b) * (b if after < before else a), axis=1)
    error = max(float(np.sqrt(np.sum(chance**2))), 1e-12 * max(before, after), 1e-300)
    return Advantage((before - after) / error, (before - after) / max(before, 1e-300))


def choose_by_information(trials: list[ModelTrial], n_views: int) -> tuple[ModelTrial, str]:
    """The first trial that no later one beats by decisive evidence of the information criterion, and the sentence that says so."""
    fitted = [t for t in trials if np.isfinite(t.information_criterion)]
    kept = fitted[0] if fitted else trials[0]
    for other in fitted[1:]:
        if other.information_criterion < kept.information_criterion - DECISIVE_BIC:
            kept = other
    return kept, (
        f"{n_views} usable views are too few to hold some out; {kept.model} taken by the Bayesian information criterion"
    )


def _rms(errors: Float[ndarray, "*n"]) -> float:
    return float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else float("nan")


def _spread(detections: Detections) -> Detections:
    """All views, or so many evenly chosen ones."""
    n = detections.n_views
    return detections if n <= MAX_VIEWS else detections.select(np.arange(MAX_VIEWS) * (n - 1) // (MAX_VIEWS - 1))


_Fit = tuple[BundleProblem, BundleMinimum]


@dataclass(frozen=True, slots=True, eq=False)
class _Base:
    """What every model starts from: the views with the board as it was found to be, the nominal problem of them, and a solution."""

    views: Detections
    problem: BundleProblem
    estimate: BundleEstimate

    @property
    def model(self) -> str:
        """That of the solution."""
        return self.problem.cameras[0].model.name

    def problem_of(self, request: CalibrationRequest) -> BundleProblem:
        """The problem of the request's model, in which each corner weighs what it does in the nominal one."""
        problem = joint_problem(self.views, request)
        cameras = zip(problem.cameras, self.problem.cameras, strict=True)
        weighed = tuple(replace(c, whitening=b.whitening, lengths2=b.lengths2) for c, b in cameras)
        return replace(problem, cameras=weighed)


def _base(detections: Detections, request: CalibrationRequest) -> _Base:
    """The nominal solve, and the board's shape on top, where it is to be found: a bent board must not choose the lens.

    Raises:
        CalibrationError, DataError: No model gets views to start from; the error is the plain model's.
    """
    nominal = solve_clean(detections, replace(request, model=PLAIN)) or _diagnosed(detections, request)
    request.check_stop()
    views, estimate = nominal.views, nominal.minimum.estimate
    is_as_given = request.board_shape == "flat" and views.object_sigma_m is None
    if not is_as_given:
        together = replace(request, exposure="together")
        solve = solve_as_they_were(nominal.problem, nominal.minimum, together, views)
        estimate = solve.minimum.estimate.bundle
        views = replace(views, object_points_m=np.ascontiguousarray(solve.minimum.estimate.points.T))
    return _Base(views, nominal.problem, estimate)


def _diagnosed(views: Detections, request: CalibrationRequest) -> NominalSolve:
    """The nominal solve of the plain model, or of the one for strong lenses where that keeps more corners.

    Raises as :func:`_base`.
    """
    found: list[tuple[int, NominalSolve]] = []
    failure: CalibrationError | DataError | None = None
    n_seen = int(views.left_is_seen.sum() + views.right_is_seen.sum())
    for name in BASES:
        request.check_stop()
        try:
            solve = solve_diagnosed(views, replace(request, model=name))
        except (CalibrationError, DataError) as error:
            failure = failure or error
            continue
        n_used = sum(int(used.sum()) for used in inliers(solve.problem, solve.minimum))
        found.append((n_used, solve))
        if solve.minimum.is_converged and n_used > (1 - BASE_OUTLIERS) * n_seen:
            break
    if not found:
        assert failure is not None
        raise failure
    return max(found, key=lambda pair: pair[0])[1]


def _trials(base: _Base, request: CalibrationRequest) -> list[ModelTrial]:
    """The models on the base's views: fitted, then tested on views left out.

    A lens on which one more coefficient is of no use is plain, and brown8 is not tried; fisheye4 only on lenses of which brown4
    leaves a good deal.
    """
    fits: dict[str, _Fit | str] = {}
    trials: list[ModelTrial] = []
    scale: _Scale | None = None
    for names in STAGES:
        for name in names:
            fits[name] = _fit(base, replace(request, model=name))
            request.report("camera models", len(fits), len(CAMERA_MODELS) + 1)
        best = _Scale.of_best(fits)
        if scale is None or best.noise_px < SAME_SCALE * scale.noise_px:  # else the first tests stand
            scale, trials = best, []
        trials += [_trial(name, base.views, fits[name], scale) for name in list(fits)[len(trials) :]]
        if base.views.n_views >= MIN_VIEWS_FOR_CHOICE and not _is_worth_more(trials):
            break
    return trials


def _is_worth_more(trials: list[ModelTrial]) -> bool:
    """Whether models with more coefficients, or of another kind, could do better than those tried."""
    plain, *richer = trials
    if not all(trial.is_tested for trial in trials) or plain.share_without_ray > 0:
        return True
    found = [gains(plain, trial) for trial in richer]
    if len(trials) < len(CAMERA_MODELS) - 1:
        return any(gain.exceeds(OF_USE) for pair in found for gain in pair)
    return any(rows.exceeds(STRONG) for rows, _ in found)


@dataclass(frozen=True, slots=True, eq=False)
class _Scale:
    """What all models are measured with: the corners that carry weight in the best fit, its focal length and noise."""

    is_used: Bool[ndarray, "views n"]
    focal_px: float
    noise_px: float

    @staticmethod
    def of_best(fits: Mapping[str, _Fit | str]) -> _Scale:
        """That of the fit with the least noise; no corner counts where there is none."""
        minima = [fit for fit in fits.values() if not isinstance(fit, str)]
        if not minima:
            return _Scale(np.zeros((0, 0), dtype=bool), 1.0, np.inf)
        problem, best = min(minima, key=lambda fit: float(fit[1].scale_px))
        left, right = inliers(problem, best)
        return _Scale(left & right, float(best.estimate.parameters[0][0]), float(best.scale_px))


def _trial(name: str, views: Detections, fit: _Fit | str, scale: _Scale) -> ModelTrial:
    nothing = LeftOutErrors.unmeasured(views.n_views, len(views.object_points_m))
    if isinstance(fit, str):
        return ModelTrial(name, nothing, failure=fit)
    problem, minimum = fit
    errors = None
    if views.n_views >= MIN_VIEWS_FOR_CHOICE:
        errors = left_out_errors(views, problem, minimum, scale.is_used, (scale.focal_px, scale.noise_px))
    rig = rig_of(minimum.estimate, views, name)
    share = sum(found.share for camera in (rig.left, rig.right) if (found := pixels_without_ray(camera))) / 2
    return ModelTrial(name, errors or nothing, share, information_criterion=_information_criterion(problem, minimum))


def _information_criterion(problem: BundleProblem, minimum: BundleMinimum) -> float:
    """N ln(mean squared residual) + k ln N over the corner coordinates that were used. Source: Schwarz 1978."""
    used = inliers(problem, minimum)
    n = 2 * sum(int(u.sum()) for u in used)
    total = sum(float(e.r2_px2[u].sum()) for e, u in zip(minimum.equations.cameras, used, strict=True))
    return n * float(np.log(max(2 * total / max(n, 1), 1e-20))) + problem.n_free * float(np.log(max(n, 1)))


def _fit(base: _Base, request: CalibrationRequest) -> _Fit | str:
    """The minimum of one model from the base's solution, or why there is none."""
    problem, options = base.problem_of(request), OPTIONS
    if has_centre_prior(base.problem):
        prior = CentrePrior((base.views.left_size_wh, base.views.right_size_wh))
        problem, options = replace(problem, terms=(*problem.terms, prior)), replace(OPTIONS, is_patient=True)
    start = base.estimate if request.model == base.model else _start(base, request)
    if start is None:
        return "the model cannot see where the corners are"
    minimum = minimize(problem, start, options)
    if not bool(minimum.is_converged):
        return "the solve did not reach a minimum"
    try:
        shared_covariance(problem, minimum.estimate, minimum.equations, 1.0)
    except CalibrationError as error:
        return str(error)
    return problem, minimum


def _start(base: _Base, request: CalibrationRequest) -> BundleEstimate | None:
    """The base's solution with the lens in another model; None where that model does not see the corners."""
    model, estimate, views = camera_model(request.model), base.estimate, base.views
    parameters = []
    poses = (estimate.T_left_board, estimate.T_right_left @ estimate.T_left_board)
    for values, T, px in zip(estimate.parameters, poses, (views.left_px, views.right_px), strict=True):
        points, pixels = T.apply(views.object_points_m).reshape(-1, 3), px.reshape(-1, 2)
        seen = np.flatnonzero(np.isfinite(pixels[:, 0]))
        some = seen[:: max(len(seen) // START_CORNERS, 1)]
        start = np.zeros(model.n_parameters)
        if not (model.sees_behind or camera_model(base.model).sees_behind):  # Brown's models extend each other
            start[: len(values)] = values[: len(start)]
            parameters.append(start)
            continue
        start[:5] = values[:5]
        fitted = fit_intrinsics(model, start, points[some], pixels[some], skew=request.skew)
        if fitted is None:
            return None
        parameters.append(fitted)
    return replace(estimate, parameters=(parameters[0], parameters[1]))
