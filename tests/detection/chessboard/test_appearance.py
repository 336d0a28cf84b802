"""Do squares and corners look like a chessboard's?"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal.detection.chessboard.appearance import are_faint, are_squares_patterned
from binocal.detection.finding.search import SearchLevel
from binocal.detection.finding.xcorners import SaddleImage, XCorners

PITCH = 24
GRID = np.stack(np.meshgrid(np.arange(1, 8), np.arange(1, 6)), axis=-1) * float(PITCH) - 0.5


def board_image(mark_share=(0.0, 0.0), faint=(), contrast=1.0):
    """Seven by five corners, dark square first; marks in the bright squares, some corners with less contrast."""
    y, x = np.mgrid[: 6 * PITCH, : 8 * PITCH]
    is_bright = (x // PITCH + y // PITCH) % 2 == 1
    image = np.where(is_bright, 210.0, 40.0)
    half_wh = 0.5 * PITCH * np.array(mark_share)
    middle = np.abs(x % PITCH - PITCH / 2 + 0.5) < half_wh[0]
    middle &= np.abs(y % PITCH - PITCH / 2 + 0.5) < half_wh[1]
    image[is_bright & middle] = 40.0
    for row, column in faint:
        x0, y0 = GRID[row, column]
        about = (np.abs(x - x0) < PITCH / 2) & (np.abs(y - y0) < PITCH / 2)
        image[about] = 125 + contrast * (image[about] - 125)
    return cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)


def level_of(smooth):
    nothing = XCorners(np.zeros((0, 2)), np.zeros((0, 4)), np.zeros(0))
    return SearchLevel(SaddleImage.of(smooth, 4.0), nothing, np.eye(2, 3), [], np.zeros((0, 2)))


@pytest.mark.parametrize(
    ("mark_share", "is_patterned"),
    [((0.0, 0.0), False), ((0.25, 0.25), False), ((0.3, 0.5), True), ((0.7, 0.7), True)],
)
def test_marks_in_the_bright_squares(mark_share, is_patterned):
    assert are_squares_patterned(board_image(mark_share), GRID, True) is is_patterned


def test_shading_is_no_pattern():
    shaded = board_image() * np.linspace(0.4, 1.0, 8 * PITCH, dtype=np.float32)
    assert not are_squares_patterned(shaded, GRID, True)
    holed = GRID.copy()
    holed[1::2] = np.nan
    assert not are_squares_patterned(board_image((0.7, 0.7)), holed, True)  # no whole square, nothing to say


@pytest.mark.parametrize(("contrast", "is_faint"), [(1.0, False), (0.4, False), (0.25, True), (0.0, True)])
def test_a_corner_with_a_third_of_the_others_contrast_is_covered(contrast, is_faint):
    level = level_of(board_image(faint=[(2, 3)], contrast=contrast))
    faint = are_faint(level, GRID.reshape(-1, 2), GRID).reshape(5, 7)
    assert faint[2, 3] == is_faint and faint.sum() == is_faint


def test_a_shadow_dims_and_does_not_cover():
    smooth = board_image()
    smooth[:, : 3 * PITCH] *= 0.2  # contrast and brightness alike
    inside = np.ones((5, 7), bool)
    inside[:, 2] = False  # on the shadow's border
    assert not are_faint(level_of(smooth), GRID.reshape(-1, 2), GRID).reshape(5, 7)[inside].any()


@pytest.mark.parametrize(("n_gone", "n_faint"), [(17, 17), (18, 0)])
def test_an_image_most_of_whose_corners_are_unclear_says_nothing(n_gone, n_faint):
    gone = [(i // 7, i % 7) for i in range(n_gone)]
    smooth = board_image()
    for row, column in gone:
        x, y = GRID[row, column]
        cv2.circle(smooth, (int(x), int(y)), 9, 120.0, -1)
    assert are_faint(level_of(smooth), GRID.reshape(-1, 2), GRID).sum() == n_faint


def test_rings_stay_within_the_squares():
    small = cv2.resize(board_image((0.5, 0.5)), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    grid = (GRID + 0.5) / 2 - 0.5  # squares of 12 px, with marks from 4 px beside their corners on
    assert not are_faint(level_of(small), grid.reshape(-1, 2), grid).any()
    smudged = small.copy()
    x, y = grid[2, 3].astype(int)
    smudged[y - 2 : y + 4, x - 2 : x + 4] = 120
    assert are_faint(level_of(smudged), grid.reshape(-1, 2), grid).sum() == 1
