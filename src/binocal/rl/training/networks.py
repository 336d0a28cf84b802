"""Actor and twin critics."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn


def _layers(sizes: tuple[int, ...]) -> nn.Sequential:
    """Linear layers with ReLU between them."""
    parts: list[nn.Module] = []
    for n_in, n_out in pairwise(sizes):
        parts += [nn.Linear(n_in, n_out), nn.ReLU()]
    return nn.Sequential(*parts[:-1])


class Actor(nn.Module):
    """Normalised observation -> action in [-1, 1]. The mean and spread of observations are part of it.

    ``centre`` is the action that an untrained actor takes, whatever it sees.
    """

    mean: Tensor
    spread: Tensor

    def __init__(
        self, n_observed: int, n_actions: int, widths: tuple[int, ...], centre: tuple[float, ...] | None = None
    ) -> None:
        super().__init__()
        self.body = _layers((n_observed, *widths, n_actions))
        self.register_buffer("mean", torch.zeros(n_observed))
        self.register_buffer("spread", torch.ones(n_observed))
        last = self.body[-1]
        assert isinstance(last, torch.nn.Linear)
        with torch.no_grad():
            last.weight *= 0.01
            last.bias.copy_(torch.atanh(torch.tensor(centre or (0.0,) * n_actions)))

    def forward(self, observation: Tensor) -> Tensor:
        """Actions (n, a)."""
        return torch.tanh(self.body(self.normalised(observation)))

    def normalised(self, observation: Tensor) -> Tensor:
        """Observations in units of their spread, cut at ±5."""
        return ((observation - self.mean) / self.spread).clamp(-5, 5)


class TwinCritic(nn.Module):
    """Two state-action values of a normalised observation and an action. Source: Fujimoto et al. 2018 (TD3)."""

    def __init__(self, n_observed: int, n_actions: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.first = _layers((n_observed + n_actions, *widths, 1))
        self.second = _layers((n_observed + n_actions, *widths, 1))

    def forward(self, normalised: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Both values (n,)."""
        both = torch.cat([normalised, action], dim=-1)
        return self.first(both)[:, 0], self.second(both)[:, 0]
