"""Criteria against the truth: every parameter's error beside its bound, and the paper's parameter accuracy (eq. 20)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from binocal.cameras import Camera, StereoRig, camera_model
from binocal.geometry import SE3, so3
from binocal.result import Covariance

BOUND_SIGMAS = 3.0
RELATIVE_TOLERANCE = 0.01  # of a focal length; of the baseline; of the image width, for a principal point
ROTATION_TOLERANCE_DEG = 0.05
DISTORTION_TOLERANCE = 5e-3


@dataclass(frozen=True, slots=True)
class ParameterError:
    """One parameter: estimate minus truth. Names and units are those of :class:`binocal.result.Covariance`.

    ``sigma`` is the calibration's own standard deviation, ``bound`` the Cramér-Rao bound's; NaN where unknown.
    ``rotation.*`` has truth 0: its value is the rotation vector, radians, that takes the true R to the estimated one.
    """

    name: str
    truth: float
    value: float
    sigma: float
    bound: float
    tolerance: float

    @property
    def error(self) -> float:
        """Estimate minus truth."""
        return self.value - self.truth

    @property
    def error_per_bound(self) -> float:
        """The error in standard deviations of the bound; NaN without a bound."""
        return self.error / self.bound if self.bound > 0 else float("nan")

    @property
    def is_correct(self) -> bool:
        """Within 3 standard deviations of the bound and within tolerance (eq. 20); without a bound, tolerance alone."""
        is_in_bound = not self.bound > 0 or abs(self.error) <= BOUND_SIGMAS * self.bound
        return bool(is_in_bound and abs(self.error) <= self.tolerance)


@dataclass(frozen=True, slots=True)
class TruthComparison:
    """A rig against the true one.

    ``*_bound_*`` are root sums of squares of the bound's standard deviations, NaN where unknown.
    """

    rotation_error_deg: float
    rotation_bound_deg: float
    translation_error_mm: float
    translation_bound_mm: float
    baseline_error_mm: float
    focal_error_px: float
    """Largest error of the four focal lengths."""
    principal_point_error_px: float
    """Longest distance of the two principal points."""
    parameters: tuple[ParameterError, ...]
    has_bound: bool

    @property
    def n_correct(self) -> int:
        """Number of parameters that are correct (eq. 20)."""
        return sum(parameter.is_correct for parameter in self.parameters)

    @property
    def parameter_accuracy_percent(self) -> float:
        """Share of computed parameters that are correct (eq. 20), percent."""
        return 100.0 * self.n_correct / len(self.parameters)


def compare_with_truth(
    rig: StereoRig,
    truth: StereoRig,
    *,
    sigma: Mapping[str, float] | None = None,
    bound: Covariance | None = None,
    has_skew: bool | None = None,
) -> TruthComparison:
    """Errors of a rig whose truth is known.

    ``rig`` and ``truth`` must be in one length unit. Rotation is compared as an angle of ``R_estimate R_truthᵀ``.
    Distortion is compared coefficient by coefficient where both lenses are of one family (a coefficient that a model
    lacks is 0), else left out: coefficients of different families have no common meaning. Skew counts when it was
    estimated: when ``has_skew`` says so, or when it is not exactly 0.
    """
    sigma = dict(sigma or {})
    bounds = bound.sigma if bound is not None else {}
    R_error = rig.T_right_left.R @ truth.T_right_left.R.T
    values: dict[str, tuple[float, float, float]] = {}
    for side, camera, true_camera in (("left", rig.left, truth.left), ("right", rig.right, truth.right)):
        values |= _camera_values(side, camera, true_camera, has_skew)
    rotation = so3.log(R_error)
    t, true_t = rig.T_right_left.t, truth.T_right_left.t
    for i, axis in enumerate("xyz"):
        values[f"rotation.{axis}"] = 0.0, float(rotation[i]), float(np.radians(ROTATION_TOLERANCE_DEG))
    for i, axis in enumerate("xyz"):
        values[f"translation.{axis}"] = float(true_t[i]), float(t[i]), RELATIVE_TOLERANCE * truth.baseline_m
    parameters = tuple(
        ParameterError(name, true, value, sigma.get(name, np.nan), bounds.get(name, np.nan), tolerance)
        for name, (true, value, tolerance) in values.items()
    )
    errors = {parameter.name: parameter.error for parameter in parameters}
    return TruthComparison(
        rotation_error_deg=float(np.degrees(so3.angle_rad(R_error))),
        rotation_bound_deg=float(np.degrees(_root_sum_square(bounds, "rotation"))),
        translation_error_mm=float(1e3 * np.linalg.norm(t - true_t)),
        translation_bound_mm=float(1e3 * _root_sum_square(bounds, "translation")),
        baseline_error_mm=float(1e3 * (rig.baseline_m - truth.baseline_m)),
        focal_error_px=max(abs(errors[f"{side}.{name}"]) for side in ("left", "right") for name in ("fx", "fy")),
        principal_point_error_px=max(
            float(np.hypot(errors[f"{side}.cx"], errors[f"{side}.cy"])) for side in ("left", "right")
        ),
        parameters=parameters,
        has_bound=bool(bounds),
    )


def in_model(camera: Camera, model: str) -> Camera | None:
    """The same lens written in a larger model of its family (missing coefficients are 0); None where that cannot be."""
    names, known = camera_model(model).parameter_names, camera_model(camera.model).parameter_names
    if not _is_one_family(camera.model, model) or not set(known) <= set(names):
        return None
    values = dict(zip(known, camera.parameters, strict=True))
    return Camera(model, camera.size_wh, np.array([values.get(name, 0.0) for name in names]))


def scaled(rig: StereoRig, factor: float) -> StereoRig:
    """The rig with every length multiplied: from board pitches to metres when the pitch becomes known."""
    T = rig.T_right_left
    return replace(rig, T_right_left=SE3(T.R, T.t * factor), is_metric=True)


def _camera_values(
    side: str, camera: Camera, truth: Camera, has_skew: bool | None
) -> dict[str, tuple[float, float, float]]:
    """(truth, value, tolerance) by parameter name."""
    values = dict(zip(camera_model(camera.model).parameter_names, camera.parameters.tolist(), strict=True))
    true = dict(zip(camera_model(truth.model).parameter_names, truth.parameters.tolist(), strict=True))
    found = {}
    for name, value in values.items():
        if name == "skew":
            if not (has_skew if has_skew is not None else value != 0):
                continue
            tolerance = RELATIVE_TOLERANCE * true["fx"]
        elif name in ("fx", "fy"):
            tolerance = RELATIVE_TOLERANCE * true[name]
        elif name in ("cx", "cy"):
            tolerance = RELATIVE_TOLERANCE * truth.size_wh[0]
        elif _is_one_family(camera.model, truth.model):
            tolerance = DISTORTION_TOLERANCE
        else:
            continue
        found[f"{side}.{name}"] = true.get(name, 0.0), value, tolerance
    return found


def _is_one_family(one: str, other: str) -> bool:
    """Whether coefficients of one name mean the same in both: the models share their projection."""
    return camera_model(one).project is camera_model(other).project


def _root_sum_square(sigma: Mapping[str, float], block: str) -> float:
    parts = [value for name, value in sigma.items() if name.startswith(f"{block}.")]
    return float(np.sqrt(np.sum(np.square(parts)))) if parts else float("nan")
