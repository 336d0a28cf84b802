"""Segments of rendered rooms: placed as stated, joined, measured through a lens; and how the lens shows in them."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.cameras import Camera
from binocal.detection.line_segments import find_line_segments, joined_pieces
from binocal.evidence.line_segments import LineSegments
from binocal.geometry.vanishing import PencilForms
from binocal.solvers.lens_bend import LensBend, estimate_bend
from rooms import frame, render_room

SIZE = (480, 360)
R = frame(40.0, 20.0, 2.0)


def camera(k1=0.0, fy=390.0):
    return Camera("brown4", SIZE, np.array([390.0, fy, 244, 177, 0, k1, 0, 0, 0]))


@pytest.mark.parametrize(("k1", "fy"), [(0.0, 390.0), (-0.2, 390.0), (0.0, 430.0)])
def test_segments_of_a_room_point_to_its_vanishing_points(k1, fy):
    """Within a fifth of a pixel at the ends, in pixels that are square with the lens taken out."""
    truth = camera(k1, fy)
    segments = find_line_segments(render_room(truth, R), "a", truth)
    assert len(segments) > 50
    K = np.array([[390.0, 0, 244], [0, 390.0, 177], [0, 0, 1]])
    exact = LineSegments(
        segments.ends_px, np.zeros((len(segments), 2, 2)), segments.bend_per_px, segments.image, ("a",), SIZE
    )
    away_px = np.abs(PencilForms.of(exact.ends_px, exact.covariance_px2, 1.0).distances((K @ R).T)).min(axis=0)
    assert np.median(away_px) < 0.1 and np.quantile(away_px, 0.9) < 0.3
    stated = np.sqrt(segments.covariance_px2[:, 0, 0])
    assert 0.002 < np.median(stated) < 0.1


def test_16_bits_give_what_8_bits_give():
    image = render_room(camera(), R)
    shallow, deep = (find_line_segments(i, "a") for i in (image, image.astype(np.uint16) * 257))
    assert len(shallow) == pytest.approx(len(deep), abs=3)


def test_an_image_without_edges_has_no_segments():
    flat = np.full((360, 480), 90, np.uint8)
    assert len(find_line_segments(flat, "a")) == 0


def test_pieces_of_an_edge_are_joined_and_opposite_edges_are_not():
    pieces = np.array(
        [[[10.0, 10], [60, 10.2]], [[66.0, 10.3], [120, 10.1]], [[120.0, 12], [12, 12]], [[20.0, 40], [90, 40]]]
    )
    joined = joined_pieces(pieces)
    assert sorted(np.linalg.norm(joined[:, 1] - joined[:, 0], axis=1).round()) == [70, 108, 110]
    assert len(joined_pieces(np.zeros((0, 2, 2)))) == 0


def test_a_lens_shows_in_the_bend_of_lines():
    """Its displacement at the corners to a fourth, being linear in the lens (-42 for -36 px); none where there is none."""
    for k1 in (-0.2, 0.0):
        parts = [
            find_line_segments(render_room(camera(k1), frame(yaw, 20.0), seed=i), "a") for i, yaw in enumerate((25, 50))
        ]
        bend = estimate_bend(LineSegments.joined(parts))
        half = 0.5 * np.hypot(*SIZE)
        assert isinstance(bend, LensBend) and bend.is_sure == (k1 != 0)
        assert bend.corner_px == pytest.approx(half * k1 * (half / 390) ** 2, rel=0.25, abs=1.0)
    assert estimate_bend(parts[0].select(np.arange(5))) is None
