"""How the pixels of points move with the points and with the rig's parameters, in the order of a covariance's names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig, camera_model
from binocal.geometry import so3
from binocal.shapes import Float


@dataclass(frozen=True, slots=True, eq=False)
class PairDerivatives:
    """Pixels of n points in both cameras, and their first derivatives.

    ``left_by_point`` and ``right_by_point`` are by the point in that camera's own frame; ``left`` and ``right`` by the named
    parameters, the point in the left frame held.
    """

    left_px: Float[ndarray, "n 2"]
    right_px: Float[ndarray, "n 2"]
    left_by_point: Float[ndarray, "n 2 3"]
    right_by_point: Float[ndarray, "n 2 3"]
    left: Float[ndarray, "n 2 p"]
    right: Float[ndarray, "n 2 p"]


def pair_derivatives(
    rig: StereoRig,
    names: Sequence[str],
    directions: Float[ndarray, "n 3"],
    inverse_range: Float[ndarray, "n"] | None = None,
) -> PairDerivatives:
    """Derivatives at the points ``directions / inverse_range`` of the left frame; at ``directions`` themselves by default.

    ``inverse_range`` 0 is a point at infinity. ``names`` are those of :class:`~binocal.uncertainty.covariance.Covariance`: the
    rotation multiplies R from the left, the translation is added. NaN where a camera cannot see.

    Raises:
        ValueError: A name is none of the rig's.
    """
    T = rig.T_right_left
    s = np.ones(len(directions)) if inverse_range is None else inverse_range
    turned = directions @ T.R.T
    in_right = turned + s[:, None] * T.t
    left_px, left_by_point, left_own = camera_derivatives(rig.left, directions)
    right_px, right_by_point, right_own = camera_derivatives(rig.right, in_right)
    columns = {f"rotation.{axis}": right_by_point @ _turn_columns(turned)[:, :, [i]] for i, axis in enumerate("xyz")}
    columns |= {f"translation.{axis}": right_by_point[:, :, [i]] * s[:, None, None] for i, axis in enumerate("xyz")}
    left, right = (np.zeros((len(directions), 2, len(names))) for _ in range(2))
    places = {
        side: {name: i for i, name in enumerate(camera_model(getattr(rig, side).model).parameter_names)}
        for side in ("left", "right")
    }
    for column, name in enumerate(names):
        side, _, own = name.partition(".")
        if name in columns:
            right[:, :, [column]] = columns[name]
        elif side in places and own in places[side]:
            target, source = (left, left_own) if side == "left" else (right, right_own)
            target[:, :, column] = source[:, :, places[side][own]]
        else:
            raise ValueError(f"the rig has no parameter {name!r}")
    return PairDerivatives(left_px, right_px, left_by_point, right_by_point, left, right)


def camera_derivatives(
    camera: Camera, points: Float[ndarray, "n 3"]
) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2 3"], Float[ndarray, "n 2 q"]]:
    """Pixels of points in the camera's frame, their derivatives by the point, and by all of its parameters.

    NaN where a point lies behind a camera that cannot see there.
    """
    model = camera_model(camera.model)
    by_parameters = np.empty((model.n_parameters, 2, len(points)))
    with np.errstate(all="ignore"):
        u, v, grad_u, grad_v = model.linearize(camera.parameters, *points.T, by_parameters)
    pixels = np.stack([u, v], axis=-1)
    by_point = np.stack([np.stack(grad_u, axis=-1), np.stack(grad_v, axis=-1)], axis=-2)
    own = np.ascontiguousarray(by_parameters.transpose(2, 1, 0))
    if not model.sees_behind:
        hidden = ~(points[:, 2] > 0)
        pixels[hidden], by_point[hidden], own[hidden] = np.nan, np.nan, np.nan
    return pixels, by_point, own


def _turn_columns(points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3 3"]:
    """Derivative of ``exp(w) x`` by w at 0."""
    return -so3.hat(points)


def variance_of(G: Float[ndarray, "*n p"], matrix: Float[ndarray, "p p"]) -> Float[ndarray, "*n"]:
    """Variance of linear figures ``G theta`` of parameters with that covariance; rounding below 0 is 0."""
    return np.maximum(np.einsum("...p,pq,...q->...", G, matrix, G, optimize=True), 0.0)
