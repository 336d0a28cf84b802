"""Training an agent: episodes on pools of rigs, gradient steps between them, held-out checks, checkpoints.

A run is a sequence of generations. In each, the rigs of one pool are started anew and solved under the exploring actor; every
so many transitions the networks take a gradient step. All randomness comes from the run's own generators, so the same
seed and number of steps give the same weights, and a run that goes on from a checkpoint ends where it would have ended.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import torch
from numpy import ndarray
from torch import Tensor

from binocal.rl.agent_kind import AgentKind
from binocal.rl.cases import Cases, cases_of
from binocal.rl.epipolar_task import action_of
from binocal.rl.episodes import EpisodeOutcome, Transitions, run_episodes
from binocal.rl.history import TrainingHistory
from binocal.rl.match_batches import FOUND_SIGMA, MATCH_SETS, sample_matches
from binocal.rl.policy import Policy
from binocal.rl.rig_batches import RIG_SETS, RigDistribution, sample_rigs
from binocal.rl.task import INCREMENT_REACH
from binocal.rl.tasks import task_of
from binocal.rl.training.networks import Actor
from binocal.rl.training.replay import ReplayBuffer
from binocal.rl.training.td3 import TD3, TD3Options
from binocal.shapes import Float

SMALL_BOARD = "chessboard:7x5:32mm"  # the size of the paper's board with two fifths of its corners: episodes cost less

TRAINING_SETS: tuple[tuple[RigDistribution, float], ...] = tuple(
    (replace(options, board=SMALL_BOARD), tolerance)
    for options, tolerance in (
        (replace(RIG_SETS["standard"], n_views=16), 0.1),
        (RIG_SETS["weak"], 0.1),
        (RIG_SETS["stress"], 0.3),
        (replace(RIG_SETS["standard"], n_views=8), 0.1),
    )
)
"""Distributions that the agents for boards train on, and standard deviations from the optimum that end an episode."""
STREET_SETS = ("drift_hard", "mid", "drift_hard", "drift_easy")
"""Those of the agent for streets; where wrong matches are few, hardly anything is left to learn."""

CORRECTED_STEP = (-0.1, 0.0, 0.0, 0.0, 0.8, -0.1)
CENTRES = {
    AgentKind.DRL: CORRECTED_STEP,
    AgentKind.DRL_INCREMENTS: None,
    AgentKind.DRL_STREETS: action_of(scale_px=16.0, damping=1e-5),
}
"""What an untrained actor does, and where random actions begin: a corrected step; nothing at all; a middling scale."""
RANDOM_SPREADS = {AgentKind.DRL: 0.3, AgentKind.DRL_STREETS: 0.5}

UPDATES_PER_TRACE = 50  # of the loss and the target lag that the figure draws
VALIDATION_RIGS = 96
MAX_TRAINING_STEPS = 15  # an episode is cut here: an agent that has not arrived by then learns little more


@dataclass(frozen=True, slots=True)
class TrainingOptions:
    """How a run goes. ``n_steps`` counts transitions of single rigs."""

    kind: AgentKind = AgentKind.DRL
    seed: int = 0
    n_steps: int = 2_000_000
    td3: TD3Options = field(default_factory=lambda: TD3Options(discount=0.9, learning_rate=7e-4))
    rigs_per_pool: int = 512
    rigs_per_generation: int = 256
    steps_per_update: float = 32.0
    batch_size: int = 256
    capacity: int = 300_000
    exploration: tuple[float, float] = (0.25, 0.03)
    """Spread of the noise on actions, at the start and at the end."""
    final_rate_share: float = 0.1
    """Learning rate at the end over that at the start."""
    n_checks: int = 12
    """Held-out checks in a run."""
    critic_lead: int = 500
    """Updates of the critics before the actor follows them."""

    def document(self) -> dict[str, Any]:
        """The options as plain data, for checkpoints and cards."""
        return asdict(self) | {"kind": str(self.kind)}


def default_options(kind: AgentKind) -> TrainingOptions:
    """The options that the shipped agent of that kind was trained with, up to its seed.

    An increment is one step long as a whole: noise that steering shrugs off keeps it from ever arriving.
    """
    options = TrainingOptions(kind=kind)
    if kind == AgentKind.DRL:
        return options
    if kind == AgentKind.DRL_STREETS:  # what counts is where an episode ends: a dozen steps must be worth looking at
        td3 = replace(options.td3, discount=0.97, smoothing=0.15)
        return replace(
            options, n_steps=600_000, exploration=(0.5, 0.15), td3=td3, rigs_per_pool=1200, rigs_per_generation=128
        )
    td3 = replace(options.td3, smoothing=0.02, smoothing_limit=0.05)
    return replace(options, n_steps=1_500_000, exploration=(0.08, 0.01), td3=td3)


@dataclass(frozen=True, slots=True)
class Check:
    """A held-out check. Iterations and success are means over the validation pools, in their order.

    ``critic_loss`` is the mean since the last check. ``value_predicted`` is the critics' value of the starts, ``value_returned``
    the discounted reward that the actor then earned there (Monte Carlo), ``value_rms`` the RMS of their difference.
    """

    n_steps: int
    n_updates: int
    critic_loss: float
    target_lag: float
    value_predicted: float
    value_returned: float
    value_rms: float
    iterations: tuple[float, ...]
    success: tuple[float, ...]

    @property
    def score(self) -> float:
        """Mean logarithm of the iterations; lower is better."""
        return float(np.mean(np.log(self.iterations)))


class Training:
    """A run and all that lives in it: networks, replay buffer, generators, counters."""

    def __init__(
        self, options: TrainingOptions, pools: list[tuple[Cases, float]], validation: list[tuple[Cases, float]]
    ) -> None:
        if not pools:
            raise ValueError("training needs at least one pool of rigs")
        self.options, self.pools, self.validation = options, pools, validation
        self.rng, self.sampling = (np.random.default_rng([options.seed, stream]) for stream in (1, 5))
        self.noise = torch.Generator().manual_seed(options.seed)
        task = task_of(options.kind)
        n_observed, n = len(task.observation_names), len(task.action_names)
        self.cases = cases_of(options.kind)
        with torch.random.fork_rng(devices=[]):  # the caller's own stream stays where it was
            torch.manual_seed(options.seed)
            self.td3 = TD3(n_observed, n, options.td3, CENTRES[options.kind])
        self.buffer = ReplayBuffer(options.capacity, n_observed, n)
        self.n_steps, self.n_generations, self.elapsed_s = 0, 0, 0.0
        self.losses: list[float] = []
        self.trace: list[tuple[int, float, float]] = []
        self.values: tuple[ndarray, ndarray] = (np.empty(0), np.empty(0))
        self.checks: list[Check] = []
        self.best: dict[str, Any] | None = None

    @property
    def is_done(self) -> bool:
        """Whether all steps were taken."""
        return self.n_steps >= self.options.n_steps

    def warm_up(self) -> None:
        """Fills the buffer with episodes of random actions around a plain start, and fixes the observations' units."""
        for pool, tolerance in self.pools:
            start = self.cases.sample_starts(pool, self.rng)
            run_episodes(
                pool,
                start,
                self._random,
                self.options.kind,
                tolerance_sigma=tolerance,
                max_steps=12,
                on_step=self._store,
            )
        self.td3.normalise_by(self.buffer.observation[: len(self.buffer)])

    def generation(self) -> None:
        """One pool's episodes under the exploring actor, and the gradient steps that fall due."""
        begin = time.perf_counter()
        options = self.options
        pool, tolerance = self.pools[self.n_generations % len(self.pools)]
        pick = self.rng.permutation(pool.n_rigs)[: options.rigs_per_generation]
        part = pool.select(pick)
        share = min(self.n_steps / options.n_steps, 1.0)
        first, last = options.exploration
        spread = first + (last - first) * share
        self.td3.set_learning_rate(options.td3.learning_rate * (1 + (options.final_rate_share - 1) * share))

        explorer = self.policy({}, of=self.td3.actor)

        def explore(observed: Float[ndarray, "n o"]) -> Float[ndarray, "n a"]:
            action = explorer(observed)
            return np.clip(action + spread * self.rng.standard_normal(action.shape), -1, 1)

        # The networks learn from what is in the buffer while the explorer, a copy of the actor, collects more: neither
        # sees the other before both are done, so the result does not depend on which is faster.
        collected: list[Transitions] = []
        with ThreadPoolExecutor(1) as aside:
            learning = aside.submit(self._learn)
            run_episodes(
                part,
                self.cases.sample_starts(part, self.rng),
                explore,
                options.kind,
                tolerance_sigma=tolerance,
                max_steps=MAX_TRAINING_STEPS,
                on_step=collected.append,
            )
            learning.result()
        for transitions in collected:
            self._store(transitions)
            self.n_steps += len(transitions.reward)
        self.n_generations += 1
        self.elapsed_s += time.perf_counter() - begin

    def check(self) -> Check:
        """A held-out check of the averaged actor; the best one so far is kept."""
        outcomes: list[EpisodeOutcome] = []
        predicted: list[ndarray] = []
        policy = self.policy({})
        for index, (pool, tolerance) in enumerate(self.validation):
            start = self.cases.sample_starts(pool, np.random.default_rng([7, index]))
            seen: list[ndarray] = []

            def act(observed: ndarray, seen: list[ndarray] = seen) -> ndarray:
                action = policy(observed)
                if not seen:
                    seen.append(self._value(observed, action))
                return action

            outcomes.append(
                run_episodes(
                    pool,
                    start,
                    act,
                    self.options.kind,
                    tolerance_sigma=tolerance,
                    discount=self.options.td3.discount,
                )
            )
            predicted += seen
        value, returned = np.concatenate(predicted), np.concatenate([o.total_reward for o in outcomes])
        self.values = (value, returned)
        check = Check(
            self.n_steps,
            self.td3.n_updates,
            float(np.mean(self.losses)) if self.losses else float("nan"),
            self.td3.target_lag(),
            float(value.mean()),
            float(returned.mean()),
            float(np.sqrt(np.mean((value - returned) ** 2))),
            tuple(float(o.n_iterations.mean()) for o in outcomes),
            tuple(float(o.has_arrived.mean()) for o in outcomes),
        )
        self.losses = []
        if self.best is None or check.score < self.best["score"]:
            weights = {name: value.clone() for name, value in self.td3.target_actor.state_dict().items()}
            self.best = {"score": check.score, "weights": weights}
        self.checks.append(check)
        return check

    def policy(self, card: dict[str, Any], *, best: bool = False, of: Actor | None = None) -> Policy:
        """The averaged (target) actor as a policy: as it is now, or as it was at the best check; or another actor."""
        weights = self.best["weights"] if best and self.best else (of or self.td3.target_actor).state_dict()
        return policy_of(self.options.kind, weights, card)

    def history(self) -> TrainingHistory:
        """The run so far, for the figure."""
        update, loss, lag = np.array(self.trace).reshape(-1, 3).T
        return TrainingHistory(
            self.options.td3.targets,
            self.options.seed,
            update.astype(int),
            loss,
            lag,
            *self.values,
            np.array([check.n_updates for check in self.checks]),
            np.array([np.mean(check.success) for check in self.checks]),
            np.array([np.mean(check.iterations) for check in self.checks]),
        )

    def state(self) -> dict[str, Any]:
        """Everything that going on needs, for a checkpoint."""
        return {
            "options": self.options.document(),
            "td3": self.td3.state(),
            "buffer": self.buffer.state(),
            "rng": self.rng.bit_generator.state,
            "sampling": self.sampling.bit_generator.state,
            "noise": self.noise.get_state(),
            "counters": (self.n_steps, self.n_generations, self.elapsed_s),
            "losses": list(self.losses),
            "trace": list(self.trace),
            "values": self.values,
            "checks": [asdict(check) for check in self.checks],
            "best": self.best,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """The inverse of :meth:`state`.

        Raises:
            ValueError: The checkpoint is of a run with other options.
        """
        theirs, ours = dict(state["options"]), self.options.document()
        if "meaning" in theirs:  # release 0.1
            theirs["kind"] = str(AgentKind.of_stored(theirs.pop("meaning")))
        if theirs != ours:
            changed = sorted(name for name in ours if ours[name] != theirs.get(name))
            raise ValueError(f"the checkpoint is of a run with other options ({', '.join(changed)})")
        self.td3.restore(state["td3"])
        self.buffer.restore(state["buffer"])
        self.rng.bit_generator.state = state["rng"]
        self.sampling.bit_generator.state = state["sampling"]
        self.noise.set_state(state["noise"])
        self.n_steps, self.n_generations, self.elapsed_s = state["counters"]
        self.losses, self.trace, self.values = list(state["losses"]), list(state["trace"]), state["values"]
        self.checks = [
            Check(**{**c, "iterations": tuple(c["iterations"]), "success": tuple(c["success"])})
            for c in state["checks"]
        ]
        self.best = state["best"]

    def _value(self, observed: ndarray, action: ndarray) -> ndarray:
        """The smaller of the critics' values."""
        with torch.no_grad():
            seen = self.td3.actor.normalised(torch.as_tensor(observed, dtype=torch.float32))
            return torch.minimum(*self.td3.critic(seen, torch.as_tensor(action, dtype=torch.float32))).numpy()

    def _random(self, observed: Float[ndarray, "n o"]) -> Float[ndarray, "n a"]:
        """Random actions around what an untrained actor does, or around the Gauss-Newton step as an increment."""
        centre = CENTRES[self.options.kind]
        if centre is not None:
            noise = self.rng.normal(0, RANDOM_SPREADS[self.options.kind], (len(observed), len(centre)))
            return np.clip(centre + noise, -1, 1)
        return np.clip(observed[:, -6:] / INCREMENT_REACH + self.rng.normal(0, 0.1, (len(observed), 6)), -1, 1)

    def _store(self, t: Transitions) -> None:
        self.buffer.add(t.observation, t.action, t.reward, t.following, t.is_terminal)

    def _learn(self) -> None:
        """The gradient steps that are due for the transitions so far."""
        while self.td3.n_updates < self.n_steps / self.options.steps_per_update:
            batch = self.buffer.sample(self.options.batch_size, self.sampling)
            waits = self.td3.n_updates < self.options.critic_lead
            self.losses.append(self.td3.update(batch, self.noise, actor_waits=waits).critic_loss)
            if self.td3.n_updates % UPDATES_PER_TRACE == 0:
                recent = float(np.mean(self.losses[-UPDATES_PER_TRACE:]))
                self.trace.append((self.td3.n_updates, recent, self.td3.target_lag()))


def policy_of(kind: AgentKind, weights: Mapping[str, Tensor], card: dict[str, Any]) -> Policy:
    """An actor's weights as a policy, in single precision."""
    arrays = {name: value.detach().numpy().astype(np.float32).astype(float) for name, value in weights.items()}
    names = sorted({name.split(".")[1] for name in arrays if name.startswith("body.")}, key=int)
    layers = tuple((arrays[f"body.{i}.weight"], arrays[f"body.{i}.bias"]) for i in names)
    return Policy(kind, arrays["mean"], arrays["spread"], layers, card)


def simulated_pools(options: TrainingOptions) -> tuple[list[tuple[Cases, float]], list[tuple[Cases, float]]]:
    """Training and validation cases of :data:`TRAINING_SETS` or :data:`STREET_SETS`; the options' seed draws both."""
    pools: list[tuple[Cases, float]] = []
    validation: list[tuple[Cases, float]] = []
    if options.kind == AgentKind.DRL_STREETS:
        for index, name in enumerate(STREET_SETS):
            rng = np.random.default_rng([options.seed, 2, index])
            pools.append((sample_matches(MATCH_SETS[name], options.rigs_per_pool, rng), FOUND_SIGMA))
            validation.append((sample_matches(MATCH_SETS[name], VALIDATION_RIGS, rng), FOUND_SIGMA))
        return pools, validation
    for index, (distribution, tolerance) in enumerate(TRAINING_SETS):
        rng = np.random.default_rng([options.seed, 2, index])
        pools.append((sample_rigs(distribution, options.rigs_per_pool, rng), tolerance))
        validation.append((sample_rigs(distribution, VALIDATION_RIGS, rng), tolerance))
    return pools, validation


def run_training(
    training: Training,
    *,
    on_check: Callable[[Training, Check], None],
    on_generation: Callable[[Training], None] = lambda _: None,
    is_cancelled: Callable[[], bool] = lambda: False,
) -> None:
    """Trains until all steps are taken or ``is_cancelled`` says so; between generations it may be cut and resumed."""
    threads_before = torch.get_num_threads()
    torch.set_num_threads(1)  # small matrices: a second thread only costs, and sums would depend on the machine
    try:
        if training.n_generations == 0 and not training.checks:
            training.warm_up()
            on_check(training, training.check())
        while not training.is_done and not is_cancelled():
            training.generation()
            if training.n_steps >= training.options.n_steps * len(training.checks) / training.options.n_checks:
                on_check(training, training.check())
            on_generation(training)
    finally:
        torch.set_num_threads(threads_before)
