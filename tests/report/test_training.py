"""The training figure: a valid SVG with four named panels; a band for several seeds, a line for one."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest

from rl.training_runs import made_up_run

pytest.importorskip("matplotlib", reason="Matplotlib is an extra: pip install binocal[report]")

from binocal.report.training import draw_training

SVG = "{http://www.w3.org/2000/svg}"


def drawn(histories, path) -> tuple[str, set[str]]:
    """All text of the figure, and the ids of its bands."""
    draw_training(histories, path)
    root = ElementTree.parse(path).getroot()
    assert root.tag == f"{SVG}svg"
    text = "\n".join("".join(element.itertext()) for element in root.iter(f"{SVG}text"))
    return text, {e.get("id") for e in root.iter() if (e.get("id") or "").startswith("band-")}


def test_panels_are_named_and_bear_units(tmp_path):
    text, _ = drawn([made_up_run(0)], tmp_path / "training.svg")
    for title in ("Critic loss", "Critic against Monte-Carlo returns", "Target lag", "Held-out rigs"):
        assert title in text
    for unit in ("(reward²)", "(reward)", "(%)", "iteration (gradient update)", "RMS parameter difference"):
        assert unit in text
    assert f"converged at {made_up_run(0).converged_step}" in text


def test_three_seeds_make_a_band_one_seed_a_line(tmp_path):
    text, bands = drawn([made_up_run(seed) for seed in range(3)], tmp_path / "three.svg")
    assert bands == {f"band-soft-{panel}" for panel in ("critic-loss", "target-lag", "held-out-rigs", "iterations")}
    assert "soft targets, 3 seeds: median, min to max" in text
    text, bands = drawn([made_up_run(7)], tmp_path / "one.svg")
    assert not bands and "soft targets, seed 7" in text
    text, _ = drawn([made_up_run(7), made_up_run(7)], tmp_path / "twice.svg")
    assert "soft targets, 2 runs: median, min to max" in text


def test_hard_and_soft_stand_side_by_side(tmp_path):
    runs = [made_up_run(seed, kind) for kind in ("hard", "soft") for seed in range(3)]
    text, bands = drawn(runs, tmp_path / "both.svg")
    assert len(bands) == 8 and "hard: converged at" in text and "soft: converged at" in text


def test_the_same_runs_give_the_same_file(tmp_path):
    for name in ("a.svg", "b.svg"):
        draw_training([made_up_run(seed) for seed in range(3)], tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.svg", "b.svg"]


def test_runs_of_other_lengths_are_drawn_as_far_as_all_go(tmp_path):
    _, bands = drawn([made_up_run(0), made_up_run(1, n=600)], tmp_path / "uneven.svg")
    assert len(bands) == 4


def test_what_was_not_measured_is_left_out(tmp_path):
    run, none = made_up_run(0), np.zeros(0)
    bare = replace(
        run, target_lag=np.full(len(run.step), np.nan), value_predicted=none, value_monte_carlo=none,
        held_out_step=none.astype(int), held_out_success=none, held_out_iterations=none,
    )  # fmt: skip
    text, _ = drawn([bare], tmp_path / "bare.svg")
    assert "Target lag" in text


def test_nothing_to_draw_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="at least one"):
        draw_training([], tmp_path / "none.svg")
