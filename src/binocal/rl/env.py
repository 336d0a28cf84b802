"""Gymnasium faces of the task: one rig (:class:`StereoExtrinsicsEnv`), or a batch (:class:`StereoExtrinsicsVectorEnv`).

These make one::

    env = gymnasium.make("binocal:binocal/StereoExtrinsics-v0", rig_set="stress")
    envs = gymnasium.make_vec("binocal:binocal/StereoExtrinsics-v0", num_envs=64)

**Action**, Box(-1, 1): with ``kind="drl"`` six numbers, all zero being robust Gauss-Newton. A not finite number counts as 0.

====================================================  =====================================================================
log damping                                           Marquardt damping 0 (at 0 and below), 5e-3 × (10^5a - 1) least pivots above
log kernel scale                                      exp(1.5 a) = 0.22 to 4.5 times the MAD noise
log rotation stretch, log translation stretch         exp(0.4 a) = 0.67 to 1.5 times the rig's step
share of the second-order correction                  1.25 a, cut to 0..1
log damping of the board poses                        as damping, 1e-2 × (10^5a - 1)
====================================================  =====================================================================

With ``kind="drl-increments"`` the change of R, T itself (three numbers of rotation, three of translation), whitened by the
rig's information; 1 is 1.5 times the length of the Gauss-Newton step.

With ``kind="drl-streets"`` episodes are solves from matches of natural images (``rig_set="drift_hard"``, say): the kernel's scale in pixels
and the damping (:mod:`binocal.rl.epipolar_task`), twelve steps an episode; reward and termination are those of its ``judge``.

**Observation**, Box of float32: the numbers that :func:`binocal.rl.task.observation_names` names with their units, each
cut to ±10 (actions and directions to ±1). **Reward**: :func:`binocal.rl.task.reward`. **Termination**: within ``tolerance_sigma`` of the robust
optimum. **Truncation**: 25 steps, unless ``max_episode_steps`` says otherwise (it is Gymnasium's ``TimeLimit`` that counts the
single form's). **Info**: ``distance_sigma`` (Mahalanobis distance of R and T to the optimum), ``n_steps``, ``is_kept`` (whether
the last candidate lowered the robust cost) and ``rig`` (its place in the pool).

Rigs come from a pool that is drawn once, from ``pool_seed``; an episode takes one of them and a new start. Other pool seeds
give other rigs: train on one, evaluate on another.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy import ndarray

from binocal.rl.agent_kind import AgentKind
from binocal.rl.cases import Cases, cases_of
from binocal.rl.match_batches import FOUND_SIGMA, MATCH_SETS, sample_matches
from binocal.rl.registration import MAX_STEPS
from binocal.rl.rig_batches import RIG_SETS, sample_rigs
from binocal.rl.task import TaskState
from binocal.rl.tasks import task_of
from binocal.shapes import Bool, Float, Float32, Int
from binocal.solvers.arrays import join_rigs, replace_rigs

OBSERVED_LIMIT = 10.0  # decades, or octaves; beyond it nothing changes what should be done
TOLERANCE_SIGMA = 0.1
TOLERANCES_SIGMA = {"stress": 0.3}
"""Sets whose results are stated at another tolerance."""


@dataclass(frozen=True, slots=True)
class EnvOptions:
    """Which rigs an environment is about, and what an action means there.

    ``tolerance_sigma`` None is 0.1, 0.3 on the stress set.
    """

    rig_set: str = "standard"
    kind: AgentKind = AgentKind.DRL
    tolerance_sigma: float | None = None
    pool_size: int = 64
    pool_seed: int = 0

    def __post_init__(self) -> None:
        if self.kind not in tuple(AgentKind):
            raise ValueError(f"kind must be {' or '.join(AgentKind)}; got {self.kind!r}")
        object.__setattr__(self, "kind", AgentKind(self.kind))
        known = MATCH_SETS if self.kind == AgentKind.DRL_STREETS else RIG_SETS
        if self.rig_set not in known:
            raise ValueError(f"rig_set must be one of {', '.join(known)} for {self.kind}; got {self.rig_set!r}")
        if self.pool_size < 1:
            raise ValueError(f"pool_size must be 1 or more; got {self.pool_size}")
        if self.tolerance_sigma is not None and not self.tolerance_sigma > 0:
            raise ValueError(f"tolerance_sigma must be above 0; got {self.tolerance_sigma}")

    @property
    def arrival_sigma(self) -> float:
        """The distance that ends an episode."""
        if self.tolerance_sigma is not None:
            return self.tolerance_sigma
        if self.kind == AgentKind.DRL_STREETS:
            return FOUND_SIGMA
        return TOLERANCES_SIGMA.get(self.rig_set, TOLERANCE_SIGMA)

    def pool(self) -> Cases:
        """The rigs, drawn on the first call; some 10 ms each."""
        return _pool(self.kind, self.rig_set, self.pool_size, self.pool_seed)

    @property
    def observation_limits(self) -> Float[ndarray, "o"]:
        """What the numbers of an observation are cut to, plus and minus."""
        names = task_of(self.kind).observation_names
        is_unit = [name.startswith(("last ", "Gauss-Newton step, ")) for name in names]
        return np.where(is_unit, 1.0, OBSERVED_LIMIT)

    def observation_space(self) -> Box:
        """What one rig's observation may be."""
        limit = self.observation_limits.astype(np.float32)
        return Box(-limit, limit, dtype=np.float32)

    def action_space(self) -> Box:
        """What one rig's action may be."""
        return Box(-1.0, 1.0, (len(task_of(self.kind).action_names),), dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Episodes under way: the rigs' places in the pool, the rigs, where their solves stand, and how far off they are."""

    rig: Int[ndarray, "n"]
    rigs: Any
    state: TaskState
    sigma: Float[ndarray, "n"]


def begin_episodes(options: EnvOptions, generators: Sequence[np.random.Generator]) -> Batch:
    """One new episode for each generator; what it draws depends on that generator alone."""
    pool, cases = options.pool(), cases_of(options.kind)
    rig, starts = [], []
    for rng in generators:
        rig.append(int(rng.integers(pool.n_rigs)))
        starts.append(cases.sample_starts(pool.select(np.array(rig[-1:])), rng))
    rigs = pool.select(np.array(rig))
    state = task_of(options.kind).initial(rigs.problem, join_rigs(starts))
    return Batch(np.array(rig), rigs, state, cases.remaining_sigma(rigs, state.loop))


def advance_episodes(
    options: EnvOptions, before: Batch, action: Float[ndarray, "n a"]
) -> tuple[Batch, Float[ndarray, "n"], Bool[ndarray, "n"]]:
    """One step of every episode: what follows, the rewards, and which ended."""
    wanted = np.asarray(action, dtype=np.float64)
    state = task_of(options.kind).transition(before.rigs.problem, before.state, wanted)
    judged = cases_of(options.kind).judge(before.rigs, before.sigma, state, options.arrival_sigma)
    return Batch(before.rig, before.rigs, state, judged.sigma), judged.reward, judged.is_terminal


def observed(options: EnvOptions, batch: Batch) -> Float32[ndarray, "n o"]:
    """The observations, cut to the space."""
    limit = options.observation_limits
    seen = task_of(options.kind).observation(batch.rigs.problem, batch.state)
    return np.clip(seen, -limit, limit).astype(np.float32)


class StereoExtrinsicsEnv(gymnasium.Env[ndarray, ndarray]):
    """One rig at a time. See the module for spaces, reward and info.

    Never truncates by itself: ``gymnasium.make`` adds the time limit.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # pyright: ignore

    def __init__(self, render_mode: None = None, **options: Any) -> None:
        """Takes the fields of :class:`EnvOptions` as keywords. There is nothing to render."""
        self.options = EnvOptions(**options)
        self.render_mode = render_mode
        self.observation_names = task_of(self.options.kind).observation_names
        self.observation_space, self.action_space = self.options.observation_space(), self.options.action_space()
        self._batch: Batch | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ndarray, dict[str, Any]]:
        """A rig of the pool and a start. ``options`` is not used."""
        super().reset(seed=seed)
        self._batch = begin_episodes(self.options, [self.np_random])
        return self._seen(self._batch)

    def step(self, action: ndarray) -> tuple[ndarray, float, bool, bool, dict[str, Any]]:
        """One iteration of the solve."""
        if self._batch is None:
            raise ValueError("step was called before reset")
        self._batch, earned, is_terminal = advance_episodes(self.options, self._batch, np.asarray(action)[None])
        seen, info = self._seen(self._batch)
        return seen, float(earned[0]), bool(is_terminal[0]), False, info

    def _seen(self, batch: Batch) -> tuple[ndarray, dict[str, Any]]:
        info = {name: values[0].item() for name, values in _info(batch).items()}
        return observed(self.options, batch)[0], info


class StereoExtrinsicsVectorEnv(VectorEnv[ndarray, ndarray, ndarray]):
    """A batch of rigs, stepped together. See the module for spaces, reward and info.

    ``autoreset_mode`` is ``NEXT_STEP`` (Gymnasium's usual one: the step after the last begins the next episode, its action is
    not looked at and its reward is 0) or ``SAME_STEP`` (the last step returns the next episode's first observation; the last
    one's is in ``info["final_obs"]``). Environment i after ``reset(seed=s)`` walks through the episodes of the single form
    after ``reset(seed=s + i)``.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 (Gymnasium's)

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int = MAX_STEPS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: None = None,
        **options: Any,
    ) -> None:
        """Takes the fields of :class:`EnvOptions` as keywords too. There is nothing to render."""
        mode = AutoresetMode(autoreset_mode)
        if mode is AutoresetMode.DISABLED:
            raise ValueError("autoreset_mode must be NextStep or SameStep; got Disabled")
        self.options, self.num_envs, self.max_episode_steps = EnvOptions(**options), num_envs, max_episode_steps
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "autoreset_mode": mode}
        self.observation_names = task_of(self.options.kind).observation_names
        self.single_observation_space = self.options.observation_space()
        self.single_action_space = self.options.action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators: list[np.random.Generator] = []
        self._has_ended = np.zeros(num_envs, dtype=bool)
        self._batch: Batch | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ndarray, dict[str, Any]]:
        """New episodes everywhere. An integer seeds environment i with ``seed + i``; ``options`` is not used.

        Raises:
            ValueError: A sequence of seeds of another length than ``num_envs``.
        """
        if seed is None or isinstance(seed, int | np.integer):
            super().reset(seed=None if seed is None else int(seed))
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed must have one entry for each of {self.num_envs} environments; got {len(seeds)}")
        old = self._generators or [None] * self.num_envs
        self._generators = [
            rng if rng is not None and one is None else seeding.np_random(one)[0]
            for rng, one in zip(old, seeds, strict=True)
        ]
        self._batch = begin_episodes(self.options, self._generators)
        self._has_ended = np.zeros(self.num_envs, dtype=bool)
        return observed(self.options, self._batch), _with_masks(_info(self._batch), np.ones(self.num_envs, dtype=bool))

    def step(self, actions: ndarray) -> tuple[ndarray, ndarray, ndarray, ndarray, dict[str, Any]]:
        """One iteration of every solve, and the next episode's beginning where the last one ended."""
        if self._batch is None:
            raise ValueError("step was called before reset")
        everywhere = np.ones(self.num_envs, dtype=bool)
        batch, earned, is_terminal = advance_episodes(self.options, self._batch, actions)
        is_truncated = (batch.state.n_steps >= self.max_episode_steps) & ~is_terminal
        has_ended, infos = is_terminal | is_truncated, {}
        if self.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP:
            old = self._has_ended
            earned, is_terminal, is_truncated = np.where(old, 0.0, earned), is_terminal & ~old, is_truncated & ~old
            batch, self._has_ended = self._renewed(batch, old), has_ended & ~old
        elif has_ended.any():
            infos = self._final(batch, has_ended)
            batch = self._renewed(batch, has_ended)
        self._batch = batch
        return (
            observed(self.options, batch),
            earned,
            is_terminal,
            is_truncated,
            {**_with_masks(_info(batch), everywhere), **infos},
        )

    def _renewed(self, batch: Batch, is_new: Bool[ndarray, "n"]) -> Batch:
        """The batch with new episodes in those places."""
        place = np.flatnonzero(is_new)
        if not len(place):
            return batch
        new = begin_episodes(self.options, [self._generators[i] for i in place])
        rig = replace_rigs(batch.rig, place, new.rig)
        state, sigma = replace_rigs(batch.state, place, new.state), replace_rigs(batch.sigma, place, new.sigma)
        return Batch(rig, self.options.pool().select(rig), state, sigma)

    def _final(self, batch: Batch, has_ended: Bool[ndarray, "n"]) -> dict[str, Any]:
        """Gymnasium's account of the last step of an episode."""
        seen = observed(self.options, batch)
        final = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(has_ended):
            final[i] = seen[i]
        ended = {name: np.where(has_ended, values, np.zeros_like(values)) for name, values in _info(batch).items()}
        return _with_masks({"final_obs": final, "final_info": _with_masks(ended, has_ended)}, has_ended)


@lru_cache(maxsize=8)  # environments of a synchronous vector share theirs
def _pool(kind: AgentKind, rig_set: str, size: int, seed: int) -> Cases:
    if kind == AgentKind.DRL_STREETS:
        return sample_matches(MATCH_SETS[rig_set], size, np.random.default_rng(seed))
    return sample_rigs(RIG_SETS[rig_set], size, np.random.default_rng(seed))


def _info(batch: Batch) -> dict[str, ndarray]:
    loop = batch.state.loop
    return {
        "distance_sigma": batch.sigma,
        "n_steps": batch.state.n_steps,
        "is_kept": loop.is_kept,
        "rig": batch.rig,
    }


def _with_masks(info: dict[str, Any], is_there: Bool[ndarray, "n"]) -> dict[str, Any]:
    """Gymnasium's vector info: every entry has a mask beside it. Nothing is shared with what it was given."""
    return {
        key: value
        for name, entry in info.items()
        for key, value in ((name, copy.copy(entry)), (f"_{name}", is_there.copy()))
    }
