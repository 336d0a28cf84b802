from __future__ import annotations

import math
import os

import numpy as np
import pytest

import binocal
from binocal import threads
from binocal.boards import parse_board
from binocal.cli import main
from binocal.detection import pairs
from binocal.kernels import arrays
from binocal.simulation import RenderOptions, sample_scene, table2_rig
from binocal.simulation import pairs as rendering


@pytest.fixture(autouse=True)
def default_again():
    yield
    threads.set_threads(None)


def test_the_default_is_what_the_process_may_use(monkeypatch):
    monkeypatch.delenv(threads.VARIABLE, raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 3, 5, 7}, raising=False)
    monkeypatch.setattr(threads, "_cgroup_limit", lambda: math.inf)
    threads.set_threads(None)
    assert threads.n_threads() == 4
    monkeypatch.setattr(threads, "_cgroup_limit", lambda: 2.5)
    assert threads.n_threads() == 4  # the number does not change under a running process
    threads.set_threads(None)
    assert threads.n_threads() == 3
    monkeypatch.setattr(threads, "_cgroup_limit", lambda: 0.2)
    threads.set_threads(None)
    assert threads.n_threads() == 1


@pytest.mark.parametrize(
    ("own", "files", "limit"),
    [
        ("0::/\n", {"cpu.max": "max 100000"}, math.inf),
        ("0::/app\n", {"app/cpu.max": "150000 100000\n"}, 1.5),
        ("0::/outer/app\n", {"outer/cpu.max": "200000 100000", "outer/app/cpu.max": "max 100000"}, 2.0),
        ("0::/../../app\n", {"app/cpu.max": "50000 100000"}, 0.5),
        ("4:memory:/a\n3:cpu,cpuacct:/a\n", {"cpu,cpuacct/a/cpu.cfs_quota_us": "300000", "cpu,cpuacct/a/cpu.cfs_period_us": "100000"}, 3.0),
        ("3:cpu:/\n", {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, math.inf),
        ("nonsense", {}, math.inf),
    ],
)  # fmt: skip
def test_a_control_group_limits_the_processors(monkeypatch, tmp_path, own, files, limit):
    (tmp_path / "cgroup").write_text(own)
    for name, text in files.items():
        path = tmp_path / "fs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setattr(threads, "_OWN_CGROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(threads, "_CGROUPS", tmp_path / "fs")
    assert threads._cgroup_limit() == limit


def test_a_system_without_control_groups_has_no_limit(monkeypatch, tmp_path):
    monkeypatch.setattr(threads, "_OWN_CGROUPS", tmp_path / "nothing")
    assert threads._cgroup_limit() == math.inf


def test_the_environment_sets_the_default(monkeypatch):
    monkeypatch.setenv(threads.VARIABLE, " 3 ")
    threads.set_threads(None)
    assert threads.n_threads() == 3
    binocal.set_threads(5)
    assert threads.n_threads() == 5


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("text", ["0", "-2", "many", "1.5"])
def test_a_wrong_number_is_named(monkeypatch, text):
    with pytest.raises(ValueError, match="number of threads must be a whole number"):
        binocal.set_threads(text)
    monkeypatch.setenv(threads.VARIABLE, text)
    threads.set_threads(None)
    with pytest.raises(ValueError, match=f"BINOCAL_THREADS must be a whole number between 1 and 4096; got '{text}'"):
        threads.n_threads()


def test_kernels_images_and_rendering_use_that_number(monkeypatch):
    asked = []

    class Pool(rendering.ThreadPoolExecutor):
        def __init__(self, n):
            asked.append(n)
            super().__init__(n)

    monkeypatch.setattr(rendering, "ThreadPoolExecutor", Pool)
    monkeypatch.setattr(pairs, "ThreadPoolExecutor", Pool)
    binocal.set_threads(3)
    assert arrays.threads_for(10**9) == 3
    scene = sample_scene(table2_rig(), parse_board("chessboard:7x5:32mm"), 1, np.random.default_rng(0))
    assert len(list(rendering.render_pairs(scene, RenderOptions(), np.random.SeedSequence(0)))) == 2
    pairs.look_at_all([], lambda path: path, None, None, None)
    assert asked == [3, 3]


def test_the_command_line_sets_it_and_names_a_wrong_one(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    simulate = ["simulate", "--board", "chessboard:7x5:32mm", "--pairs", "1", "--output", "out"]
    assert main([*simulate, "--threads", "3"]) == 0 and threads.n_threads() == 3
    assert main([*simulate, "--threads", "0", "--force"]) == 2
    threads.set_threads(None)
    monkeypatch.setenv(threads.VARIABLE, "all")
    assert main([*simulate, "--force"]) == 2
    assert "BINOCAL_THREADS must be a whole number between 1 and 4096; got 'all'" in capsys.readouterr().err
