"""``zoom``: a pair with zoom lenses, calibrated at several settings; cameras and their pose as functions of the setting.

At each setting the rig is calibrated as by ``lm``. Smooth curves go through these calibrations, and a network trained by
back-propagation learns what they leave (:mod:`binocal.solvers.zoom_network`); whether it helps is decided by settings left out in turn.
The rig that is returned is that at the option ``setting`` (the middle of the range unless given); the curves are in
``extra["zoom"]``, for :class:`binocal.cameras.zoom_rig.ZoomRig`.

Source: the paper's related work [12] as its text describes it (a parallel pair, calibrated at several zoom settings, triangulation, a
back-propagation network that corrects the residual error); near it Ahmed & Farag 2000, "A neural approach to zoom-lens camera
calibration from data with outliers", which maps the setting to all parameters and trains on the reprojection error. Deviations:
the network corrects the cameras from which points are triangulated, not the points; it is trained on the reprojection error to
second order; several networks are averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.joint import calibrate_jointly
from binocal.calibrators.lm import calibrate_lm
from binocal.calibrators.registry import refuse_unsuited
from binocal.cameras import StereoRig
from binocal.cameras.zoom_rig import ZoomRig, by_parameters, curve_names, curve_quantities
from binocal.errors import CalibrationError, DataError
from binocal.evidence.zoom_settings import ZoomSettings
from binocal.findings import Finding, finding
from binocal.result import Covariance, RejectedView, ResidualSummary, StereoCalibration
from binocal.shapes import Float
from binocal.solvers.zoom_network import N_HIDDEN, Fitted, fit_network

NAME = "zoom"
MIN_SETTINGS = 5  # a curve of three terms, and two settings to leave out
N_NETWORKS = 5
MAX_DEGREE = 4  # of 9 settings' curves: with 2 the rows between them err 2.3 times as much as at them, with 3 and 4 1.0 and 1.3 times
OFF_SIGMAS = (
    2.0  # of a setting from the curves through the others, RMS over its quantities: 1.4 measured at most of sound sets
)
TURNED_SIGMAS = (
    5.0  # of a focal length that falls between two settings where it grows on the whole, or grows where it falls
)
SIGMA_SHARE = 1.0  # of a quantity's typical standard deviation: the least unit for it


def calibrate_zoom(evidence: ZoomSettings, request: CalibrationRequest) -> StereoCalibration:
    """The rig at a setting of the zoom (see :class:`binocal.calibrators.base.Calibrator`).

    Covariance: what the calibrations' own errors leave of the curves there, what the networks differ by, and both widened by
    how far calibrations that were left out lie from the curves through the others.
    """
    if not isinstance(evidence, ZoomSettings):
        raise TypeError(f"calibrator {NAME!r} works from ZoomSettings; got {type(evidence).__name__}")
    request.check_options("setting")
    refuse_unsuited(NAME, request)
    settings = evidence.settings
    if len(settings) < MIN_SETTINGS:
        raise DataError(
            f"{len(settings)} zoom settings, {MIN_SETTINGS} needed to check a curve; calibrate at more of them."
        )
    low, high = float(settings[0]), float(settings[-1])
    wanted = float(request.options.get("setting", (low + high) / 2))
    if not low <= wanted <= high:
        raise ValueError(f"zoom setting {wanted:g} is outside of those calibrated, {low:g} to {high:g}")
    made = _each_setting(evidence, request)
    points = _CurvePoints.of(settings, made)
    request.report("zoom curves", 0, 2)
    errors = {n: points.left_out(request, n) for n in (0, N_HIDDEN)}
    n_hidden = min(errors, key=lambda n: errors[n].rms)
    request.report("zoom curves", 1, 2)
    fits = points.fits(n_hidden, request.seed)
    zoom = points.zoom_rig(fits)
    widening = max(1.0, errors[n_hidden].in_sigmas)
    covariance = points.covariance_at(fits, zoom, wanted) * widening**2
    request.report("zoom curves", 2, 2)
    said = {
        "setting": wanted,
        "settings": settings.tolist(),
        "hidden": n_hidden,
        "left_out_error": {
            "unit": "standard deviations of a setting's own calibration, rms",
            "network": errors[N_HIDDEN].rms,
            "polynomial": errors[0].rms,
            "linear_interpolation": points.left_out_linear(),
        },
        "sigma_factor": widening,
    }
    calibration = _summarized(settings, made, zoom, wanted, covariance, said)
    return replace(calibration, findings=(*_off_curve(settings, made, errors[n_hidden]), *calibration.findings))


def _off_curve(
    settings: Float[ndarray, "k"], made: Sequence[StereoCalibration], left_out: _LeftOut
) -> tuple[Finding, ...]:
    """A setting whose number or whose views are not what they are given as, if there is one."""
    focal = np.array([c.rig.left.parameters[0] for c in made])
    sigma = np.array([c.covariance.sigma["left.fx"] for c in made])
    step = np.diff(focal) * np.sign(focal[-1] - focal[0]) / np.hypot(sigma[1:], sigma[:-1])
    turned = int(np.argmin(step))
    if step[turned] < -TURNED_SIGMAS:
        at = f"between the zoom settings {settings[turned]:g} and {settings[turned + 1]:g} the focal length goes back"
        return (finding("zoom-off-curve", at=at, sigmas=-float(step[turned])),)
    if left_out.farthest_sigmas > OFF_SIGMAS:
        at = f"the calibration at zoom setting {settings[left_out.farthest]:g} lies off the curves through the others"
        return (finding("zoom-off-curve", at=at, sigmas=left_out.farthest_sigmas),)
    return ()


def _each_setting(evidence: ZoomSettings, request: CalibrationRequest) -> list[StereoCalibration]:
    """The calibrations, all with one camera model: the one asked for, or the best at the widest setting, where lenses bend most."""
    plain = replace(request, options={}, progress=None)
    made: list[StereoCalibration] = []
    for i, (setting, detections) in enumerate(zip(evidence.settings.tolist(), evidence.detections, strict=True)):
        request.report("zoom settings", i, len(evidence.detections))
        try:
            if plain.model == "auto":
                from binocal.calibrators.model_selection import calibrate_with_best_model

                made.append(calibrate_with_best_model(detections, calibrate_lm, plain))
                plain = replace(plain, model=made[0].rig.left.model)
            else:
                made.append(calibrate_jointly(detections, plain))
        except (CalibrationError, DataError) as error:
            raise _at_setting(error, setting) from error
    return made


def _at_setting(error: CalibrationError | DataError, setting: float) -> CalibrationError | DataError:
    """The error with the setting that it is about."""
    kind = DataError if isinstance(error, DataError) else CalibrationError
    return kind(f"zoom setting {setting:g}: {error}")


@dataclass(frozen=True, slots=True)
class _LeftOut:
    """How far calibrations that were left out lie from the curves: in their own standard deviations, and in those of both.

    The farthest setting's number, and its distance in standard deviations of both, stand beside.
    """

    rms: float
    in_sigmas: float
    farthest: int
    farthest_sigmas: float


@dataclass(frozen=True, slots=True, eq=False)
class _CurvePoints:
    """The calibrations as points of curves in standard units, settings in [-1, 1]."""

    settings: Float[ndarray, "k"]
    middle: StereoRig
    centre: Float[ndarray, "q"]
    scale: Float[ndarray, "q"]
    targets: Float[ndarray, "k q"]
    covariances: Float[ndarray, "k q q"]
    roots: Float[ndarray, "k q q"]

    @staticmethod
    def of(settings: Float[ndarray, "k"], made: Sequence[StereoCalibration]) -> _CurvePoints:
        middle = made[len(made) // 2].rig
        quantities = np.stack([curve_quantities(c.rig, middle) for c in made])
        J = np.stack([by_parameters(c.rig, middle) for c in made])
        covariances = J @ np.stack([c.covariance.matrix for c in made]) @ J.swapaxes(-1, -2)
        typical = np.sqrt(np.median(np.diagonal(covariances, axis1=1, axis2=2), axis=0))
        scale = np.maximum(quantities.std(axis=0), SIGMA_SHARE * typical)
        covariances = covariances / np.outer(scale, scale)
        centre = quantities.mean(axis=0)
        roots = np.stack([np.linalg.cholesky(np.linalg.inv(C)) for C in covariances])
        return _CurvePoints(settings, middle, centre, scale, (quantities - centre) / scale, covariances, roots)

    @property
    def x(self) -> Float[ndarray, "k"]:
        """Settings in [-1, 1]."""
        return 2 * (self.settings - self.settings[0]) / (self.settings[-1] - self.settings[0]) - 1

    def fits(
        self, n_hidden: int, seed: int, *, without: int | None = None, n_networks: int = N_NETWORKS
    ) -> list[Fitted]:
        """Networks with different first weights; one of no hidden units."""
        kept = [i for i in range(len(self.settings)) if i != without]
        return [
            fit_network(
                self.x[kept],
                self.targets[kept],
                self.roots[kept],
                np.random.default_rng([seed, number]),
                degree=min(MAX_DEGREE, (len(self.settings) - 1) // 2),
                n_hidden=n_hidden,
            )
            for number in range(n_networks if n_hidden else 1)
        ]

    def left_out(self, request: CalibrationRequest, n_hidden: int) -> _LeftOut:
        """Every setting but the outer two left out in turn."""
        own, both = [], []
        for i in range(1, len(self.settings) - 1):
            request.check_stop()
            fits = self.fits(n_hidden, request.seed, without=i, n_networks=2)
            x = float(self.x[i])
            away = np.mean([fit.network(x) for fit in fits], axis=0) - self.targets[i]
            own.append(np.mean((self.roots[i].T @ away) ** 2))
            total = self.covariances[i] + _output_covariance(fits, x)
            both.append(away @ np.linalg.solve(total, away) / len(away))
        farthest = int(np.argmax(both))
        rms = float(np.sqrt(np.mean(own))), float(np.sqrt(np.mean(both)))
        return _LeftOut(*rms, farthest + 1, float(np.sqrt(both[farthest])))

    def left_out_linear(self) -> float:
        """The same of straight lines between neighbouring settings, parameter by parameter."""
        own = []
        for i in range(1, len(self.settings) - 1):
            share = (self.x[i] - self.x[i - 1]) / (self.x[i + 1] - self.x[i - 1])
            away = (1 - share) * self.targets[i - 1] + share * self.targets[i + 1] - self.targets[i]
            own.append(np.mean((self.roots[i].T @ away) ** 2))
        return float(np.sqrt(np.mean(own)))

    def zoom_rig(self, fits: Sequence[Fitted]) -> ZoomRig:
        """The curves as a value of their own."""
        low, high = float(self.settings[0]), float(self.settings[-1])
        return ZoomRig(low, high, self.middle, self.centre, self.scale, tuple(fit.network for fit in fits))

    def covariance_at(self, fits: Sequence[Fitted], zoom: ZoomRig, setting: float) -> Float[ndarray, "q q"]:
        """Of the rig's parameters at a setting."""
        x = 2 * (setting - zoom.low) / (zoom.high - zoom.low) - 1
        of_quantities = _output_covariance(fits, x) * np.outer(self.scale, self.scale)
        back = np.linalg.inv(by_parameters(zoom.rig_at(setting), self.middle))
        covariance = back @ of_quantities @ back.T
        return 0.5 * (covariance + covariance.T)


def _output_covariance(fits: Sequence[Fitted], x: float) -> Float[ndarray, "q q"]:
    """Of the networks' mean: their own, and what they differ by."""
    outputs = np.stack([fit.network(x) for fit in fits])
    within = np.mean([fit.output_covariance(x) for fit in fits], axis=0)
    away = outputs - outputs.mean(axis=0)
    return within + away.T @ away / max(len(fits) - 1, 1)


def _summarized(
    settings: Float[ndarray, "k"],
    made: Sequence[StereoCalibration],
    zoom: ZoomRig,
    wanted: float,
    covariance: Float[ndarray, "q q"],
    said: dict[str, Any],
) -> StereoCalibration:
    named = list(zip([f"{s:g}" for s in settings.tolist()], made, strict=True))
    views = [replace(view, name=f"{at}/{view.name}") for at, c in named for view in c.views]
    squares = np.array([[r**2 for r in (c.rms.left_px, c.rms.right_px, c.rms.all_px, c.noise_px)] for c in made])
    left, right, together, noise_px = np.sqrt(squares.mean(axis=0)).tolist()
    findings = {found.code: found for c in made for found in c.findings}
    return StereoCalibration(
        rig=zoom.rig_at(wanted),
        covariance=Covariance(curve_names(zoom.middle), covariance),
        rms=ResidualSummary(left, right, together),
        noise_px=noise_px,
        views=tuple(views),
        rejected=tuple(RejectedView(f"{at}/{v.name}", v.reason, v.code) for at, c in named for v in c.rejected),
        findings=tuple(findings.values()),
        n_iterations=sum(c.n_iterations for c in made),
        provenance={"zoom": said},
        extra={"zoom": zoom.document()},
    )
