"""Rigid transforms. ``T_a_b`` takes coordinates in frame b to frame a."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.geometry import so3
from binocal.shapes import Float
from binocal.values import ArrayValue, frozen_array


@dataclass(frozen=True, slots=True, eq=False)
class SE3(ArrayValue):
    """A rigid transform ``x_a = R x_b + t``, or a batch of them (leading dimensions).

    ``t`` is in metres wherever the scale is known. ``R`` must be a rotation within 1e-6.
    """

    R: Float[ndarray, "*batch 3 3"]
    t: Float[ndarray, "*batch 3"]

    def __post_init__(self) -> None:
        R, t = frozen_array(self.R), frozen_array(self.t)
        if R.shape[-2:] != (3, 3) or t.shape != R.shape[:-1]:
            raise ValueError(f"SE3 expects R (..., 3, 3) and t (..., 3); got {R.shape} and {t.shape}")
        if not (np.abs(R @ R.swapaxes(-1, -2) - np.eye(3)).max(initial=0) < 1e-6 and np.all(np.linalg.det(R) > 0)):
            raise ValueError("SE3: R is not a rotation matrix")
        object.__setattr__(self, "R", R)
        object.__setattr__(self, "t", t)

    @classmethod
    def unchecked(cls, R: Float[ndarray, "*batch 3 3"], t: Float[ndarray, "*batch 3"]) -> SE3:
        """A transform of float arrays that are known to be sound: neither copied nor checked nor set read-only.

        For inner loops: 0.3 us instead of 12 and more. The arrays must not be changed afterwards.
        """
        transform = object.__new__(cls)
        object.__setattr__(transform, "R", R)
        object.__setattr__(transform, "t", t)
        return transform

    @staticmethod
    def identity() -> SE3:
        """The transform that changes nothing."""
        return SE3(np.eye(3), np.zeros(3))

    @staticmethod
    def exp(xi: Float[ndarray, "*batch 6"]) -> SE3:
        """Transform of a tangent vector, rotation first (radians), then translation taken as it is.

        The translation is NOT multiplied by the left Jacobian: ``exp(xi) = (exp(xi[:3]), xi[3:])``, the solver's
        retraction.
        """
        xi = np.asarray(xi, dtype=float)
        return SE3(so3.exp(xi[..., :3]), xi[..., 3:])

    def apply(self, points: Float[ndarray, "*points n 3"]) -> Float[ndarray, "*batch n 3"]:
        """Points of frame b, in frame a."""
        return np.asarray(points, dtype=float) @ self.R.swapaxes(-1, -2) + self.t[..., None, :]

    def inverse(self) -> SE3:
        """``T_b_a``."""
        R_inv = self.R.swapaxes(-1, -2)
        return SE3(R_inv, -(R_inv @ self.t[..., None])[..., 0])

    def __matmul__(self, other: SE3) -> SE3:
        return SE3(self.R @ other.R, (self.R @ other.t[..., None])[..., 0] + self.t)

    def __getitem__(self, index: object) -> SE3:
        return SE3(self.R[index], self.t[index])  # type: ignore[index]

    @property
    def matrix(self) -> Float[ndarray, "*batch 4 4"]:
        """Homogeneous 4x4 matrix."""
        out = np.zeros((*self.R.shape[:-2], 4, 4))
        out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = self.R, self.t, 1.0
        return out
