"""Rotation and direction of T from matches as a Markov decision process: pure functions over a batch of sets of matches.

An episode is one robust solve of twelve iterations from an old rig. As in :mod:`binocal.rl.task` the state is where the solve
stands; here an action chooses the kernel's scale in pixels and the damping, since half of the matches and more may be wrong and
no median tells the noise. The observation has the residuals' quantiles in pixels for the same reason: how well matches are
measured is known beforehand to a factor of three.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.geometry import so3
from binocal.rl.task import TaskState, raised_damping, sound_action
from binocal.shapes import Float
from binocal.solvers.chosen_scale import CHOSEN_SCALE
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.epipolar_descent import KERNEL, START_SCALE_PX, EpipolarState
from binocal.solvers.loop import advance, begin
from binocal.solvers.loop_state import Action
from binocal.solvers.relative_pose import RelativePose

N_STEPS = 12
CHOSEN = ("log kernel scale, px", "log damping")
"""The two numbers of an action, each in [-1, 1]."""
MIDDLE_OCTAVE, OCTAVES = 3.5, 3.5  # scales from 1 to 128 px
MIDDLE_DECADE, DECADES = -3.0, 3.0  # damping from 1e-6 to 1 of the diagonal
QUANTILES = (0.1, 0.2, 0.3, 0.5, 0.7, 0.9)
OBSERVED = (
    *(f"log10 {100 * q:.0f} % quantile of the residuals, px" for q in QUANTILES),
    *(f"last {name}" for name in CHOSEN),
    "last candidate kept",
    "log10 length of the Gauss-Newton step, px by match",
    "log10 rotation of the same, rad",
    "log10 turn of the direction of T by the same, rad",
    "steps so far, over 12",
    "log10 number of matches, over 200",
    "log10 turn away from the start, rad",
    "log10 turn of the direction of T away from the start, rad",
    "rejections in a row",
    "log10 share of the cost by which the last candidate lowered it",
)
LEAST_PX, LEAST_RAD, LEAST_SHARE = 1e-3, 1e-6, 1e-6  # below these nothing changes what should be done
FOUND_REWARD = 1.5


def initial(problem: EpipolarProblem, start: RelativePose) -> TaskState:
    """The first state of an episode for each set of matches."""
    loop = begin(problem, start, KERNEL, rules=CHOSEN_SCALE, scale_factor=START_SCALE_PX)
    return TaskState.at_start(loop, len(CHOSEN))


def observation(problem: EpipolarProblem, state: TaskState) -> Float[ndarray, "*batch o"]:
    """What the agent sees: :data:`OBSERVED`."""
    loop: EpipolarState = state.loop
    residuals = np.abs(loop.equations.residuals_px)
    n = problem.n_matches(residuals.shape[:-1])
    if problem.counts is not None:
        residuals = np.where(problem.counts > 0, residuals, np.inf)
    ordered = np.sort(residuals, axis=-1)
    place = np.floor(np.asarray(QUANTILES) * (n[..., None] - 1)).astype(int)
    newton, away = loop.newton, _away(loop)
    step_px = np.sqrt(np.maximum(2 * np.nan_to_num(newton.predicted_px2), 0) / n)
    xi = np.nan_to_num(newton.xi)
    numbers = [
        _log10(step_px, LEAST_PX),
        _log10(np.linalg.norm(xi[..., :3], axis=-1), LEAST_RAD),
        _log10(np.linalg.norm(xi[..., 3:], axis=-1), LEAST_RAD),
        state.n_steps / N_STEPS,
        np.log10(n / 200),
        *away,
        np.minimum(state.n_rejected, 3.0),
        _log10(loop.seen.gain, LEAST_SHARE),
    ]
    parts = [
        _log10(np.take_along_axis(ordered, place, axis=-1), LEAST_PX),
        state.last_action,
        loop.is_kept[..., None].astype(float),
        np.stack(np.broadcast_arrays(*numbers), axis=-1),
    ]
    return np.concatenate(parts, axis=-1)


def transition(problem: EpipolarProblem, state: TaskState, action: Float[ndarray, "*batch a"]) -> TaskState:
    """The state after an action; the given state is not altered. A number that is not finite counts as 0."""
    action = sound_action(action)
    loop = advance(problem, state.loop, solver_action(problem, state, action), KERNEL, CHOSEN_SCALE)
    return state.following(loop, action)


def solver_action(problem: EpipolarProblem, state: TaskState, action: Float[ndarray, "*batch 2"]) -> Action:
    """What two numbers in [-1, 1] ask of the solver; rejections in a row raise the damping whatever they say."""
    a = sound_action(action)
    damping = 10 ** (MIDDLE_DECADE + DECADES * a[..., 1])
    return Action(raised_damping(damping, state.n_rejected), 2 ** (MIDDLE_OCTAVE + OCTAVES * a[..., 0]))


def action_of(scale_px: float, damping: float) -> tuple[float, float]:
    """The action that asks for a scale and a damping: the inverse of :func:`solver_action`."""
    return (
        (float(np.log2(scale_px)) - MIDDLE_OCTAVE) / OCTAVES,
        (float(np.log10(damping)) - MIDDLE_DECADE) / DECADES,
    )


def _away(loop: EpipolarState) -> tuple[ndarray, ndarray]:
    """Logarithms of the turns of the pose and of the direction of T since the start."""
    start, now = loop.start, loop.estimate
    turn = so3.angle_rad(now.R @ start.R.swapaxes(-1, -2))
    cosine = np.abs(np.sum(now.t * start.t, axis=-1))
    direction = np.arctan2(np.linalg.norm(np.cross(now.t, start.t), axis=-1), cosine)
    return _log10(turn, LEAST_RAD), _log10(direction, LEAST_RAD)


def _log10(values: ndarray | np.floating, least: float) -> ndarray:
    return np.asarray(np.log10(np.maximum(values, least)))
