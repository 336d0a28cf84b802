"""Which spots are taken for circles of one plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.detection.finding.blobs import Blobs
from binocal.detection.finding.equal_circles import GridSpots, are_equal_circles
from binocal.detection.measuring.ellipses import MeasuredSpots
from binocal.kernels.image_lens import LensFitOptions

SIZE_WH = 640, 480
SHEAR = np.array([[30.0, 8.0], [2.0, 40.0]])  # from pitches to pixels


def seen_circles(n=30):
    """The images of equal circles through an affine map."""
    xy = np.argwhere(np.ones((6, 5)))[:n].astype(float)
    centres = xy @ SHEAR.T + 100
    values, vectors = np.linalg.eigh(SHEAR @ SHEAR.T)
    axes = np.tile(0.25 * np.sqrt(values), (n, 1))
    angle = np.full(n, np.arctan2(vectors[1, 0], vectors[0, 0]))
    areas = np.pi * axes.prod(axis=1)
    measured = MeasuredSpots(centres, np.tile(np.eye(2), (n, 1, 1)), areas, np.full(n, 0.01))
    return GridSpots(xy, np.ones(n), measured, Blobs(centres, axes, angle, np.zeros(n)))


def are_taken(spots):
    return are_equal_circles(spots, SIZE_WH, LensFitOptions(has_one_unknown=True))


def test_circles_of_a_plane_are_taken_and_marked_ones_by_their_own_size():
    spots = seen_circles()
    assert are_taken(spots)
    larger = np.where(np.arange(30) % 5 == 0, 1.4, 1.0)
    areas = spots.measured.areas_px2 * larger**2
    measured = replace(spots.measured, areas_px2=areas)
    assert not are_taken(replace(spots, measured=measured))
    assert are_taken(replace(spots, measured=measured, relative_radii=larger))


@pytest.mark.parametrize("kind", ["sizes", "shapes", "turned"])
def test_other_spots_are_not(kind):
    spots = seen_circles()
    rng = np.random.default_rng(0)
    if kind == "sizes":
        areas = spots.measured.areas_px2 * np.exp(rng.normal(0, 0.5, 30))
        spots = replace(spots, measured=replace(spots.measured, areas_px2=areas))
    elif kind == "shapes":
        spots = replace(spots, measured=replace(spots.measured, shape_residuals=np.full(30, 0.25)))
    else:
        blobs = replace(spots.blobs, axes_px=spots.blobs.axes_px * [0.5, 2.0])
        spots = replace(spots, blobs=blobs)
    assert not are_taken(spots)


def test_spots_too_small_to_have_a_shape_need_a_large_grid():
    for n, is_taken in ((30, True), (16, False)):
        spots = seen_circles(n)
        spots = replace(spots, measured=replace(spots.measured, shape_residuals=np.full(n, np.nan)))
        assert are_taken(spots) == is_taken
