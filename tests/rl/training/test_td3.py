"""Twin-delayed actor-critic: its targets by hand, its two kinds of target networks, resuming, and toys that it must solve."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is an extra: pip install binocal[train]")

from binocal.rl.training.replay import ReplayBuffer
from binocal.rl.training.td3 import TD3, TD3Options

SMALL = {"actor_widths": (16,), "critic_widths": (16,)}


def agent(torch, seed: int = 0, **options) -> TD3:
    torch.manual_seed(seed)
    return TD3(3, 2, TD3Options(**{**SMALL, **options}))


def batches(n: int, seed: int = 0, rows: int = 32) -> list[tuple[np.ndarray, ...]]:
    """Random transitions of three observed numbers and two actions."""
    rng = np.random.default_rng(seed)
    return [
        tuple(
            a.astype(np.float32)
            for a in (
                rng.normal(size=(rows, 3)),
                rng.uniform(-1, 1, (rows, 2)),
                rng.normal(size=rows),
                rng.normal(size=(rows, 3)),
                rng.random(rows) < 0.2,
            )
        )
        for _ in range(n)
    ]


def parameters(module) -> np.ndarray:
    return np.concatenate([p.detach().numpy().ravel() for p in module.parameters()])


def weights(td3: TD3) -> np.ndarray:
    """Every network's parameters in one row."""
    parts = (td3.actor, td3.critic, td3.target_actor, td3.target_critic)
    return np.concatenate([parameters(part) for part in parts])


def test_td_targets_of_a_three_step_episode_by_hand(torch):
    td3 = TD3(1, 1, TD3Options(discount=0.9, actor_widths=(), critic_widths=(), smoothing=0.1, smoothing_limit=0.15))
    with torch.no_grad():
        td3.target_actor.body[0].weight.fill_(0.5)  # the action is tanh(q / 2)
        td3.target_critic.first[0].weight.copy_(torch.tensor([[2.0, 3.0]]))
        td3.target_critic.first[0].bias.fill_(1.0)  # Q1 = 2 q + 3 a + 1
        td3.target_critic.second[0].weight.copy_(torch.tensor([[1.0, -1.0]]))
        td3.target_critic.second[0].bias.fill_(4.0)  # Q2 = q - a + 4
    # states 2 -> 1 -> 3 -> -8 (the end); the noise is -1, +2 (limited to 1.5 by 0.15 / 0.1), and of no matter at the end
    following = torch.tensor([[1.0], [3.0], [-8.0]])
    got = td3.targets(
        torch.tensor([-1.0, 0.5, 2.0]), following, torch.tensor([0.0, 0.0, 1.0]), torch.tensor([[-1.0], [2.0], [0.3]])
    )
    a1 = math.tanh(0.5) - 0.1
    a2 = 1.0  # tanh(1.5) + 0.15 = 1.055, cut to 1
    assert 2 * 1 + 3 * a1 + 1 < 1 - a1 + 4 and 3 - a2 + 4 < 2 * 3 + 3 * a2 + 1  # the smaller one is Q1, then Q2
    want = [-1 + 0.9 * (3 + 3 * a1), 0.5 + 0.9 * 6.0, 2.0]
    np.testing.assert_allclose(got.numpy(), want, rtol=1e-6)


def test_the_return_of_an_episode_is_the_targets_fixed_point(torch):
    # rewards 1, 2, 3 and discount 0.5: values 1 + (2 + 3 / 2) / 2 = 2.75, 3.5, 3
    td3 = TD3(3, 1, TD3Options(discount=0.5, smoothing=0.0, target_rate=0.05, learning_rate=1e-2, **SMALL))
    here, ahead = np.eye(3, dtype=np.float32), np.eye(3, dtype=np.float32)[[1, 2, 0]]
    episode = (here, np.zeros((3, 1), np.float32), np.float32([1, 2, 3]), ahead, np.float32([0, 0, 1]))
    generator = torch.Generator().manual_seed(0)
    for _ in range(400):
        td3.update(episode, generator, actor_waits=True)
    with torch.no_grad():
        values = td3.critic(torch.tensor(here), torch.zeros(3, 1))[0]
    np.testing.assert_allclose(values.numpy(), [2.75, 3.5, 3.0], atol=0.02)


def test_hard_targets_are_copies_every_one_over_eta_updates(torch):
    td3 = agent(torch, targets="hard", target_rate=0.1)
    generator = torch.Generator().manual_seed(0)
    old = parameters(td3.target_critic)
    for i, batch in enumerate(batches(25), start=1):
        td3.update(batch, generator)
        if i % 10 == 0:
            old = parameters(td3.critic)
            np.testing.assert_array_equal(parameters(td3.target_actor), parameters(td3.actor))
        else:
            assert not np.array_equal(parameters(td3.critic), old)
        np.testing.assert_array_equal(parameters(td3.target_critic), old)


def test_soft_targets_follow_polyak(torch):
    eta = 0.3
    td3 = agent(torch, targets="soft", target_rate=eta)
    generator = torch.Generator().manual_seed(0)
    for batch in batches(6):
        before = [parameters(m) for m in (td3.target_actor, td3.target_critic)]
        td3.update(batch, generator)
        for old, online, target in zip(
            before, (td3.actor, td3.critic), (td3.target_actor, td3.target_critic), strict=True
        ):
            want = (1 - eta) * old + eta * parameters(online)
            np.testing.assert_allclose(parameters(target), want, rtol=0, atol=1e-6)


def test_the_actor_moves_every_second_update_and_not_while_it_waits(torch):
    td3 = agent(torch)
    generator = torch.Generator().manual_seed(0)
    moved = []
    for i, batch in enumerate(batches(8)):
        before = parameters(td3.actor)
        report = td3.update(batch, generator, actor_waits=i < 4)
        moved.append(not np.array_equal(before, parameters(td3.actor)))
        assert math.isfinite(report.actor_value) == moved[-1] and report.critic_loss > 0
    assert moved == [False] * 4 + [False, True] * 2


def test_target_lag_is_the_rms_difference(torch):
    td3 = agent(torch)
    with torch.no_grad():
        for p in td3.target_actor.parameters():
            p += 0.25
    assert td3.target_lag() == pytest.approx(0.25, rel=1e-5)


def test_same_seed_same_weights_other_seed_others(torch):
    ends = []
    for seed in (1, 1, 2):
        td3 = agent(torch, seed)
        generator = torch.Generator().manual_seed(seed)
        for batch in batches(20):
            td3.update(batch, generator)
        ends.append(weights(td3))
    np.testing.assert_array_equal(ends[0], ends[1])
    assert not np.array_equal(ends[0], ends[2])


@pytest.mark.parametrize("targets", ["soft", "hard"])
def test_a_resumed_run_goes_on_bit_for_bit(torch, targets, tmp_path):
    whole, generator = agent(torch, targets=targets, target_rate=0.1), torch.Generator().manual_seed(5)
    data = batches(27)
    whole.normalise_by(data[0][0])
    for batch in data[:13]:
        whole.update(batch, generator)
    torch.save({"agent": whole.state(), "generator": generator.get_state()}, tmp_path / "checkpoint.pt")
    for batch in data[13:]:
        whole.update(batch, generator)
    resumed, again = agent(torch, seed=99, targets=targets, target_rate=0.1), torch.Generator()
    saved = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    resumed.restore(saved["agent"])
    again.set_state(saved["generator"])
    for batch in data[13:]:
        resumed.update(batch, again)
    np.testing.assert_array_equal(weights(resumed), weights(whole))
    assert resumed.n_updates == whole.n_updates == 27
    np.testing.assert_array_equal(resumed.actor.mean.numpy(), whole.actor.mean.numpy())


def Room(n_observed: int, n_actions: int):
    """A Gymnasium environment in which nothing happens."""
    gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is an extra: pip install binocal[train]")

    class Empty(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-5, 5, (n_observed,), dtype=np.float32)
        action_space = gymnasium.spaces.Box(-1, 1, (n_actions,), dtype=np.float32)

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            return np.zeros(n_observed, np.float32), {}

    return Empty()


def calibration_batches(n: int) -> list[tuple[np.ndarray, ...]]:
    """Transitions of 32 calibrations under random actions; observations are cut where our networks cut them."""
    gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is an extra: pip install binocal[train]")
    envs = gymnasium.make_vec(
        "binocal:binocal/StereoExtrinsics-v0", num_envs=32, pool_size=12, autoreset_mode="SameStep"
    )
    rng, out, (seen, _) = np.random.default_rng(0), [], envs.reset(seed=0)
    for _ in range(n):
        action = rng.uniform(-1, 1, (32, 6)).astype(np.float32)
        following, reward, is_terminal, _, info = envs.step(action)
        last = following.copy()
        for i in np.flatnonzero(info.get("_final_obs", np.zeros(32, dtype=bool))):
            last[i] = info["final_obs"][i]
        out.append((seen.clip(-5, 5), action, np.float32(reward), last.clip(-5, 5), np.float32(is_terminal)))
        seen = following
    return out


@pytest.mark.parametrize("source", ["random numbers", "the calibration environment"])
def test_updates_equal_those_of_stable_baselines3(torch, source):
    """The same networks, batches and no smoothing noise: 20 updates of both end in the same weights."""
    sb3 = pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is the reference that is compared with")
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.type_aliases import ReplayBufferSamples

    eta, rate = 0.05, 1e-2
    data = batches(20) if source == "random numbers" else calibration_batches(20)
    n_observed, n_actions = data[0][0].shape[1], data[0][1].shape[1]
    torch.manual_seed(0)
    # one actor step per critic step: with more, Stable-Baselines3 lets the targets wait for the actor, ours do not
    ours = TD3(
        n_observed, n_actions,
        TD3Options(policy_delay=1, smoothing=0.0, target_rate=eta, learning_rate=rate, **SMALL),
    )  # fmt: skip
    theirs = sb3.TD3(
        "MlpPolicy", Room(n_observed, n_actions), gamma=ours.options.discount, tau=eta, learning_rate=rate, policy_delay=1,
        target_policy_noise=0.0, policy_kwargs={"net_arch": [16]}, device="cpu",
    )  # fmt: skip
    theirs.set_logger(configure(None, []))
    for actor in (theirs.actor, theirs.actor_target):
        actor.mu.load_state_dict(ours.actor.body.state_dict())
    for critic in (theirs.critic, theirs.critic_target):
        critic.qf0.load_state_dict(ours.critic.first.state_dict())
        critic.qf1.load_state_dict(ours.critic.second.state_dict())
    begin, generator = weights(ours), torch.Generator()
    for batch in data:
        observation, action, reward, following, is_terminal = (torch.as_tensor(a) for a in batch)
        sample = ReplayBufferSamples(observation, action, following, is_terminal[:, None], reward[:, None])
        theirs.replay_buffer.sample = lambda *_, sample=sample, **__: sample
        theirs.train(1, batch_size=32)
        ours.update(batch, generator)
    got = np.concatenate(
        [parameters(m) for m in (theirs.actor, theirs.critic, theirs.actor_target, theirs.critic_target)]
    )
    assert np.abs(weights(ours) - begin).max() > 0.05
    np.testing.assert_allclose(weights(ours), got, atol=1e-5)  # measured 3e-7


# --- a toy: drive a point in the plane to the origin ---

TOY_STEPS = 10
IDLE_RETURN, BEST_RETURN = -6.67, -0.083  # doing nothing: -10 E|q|²; going straight to it: -2 E[max(|q| - 0.5, 0)²]


class Toy:
    """Points in the plane; an action moves each by half of it, the reward is minus the squared distance to the origin."""

    def __init__(self, n: int, seed: int) -> None:
        self.n, self.rng = n, np.random.default_rng(seed)

    def start(self) -> np.ndarray:
        return self.rng.uniform(-1, 1, (self.n, 2))

    @staticmethod
    def move(q: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        after = np.clip(q + 0.5 * a, -2, 2)
        return after, -np.sum(after**2, axis=1)


def train_on_toy(torch, options: TD3Options, seed: int, n_updates: int = 2000) -> float:
    """Mean return of the trained actor over 500 starts. Episodes are cut after ten steps, never terminated."""
    torch.manual_seed(seed)
    td3, generator = TD3(2, 2, options), torch.Generator().manual_seed(seed)
    toy, buffer = Toy(16, seed), ReplayBuffer(20_000, 2, 2)
    q, step = toy.start(), 0
    for update in range(n_updates):
        with torch.no_grad():
            a = td3.actor(torch.as_tensor(q, dtype=torch.float32)).numpy() + 0.3 * toy.rng.standard_normal((16, 2))
        a = np.clip(a, -1, 1) if update > 50 else toy.rng.uniform(-1, 1, (16, 2))
        after, reward = toy.move(q, a)
        buffer.add(q, a, reward, after, np.zeros(16, dtype=bool))
        q, step = after, step + 1
        if step == TOY_STEPS:
            q, step = toy.start(), 0
        td3.update(buffer.sample(128, toy.rng), generator)
    toy = Toy(500, 1000)
    q, total = toy.start(), 0.0
    for _ in range(TOY_STEPS):
        with torch.no_grad():
            q, reward = toy.move(q, td3.actor(torch.as_tensor(q, dtype=torch.float32)).numpy())
        total += reward.mean()
    return total


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("targets", ["soft", "hard"])
def test_the_toy_is_solved(torch, targets, seed):
    options = TD3Options(discount=0.9, targets=targets, target_rate=0.02, actor_widths=(32, 32), critic_widths=(32, 32))
    reached = train_on_toy(torch, options, seed)
    assert reached > -0.6, f"return {reached:.3f}; idle {IDLE_RETURN}, best {BEST_RETURN}"  # six seeds: -0.10 to -0.44
