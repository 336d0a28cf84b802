"""The classical controllers of :mod:`binocal.solvers.loop`: who chooses damping and scale without having learned to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.shapes import Float
from binocal.solvers.loop_state import Action, LoopState, Memory


@dataclass(frozen=True, slots=True)
class Schedule:
    """The kernel's scale over the MAD noise in each iteration (the last value stays), and corrected steps if asked for.

    A scale that starts wide and closes is graduated non-convexity. Source: Blake & Zisserman 1987, "Visual reconstruction".
    """

    scale_factors: tuple[float, ...] = (1.0,)
    bend: float = 0.0

    def action(self, damping: Float[ndarray, "*batch"], n_steps: int) -> Action:
        """The action with that damping."""
        factor = self.scale_factors[min(n_steps, len(self.scale_factors) - 1)]
        return Action(damping, factor, bend=np.full(damping.shape, self.bend) if self.bend else None)


@dataclass(frozen=True, slots=True)
class Marquardt:
    """Levenberg-Marquardt: damping falls by a factor after a kept step, rises after a rejected one (Marquardt 1963).

    With ``damping`` 0 it is Gauss-Newton, guarded: only a rejected step raises a damping.
    """

    damping: float = 1e-3
    fall: float = 10.0
    rise: float = 10.0
    least_raised: float = 1e-6  # weak directions have eigenvalues of 1e-7 of the diagonal: less would not be felt
    schedule: Schedule = Schedule()

    def start(self, batch: tuple[int, ...]) -> Memory:
        """See :class:`~binocal.solvers.loop_state.Controller`."""
        return {"damping": np.full(batch, self.damping), "n_steps": np.zeros(batch, dtype=int)}

    def choose(self, problem: Any, state: LoopState[Any, Any, Any], memory: Memory) -> tuple[Action, Memory]:
        """See :class:`~binocal.solvers.loop_state.Controller`."""
        damping, n_steps = memory["damping"], memory["n_steps"]
        if n_steps.flat[0] > 0:
            raised = np.maximum(damping * self.rise, self.least_raised)
            damping = np.where(state.is_kept, damping / self.fall, raised)
        return self.schedule.action(damping, int(n_steps.flat[0])), {"damping": damping, "n_steps": n_steps + 1}


@dataclass(frozen=True, slots=True)
class Nielsen:
    """Damping that follows the gain ratio. Source: Nielsen 1999, "Damping parameter in Marquardt's method"."""

    damping: float = 1e-3
    schedule: Schedule = Schedule()

    def start(self, batch: tuple[int, ...]) -> Memory:
        """See :class:`~binocal.solvers.loop_state.Controller`."""
        return {
            "damping": np.full(batch, self.damping),
            "growth": np.full(batch, 2.0),
            "n_steps": np.zeros(batch, dtype=int),
        }

    def choose(self, problem: Any, state: LoopState[Any, Any, Any], memory: Memory) -> tuple[Action, Memory]:
        """See :class:`~binocal.solvers.loop_state.Controller`."""
        damping, growth, n_steps = memory["damping"], memory["growth"], memory["n_steps"]
        if n_steps.flat[0] > 0:
            lowered = damping * np.maximum(1 / 3, 1 - (2 * state.seen.gain - 1) ** 3)
            damping = np.where(state.is_kept, lowered, np.maximum(damping, 1e-9) * growth)
            growth = np.where(state.is_kept, 2.0, 2 * growth)
        action = self.schedule.action(damping, int(n_steps.flat[0]))
        return action, {"damping": damping, "growth": growth, "n_steps": n_steps + 1}
