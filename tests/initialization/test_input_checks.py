"""Sets from which no focal length follows, through a telephoto lens: the advice is not what the set already has."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.cameras import Camera
from binocal.errors import DegenerateGeometryError
from binocal.evidence import Detections
from binocal.findings import findings_of
from binocal.geometry import so3
from binocal.initialization.diagnosis import diagnose_views

POINTS = parse_board("chessboard:9x6:30mm").object_points_m
SIZE_WH = (640, 480)


def seen(widths: float, tilt_deg: float, noise_px: float, aside: float = 0.1) -> Detections:
    """Two converging cameras of so many image widths' focal length before a board that fills half of the image."""
    focal_px, rng = 640.0 * widths, np.random.default_rng(1)
    camera = Camera("brown4", SIZE_WH, np.r_[focal_px, focal_px, 320, 240, np.zeros(5)])
    distance, baseline = 0.27 * focal_px / 300, np.array([-0.2, 0.0, 0.0])
    sides: list[list[np.ndarray]] = [[], []]
    for _ in range(12):
        R = so3.exp(np.radians(rng.uniform(-tilt_deg, tilt_deg, 3)))
        X = (POINTS - POINTS.mean(axis=0)) @ R.T + distance * np.array([*rng.uniform(-aside, aside, 2) / widths, 1.0])
        sides[0].append(camera.project(X))
        sides[1].append(camera.project((X + baseline) @ so3.exp(np.array([0, 0.2 / distance, 0])).T))
    left, right = (np.array(side) + rng.normal(0, noise_px, (12, len(POINTS), 2)) for side in sides)
    return Detections.from_arrays(POINTS, left, right, SIZE_WH)


@pytest.mark.parametrize("widths", [100, 1000])
def test_tilted_boards_without_perspective_are_not_to_be_tilted(widths):
    with pytest.raises(DegenerateGeometryError, match="no perspective") as caught:
        diagnose_views(seen(widths, 35, 0.1), "brown4")
    (found,) = findings_of(caught.value)
    assert found.code == "no-perspective" and 15 < found.figures["tilt_deg"] < 40 and "tilt" not in found.remedy


@pytest.mark.parametrize(("widths", "tilt_deg"), [(100, 1), (1, 0.01)])
def test_boards_that_are_not_tilted_still_are(widths, tilt_deg):
    with pytest.raises(DegenerateGeometryError, match="tilt the board"):
        diagnose_views(seen(widths, tilt_deg, 0.1), "brown4")


def test_tilted_boards_with_perspective_pass():
    assert diagnose_views(seen(3, 35, 0.05), "brown4").is_used.all()
