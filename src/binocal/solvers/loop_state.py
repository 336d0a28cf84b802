"""What the loop passes around: where a batch of solves stands, and what a controller asks of the next iteration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float
from binocal.solvers.board_views import BundleEquations, BundleEstimate, BundleProblem, BundleStep

Memory = dict[str, ndarray]
"""What a controller remembers between iterations; every array has one entry for each rig."""


@dataclass(frozen=True, slots=True, eq=False)
class Action:
    """What a controller chooses for the next iteration; one value for each rig (``scale_factor`` may be one for all).

    ``damping`` is Marquardt's, 0 for Gauss-Newton; ``pose_damping`` holds the board poses back beyond it. ``scale_factor`` times
    the MAD noise is the kernel's scale. ``stretch`` multiplies the steps of rotation and translation. ``bend``
    above 0 asks for a corrected step, and is the share of the projections' second order that it follows.
    ``increment``, if given, takes the place of the rig's own step (rotation, translation; the paper's action).
    """

    damping: Float[ndarray, "*batch"]
    scale_factor: Float[ndarray, "*batch"] | float
    stretch: Float[ndarray, "*batch 2"] | None = None
    bend: Float[ndarray, "*batch"] | None = None
    pose_damping: Float[ndarray, "*batch"] | None = None
    increment: Float[ndarray, "*batch 6"] | None = None

    @property
    def is_finite(self) -> bool:
        """Whether every number of it is."""
        parts = (self.damping, self.scale_factor, self.stretch, self.bend, self.pose_damping, self.increment)
        return all(part is None or bool(np.isfinite(part).all()) for part in parts)


@dataclass(frozen=True, slots=True, eq=False)
class LoopState:
    """Where a batch of robust solves stands.

    ``cost_px2`` is the robust cost under ``scale_px``, the kernel's scale; ``mad_px`` the MAD noise of the estimate. ``start`` is
    the estimate that the loop began with. ``is_kept`` says whether the last candidate was. ``is_settled`` says
    where the scale is that of the noise, ``is_closing`` whether looking ahead still pays. For controllers that observe:
    ``newton``, the undamped step from here; the gain, actual over predicted fall of the last candidate's cost, -1 where it
    was rejected; and MAD noise and Newton step before it.
    """

    estimate: BundleEstimate
    equations: BundleEquations
    cost_px2: Float[ndarray, "*batch"]
    scale_px: Float[ndarray, "*batch"]
    mad_px: Float[ndarray, "*batch"]
    is_kept: Bool[ndarray, "*batch"]
    start: BundleEstimate
    is_settled: Bool[ndarray, "*batch"]
    is_closing: bool
    newton: BundleStep | None
    gain: Float[ndarray, "*batch"]
    previous_mad_px: Float[ndarray, "*batch"]
    previous_newton: BundleStep | None

    @property
    def decrement_sigma(self) -> Float[ndarray, "*batch"]:
        """Length of the Gauss-Newton step over all unknowns, in standard deviations of the estimate."""
        return np.sqrt(np.maximum(2 * self.newton.predicted_px2, 0)) / self.mad_px


class Controller(Protocol):
    """Chooses what the next iteration of every rig does."""

    def start(self, batch: tuple[int, ...]) -> Memory:
        """The memory at the start of a batch of solves."""
        ...

    def choose(self, problem: BundleProblem, state: LoopState, memory: Memory) -> tuple[Action, Memory]:
        """The next action, and what to remember of it."""
        ...
