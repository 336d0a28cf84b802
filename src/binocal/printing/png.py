"""A page as a grey PNG at an exact number of dots per inch. Source: W3C, "Portable Network Graphics", second edition."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from binocal.printing.drawing import Page
from binocal.printing.raster import raster_bands, raster_size

MM_PER_INCH = 25.4
MOST_PIXELS = 600_000_000  # A0 at 600 dpi; image programs open few larger ones


def png_content(page: Page, dpi: float) -> bytes:
    """The page in 8-bit grey, with its resolution.

    Raises:
        ValueError: It would have more than ``MOST_PIXELS``.
    """
    width, height = raster_size(page, dpi / MM_PER_INCH)
    if width * height > MOST_PIXELS:
        most = int(dpi * np.sqrt(MOST_PIXELS / (width * height)))
        raise ValueError(f"{width} x {height} pixels are too many; take --dpi {most} or less, or a PDF")
    return encode_png(raster_bands(page, dpi / MM_PER_INCH), (width, height), dpi)


def encode_png(bands, size_wh: tuple[int, int], dpi: float) -> bytes:
    """Rows of grey pixels as a PNG file."""
    width, height = size_wh
    squeezer = zlib.compressobj(6)
    data = bytearray()
    for band in bands:
        lines = np.zeros((len(band), width + 1), np.uint8)  # a line's first byte is its filter, 0 none
        lines[:, 1:] = band
        data += squeezer.compress(lines.tobytes())
    data += squeezer.flush()
    per_metre = round(1000 * dpi / MM_PER_INCH)
    return b"".join(
        [
            b"\x89PNG\r\n\x1a\n",
            _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)),
            _chunk(b"pHYs", struct.pack(">IIB", per_metre, per_metre, 1)),
            _chunk(b"IDAT", bytes(data)),
            _chunk(b"IEND", b""),
        ]
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
