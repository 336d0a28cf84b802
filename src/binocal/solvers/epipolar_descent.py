"""Solves of the epipolar problem: the kernel closes in pixels, then the minimum at the scale that the residuals have.

The loop is that of every problem (:mod:`binocal.solvers.loop`). What is special is the kernel's scale: half of the matches and more
may be wrong, so that no median tells the noise of the right ones. It is closed in pixels first, 64 to 1, which match noise is
known to lie below, and only then measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from binocal.solvers.chosen_scale import CHOSEN_SCALE, Counted
from binocal.solvers.controllers import Marquardt, Schedule
from binocal.solvers.epipolar import EpipolarEquations, EpipolarProblem, EpipolarStep
from binocal.solvers.loop import begin, run
from binocal.solvers.loop_state import Controller, LoopState
from binocal.solvers.minimization import START_DAMPING, LoopOptions, Minimum, minimize
from binocal.solvers.relative_pose import RelativePose

SCHEDULE_PX = (64.0, 32.0, 16.0, 8.0, 4.0, 2.0, 1.0)
KERNEL = "geman"
START_SCALE_PX = 16.0  # that a controller sees the start under
STEPS_EACH = 2
LAST_STEPS = 20
NEAR_PX = 4.0  # beyond it nothing carries weight at the end; the median is then that of matches that may be right


EpipolarMinimum = Minimum[RelativePose, EpipolarEquations]
EpipolarState = LoopState[RelativePose, EpipolarEquations, EpipolarStep]


def descend(
    problem: EpipolarProblem,
    start: RelativePose,
    schedule_px: tuple[float, ...] = SCHEDULE_PX,
    *,
    steps_each: int = STEPS_EACH,
) -> RelativePose:
    """The estimate after the kernel has closed in pixels (Geman & McClure 1985)."""
    scales = tuple(scale for scale in schedule_px for _ in range(steps_each))
    return steer(problem, start, Marquardt(START_DAMPING, schedule=Schedule(scales)), len(scales))


def steer(problem: EpipolarProblem, start: RelativePose, controller: Controller, n_iterations: int) -> RelativePose:
    """The estimate after iterations in which a controller chose scale, in pixels, and damping."""
    known = replace(problem, scale_px=1.0)
    state = begin(known, start, KERNEL, rules=CHOSEN_SCALE, scale_factor=START_SCALE_PX)
    return run(known, state, controller, KERNEL, CHOSEN_SCALE, Counted(n_iterations)).estimate


def finish(problem: EpipolarProblem, start: RelativePose, *, max_iterations: int = LAST_STEPS) -> EpipolarMinimum:
    """The minimum under Tukey's kernel, its scale from the residuals of what is left within a few pixels.

    NOT checked: that anything is. For a batch of starts of one problem, the others count nothing.
    """
    near = np.abs(problem.residuals_px(start)) < NEAR_PX
    if near.ndim > 1:
        part = replace(problem, counts=near * (1.0 if problem.counts is None else problem.counts), scale_px=None)
    else:
        part = replace(problem.select(near), scale_px=None)
    return minimize(part, start, LoopOptions("tukey", max_iterations=max_iterations, tolerance_sigma=0.005))
