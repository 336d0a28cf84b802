"""Batches in dataclasses: what is mapped, what is shared, and that rigs come out as they went in."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy import ndarray

from binocal.geometry import SE3
from binocal.solvers.arrays import SHARED, choose_rigs, join_rigs, replace_rigs, stack_rigs, take_rigs


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    values: ndarray
    weights: ndarray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Whole:
    points: ndarray = field(metadata=SHARED)
    parts: tuple[Part, ...]
    pose: SE3
    name: str = "x"


POINTS = np.arange(3.0)


def whole(first, n=3):
    rng = np.random.default_rng(first)
    pose = SE3.exp(rng.standard_normal((n, 6)))
    return Whole(
        POINTS, (Part(first + np.arange(n), rng.standard_normal((n, 2))), Part(first * np.ones((n, 2, 2)))), pose
    )


def check(value, expected_rows):
    """Every array of ``value`` has the rows (source, place)."""
    for get in (
        lambda w: w.parts[0].values,
        lambda w: w.parts[0].weights,
        lambda w: w.parts[1].values,
        lambda w: w.pose.R,
        lambda w: w.pose.t,
    ):
        assert np.array_equal(get(value), np.stack([get(source)[place] for source, place in expected_rows]))
    assert value.points is POINTS and value.name == "x" and value.parts[1].weights is None


def test_rigs_are_taken_chosen_joined_and_replaced_in_every_array():
    a, b = whole(10), whole(20)
    check(take_rigs(a, np.array([2, 0])), [(a, 2), (a, 0)])
    check(choose_rigs(np.array([True, False, True]), a, b), [(a, 0), (b, 1), (a, 2)])
    check(join_rigs([a, b]), [(a, 0), (a, 1), (a, 2), (b, 0), (b, 1), (b, 2)])
    check(replace_rigs(a, np.array([1]), take_rigs(b, np.array([2]))), [(a, 0), (b, 2), (a, 2)])
    check(a, [(a, 0), (a, 1), (a, 2)])  # and nothing is altered in place


def test_one_rig_and_a_stack_of_single_ones_are_inverse():
    a = whole(10)
    single = take_rigs(a, 1)
    assert single.parts[0].values.shape == () and isinstance(single.parts[0].values, ndarray)
    check(stack_rigs([take_rigs(a, i) for i in (0, 2)]), [(a, 0), (a, 2)])


def test_values_of_different_structure_are_refused():
    a = whole(10)
    with pytest.raises(ValueError, match="zip"):
        choose_rigs(np.ones(3, dtype=bool), a, Whole(POINTS, a.parts[:1], a.pose))
