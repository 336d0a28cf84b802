"""Outlines of cells, and the pixels of a page."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from binocal.printing.drawing import Area, Disc, Group, Page, Text, rectangles, trace_cells
from binocal.printing.png import png_content
from binocal.printing.raster import BAND_ROWS, raster_bands


def raster(shapes: Sequence[Area | Disc | Text], size: tuple[float, float], dots_per_mm: float, **group) -> np.ndarray:
    page = Page(*size, (Group("board", tuple(shapes), **group),))
    return np.concatenate(list(raster_bands(page, dots_per_mm)))


@pytest.mark.parametrize("seed", range(6))
def test_outlines_enclose_the_inked_cells_and_no_more(seed):
    rng = np.random.default_rng(seed)
    ink = (rng.random((17, 23)) < (0.3, 0.5, 0.7)[seed % 3]).astype(int)
    area = trace_cells(ink, np.arange(24.0), np.arange(18.0))
    assert np.array_equal(raster([area], (23.0, 17.0), 1.0), 255 * (1 - ink).astype(np.uint8))
    for outline in area.outlines:
        along = np.roll(outline, -1, axis=0) - outline
        assert ((along == 0).sum(axis=1) == 1).all()  # horizontal and vertical edges
        assert ((along[:, 0] == 0) != (np.roll(along, -1, axis=0)[:, 0] == 0)).all()  # in turn


def test_squares_that_touch_at_corners_alone_have_outlines_of_their_own():
    area = trace_cells(np.array([[1, 0], [0, 1]]), np.arange(3.0), np.arange(3.0))
    assert sorted(len(outline) for outline in area.outlines) == [4, 4]


def test_a_hole_is_an_outline_of_its_own():
    ink = np.ones((3, 3), int)
    ink[1, 1] = 0
    assert [len(outline) for outline in trace_cells(ink, np.arange(4.0), np.arange(4.0)).outlines] == [4, 4]


def test_pixels_have_the_share_of_their_area_that_is_white():
    image = raster([rectangles((0.25, 0.5, 2.5, 2.0))], (4.0, 3.0), 1.0)
    share = np.outer([0.5, 1, 0], [0.75, 1, 0.5, 0])
    assert image == pytest.approx(255 * (1 - share), abs=0.5)


def test_shapes_reach_over_bands_and_the_pages_edge():
    height = BAND_ROWS + 50.0
    image = raster([rectangles((-3.0, -2.0, 5.0, height + 9))], (8.0, height), 1.0)
    assert (image[:, :5] == 0).all() and (image[:, 5:] == 255).all()


def test_a_disc_has_its_area_and_its_centre():
    ink = 1 - raster([Disc(30.3, 260.4, 20.25)], (70.0, 290.0), 1.0) / 255.0
    v, u = np.mgrid[: ink.shape[0], : ink.shape[1]]
    assert ink.sum() == pytest.approx(np.pi * 20.25**2, rel=1e-3)
    assert (ink * u).sum() / ink.sum() + 0.5 == pytest.approx(30.3, abs=1e-3)
    assert (ink * v).sum() / ink.sum() + 0.5 == pytest.approx(260.4, abs=1e-3)


def test_nothing_is_drawn_outside_of_the_clip():
    image = raster([rectangles((0, 0, 10, 10))], (10.0, 10.0), 1.0, shift=(1.0, 1.0), clip=(2.0, 3.0, 5.0, 6.5))
    expected = np.full((10, 10), 255)
    expected[3:6, 2:5], expected[6, 2:5] = 0, 128
    assert image == pytest.approx(expected, abs=1)


def test_text_is_as_wide_as_courier():
    image = raster([Text(10.0, 20.0, 5.0, "WWWW WWWW")], (50.0, 30.0), 10.0)
    columns = np.flatnonzero((image < 128).any(axis=0))
    assert columns[0] == pytest.approx(100, abs=5) and columns[-1] == pytest.approx(100 + 9 * 0.6 * 50, abs=5)
    assert (image[:, columns[0] : columns[-1]] < 128).any(axis=1).sum() == pytest.approx(30, abs=6)


def test_a_png_states_its_resolution_and_opens():
    content = png_content(Page(25.4, 50.8, (Group("board", (rectangles((5, 5, 10, 10)),)),)), 300.0)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image.shape == (600, 300) and image.dtype == np.uint8 and image[80, 80] == 0 and image[200, 200] == 255
    start = content.index(b"pHYs")
    data = content[start + 4 : start + 13]
    assert data == (11811).to_bytes(4, "big") * 2 + b"\x01"  # pixels in a metre
    assert content[start + 13 : start + 17] == zlib.crc32(b"pHYs" + data).to_bytes(4, "big")


def test_a_png_of_too_many_pixels_is_refused():
    with pytest.raises(ValueError, match="are too many; take --dpi 622 or less"):
        png_content(Page(841.0, 1189.0, ()), 1223.9)
