"""The compiled PNG decoder against pictures that were written with every filter, and its refusals."""

import itertools
import struct
import zlib

import numpy as np
import pytest

from binocal.native.pictures import decode_grey_png


def chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def filter_row(kind, row, above, step):
    """A row's bytes less what its filter predicts (PNG specification, section 9)."""
    a = np.r_[np.zeros(step, int), row[:-step]]
    b, c = above, np.r_[np.zeros(step, int), above[:-step]]
    p = a + b - c
    distances = np.abs(np.stack([p - a, p - b, p - c]))
    paeth = np.choose(distances.argmin(axis=0), [a, b, c])  # the first of equals
    return (row - [0 * a, a, b, (a + b) // 2, paeth][kind]) % 256


def write_png(
    image, filters=(0, 1, 2, 3, 4), level=6, strategy=zlib.Z_DEFAULT_STRATEGY, header=(0, 0, 0, 0), extra=b"", split=1
):
    """A grey PNG whose rows take the filters in turn; ``header`` is colour, compression, filter, interlace."""
    step = image.dtype.itemsize
    rows = image.astype(image.dtype.newbyteorder(">")).view(np.uint8).reshape(len(image), -1).astype(int)
    raw, above = b"", np.zeros(rows.shape[1], int)
    for kind, row in zip(itertools.cycle(filters), rows, strict=False):
        raw += bytes([kind]) + filter_row(kind, row, above, step).astype(np.uint8).tobytes()
        above = row
    deflate = zlib.compressobj(level, zlib.DEFLATED, 15, 8, strategy)
    data = deflate.compress(raw) + deflate.flush()
    ihdr = struct.pack(">IIBBBBB", image.shape[1], image.shape[0], 8 * step, *header)
    parts = [data[i * len(data) // split : (i + 1) * len(data) // split] for i in range(split)]
    idat = b"".join(chunk(b"IDAT", part) for part in parts)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", ihdr) + extra + idat + chunk(b"IEND", b"")


def make_image(dtype, shape=(61, 47), noise=3.0):
    slope = 40.0 + 2 * np.add.outer(np.arange(shape[0]), np.arange(shape[1]))
    picture = slope + noise * np.random.default_rng(0).standard_normal(shape)
    return (np.clip(picture, 0, 255) * (257 if dtype == np.uint16 else 1)).astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    "level, strategy", [(0, 0), (1, 0), (9, 0), (6, zlib.Z_HUFFMAN_ONLY), (6, zlib.Z_RLE), (6, zlib.Z_FIXED)]
)
@pytest.mark.parametrize("noise", [0.0, 3.0, 80.0])
def test_pictures_come_back_from_every_filter_and_kind_of_block(dtype, level, strategy, noise):
    image = make_image(dtype, (200, 301), noise)
    for filters in ((0, 1, 2, 3, 4), (4, 3)):
        decoded = decode_grey_png(write_png(image, filters, level, strategy, split=3))
        assert decoded is not None and decoded.dtype == dtype and np.array_equal(decoded, image)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (5, 3)])
def test_small_pictures(shape):
    image = make_image(np.uint8, shape)
    assert np.array_equal(decode_grey_png(write_png(image)), image)


def test_what_is_not_plainly_grey_is_left_to_others():
    image = make_image(np.uint8)
    for header in ((2, 0, 0, 0), (3, 0, 0, 0), (0, 0, 0, 1), (0, 1, 0, 0)):
        assert decode_grey_png(write_png(image, header=header)) is None
    assert decode_grey_png(write_png(image, extra=chunk(b"tRNS", b"\0\7"))) is None
    assert decode_grey_png(b"") is None and decode_grey_png(b"\xff\xd8" + bytes(60)) is None
    huge = write_png(image)
    assert decode_grey_png(huge[:16] + struct.pack(">II", 1 << 30, 1 << 30) + huge[24:]) is None


def test_what_is_not_whole_is_refused():
    whole = write_png(make_image(np.uint8))
    assert all(decode_grey_png(whole[:n]) is None for n in range(0, len(whole) - 12, 7))
    larger = whole[:16] + struct.pack(">II", 47, 62) + whole[24:]
    smaller = whole[:16] + struct.pack(">II", 47, 60) + whole[24:]
    assert decode_grey_png(larger) is None and decode_grey_png(smaller) is None


def test_damage_gives_a_picture_or_nothing():
    whole, rng = write_png(make_image(np.uint8), level=9), np.random.default_rng(1)
    n_refused = 0
    for _ in range(500):
        damaged = bytearray(whole)
        for at in rng.integers(33, len(whole), 3):
            damaged[at] = rng.integers(256)
        picture = decode_grey_png(bytes(damaged))
        assert picture is None or picture.shape == (61, 47)
        n_refused += picture is None
    assert 50 < n_refused < 500
