from __future__ import annotations

import numpy as np
import pytest

from binocal import detect
from binocal.detection import strengthen_edges


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_edges_become_steeper_and_the_depth_stays(dtype):
    step = np.zeros((40, 40), dtype)
    step[:, 20:] = np.iinfo(dtype).max // 2
    soft = ((step.astype(float) + np.roll(step, 1, axis=1) + np.roll(step, 2, axis=1)) / 3).astype(dtype)
    strong = strengthen_edges(soft)
    assert strong.dtype == dtype and strong.shape == soft.shape
    assert np.diff(strong[20, 10:30].astype(float)).max() > np.diff(soft[20, 10:30].astype(float)).max()


def test_corners_do_not_move(shoot):
    shot = shoot("chessboard:9x6:30mm")
    plain, prepared = detect(shot.image, shot.board), detect(strengthen_edges(shot.image), shot.board)
    shift = prepared.points_px - plain.points_px
    assert np.abs(shift.mean(axis=0)).max() < 0.01 and np.sqrt(np.mean(shift**2)) < 0.03  # measured 0.002, 0.01 px


def test_other_depths_are_the_callers_mistake():
    with pytest.raises(ValueError, match="uint8 or uint16"):
        strengthen_edges(np.zeros((9, 9)))
