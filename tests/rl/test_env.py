"""The Gymnasium faces: both checkers, seeding, endings, autoreset, and that the vector form is the single one n times."""

from __future__ import annotations

import copy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="Gymnasium is an extra: pip install binocal[train]")

import gymnasium
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from binocal.rl.agent_kind import AgentKind
from binocal.rl.env import EnvOptions, StereoExtrinsicsEnv, StereoExtrinsicsVectorEnv
from binocal.rl.registration import ENV_ID, MAX_STEPS, register_if_loaded
from binocal.rl.task import observation_names

pytestmark = pytest.mark.usefixtures("many_calls")

FEW = {"pool_size": 12}


def make(**options):
    return gymnasium.make(ENV_ID, **{**FEW, **options})


def make_vec(num_envs: int = 6, **options):
    return gymnasium.make_vec(ENV_ID, num_envs=num_envs, **{**FEW, **options})


@pytest.mark.parametrize(
    ("rig_set", "kind"),
    [
        *((rig_set, kind) for rig_set in ("standard", "stress") for kind in (AgentKind.DRL, AgentKind.DRL_INCREMENTS)),
        ("drift_hard", AgentKind.DRL_STREETS),
    ],
)
def test_gymnasium_finds_nothing_to_warn_of(rig_set, kind):
    check_env(make(rig_set=rig_set, kind=kind).unwrapped)


@pytest.mark.parametrize("kind", [AgentKind.DRL, AgentKind.DRL_INCREMENTS])
def test_stable_baselines3_finds_nothing_to_warn_of(kind):
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="its checker is what is asked")
    checker.check_env(make(kind=kind), warn=True)


@pytest.mark.parametrize(
    "code",
    [
        "import gymnasium, binocal; gymnasium.make('binocal/StereoExtrinsics-v0')",
        "import gymnasium; gymnasium.make('binocal:binocal/StereoExtrinsics-v0')",
        "import binocal, gymnasium; gymnasium.make('binocal:binocal/StereoExtrinsics-v0')",
        "import binocal.rl.task, gymnasium; gymnasium.make_vec('binocal:binocal/StereoExtrinsics-v0')",
        "import sys; before = list(sys.meta_path); import binocal; assert sys.meta_path == before and "
        "'gymnasium' not in sys.modules",
    ],
)
def test_a_fresh_process_knows_the_environment(code):
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_registering_again_changes_nothing(recwarn):
    before = gymnasium.spec(ENV_ID)
    register_if_loaded()
    assert gymnasium.spec(ENV_ID) is before and before.max_episode_steps == MAX_STEPS and not recwarn.list


def test_spaces_are_named_and_finite():
    env = make().unwrapped
    assert env.observation_names == observation_names(AgentKind.DRL)
    assert env.observation_space.shape == (len(env.observation_names),) and env.action_space.shape == (6,)
    assert env.observation_space.is_bounded() and env.observation_space.dtype == env.action_space.dtype == np.float32


def test_episodes_on_streets_end_after_twelve_steps_alone_and_together():
    options = {"kind": "drl-streets", "rig_set": "drift_easy"}
    env, envs = make(**options), make_vec(3, **options)
    (seen, _), (all_seen, _) = env.reset(seed=5), envs.reset(seed=5)
    rng = np.random.default_rng(0)
    for step in range(12):
        np.testing.assert_allclose(seen, all_seen[0], atol=1e-4)
        actions = rng.uniform(-1, 1, (3, 2)).astype(np.float32)
        seen, reward, is_terminal, *_ = env.step(actions[0])
        all_seen, rewards, *_ = envs.step(actions)
        assert reward == pytest.approx(rewards[0], abs=1e-4) and is_terminal == (step == 11)
    with pytest.raises(ValueError, match="drift_hard"):
        make(kind="drl-streets", rig_set="stress")


def test_observations_stay_in_their_space_whatever_is_done():
    envs = make_vec(12, rig_set="stress")
    rng, (seen, _) = np.random.default_rng(0), envs.reset(seed=0)
    for _ in range(30):
        assert envs.observation_space.contains(seen)
        seen = envs.step(np.sign(rng.standard_normal((12, 6))).astype(np.float32))[0]


def episode(env, seed: int, n: int = 8) -> list:
    rng = np.random.default_rng(0)
    seen, info = env.reset(seed=seed)
    out = [(seen, 0.0, False, False, info)]
    for _ in range(n):
        out.append(env.step(rng.uniform(-0.3, 0.3, 6).astype(np.float32)))
        if out[-1][2] or out[-1][3]:
            break
    return out


def test_same_seed_same_episode_other_seed_another():
    one, same, other = episode(make(), 3), episode(make(), 3), episode(make(), 4)
    assert len(one) == len(same) > 2
    for a, b in zip(one, same, strict=True):
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1:] == b[1:]
    assert not np.array_equal(one[0][0], other[0][0])
    assert not np.array_equal(one[0][0], episode(make(pool_seed=1), 3)[0][0])  # the same draws, other rigs


def test_a_step_alters_no_state_and_no_observation_given_out():
    env = make().unwrapped
    seen, _ = env.reset(seed=0)
    before = env._batch
    kept = copy.deepcopy(
        (seen, before.state.loop.estimate.T_right_left.R, before.sigma, before.rigs.problem.cameras[0].pixels)
    )
    env.step(np.full(6, 0.5, dtype=np.float32))
    assert env._batch is not before
    now = (seen, before.state.loop.estimate.T_right_left.R, before.sigma, before.rigs.problem.cameras[0].pixels)
    for a, b in zip(now, kept, strict=True):
        np.testing.assert_array_equal(a, b)


def test_arrival_terminates_and_time_truncates():
    env, n_arrived = make(), 0
    for seed in range(12):
        env.reset(seed=seed)
        for step in range(1, MAX_STEPS + 1):
            _, reward, is_terminal, is_truncated, info = env.step(np.zeros(6, dtype=np.float32))
            assert info["n_steps"] == step and is_terminal == (info["distance_sigma"] < 0.1)
            assert isinstance(info["is_kept"], bool) and np.isfinite(reward)
            if is_terminal:
                n_arrived += 1
                break
            assert is_truncated == (step == MAX_STEPS)
    assert n_arrived >= 6  # plain Gauss-Newton fails on some
    # a damping of 10 moves too slowly to arrive within 3 steps
    env = make(max_episode_steps=3)
    env.reset(seed=0)
    ends = [env.step(np.float32([1, 0, 0, 0, 0, 1]))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


@pytest.mark.parametrize("mode", ["NextStep", pytest.param("SameStep", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", [AgentKind.DRL, AgentKind.DRL_INCREMENTS])
def test_the_vector_form_is_the_single_form_n_times(mode, kind):
    options = {"kind": kind, "max_episode_steps": 5, **FEW}
    ours = make_vec(autoreset_mode=mode, **options)
    plain = gymnasium.make_vec(
        ENV_ID, num_envs=6, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **options
    )
    assert ours.metadata["autoreset_mode"] is plain.metadata["autoreset_mode"] is AutoresetMode(mode)
    assert ours.single_observation_space == plain.single_observation_space
    assert ours.observation_space == plain.observation_space and ours.action_space == plain.action_space
    rng = np.random.default_rng(0)
    got = ours.reset(seed=11)
    assert_alike(got, plain.reset(seed=11))
    n_ended = np.zeros(2, dtype=int)
    for _ in range(40):
        # random increments come nowhere near, so these follow the Newton step, which is what the last six numbers tell
        action = rng.uniform(-0.2, 0.2, (6, 6)) if kind == AgentKind.DRL else got[0][:, -6:] / 1.5
        got, want = ours.step(np.float32(action)), plain.step(np.float32(action))
        # an arrival at the last step is no truncation; Gymnasium's TimeLimit says both
        assert_alike(got, (*want[:3], want[3] & ~want[2], want[4]))
        n_ended += got[2].sum(), got[3].sum()
    assert n_ended[0] > 3 and n_ended[1] > 0, n_ended  # both endings were seen
    assert_alike(ours.reset(seed=[5, None, 5, 6, 7, 8])[:1], plain.reset(seed=[5, None, 5, 6, 7, 8])[:1])


def assert_alike(got, want):
    """Equal values, types, shapes and keys; dictionaries and object arrays are gone into."""
    assert type(got) is type(want)
    if isinstance(got, dict):
        assert got.keys() == want.keys()
        for key in got:
            assert_alike(got[key], want[key])
    elif isinstance(got, tuple) or (isinstance(got, np.ndarray) and got.dtype == object):
        for a, b in zip(got, want, strict=True):
            assert_alike(a, b)
    elif got is not None:
        assert np.asarray(got).dtype == np.asarray(want).dtype and np.shape(got) == np.shape(want)
        np.testing.assert_allclose(got, want, rtol=1e-6, atol=1e-6)


def test_a_batch_begins_anew_with_the_same_seed():
    envs = make_vec()
    first, info = envs.reset(seed=1)
    again, next_info = envs.reset()
    assert not np.array_equal(first, again)
    np.testing.assert_array_equal(envs.reset(seed=1)[0], first)
    assert info["_rig"].all() and next_info["rig"].shape == (6,)


def test_what_a_step_gives_out_is_not_written_to_later():
    envs = make_vec(autoreset_mode="SameStep", max_episode_steps=2)
    envs.reset(seed=0)
    out = [envs.step(np.zeros((6, 6), np.float32)) for _ in range(2)]
    kept = copy.deepcopy(out)
    for _ in range(3):
        envs.step(np.ones((6, 6), np.float32))
    for a, b in zip(out, kept, strict=True):
        assert_alike(a, b)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rig_set": "hard"}, "rig_set must be one of standard"),
        ({"kind": "guess"}, "kind must be drl or drl-increments"),
        ({"pool_size": 0}, "pool_size must be 1 or more"),
        ({"tolerance_sigma": 0.0}, "tolerance_sigma must be above 0"),
    ],
)
def test_wrong_options_are_named(options, message):
    for form in (StereoExtrinsicsEnv, StereoExtrinsicsVectorEnv):
        with pytest.raises(ValueError, match=message):
            form(**options)


def test_wrong_use_is_named():
    with pytest.raises(ValueError, match="before reset"):
        StereoExtrinsicsEnv(**FEW).step(np.zeros(6))
    with pytest.raises(ValueError, match="before reset"):
        StereoExtrinsicsVectorEnv(2, **FEW).step(np.zeros((2, 6)))
    with pytest.raises(ValueError, match="Disabled"):
        StereoExtrinsicsVectorEnv(2, autoreset_mode="Disabled", **FEW)
    with pytest.raises(ValueError, match="one entry for each of 2"):
        StereoExtrinsicsVectorEnv(2, **FEW).reset(seed=[1])


def test_stress_is_evaluated_at_its_own_tolerance():
    assert EnvOptions().arrival_sigma == 0.1 and EnvOptions("stress").arrival_sigma == 0.3
    assert EnvOptions("stress", tolerance_sigma=0.2).arrival_sigma == 0.2


@pytest.mark.slow
def test_the_example_runs(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the example is for Stable-Baselines3")
    example = Path(__file__).parents[2] / "examples" / "train_with_stable_baselines3.py"
    done = subprocess.run(
        [sys.executable, "-W", "error", str(example), "150"], capture_output=True, text=True, timeout=600, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    before, after = done.stdout.splitlines()
    assert before.startswith("before: ") and after.startswith("after: ") and after.endswith("steps each")
