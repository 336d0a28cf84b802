"""An earlier calibration as a prior: what is known of a rig before its new views are seen, any part of it held exactly.

A calibration and its covariance are a Gaussian prior for the next one: solving half of the views with the prior that the other
half gave is, to first order, solving all of them at once. Known intrinsics are the extreme case: both cameras held, only the
rig is sought. Source: Bayes; in bundle adjustment e.g. Triggs et al. 2000, section 3.5 ("prior terms").
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig, camera_model
from binocal.errors import DataError
from binocal.geometry import SE3, so3
from binocal.result import Covariance, StereoCalibration
from binocal.shapes import Float
from binocal.solvers.board_views import BundleEstimate, BundleProblem
from binocal.values import ArrayValue, frozen_array

PARTS = ("left", "right", "rotation", "translation")
SIDES = ("left", "right")


@dataclass(frozen=True, slots=True, eq=False)
class RigPrior(ArrayValue):
    """What is known of a rig: its most probable value, the information about some parameters, and what is held exactly.

    ``names`` are those of :class:`binocal.result.Covariance`, without the held ones; ``information`` is the inverse of their
    covariance, given that the held ones are exact. ``held`` are names of parameters (``left.fx``) and of the rig's parts,
    ``rotation`` and ``translation``, which are held as a whole.
    """

    rig: StereoRig
    names: tuple[str, ...]
    information: Float[ndarray, "p p"]
    held: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        information = frozen_array(self.information)
        if information.shape != (len(self.names),) * 2:
            raise ValueError(f"{len(self.names)} names for an information of shape {information.shape}")
        size = np.sqrt(np.abs(np.diag(information)))
        scaled = information / np.maximum(np.outer(size, size), 1e-300)
        if (
            not np.isfinite(information).all()
            or np.abs(scaled - scaled.T).max(initial=0) > 1e-6
            or np.linalg.eigvalsh(scaled).min(initial=0) < -1e-6
        ):
            raise ValueError("the information of a prior must be finite, symmetric and not negative")
        object.__setattr__(self, "information", information)

    @classmethod
    def from_calibration(
        cls, calibration: StereoCalibration, *, parts: Collection[str] = PARTS, held: Collection[str] = ()
    ) -> RigPrior:
        """The prior that a calibration is; see :meth:`from_rig`."""
        return cls.from_rig(calibration.rig, calibration.covariance, parts=parts, held=held)

    @classmethod
    def from_rig(
        cls, rig: StereoRig, covariance: Covariance, *, parts: Collection[str] = PARTS, held: Collection[str] = ()
    ) -> RigPrior:
        """The prior of a rig with a covariance.

        ``parts`` are what it informs of: ``left`` and ``right`` (intrinsics), ``rotation``, ``translation``; a camera that was
        put on another mount informs of its intrinsics only. ``held`` are parts, or single intrinsics by name, that are
        taken for exact.

        Raises:
            ValueError: A part or name is unknown, or the covariance of what is not held is singular.
        """
        held, parts = ((given,) if isinstance(given, str) else tuple(given) for given in (held, parts))
        held_names = _held_names(rig, held)
        for part in parts:
            if part not in PARTS:
                raise ValueError(f"a rig has no part {part!r}; it has {', '.join(PARTS)}")
        is_held = np.array([_holds(held_names, name) for name in covariance.names], dtype=bool)
        is_informed = np.array([name.split(".")[0] in parts for name in covariance.names], dtype=bool)
        wanted = np.flatnonzero(is_held | is_informed)
        known = covariance.matrix[np.ix_(wanted, wanted)]
        free = np.flatnonzero(~is_held[wanted])
        information = _inverse(known)[np.ix_(free, free)] if len(free) else np.zeros((0, 0))
        return cls(rig, tuple(covariance.names[i] for i in wanted[free]), information, held_names)

    def check(self, model: str, size_wh: tuple[tuple[int, int], tuple[int, int]], *, is_metric: bool) -> None:
        """See that it is about such cameras.

        Raises:
            DataError: Camera model, image sizes or the unit of length are others.
        """
        for side, size in zip(SIDES, size_wh, strict=True):
            camera = getattr(self.rig, side)
            if camera.model != model:
                raise DataError(
                    f"the prior's {side} camera is {camera.model}, the calibration's {model}; they must agree."
                )
            if camera.size_wh != tuple(size):
                raise DataError(
                    f"the prior's {side} images are {camera.size_wh} pixels, the calibration's {tuple(size)}."
                )
        if self.rig.is_metric != is_metric:
            raise DataError("only one of the prior and the board is in metres.")

    def applied(self, problem: BundleProblem) -> BundleProblem:
        """The problem with this prior: a term more, what is held no longer free.

        The weak prior of a camera's model counts in the earlier calibration already, so it does not count again.
        """
        cameras = []
        for side, camera in zip(SIDES, problem.cameras, strict=True):
            is_held = np.array([f"{side}.{name}" in self.held for name in camera.model.parameter_names])
            is_known = is_held.any() or any(name.startswith(f"{side}.") for name in self.names)
            model = replace(camera.model, prior_sigma=np.inf) if is_known else camera.model
            cameras.append(replace(camera, model=model, is_free=camera.is_free & ~is_held))
        held = [part for part in ("rotation", "translation") if part in self.held]
        return replace(
            problem,
            cameras=tuple(cameras),
            is_rig_free=len(held) < 2,
            held_part=held[0] if len(held) == 1 else None,
            terms=(*problem.terms, PriorTerm(self)) if self.names else problem.terms,
        )

    def with_held_values(self, estimate: BundleEstimate) -> BundleEstimate:
        """The estimate with what is held at its exact value."""
        parameters = []
        for side, values in zip(SIDES, estimate.parameters, strict=True):
            camera = getattr(self.rig, side)
            names = camera_names(self.rig, side)
            is_held = np.array([name in self.held for name in names])
            parameters.append(np.where(is_held, camera.parameters, values))
        T, known = estimate.T_right_left, self.rig.T_right_left
        R = np.broadcast_to(known.R, T.R.shape) if "rotation" in self.held else T.R
        t = np.broadcast_to(known.t, T.t.shape) if "translation" in self.held else T.t
        return replace(estimate, parameters=tuple(parameters), T_right_left=SE3.unchecked(R, t))


@dataclass(frozen=True, slots=True, eq=False)
class PriorTerm:
    """A rig's prior as a term of the joint problem (:class:`binocal.solvers.problem.SharedTerm`)."""

    prior: RigPrior
    places: dict[str, int] = field(init=False)
    """Where a parameter's name stands among those that the prior is about: both cameras' intrinsics, rotation, translation."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "places", {name: i for i, name in enumerate(self.prior.names)})

    def energy(self, problem: BundleProblem, estimate: BundleEstimate) -> Float[ndarray, "*batch"]:
        """Half the squared Mahalanobis distance from the prior's rig."""
        away = self.distance(estimate)
        return 0.5 * (away * (away @ self.prior.information)).sum(axis=-1)

    def normal_equations(
        self, problem: BundleProblem, estimate: BundleEstimate
    ) -> tuple[Float[ndarray, "*batch s s"], Float[ndarray, "*batch s"]]:
        """Information of the shared unknowns; the gradient pulls towards the prior's rig."""
        J, away = self._columns(problem, estimate), self.distance(estimate)
        pulled = J.swapaxes(-1, -2) @ self.prior.information
        return pulled @ J, -(pulled @ away[..., None])[..., 0]

    def distance(self, estimate: BundleEstimate) -> Float[ndarray, "*batch p"]:
        """Estimate less prior, in the coordinates of a covariance."""
        rig, T = self.prior.rig, estimate.T_right_left
        values: dict[str, ndarray] = {}
        for side, parameters in zip(SIDES, estimate.parameters, strict=True):
            away = parameters - getattr(rig, side).parameters
            values |= {name: away[..., i] for i, name in enumerate(camera_names(rig, side))}
        turn, shift = so3.log(T.R @ rig.T_right_left.R.T), T.t - rig.T_right_left.t
        values |= {f"rotation.{axis}": turn[..., i] for i, axis in enumerate("xyz")}
        values |= {f"translation.{axis}": shift[..., i] for i, axis in enumerate("xyz")}
        return np.stack([values[name] for name in self.prior.names], axis=-1)

    def _columns(self, problem: BundleProblem, estimate: BundleEstimate) -> Float[ndarray, "*batch p s"]:
        """Derivatives of the distance by the shared unknowns, the rig stepped from the left."""
        rig, T = self.prior.rig, estimate.T_right_left
        J = np.zeros((*estimate.batch, len(self.prior.names), problem.n_shared))
        for side, camera, place in zip(SIDES, problem.cameras, problem.places, strict=True):
            free = [name for name, is_free in zip(camera_names(rig, side), camera.is_free, strict=True) if is_free]
            for column, name in enumerate(free, start=place.start):
                if name in self.places:
                    J[..., self.places[name], column] = 1.0
        if problem.is_rig_free:
            turned = so3.inverse_left_jacobian(so3.log(T.R @ rig.T_right_left.R.T))
            shifted = np.concatenate([-so3.hat(T.t), np.broadcast_to(np.eye(3), T.R.shape)], axis=-1)
            for i, axis in enumerate("xyz"):
                if f"rotation.{axis}" in self.places:
                    J[..., self.places[f"rotation.{axis}"], -6:-3] = turned[..., i, :]
                if f"translation.{axis}" in self.places:
                    J[..., self.places[f"translation.{axis}"], -6:] = shifted[..., i, :]
        return J


def camera_names(rig: StereoRig, side: str) -> tuple[str, ...]:
    """Names of a camera's parameters as a covariance has them."""
    return tuple(f"{side}.{name}" for name in camera_model(getattr(rig, side).model).parameter_names)


def _holds(held: Collection[str], name: str) -> bool:
    return name in held or name.split(".")[0] in held


def _held_names(rig: StereoRig, held: Collection[str]) -> tuple[str, ...]:
    """Single intrinsics and parts of the rig, from names of either."""
    cameras = {side: camera_names(rig, side) for side in SIDES}
    out: list[str] = []
    for name in held:
        if name in cameras:
            out += cameras[name]
        elif name in ("rotation", "translation") or any(name in names for names in cameras.values()):
            out.append(name)
        else:
            raise ValueError(f"a rig has no {name!r} to hold; it has {', '.join(PARTS)} and intrinsics such as left.fx")
    return tuple(dict.fromkeys(out))


def _inverse(covariance: Float[ndarray, "p p"]) -> Float[ndarray, "p p"]:
    """Its inverse by way of correlations, whose condition does not depend on units."""
    sigma = np.sqrt(np.diag(covariance))
    if not (np.isfinite(covariance).all() and (sigma > 0).all()):
        raise ValueError("the covariance of a prior must be finite, its variances above 0; hold what is known exactly")
    values, vectors = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    if not values[0] > 1e-15 * values[-1]:
        raise ValueError("the covariance of a prior is singular; hold what is known exactly")
    return (vectors / values) @ vectors.T / np.outer(sigma, sigma)
