import cv2
import numpy as np
import pytest

from binocal.images.encoding import draw_depth, draw_rows, encode_float_tiff, encode_image, to_8_bit

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_keeps_every_pixel(shape, dtype):
    image = RNG.integers(0, np.iinfo(dtype).max, shape, dtype=dtype)
    back = cv2.imdecode(np.frombuffer(encode_image(image), np.uint8), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(back, image) and back.dtype == dtype


def test_tiff_keeps_numbers_and_nan():
    image = RNG.standard_normal((20, 30)).astype(np.float32)
    image[3, 4] = np.nan
    back = cv2.imdecode(np.frombuffer(encode_float_tiff(image), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(back, image)


def test_rows_run_through_both_images():
    left, right = np.full((48, 30), 40, np.uint8), np.full((48, 30), 90, np.uint8)
    drawn = draw_rows(left, right)
    lines = np.flatnonzero((drawn == (0, 220, 255)).all(axis=(1, 2)))
    assert drawn.shape == (48, 60, 3) and len(lines) == 24 and drawn[0, 0].tolist() == [40] * 3
    above = draw_rows(left, right, is_vertical=True)
    assert above.shape == (96, 30, 3) and (above == (0, 220, 255)).all(axis=(0, 2)).sum() == 24


def test_near_is_red_far_is_blue_and_nothing_is_black():
    distance = np.tile(np.linspace(0.5, 5, 50, dtype=np.float32), (4, 1))
    distance[0, 0] = np.nan
    picture = draw_depth(distance).astype(int)
    assert picture[1, 0, 2] > picture[1, 0, 0] and picture[1, 45, 0] > picture[1, 45, 2] and not picture[0, 0].any()
    assert not draw_depth(np.full((2, 2), np.nan)).any()


def test_16_bits_are_spread_over_8():
    image = (1000 + np.arange(5000)).astype(np.uint16).reshape(50, 100)
    small = to_8_bit(image)
    assert small.dtype == np.uint8 and small.min() == 0 and small.max() == 255 and 120 < np.median(small) < 135
