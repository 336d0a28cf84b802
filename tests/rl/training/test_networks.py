"""The networks' shapes, ranges and beginnings."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is an extra: pip install binocal[train]")

from binocal.rl.training.networks import Actor, TwinCritic


def test_actions_are_within_one_and_begin_near_zero(torch):
    torch.manual_seed(0)
    actor = Actor(5, 3, (16, 16))
    wild = 1e6 * torch.randn(200, 5)
    assert actor(wild).shape == (200, 3)
    assert actor(wild).abs().max() < 0.1  # 0 is plain Gauss-Newton
    with torch.no_grad():
        actor.body[-1].weight *= 1e6
    assert actor(wild).abs().max() <= 1


def test_observations_are_taken_in_units_of_their_spread_and_cut(torch):
    actor = Actor(2, 1, (4,))
    actor.mean.copy_(torch.tensor([1.0, -2.0]))
    actor.spread.copy_(torch.tensor([2.0, 0.5]))
    got = actor.normalised(torch.tensor([[2.0, -2.25], [1e9, -1e9]]))
    np.testing.assert_allclose(got.numpy(), [[0.5, -0.5], [5.0, -5.0]])
    assert {"mean", "spread"} <= set(actor.state_dict())  # they travel with the weights


def test_the_two_critics_are_independent(torch):
    torch.manual_seed(0)
    critic = TwinCritic(4, 2, (8, 8))
    first, second = critic(torch.randn(7, 4), torch.randn(7, 2))
    assert first.shape == second.shape == (7,)
    assert not torch.allclose(first, second)


def test_no_hidden_layer_is_a_linear_map(torch):
    critic = TwinCritic(1, 1, ())
    with torch.no_grad():
        critic.first[0].weight.copy_(torch.tensor([[2.0, 3.0]]))
        critic.first[0].bias.copy_(torch.tensor([1.0]))
        assert float(critic(torch.tensor([[10.0]]), torch.tensor([[0.5]]))[0]) == 22.5
