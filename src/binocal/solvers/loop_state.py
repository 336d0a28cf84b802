"""What the loop passes around: where a batch of solves stands, and what a controller asks of the next iteration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, Protocol, runtime_checkable

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float
from binocal.solvers.problem import E, Q, S

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
class Observed(Generic[S]):
    """What controllers look at beside the residuals.

    ``newton`` is the undamped step from here; ``gain`` the actual over the predicted fall of the last candidate's cost, -1
    where it was rejected; the others are MAD noise and Newton step before that candidate.
    """

    newton: S
    gain: Float[ndarray, "*batch"]
    previous_mad_px: Float[ndarray, "*batch"]
    previous_newton: S


@dataclass(frozen=True, slots=True, eq=False)
class LoopState(Generic[E, Q, S]):
    """Where a batch of robust solves stands.

    ``cost_px2`` is the robust cost under ``scale_px``, the kernel's scale; ``mad_px`` the MAD noise of the estimate. ``start`` is
    the estimate that the loop began with. ``is_kept`` says whether the last candidate was. ``is_settled`` says
    where the scale is that of the noise, ``is_closing`` whether looking ahead still pays. ``observed`` is None under rules
    that spare its cost (:data:`binocal.solvers.rules.NEAR`).
    """

    estimate: E
    equations: Q
    cost_px2: Float[ndarray, "*batch"]
    scale_px: Float[ndarray, "*batch"]
    mad_px: Float[ndarray, "*batch"]
    is_kept: Bool[ndarray, "*batch"]
    start: E
    is_settled: Bool[ndarray, "*batch"]
    is_closing: bool
    observed: Observed[S] | None

    @property
    def seen(self) -> Observed[S]:
        """``observed``, for controllers that need it.

        Raises:
            ValueError: The loop runs under rules that do not observe.
        """
        if self.observed is None:
            raise ValueError("this controller looks at Newton steps, which the loop's rules leave out")
        return self.observed

    @property
    def newton(self) -> S:
        """The undamped step from here."""
        return self.seen.newton

    @property
    def decrement_sigma(self) -> Float[ndarray, "*batch"]:
        """Length of the Gauss-Newton step over all unknowns, in standard deviations of the estimate."""
        return np.sqrt(np.maximum(2 * self.newton.predicted_px2, 0)) / self.mad_px


@dataclass(frozen=True, slots=True, eq=False)
class Outcome(Generic[E, Q, S]):
    """One iteration: the step, what its candidate cost, and the better one of estimate and candidate, rig by rig.

    ``trial_px2`` is the candidate's robust cost and ``before_px2`` the estimate's, both under ``scale_px``, as is
    ``cost_px2`` of what was kept. ``ahead_px`` is the candidate's MAD noise where the rules looked ahead.
    """

    action: Action
    step: S
    is_kept: Bool[ndarray, "*batch"]
    estimate: E
    equations: Q
    cost_px2: Float[ndarray, "*batch"]
    scale_px: Float[ndarray, "*batch"]
    ahead_px: Float[ndarray, "*batch"]
    trial_px2: Float[ndarray, "*batch"]
    before_px2: Float[ndarray, "*batch"]


@runtime_checkable
class Controller(Protocol):
    """Chooses what the next iteration of every rig does."""

    def start(self, batch: tuple[int, ...]) -> Memory:
        """The memory at the start of a batch of solves."""
        ...

    def choose(self, problem: Any, state: LoopState[Any, Any, Any], memory: Memory) -> tuple[Action, Memory]:
        """The next action, and what to remember of it."""
        ...
