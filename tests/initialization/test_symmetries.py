from __future__ import annotations

import numpy as np
import pytest
from simulated_rigs import grid

from binocal.boards import parse_board
from binocal.initialization.symmetries import board_symmetries, transposed_order


@pytest.mark.parametrize(
    ("spec", "count"),
    [
        ("chessboard:11x8:20mm", 4),
        ("chessboard:7x7:20mm", 8),
        ("circles:10x6:30mm", 4),
        ("acircles:4x11:20mm", 2),
        ("squares:4x3:30mm:20mm", 4),
        ("squares:4x4:30mm:20mm", 8),
        ("charuco:11x8:30mm:22mm:DICT_5X5_50", 4),
        ("aprilgrid:6x6:88mm:0.3", 8),
    ],
)
def test_symmetries_map_the_board_onto_itself(spec: str, count: int) -> None:
    points = parse_board(spec).object_points_m
    symmetries = board_symmetries(points)
    assert len(symmetries.names) == count
    assert symmetries.order[0].tolist() == list(range(len(points)))
    for k in range(count):
        np.testing.assert_allclose(symmetries.motions[k].apply(points), points[symmetries.order[k]], atol=1e-9)
        back = symmetries.inverse_of(k)
        np.testing.assert_array_equal(symmetries.order[k][symmetries.order[back]], np.arange(len(points)))


def test_an_irregular_board_has_no_symmetry() -> None:
    points = np.c_[np.random.default_rng(0).uniform(0, 1, (12, 2)), np.zeros(12)]
    assert board_symmetries(points).names == ("",)


def test_transposed_order_reads_column_by_column() -> None:
    points = grid(4, 3, 1.0)
    order = transposed_order(points)
    assert points[order][:4, :2].tolist() == [[0, 0], [0, 1], [0, 2], [1, 0]]
    assert transposed_order(parse_board("acircles:4x11:20mm").object_points_m) is None
