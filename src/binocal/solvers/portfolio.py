"""Several controllers solve the same epipolar problem from an old rig; the lowest cost that an old rig allows wins.

Structured wrong matches (a moving object, a repeated facade) may well have a lower cost than the right ones, so the cost is not all
that counts: a rig that has turned far from the old one has broken, and what lies behind the cameras was not seen by them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.geometry import so3
from binocal.shapes import Float, Int
from binocal.solvers import robust
from binocal.solvers.arrays import map_arrays, stack_rigs
from binocal.solvers.controllers import Marquardt, Schedule
from binocal.solvers.epipolar import EpipolarProblem, parallax_and_sides
from binocal.solvers.epipolar_descent import KERNEL, SCHEDULE_PX, STEPS_EACH, descend, steer
from binocal.solvers.loop_state import Controller
from binocal.solvers.minimization import START_DAMPING
from binocal.solvers.relative_pose import RelativePose

OLD_RIG_TURN_DEG, OLD_RIG_DIRECTION_DEG = 5.5, 6.0
"""Within which a result is taken for the same rig; a mount that moved by more has broken."""
CLEAR_PARALLAX_PX = 3.0  # of a point whose side of the cameras no noise turns round
POLISH_PX = (1.0,) * 8
"""The common end of all solves that compete: the kernel of one pixel."""
EQUAL_SHARE = 1e-6  # of the largest cost: the same minimum, reached by another way


@dataclass(frozen=True, slots=True)
class Led:
    """A controller and the iterations that it has."""

    controller: Controller
    n_iterations: int


def by_schedule(schedule_px: tuple[float, ...], steps_each: int = STEPS_EACH) -> Led:
    """Scales in pixels, so many steps under each, and the classical damping."""
    scales = tuple(scale for scale in schedule_px for _ in range(steps_each))
    return Led(Marquardt(START_DAMPING, schedule=Schedule(scales)), len(scales))


PORTFOLIO: Mapping[str, Led] = {
    "schedule 64 to 1": by_schedule(SCHEDULE_PX),
    "schedule 16, 4, 1": by_schedule((16.0, 4.0, 1.0)),
    "schedule 4, 2, 1": by_schedule((4.0, 2.0, 1.0), 4),
    "schedule 128, 32, 8, 2": by_schedule((128.0, 32.0, 8.0, 2.0)),
}
"""The usual schedule, and those of 36 that found most beside those before them, on 160 problems each of three sets."""


@dataclass(frozen=True, slots=True, eq=False)
class Contest:
    """Where the solves ended and what they cost, first axis: the solves in the order of ``names``."""

    names: tuple[str, ...]
    estimates: RelativePose
    costs: Float[ndarray, "solves *batch"]

    @property
    def winner(self) -> Int[ndarray, "*batch"]:
        """The first of those with the lowest cost."""
        least = self.costs.min(axis=0)
        return np.argmax(self.costs <= least + EQUAL_SHARE * np.abs(least), axis=0)

    @property
    def n_agreeing(self) -> Int[ndarray, "*batch"]:
        """How many ended in the same minimum as the winner."""
        least = self.costs.min(axis=0)
        return np.sum(self.costs <= least + EQUAL_SHARE * np.abs(least), axis=0)

    @property
    def estimate(self) -> RelativePose:
        """The winner's."""
        place = self.winner

        def pick(a: ndarray) -> ndarray:
            index = place.reshape((1, *place.shape, *[1] * (a.ndim - 1 - place.ndim)))
            return np.take_along_axis(a, index, axis=0)[0]

        return map_arrays(pick, self.estimates)

    def of(self, names: tuple[str, ...]) -> Contest:
        """The contest of some of the solves alone."""
        index = np.array([self.names.index(name) for name in names])
        return Contest(names, map_arrays(lambda a: a[index], self.estimates), self.costs[index])


def compete(
    problem: EpipolarProblem,
    old: RelativePose,
    solves: Mapping[str, Led],
    others: Mapping[str, RelativePose] | None = None,
    *,
    turn_deg: float = OLD_RIG_TURN_DEG,
    direction_deg: float = OLD_RIG_DIRECTION_DEG,
) -> Contest:
    """Every solve from the old rig, polished alike, and its cost; ``others`` are estimates from elsewhere that compete too."""
    ends = {name: steer(problem, old, led.controller, led.n_iterations) for name, led in solves.items()}
    ends |= others or {}
    polished = descend(problem, stack_rigs(list(ends.values())), POLISH_PX)
    return Contest(tuple(ends), polished, cost_beside(problem, polished, old, turn_deg, direction_deg))


def cost_beside(
    problem: EpipolarProblem,
    estimate: RelativePose,
    old: RelativePose,
    turn_deg: float = OLD_RIG_TURN_DEG,
    direction_deg: float = OLD_RIG_DIRECTION_DEG,
) -> Float[ndarray, "*batch"]:
    """The cost of what is seen, at one pixel; an estimate farther from the old rig than the bounds costs more than any within."""
    costs = cost_of_seen(problem, estimate, old)
    is_outside = ~is_near(old, estimate, turn_deg, direction_deg)
    return np.asarray(costs + is_outside * 0.5 * problem.n_matches(is_outside.shape))


def cost_of_seen(
    problem: EpipolarProblem, estimate: RelativePose, old: RelativePose | None, scale_px: float = 1.0
) -> Float[ndarray, "*batch"]:
    """Geman and McClure's cost in squares of the scale, a match counting as wrong whose point lies behind a camera.

    The sign of the translation is the old rig's; without one that by which more is seen.
    """
    costs = robust.costs(problem.residuals_px(estimate) ** 2, np.asarray(scale_px), KERNEL) / scale_px**2
    counts = 1.0 if problem.counts is None else problem.counts

    def seen_with(sign: Float[ndarray, "*batch 1"] | float) -> Float[ndarray, "*batch"]:
        parallax_px, side = parallax_and_sides(problem, RelativePose(estimate.R, sign * estimate.t))
        seen = np.where((parallax_px > CLEAR_PARALLAX_PX) & (side < 0), 0.5, costs)
        return np.asarray((counts * seen).sum(axis=-1))

    if old is None:
        return np.minimum(seen_with(1.0), seen_with(-1.0))
    return seen_with(np.where(np.sum(estimate.t * old.t, axis=-1, keepdims=True) < 0, -1.0, 1.0))


def is_near(
    old: RelativePose,
    new: RelativePose,
    turn_deg: float | Float[ndarray, "*batch"] = OLD_RIG_TURN_DEG,
    direction_deg: float | Float[ndarray, "*batch"] = OLD_RIG_DIRECTION_DEG,
) -> ndarray:
    """Whether a pose lies within bounds of an old one."""
    turn = np.degrees(so3.angle_rad(new.R @ old.R.swapaxes(-1, -2)))
    direction = np.degrees(np.linalg.norm(old.step_to(new)[..., 3:], axis=-1))
    return np.asarray((turn < turn_deg) & (direction < direction_deg))
