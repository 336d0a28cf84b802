"""Policies without PyTorch: the same numbers as the network, files that are checked, controllers that guard."""

import os
from itertools import pairwise

import numpy as np
import pytest

from binocal.errors import FormatError
from binocal.rl.agent_kind import AgentKind
from binocal.rl.policy import ConstantController, LearnedController, Policy, load_policy, save_policy, shipped_policy
from binocal.rl.rig_batches import RIG_SETS, sample_rigs, sample_starts
from binocal.rl.task import KERNEL, observation_names
from binocal.rl.tasks import task_of
from binocal.solvers.loop import advance, begin


def make_policy(scale=0.3, kind=AgentKind.DRL, seed=0):
    rng = np.random.default_rng(seed)
    n = len(observation_names(kind))
    sizes = (n, 16, 6)
    layers = tuple(
        (
            np.float32(scale * rng.standard_normal((b, a))).astype(float),
            np.float32(rng.standard_normal(b)).astype(float),
        )
        for a, b in pairwise(sizes)
    )
    return Policy(kind, np.zeros(n), np.ones(n), layers, {"seed": seed})


@pytest.fixture(scope="module")
def case():
    rigs = sample_rigs(RIG_SETS["weak"], 3, np.random.default_rng(0))
    return rigs, sample_starts(rigs, np.random.default_rng(1))


def test_files_hold_the_policy_and_its_card(tmp_path):
    policy = make_policy()
    save_policy(policy, tmp_path / "p.safetensors")
    loaded = load_policy(tmp_path / "p.safetensors")
    seen = np.random.default_rng(2).standard_normal((5, len(policy.mean)))
    assert np.allclose(loaded(seen), policy(seen), atol=1e-6)
    assert loaded.card == {"seed": 0} and loaded.kind == AgentKind.DRL


def test_numpy_gives_what_the_network_gives():
    torch = pytest.importorskip("torch", reason="compares with the network")
    from binocal.rl.training.networks import Actor

    torch.manual_seed(0)
    actor = Actor(31, 6, (16, 8), (0.1, -0.2, 0.3, 0.0, 0.5, -0.6))
    actor.mean.copy_(torch.randn(31))
    actor.spread.copy_(torch.rand(31) + 0.5)
    arrays = {name: value.numpy().astype(float) for name, value in actor.state_dict().items()}
    layers = tuple((arrays[f"body.{i}.weight"], arrays[f"body.{i}.bias"]) for i in (0, 2, 4))
    policy = Policy(AgentKind.DRL, arrays["mean"], arrays["spread"], layers, {})
    seen = 10 * np.random.default_rng(3).standard_normal((7, 31))
    with torch.no_grad():
        expected = actor(torch.as_tensor(seen, dtype=torch.float32)).numpy()
    assert np.abs(policy(seen) - expected).max() < 1e-5


@pytest.mark.parametrize("damage", ["empty", "text", "foreign", "other observation"])
def test_a_wrong_file_is_named(tmp_path, damage):
    path = tmp_path / "w.safetensors"
    if damage == "empty":
        path.write_bytes(b"")
    elif damage == "text":
        path.write_text("not weights at all, just a line of text that is long enough")
    elif damage == "foreign":
        from safetensors.numpy import save_file

        save_file({"a": np.zeros(3)}, str(path))
    else:
        policy = make_policy()
        fewer = Policy(AgentKind.DRL, np.zeros(5), np.ones(5), ((np.zeros((6, 5)), np.zeros(6)),), policy.card)
        save_policy(fewer, path)
    with pytest.raises(FormatError, match=r"w\.safetensors"):
        load_policy(path)


@pytest.mark.parametrize("kind", list(AgentKind))
def test_shipped_weights_fit_and_are_small(kind):
    from importlib import resources

    policy = shipped_policy(kind)
    assert policy.kind == kind and len(policy.mean) == len(task_of(kind).observation_names)
    assert policy.card["command"].startswith("binocal train") and policy.card["seed"] >= 0
    folder = resources.files("binocal.rl") / "weights"
    assert sum(len(file.read_bytes()) for file in folder.iterdir() if file.name.endswith("safetensors")) < 200_000


def test_rejections_raise_the_damping_whatever_the_policy_says(case):
    rigs, start = case
    controller, state = LearnedController(make_policy()), begin(rigs.problem, start, KERNEL)
    memory = controller.start((3,))
    from dataclasses import replace

    damping = []
    for _ in range(3):
        state = replace(state, is_kept=np.array([False, False, True]))
        action, memory = controller.choose(rigs.problem, state, memory)
        damping.append(action.damping)
    damping = np.array(damping)
    assert np.all(damping[1:, :2] >= 30 * 1e-3 - 1e-12) and np.all(damping[2, :2] >= 0.9 - 1e-12)
    assert memory["n_rejected"].tolist() == [3, 3, 0]


def test_a_policy_that_is_not_finite_says_so_for_its_rigs_alone(case):
    rigs, start = case
    good = make_policy()
    broken = Policy(
        AgentKind.DRL, good.mean, good.spread, ((good.layers[0][0] * np.nan, good.layers[0][1]), good.layers[1]), {}
    )
    action, memory = LearnedController(broken).choose(
        rigs.problem, begin(rigs.problem, start, KERNEL), LearnedController(broken).start((3,))
    )
    assert np.isnan(action.damping).all() and np.all(memory["last_action"] == 0)


def test_a_constant_controller_looks_at_nothing(case):
    rigs, start = case
    constant = ConstantController(np.array([0.2, 0.0, 0.1, -0.1, 0.5, 0.3]))
    state = begin(rigs.problem, start, KERNEL)
    first, memory = constant.choose(rigs.problem, state, constant.start((3,)))
    second, _ = constant.choose(rigs.problem, advance(rigs.problem, state, first, KERNEL), memory)
    assert np.array_equal(first.scale_factor, second.scale_factor) and np.array_equal(first.stretch, second.stretch)
    assert np.array_equal(first.pose_damping, second.pose_damping)


@pytest.mark.parametrize("damage", ["empty", "no layers", "no card", "a card that is a list", "a scalar", "a pipe"])
def test_damaged_weights_are_named(tmp_path, damage):
    from safetensors.numpy import save

    path, policy = tmp_path / "w.safetensors", make_policy()
    arrays = {"mean": policy.mean, "spread": policy.spread}
    metadata = {"kind": str(policy.kind), "card": "{}"}
    match damage:
        case "no layers":
            path.write_bytes(save(arrays, metadata))
        case "no card":
            path.write_bytes(save(arrays))
        case "a card that is a list":
            path.write_bytes(save(arrays, metadata | {"card": "[" * 100_000}))
        case "a scalar":
            path.write_bytes(
                save(arrays | {"mean": np.array(1.0), "weight0": np.eye(2), "bias0": np.ones(2)}, metadata)
            )
        case "a pipe":
            os.mkfifo(path)
        case _:
            path.touch()
    with pytest.raises(FormatError, match=r"w\.safetensors") as caught:
        load_policy(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400
