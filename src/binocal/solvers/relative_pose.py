"""The unknowns between two cameras whose translation has no length: a rotation and a direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.geometry import SE3, so3
from binocal.shapes import Float


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """Rotation and unit translation: p_right = R p_left + length t."""

    R: Float[ndarray, "*batch 3 3"]
    t: Float[ndarray, "*batch 3"]

    @property
    def batch(self) -> tuple[int, ...]:
        """The batch's dimensions."""
        return self.t.shape[:-1]

    @staticmethod
    def of(T_right_left: SE3) -> RelativePose:
        """Without the length of the translation."""
        t = T_right_left.t
        return RelativePose(T_right_left.R, t / np.linalg.norm(t, axis=-1, keepdims=True))

    def stepped(self, xi: Float[ndarray, "*batch 5"]) -> RelativePose:
        """Turned from the left by the first three; the direction of t along the last two of :func:`tangents`."""
        turn = so3.exp((tangents(self.t) @ xi[..., 3:, None])[..., 0])
        t = (turn @ self.t[..., None])[..., 0]
        return RelativePose(so3.exp(xi[..., :3]) @ self.R, t / np.linalg.norm(t, axis=-1, keepdims=True))

    def step_to(self, other: RelativePose) -> Float[ndarray, "*batch 5"]:
        """What :meth:`stepped` would take to arrive at another pose, whichever way its translation points."""
        sign = np.where(np.sum(self.t * other.t, axis=-1, keepdims=True) < 0, -1.0, 1.0)
        axis = np.cross(self.t, sign * other.t)
        length = np.linalg.norm(axis, axis=-1, keepdims=True)
        angle = np.arctan2(length, np.abs(np.sum(self.t * other.t, axis=-1, keepdims=True)))
        turn = (tangents(self.t).swapaxes(-1, -2) @ axis[..., None])[..., 0] * angle / np.maximum(length, 1e-300)
        return np.concatenate([so3.log(other.R @ self.R.swapaxes(-1, -2)), turn], axis=-1)


def tangents(t: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 2"]:
    """Two axes about which a turn moves a direction, at right angles to it and to each other."""
    first = np.cross(t, np.eye(3)[np.argmin(np.abs(t), axis=-1)])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(t, first)], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class PosePrior:
    """Where a pose was, and by how much it may have moved: one standard deviation of each angle of R, and of the direction of t.

    In a robust problem noise is taken to be the kernel's scale: a wide kernel, under which wrong matches pull with full weight, hardly
    moves what matches hardly tell; one of a pixel does not feel the prior.
    """

    pose: RelativePose
    turn_rad: float
    direction_rad: float

    @property
    def precision(self) -> Float[ndarray, "5"]:
        """1 / variance of the five unknowns."""
        return np.r_[[self.turn_rad**-2] * 3, [self.direction_rad**-2] * 2]

    def pull_on(self, estimate: RelativePose, scale_px: Float[ndarray, "*batch"]) -> PriorPull:
        """What it adds to the equations of an estimate."""
        return PriorPull(self.precision * np.ones((*estimate.batch, 1)), estimate.step_to(self.pose), scale_px)


@dataclass(frozen=True, slots=True, eq=False)
class PriorPull:
    """A prior's part in the equations of an estimate, under a kernel's scale.

    Half the squared length of ``step_back``, which leads to the prior's pose, has the exact gradient that a step's has.
    """

    precision: Float[ndarray, "*batch 5"]
    step_back: Float[ndarray, "*batch 5"]
    scale_px: Float[ndarray, "*batch"]

    @property
    def information_px2(self) -> Float[ndarray, "*batch 5"]:
        """The diagonal that it adds to the information."""
        return self.precision * np.asarray(self.scale_px)[..., None] ** 2

    @property
    def downhill_px2(self) -> Float[ndarray, "*batch 5"]:
        """The negative gradient of its cost."""
        return self.information_px2 * self.step_back

    @property
    def cost_px2(self) -> Float[ndarray, "*batch"]:
        """What it adds to the cost."""
        return np.asarray(0.5 * np.sum(self.information_px2 * self.step_back**2, axis=-1))
