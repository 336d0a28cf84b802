"""Choose the camera model by the error on views that were held out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import MIN_VIEWS, CalibrationRequest, Calibrator
from binocal.calibrators.summary import joint_problem, rig_of
from binocal.cameras import CAMERA_MODELS, StereoRig
from binocal.errors import CalibrationError, DataError, NotConvergedError
from binocal.evidence import Detections
from binocal.findings import finding
from binocal.geometry import SE3
from binocal.result import Evidence, StereoCalibration
from binocal.shapes import Float
from binocal.solvers.board_views import BundleEstimate
from binocal.solvers.minimization import LoopOptions, minimize
from binocal.solvers.poses import estimate_board_poses
from binocal.solvers.whitening import CornerWeights, corner_weights

N_FOLDS = 4
MIN_VIEWS_FOR_CHOICE = 2 * MIN_VIEWS  # below that the training folds would be degenerate
FOLD_OPTIONS = LoopOptions(tolerance_sigma=0.1)  # the models differ by far more than a tenth of a standard deviation
RESIDUAL_CAP_SIGMA = 5.0  # a wild corner must not choose the model


@dataclass(frozen=True, slots=True, eq=False)
class ModelTrial:
    """One model's fit: its calibration, or why there is none, and each view's held-out mean squared residual (NaN: not tested)."""

    model: str
    calibration: StereoCalibration | None
    failure: str
    held_out_px2: Float[ndarray, "views"]

    @property
    def held_out_rms_px(self) -> float:
        """RMS over the held-out views, pixels; NaN if none."""
        return float(np.sqrt(np.nanmean(self.held_out_px2))) if np.isfinite(self.held_out_px2).any() else float("nan")


def calibrate_with_best_model(
    detections: Detections,
    method: Calibrator,
    request: CalibrationRequest,
) -> StereoCalibration:
    """Calibrate with every camera model and keep the one that predicts held-out views best.

    The simplest model is kept whose held-out error is within one standard error (paired over the views) of the best
    one's. The reason is written to the provenance under ``model_choice``. With fewer than six usable views nothing can
    be held out; the Bayesian information criterion decides then, which is said in a warning.

    Raises:
        CalibrationError: No model gives a trustworthy rig; the error of the simplest is raised.
    """
    fits: dict[str, StereoCalibration] = {}
    failures: dict[str, CalibrationError | DataError] = {}
    names = list(CAMERA_MODELS)
    for done, name in enumerate(names):
        request.report("camera models", done, 2 * len(names))
        try:
            fits[name] = method(detections, replace(request, model=name))
        except (CalibrationError, DataError) as error:
            failures[name] = error
    if not fits:
        # a solve that ran out of iterations says less than one that was refused for a reason
        raise min(failures.values(), key=lambda error: isinstance(error, NotConvergedError))
    evidence = {name: fit.evidence for name, fit in fits.items() if fit.evidence is not None}
    good = _views_to_hold_out(evidence.values()) if evidence else ()
    if len(good) < MIN_VIEWS_FOR_CHOICE:
        name = min(fits, key=lambda name: information_criterion(fits[name]))
        reason = (
            f"{len(good)} usable views are too few to hold some out; {name} taken by the Bayesian information criterion"
        )
        return _with_choice(fits[name], name, reason, [], warn=True)

    noise_px = min(c.noise_px for c in fits.values())
    misfit_px = min(e.misfit_px for e in evidence.values())
    trials = []
    for done, name in enumerate(names):
        request.report("camera models", len(names) + done, 2 * len(names))
        if name in evidence:
            trials.append(_hold_out(good, replace(request, model=name), fits[name], noise_px, misfit_px))
        else:
            trials.append(
                ModelTrial(name, None, str(failures.get(name, "no corners to hold out")), np.full(len(good), np.nan))
            )
    request.report("camera models", 2 * len(names), 2 * len(names))
    chosen, reason = choose_model(trials)
    return _with_choice(chosen.calibration, chosen.model, reason, trials, warn=False)  # type: ignore[arg-type]


def choose_model(trials: list[ModelTrial]) -> tuple[ModelTrial, str]:
    """The simplest trial within one standard error of the best, and the sentence that says so.

    Models of equal size compete by their error alone. Trials without held-out figures cannot win.
    """
    tested = [t for t in trials if t.calibration is not None and np.isfinite(t.held_out_rms_px)]
    if not tested:
        only = next(t for t in trials if t.calibration is not None)
        return only, f"{only.model} is the only model that could be fitted; nothing could be held out"
    best = min(tested, key=lambda t: t.held_out_rms_px)
    within = [best]
    for trial in tested:
        difference = trial.held_out_px2 - best.held_out_px2
        difference = difference[np.isfinite(difference)]
        standard_error = difference.std(ddof=1) / np.sqrt(len(difference)) if len(difference) > 1 else 0.0
        if trial is not best and difference.mean() <= standard_error:
            within.append(trial)
    chosen = min(within, key=lambda t: (len(CAMERA_MODELS[t.model].distortion_names), t.held_out_rms_px))
    figures = ", ".join(f"{t.model} {t.held_out_rms_px:.4f}" for t in tested)
    if chosen is best:
        reason = f"{chosen.model} has the least held-out error (px: {figures})"
    else:
        reason = (
            f"{chosen.model} is the simplest model within one standard error of the best, {best.model} "
            f"(held-out error, px: {figures})"
        )
    failed = [t.model for t in trials if t.calibration is None]
    return chosen, reason + (f"; {', '.join(failed)} could not be fitted" if failed else "")


def information_criterion(calibration: StereoCalibration) -> float:
    """N ln(mean squared residual) + k ln n over the corner coordinates that were used. Source: Schwarz 1978."""
    n = 2 * sum(v.n_corners - v.n_outliers for v in calibration.views)
    return n * np.log(max(calibration.rms.all_px**2, 1e-20)) + len(calibration.covariance.names) * np.log(n)


def _views_to_hold_out(evidence: Iterable[Evidence]) -> tuple[str, ...]:
    """Names of the views that every fitted model used and both cameras saw."""
    used = []
    for detections in (e.detections for e in evidence):
        both = np.asarray(detections.left_is_seen.any(axis=1) & detections.right_is_seen.any(axis=1))
        used.append([name for name, is_seen in zip(detections.names, both.tolist(), strict=True) if is_seen])
    common = set(used[0]).intersection(*used)
    return tuple(name for name in used[0] if name in common)


def _hold_out(
    good: tuple[str, ...], request: CalibrationRequest, full: StereoCalibration, noise_px: float, misfit_px: float
) -> ModelTrial:
    """Cross-validate one model: each fold is solved anew from the full fit, without the views it is then tested on.

    The joint problem has one optimum in the basin that all calibrators end in, so the start saves time and does not
    leak. Residuals are weighted alike for all models, with ``noise_px`` and ``misfit_px`` of the best.
    """
    evidence = full.corners
    index = np.array([evidence.detections.names.index(name) for name in good])
    detections, T_left_board = evidence.detections.select(index), evidence.T_left_board[index]
    weights = corner_weights(detections, misfit_px)
    held_out = np.full(len(good), np.nan)
    folds = min(N_FOLDS, len(good) // 2)
    for fold in range(folds):
        request.check_stop()
        is_test = np.arange(len(good)) % folds == fold
        if np.sum(~is_test) < MIN_VIEWS:
            continue
        views, T = detections.select(~is_test), T_left_board[~is_test]
        start = BundleEstimate.of_rig(full.rig, T)
        problem = joint_problem(views, request, corner_weights(views, evidence.misfit_px))
        minimum = minimize(problem, start, FOLD_OPTIONS)
        if not minimum.is_converged:
            continue
        rig = rig_of(minimum.estimate, views, request.model)
        test = detections.select(is_test), T_left_board[is_test], weights.select(np.flatnonzero(is_test))
        held_out[is_test] = held_out_px2(rig, *test, noise_px)
    return ModelTrial(request.model, full, "", held_out)


def held_out_px2(
    rig: StereoRig, detections: Detections, T_left_board: SE3, weights: CornerWeights, noise_px: float
) -> Float[ndarray, "views"]:
    """Mean squared residual length of each view, whitened, with the rig held and the board pose fitted.

    Each length capped at 5 sigma.
    """
    poses = estimate_board_poses(rig, detections, T_left_board, weights)
    r2 = np.concatenate([poses.left_r2_px2, poses.right_r2_px2], axis=1)
    cap = max((RESIDUAL_CAP_SIGMA * noise_px) ** 2, 1e-12)
    out = np.full(detections.n_views, np.nan)
    seen = np.isfinite(r2).any(axis=1)
    out[seen] = np.nanmean(np.minimum(r2[seen], cap), axis=1)
    return out


def _with_choice(
    calibration: StereoCalibration, model: str, reason: str, trials: list[ModelTrial], *, warn: bool
) -> StereoCalibration:
    choice = {
        "model": model,
        "reason": reason,
        "held_out_rms_px": {t.model: t.held_out_rms_px for t in trials if np.isfinite(t.held_out_rms_px)},
        "failures": {t.model: t.failure for t in trials if t.failure},
    }
    findings = calibration.findings + ((finding("model-choice-weak", reason=reason),) if warn else ())
    return replace(calibration, provenance={**calibration.provenance, "model_choice": choice}, findings=findings)
