"""The camera models by name, records of functions: the built-in ones, and those that installed packages add."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import add
from typing import Any

from binocal import plugins
from binocal.cameras import brown_conrady, kannala_brandt

LINEAR_NAMES = ("fx", "fy", "cx", "cy", "skew")


@dataclass(frozen=True, slots=True)
class CameraModel:
    """One camera model: names of its distortion coefficients, and its functions on component-first arrays.

    ``sees_behind`` says that points with Z <= 0 can be seen (fisheye). ``prior_sigma`` is the standard deviation of a
    weak prior that holds each radial coefficient near 0 where the corners say nothing about it; infinite: no prior.
    ``step_parameters`` moves parameters by a solver's step: their sum to first order. ``farthest_angle`` is the angle from the axis,
    radians, up to which the image of a ray moves outwards as the ray does; beyond it the model folds back.
    """

    name: str
    distortion_names: tuple[str, ...]
    sees_behind: bool
    project: Callable[..., Any]
    linearize: Callable[..., Any]
    unproject: Callable[..., Any]
    prior_sigma: float = math.inf
    step_parameters: Callable[..., Any] = add
    farthest_angle: Callable[..., float] | None = None

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """fx, fy, cx, cy, skew, then the distortion."""
        return LINEAR_NAMES + self.distortion_names

    @property
    def n_parameters(self) -> int:
        """Length of the parameter vector, skew included."""
        return 5 + len(self.distortion_names)

    @property
    def is_compiled(self) -> bool:
        """Whether the compiled kernel knows it; calibrating needs that, all else works with the functions above."""
        return self.name in CAMERA_MODELS

    @property
    def has_prior(self) -> bool:
        """Whether any coefficient has a prior."""
        return math.isfinite(self.prior_sigma)

    @property
    def prior_precision(self) -> tuple[float, ...]:
        """1 / variance of the prior of each parameter, 0 where there is none (tangential terms are well determined)."""
        weight = self.prior_sigma**-2 if math.isfinite(self.prior_sigma) else 0.0
        return (0.0,) * 5 + tuple(weight if name.startswith("k") else 0.0 for name in self.distortion_names)


# Numerator and denominator of the rational model can cancel: on an ordinary lens the coefficients run off to 10 and
# more for a gain of 1e-3 in the cost. Published wide-angle calibrations lie within 3.
RATIONAL_PRIOR_SIGMA = 3.0


def _brown(name: str, *distortion_names: str, prior_sigma: float = math.inf) -> CameraModel:
    return CameraModel(
        name,
        distortion_names,
        False,
        brown_conrady.project,
        brown_conrady.linearize,
        brown_conrady.unproject,
        prior_sigma,
        brown_conrady.step_parameters,
        brown_conrady.farthest_angle,
    )


CAMERA_MODELS: dict[str, CameraModel] = {
    "brown4": _brown("brown4", "k1", "k2", "p1", "p2"),
    "brown5": _brown("brown5", "k1", "k2", "p1", "p2", "k3"),
    "brown8": _brown("brown8", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", prior_sigma=RATIONAL_PRIOR_SIGMA),
    "fisheye4": CameraModel(
        "fisheye4",
        ("k1", "k2", "k3", "k4"),
        True,
        kannala_brandt.project,
        kannala_brandt.linearize,
        kannala_brandt.unproject,
        farthest_angle=kannala_brandt.farthest_angle,
    ),
}


def camera_model(name: str) -> CameraModel:
    """The model of that name.

    Raises:
        ValueError: No such model; the text names those that are known.
        PluginError: An installed package adds it, and it fails to load.
    """
    if name in CAMERA_MODELS:
        return CAMERA_MODELS[name]
    added = plugins.load_plugin(plugins.CAMERA_MODELS, name, CameraModel)
    if added is None:
        raise ValueError(f"unknown camera model {name!r}; known: {', '.join(known_camera_models())}")
    return added


def known_camera_models() -> tuple[str, ...]:
    """Names of all camera models, the built-in ones first."""
    added = plugins.plugin_names(plugins.CAMERA_MODELS)
    return (*CAMERA_MODELS, *(name for name in added if name not in CAMERA_MODELS))
