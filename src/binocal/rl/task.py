"""External calibration as a Markov decision process: pure functions over a batch of rigs.

An episode is one robust solve. The state is where the solve stands, the observation a row of scale-free numbers, the
action what the next iteration does, the reward the fall in error. Source: the paper, section 3.2.2; what the action means
is decided by an :class:`~binocal.rl.agent_kind.AgentKind`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.rl.agent_kind import AgentKind
from binocal.shapes import Bool, Float, Int
from binocal.solvers.board_views import BundleEstimate, BundleProblem, BundleState
from binocal.solvers.loop import advance, begin
from binocal.solvers.loop_state import Action
from binocal.solvers.observation import OBSERVED, observe_state

KERNEL = "hampel"

STEERING = (
    "log damping",
    "log kernel scale",
    "log rotation stretch",
    "log translation stretch",
    "share of the second-order correction",
    "log damping of the board poses",
)
"""The six numbers of a steering action, each in [-1, 1]; all zero is robust Gauss-Newton."""
INCREMENTS = tuple(f"whitened {part} {axis}" for part in ("rotation", "translation") for axis in "xyz")

LEAST_DAMPING, DAMPING_DECADES = 5e-3, 5.0
"""Damping runs from 0 over 5e-3 to 500 times the least pivot of the equilibrated equations, some 0.02 with held intrinsics.
With free ones the pivot is 1e-6 and less: a damping that means nothing to one problem stops the other."""
LEAST_POSE_DAMPING, POSE_DAMPING_DECADES = 1e-2, 5.0  # that of the board poses to 1000, which holds them still
SCALE_REACH = 1.5  # natural logarithm: 0.22 to 4.5 times the MAD noise
STRETCH_REACH = 0.4  # 0.67 to 1.5 times the step
BEND_REACH = 1.25  # the whole correction is reached before the end of the range, so that tanh need not saturate
INCREMENT_REACH = 1.5  # an increment may be this much longer than the rig's Gauss-Newton step

STEP_COST = 1.0
PROGRESS_REWARD = 0.3  # for a decade
MAX_DISTANCE_DECADES = 8.0

LEAST_RAISED_DAMPING, RAISE = 1e-3, 30.0  # of the damping after rejected steps


@dataclass(frozen=True, slots=True, eq=False)
class TaskState:
    """A batch of episodes, of this task or of :mod:`binocal.rl.epipolar_task`.

    ``last_action`` is the one before this state; ``n_steps`` counts candidates, ``n_rejected`` those that were rejected in a row.
    """

    loop: Any
    last_action: Float[ndarray, "*batch a"]
    n_steps: Int[ndarray, "*batch"]
    n_rejected: Int[ndarray, "*batch"]

    @staticmethod
    def at_start(loop: Any, n_actions: int) -> TaskState:
        """Before the first step of a loop."""
        batch = loop.mad_px.shape
        nothing = np.zeros(batch, dtype=int)
        return TaskState(loop, np.zeros((*batch, n_actions)), nothing, nothing)

    def following(self, loop: Any, action: Float[ndarray, "*batch a"]) -> TaskState:
        """After a step that an action led to."""
        n_rejected = np.where(loop.is_kept, 0, self.n_rejected + 1)
        return TaskState(loop, action, self.n_steps + 1, n_rejected)


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """What a step was worth: the distance after it in standard deviations, the reward, whether the episode ended, and well."""

    sigma: Float[ndarray, "n"]
    reward: Float[ndarray, "n"]
    is_terminal: Bool[ndarray, "n"]
    has_arrived: Bool[ndarray, "n"]


def n_actions(kind: AgentKind) -> int:
    """Numbers in an action."""
    return len(STEERING if kind == AgentKind.DRL else INCREMENTS)


def observation_names(kind: AgentKind) -> tuple[str, ...]:
    """What :func:`observation` returns, in order."""
    last = tuple(f"last {name}" for name in (STEERING if kind == AgentKind.DRL else INCREMENTS))
    own = () if kind == AgentKind.DRL else tuple(f"Gauss-Newton step, {name}" for name in INCREMENTS)
    return (*OBSERVED, "steps so far, over 10", *last, *own)


def initial(problem: BundleProblem, start: BundleEstimate, kind: AgentKind) -> TaskState:
    """The first state of an episode for each rig."""
    return TaskState.at_start(begin(problem, start, KERNEL), n_actions(kind))


def observation(problem: BundleProblem, state: TaskState, kind: AgentKind) -> Float[ndarray, "*batch o"]:
    """What the agent sees."""
    parts = [observe_state(problem, state.loop), state.n_steps[..., None] / 10, state.last_action]
    if kind == AgentKind.DRL_INCREMENTS:
        _, whitened = _whitened_step(problem, state.loop)
        parts.append(whitened / np.maximum(np.linalg.norm(whitened, axis=-1, keepdims=True), 1e-300))
    return np.concatenate(parts, axis=-1)


def transition(
    problem: BundleProblem, state: TaskState, action: Float[ndarray, "*batch a"], kind: AgentKind
) -> TaskState:
    """The state after an action; the given state is not altered. A number that is not finite counts as 0."""
    action = sound_action(action)
    loop = advance(problem, state.loop, solver_action(problem, state, action, kind), KERNEL)
    return state.following(loop, action)


def sound_action(action: Float[ndarray, "*batch a"]) -> Float[ndarray, "*batch a"]:
    """Cut to [-1, 1]; 0 for what is not finite."""
    return np.clip(np.where(np.isfinite(action), action, 0.0), -1.0, 1.0)


def raised_damping(damping: Float[ndarray, "*batch"], n_rejected: Int[ndarray, "*batch"]) -> Float[ndarray, "*batch"]:
    """Not learned: every rejection in a row raises the damping."""
    least = np.where(n_rejected > 0, LEAST_RAISED_DAMPING * RAISE ** (n_rejected - 1.0), 0.0)
    return np.maximum(damping, least)


def solver_action(problem: BundleProblem, state: TaskState, a: Float[ndarray, "*batch 6"], kind: AgentKind) -> Action:
    """What an action asks of the solver."""
    return steering_action(a, state.loop) if kind == AgentKind.DRL else increment_action(problem, state.loop, a)


def steering_action(a: Float[ndarray, "*batch 6"], loop: BundleState) -> Action:
    """What six numbers in [-1, 1] ask of the solver. Not finite ones ask for plain Gauss-Newton."""
    a = np.where(np.isfinite(a), a, 0.0)
    decade = np.log(10)
    pivot = np.where(np.isnan(loop.newton.least_pivot), 1.0, loop.newton.least_pivot)
    return Action(
        pivot * LEAST_DAMPING * np.expm1(decade * DAMPING_DECADES * np.maximum(a[..., 0], 0.0)),
        np.exp(SCALE_REACH * a[..., 1]),
        np.exp(STRETCH_REACH * a[..., 2:4]),
        np.minimum(np.maximum(BEND_REACH * a[..., 4], 0.0), 1.0),
        pose_damping=LEAST_POSE_DAMPING * np.expm1(decade * POSE_DAMPING_DECADES * np.maximum(a[..., 5], 0.0)),
    )


def increment_action(problem: BundleProblem, loop: BundleState, a: Float[ndarray, "*batch 6"]) -> Action:
    """The change of R, T that six numbers in [-1, 1] ask for, each a share of the whitened Gauss-Newton step's length."""
    root, whitened = _whitened_step(problem, loop)
    length = np.linalg.norm(whitened, axis=-1, keepdims=True)
    wanted = INCREMENT_REACH * length * np.where(np.isfinite(a), a, 0.0)
    increment = np.linalg.solve(root, wanted[..., None])[..., 0]
    return Action(np.zeros(a.shape[:-1]), np.ones(a.shape[:-1]), increment=increment)


def _whitened_step(
    problem: BundleProblem, loop: BundleState
) -> tuple[Float[ndarray, "*batch 6 6"], Float[ndarray, "*batch 6"]]:
    """The factor that whitens a left step of the rig (intrinsics held, board poses free), and the whitened Newton step."""
    information = problem.shared_information(loop.estimate, loop.equations)[..., -6:, -6:]
    is_sound = np.isfinite(information).all(axis=(-1, -2)) & np.isfinite(loop.newton.predicted_px2)
    information = np.where(is_sound[..., None, None], information, np.eye(6))
    values, vectors = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(values, 1e-12 * values[..., -1:]))[..., None] * vectors.swapaxes(-1, -2)
    step = np.where(is_sound[..., None], loop.newton.shared[..., -6:], 0.0)
    return root, (root @ step[..., None])[..., 0]


def reward(
    before_sigma: Float[ndarray, "*batch"], after_sigma: Float[ndarray, "*batch"], tolerance_sigma: float
) -> Float[ndarray, "*batch"]:
    """The fall of the log distance to the robust optimum, minus the cost of a step.

    Distances below the tolerance count as the tolerance, so the sum over an episode that arrives depends on its start and
    on the number of steps alone (potential-based shaping; Ng, Harada & Russell 1999).
    """

    def potential(sigma: ndarray) -> ndarray:
        decades = np.log10(np.maximum(sigma, tolerance_sigma) / tolerance_sigma)
        return np.minimum(np.nan_to_num(decades, nan=MAX_DISTANCE_DECADES), MAX_DISTANCE_DECADES)

    return PROGRESS_REWARD * (potential(before_sigma) - potential(after_sigma)) - STEP_COST


def has_arrived(sigma: Float[ndarray, "*batch"], tolerance_sigma: float) -> Bool[ndarray, "*batch"]:
    """Whether the episode ended at the optimum (termination, not truncation)."""
    return sigma < tolerance_sigma
