"""A trained actor without PyTorch: weights from a safetensors file, inference in NumPy."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.errors import FormatError
from binocal.input_file import read_file
from binocal.output import write_aside
from binocal.rl.agent_kind import AgentKind
from binocal.rl.task import TaskState, raised_damping, steering_action
from binocal.rl.tasks import task_of
from binocal.shapes import Float
from binocal.solvers.loop_state import Action, LoopState, Memory

SHIPPED = {
    AgentKind.DRL: "drl.safetensors",
    AgentKind.DRL_INCREMENTS: "drl_increments.safetensors",
    AgentKind.DRL_STREETS: "drl_streets.safetensors",
}
MOST_BYTES = 64 << 20  # the shipped weights have 90 kB
OBSERVATION_LIMIT = 5.0  # in units of the spread, as in training


@dataclass(frozen=True, slots=True, eq=False)
class Policy:
    """An actor: ``layers`` of (weight (out, in), bias (out)), ReLU between them, tanh after the last.

    ``card`` is what is known of its training.
    """

    kind: AgentKind
    mean: Float[ndarray, "o"]
    spread: Float[ndarray, "o"]
    layers: tuple[tuple[Float[ndarray, "_ _"], Float[ndarray, "_"]], ...]
    card: Mapping[str, Any]

    def __call__(self, observed: Float[ndarray, "*batch o"]) -> Float[ndarray, "*batch a"]:
        """Actions in [-1, 1]; NaN where the weights are."""
        x = (observed - self.mean) / self.spread
        x = np.minimum(np.maximum(x, -OBSERVATION_LIMIT), OBSERVATION_LIMIT)
        *hidden, (weight, bias) = self.layers
        for w, b in hidden:
            x = np.maximum(x @ w.T + b, 0.0)
        return np.tanh(x @ weight.T + bias)


@dataclass(frozen=True, slots=True)
class LearnedController:
    """A policy as a controller of the robust loop (:class:`binocal.solvers.loop_state.Controller`)."""

    policy: Policy

    def start(self, batch: tuple[int, ...]) -> Memory:
        """See the protocol."""
        return {
            "last_action": np.zeros((*batch, len(task_of(self.policy.kind).action_names))),
            "n_steps": np.zeros(batch, dtype=int),
            "n_rejected": np.zeros(batch, dtype=int),
        }

    def choose(self, problem: Any, state: LoopState[Any, Any, Any], memory: Memory) -> tuple[Action, Memory]:
        """See the protocol. Where the policy's numbers are not finite, neither is the damping, and the guards take over."""
        task = task_of(self.policy.kind)
        n_rejected = np.where(state.is_kept, 0, memory["n_rejected"] + 1)
        here = TaskState(state, memory["last_action"], memory["n_steps"], n_rejected)
        raw = self.policy(task.observation(problem, here))
        is_sound = np.asarray(np.isfinite(raw).all(axis=-1))
        action = task.solver_action(problem, here, raw)
        if not is_sound.all():
            action = replace(action, damping=np.where(is_sound, action.damping, np.nan))
            raw = np.where(is_sound[..., None], raw, 0.0)
        if n_rejected.any():
            action = replace(action, damping=raised_damping(action.damping, n_rejected))
        return action, {"last_action": raw, "n_steps": memory["n_steps"] + 1, "n_rejected": n_rejected}


@dataclass(frozen=True, slots=True, eq=False)
class ConstantController:
    """The same steering action in every iteration, whatever the state."""

    action: Float[ndarray, "a"]

    def start(self, batch: tuple[int, ...]) -> Memory:
        """See the protocol."""
        return {"n_steps": np.zeros(batch, dtype=int)}

    def choose(self, problem: Any, state: LoopState[Any, Any, Any], memory: Memory) -> tuple[Action, Memory]:
        """See the protocol."""
        return steering_action(np.broadcast_to(self.action, (*state.mad_px.shape, len(self.action))), state), memory


def load_policy(path: str | Path) -> Policy:
    """A policy from a safetensors file written by :func:`save_policy`.

    Raises:
        FormatError: The file is not one, or its shapes do not fit this version's observation.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    content = read_file(path, most_bytes=MOST_BYTES)
    try:
        arrays = {name: array.astype(float) for name, array in load(content).items()}
    except (SafetensorError, ValueError, TypeError, LookupError, OverflowError) as error:
        raise FormatError(path, f"not a readable safetensors file ({' '.join(str(error).split())[:100]}).") from None
    try:
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
        metadata = header["__metadata__"]
        kind = AgentKind.of_stored(metadata.get("kind") or metadata["meaning"])
        n_layers = sum(name.startswith("weight") for name in arrays)
        layers = tuple((arrays[f"weight{i}"], arrays[f"bias{i}"]) for i in range(n_layers))
        card = json.loads(metadata["card"])
        if not isinstance(card, dict):
            raise ValueError("its card is no object; it is")
        policy = Policy(kind, arrays["mean"], arrays["spread"], layers, card)
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(
            path, f"not binocal's weights ({' '.join(str(error).split())[:100]} missing or unreadable)."
        ) from None
    if not _fit(policy):
        raise FormatError(path, "weights for another version of the observation; train again.")
    return policy


def _fit(policy: Policy) -> bool:
    """Whether the shapes are those of this version's observation and actions."""
    task = task_of(policy.kind)
    n_observed = len(task.observation_names)
    if not policy.layers or policy.mean.shape != (n_observed,) or policy.spread.shape != (n_observed,):
        return False
    n_in = n_observed
    for weight, bias in policy.layers:
        if weight.ndim != 2 or weight.shape[1] != n_in or bias.shape != weight.shape[:1]:
            return False
        n_in = len(weight)
    return n_in == len(task.action_names)


def save_policy(policy: Policy, path: str | Path) -> None:
    """Writes the weights in single precision, with their card as metadata."""
    from safetensors.numpy import save

    arrays = {"mean": policy.mean, "spread": policy.spread}
    for i, (weight, bias) in enumerate(policy.layers):
        arrays |= {f"weight{i}": weight, f"bias{i}": bias}
    single = {name: np.ascontiguousarray(a, dtype=np.float32) for name, a in arrays.items()}
    metadata = {"kind": str(policy.kind), "card": json.dumps(policy.card, sort_keys=True)}
    write_aside(path, save(single, metadata=metadata), force=True)


@cache
def shipped_policy(kind: AgentKind = AgentKind.DRL) -> Policy:
    """The policy that comes with binocal."""
    with resources.as_file(resources.files("binocal.rl") / "weights" / SHIPPED[kind]) as path:
        return load_policy(path)
