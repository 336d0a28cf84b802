"""Twin-delayed deep deterministic policy gradient (TD3), with hard or soft target updates.

The paper's actor-critic: the critic Q(q, a; omega) is fitted to the state-action value (eqs 13, 14), the actor's parameters
theta follow its gradient, and target networks of both are renewed by copying (hard) or by Polyak averaging (soft, eqs
15, 16 as they should read: target <- (1 - eta) target + eta online).
Source: Fujimoto, van Hoof & Meger 2018, "Addressing function approximation error in actor-critic methods".
Deviation: the targets follow at every update, there only at those that move the actor too.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, Literal

import torch
from numpy import ndarray
from torch import Tensor

from binocal.rl.training.networks import Actor, TwinCritic

Targets = Literal["soft", "hard"]


@dataclass(frozen=True, slots=True)
class TD3Options:
    """The algorithm's numbers, those of Fujimoto et al. unless said otherwise."""

    discount: float = 0.97  # an episode has a dozen steps at most
    targets: Targets = "soft"
    target_rate: float = 0.005
    """eta; hard targets are copied every 1 / eta updates, which is the same time constant."""
    learning_rate: float = 1e-3
    policy_delay: int = 2
    smoothing: float = 0.1
    """Spread of the noise on the target's action; smaller than usual, as good actions lie close together."""
    smoothing_limit: float = 0.3
    actor_widths: tuple[int, ...] = (64, 64)
    critic_widths: tuple[int, ...] = (128, 128)


@dataclass(frozen=True, slots=True)
class UpdateReport:
    """Of one update: the critics' loss, and the actor's mean value (NaN where the actor waited)."""

    critic_loss: float
    actor_value: float


class TD3:
    """Networks, their targets and optimisers; the only state of the algorithm."""

    def __init__(
        self, n_observed: int, n_actions: int, options: TD3Options, centre: tuple[float, ...] | None = None
    ) -> None:
        self.options, self.n_updates = options, 0
        self.actor = Actor(n_observed, n_actions, options.actor_widths, centre)
        self.critic = TwinCritic(n_observed, n_actions, options.critic_widths)
        self.target_actor, self.target_critic = copy.deepcopy(self.actor), copy.deepcopy(self.critic)
        pairs = ((self.actor, self.target_actor), (self.critic, self.target_critic))
        self._followed = [(list(online.parameters()), list(target.parameters())) for online, target in pairs]
        self.actor_optimiser = torch.optim.Adam(self.actor.parameters(), lr=options.learning_rate, fused=True)
        self.critic_optimiser = torch.optim.Adam(self.critic.parameters(), lr=options.learning_rate, fused=True)

    def normalise_by(self, observations: ndarray) -> None:
        """Fixes the observations' mean and spread, in the actor and its target."""
        values = torch.as_tensor(observations, dtype=torch.float32)
        for actor in (self.actor, self.target_actor):
            actor.mean.copy_(values.mean(dim=0))
            actor.spread.copy_(values.std(dim=0).clamp_min(1e-2))

    def set_learning_rate(self, rate: float) -> None:
        """Changes the learning rate of both optimisers."""
        for optimiser in (self.actor_optimiser, self.critic_optimiser):
            for group in optimiser.param_groups:
                group["lr"] = rate

    def targets(self, reward: Tensor, following: Tensor, is_terminal: Tensor, noise: Tensor) -> Tensor:
        """TD targets: reward plus the discounted smaller value of the targets' smoothed action, nothing after the end."""
        options = self.options
        with torch.no_grad():
            shaken = (noise * options.smoothing).clamp(-options.smoothing_limit, options.smoothing_limit)
            action = (self.target_actor(following) + shaken).clamp(-1, 1)
            first, second = self.target_critic(self.actor.normalised(following), action)
            return reward + options.discount * (1 - is_terminal) * torch.minimum(first, second)

    def update(
        self, batch: tuple[ndarray, ...], generator: torch.Generator, *, actor_waits: bool = False
    ) -> UpdateReport:
        """One gradient step of the critics, and of the actor every ``policy_delay`` times."""
        observation, action, reward, following, is_terminal = (torch.as_tensor(a) for a in batch)
        noise = torch.randn(action.shape, generator=generator)
        wanted = self.targets(reward, following, is_terminal, noise)
        normalised = self.actor.normalised(observation)
        first, second = self.critic(normalised, action)
        loss = torch.nn.functional.mse_loss(first, wanted) + torch.nn.functional.mse_loss(second, wanted)
        self.critic_optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.critic_optimiser.step()
        self.n_updates += 1
        value = float("nan")
        if self.n_updates % self.options.policy_delay == 0 and not actor_waits:
            mean_value = self.critic(normalised, self.actor(observation))[0].mean()
            self.actor_optimiser.zero_grad(set_to_none=True)
            (-mean_value).backward()
            self.actor_optimiser.step()
            value = float(mean_value.detach())
        self._follow()
        return UpdateReport(float(loss.detach()), value)

    def _follow(self) -> None:
        """Renews the targets."""
        rate = self.options.target_rate
        if self.options.targets == "hard":
            if self.n_updates % round(1 / rate):
                return
            rate = 1.0
        with torch.no_grad():
            for online, target in self._followed:
                torch._foreach_lerp_(target, online, rate)  # pyright: ignore - its stub knows no Parameter

    def target_lag(self) -> float:
        """RMS difference of the actor's parameters and its target's."""
        with torch.no_grad():
            pairs = zip(self.actor.parameters(), self.target_actor.parameters(), strict=True)
            squares = torch.cat([(a - b).square().flatten() for a, b in pairs])
            return float(squares.mean().sqrt())

    def state(self) -> dict[str, Any]:
        """Everything that a resumed run needs."""
        return {
            "n_updates": self.n_updates,
            **{name: getattr(self, name).state_dict() for name in self._PARTS},
        }

    def restore(self, state: dict[str, Any]) -> None:
        """The inverse of :meth:`state`."""
        self.n_updates = state["n_updates"]
        for name in self._PARTS:
            getattr(self, name).load_state_dict(state[name])

    _PARTS = ("actor", "critic", "target_actor", "target_critic", "actor_optimiser", "critic_optimiser")
