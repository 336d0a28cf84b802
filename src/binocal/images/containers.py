"""Is an image file whole? The container's structure, walked without decoding a pixel.

Sources: PNG specification (ISO/IEC 15948) section 5, JPEG (ITU-T T.81) annex B, TIFF 6.0 section 2, BITMAPINFOHEADER,
Netpbm.
"""

from __future__ import annotations

import re
import struct
import zlib

_TIFF_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_TIFF_FORMATS = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}
# Entropy-coded JPEG data end at an FF that is followed by neither a stuffed zero, a restart marker nor a fill byte.
_JPEG_MARKER = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])")


def identify_container(content: bytes) -> str | None:
    """``PNG``, ``JPEG``, ``TIFF``, ``BMP`` or ``PNM`` by the first bytes; None for anything else."""
    if content.startswith(b"\x89PNG\r\n\x1a\n"):
        return "PNG"
    if content.startswith(b"\xff\xd8\xff"):
        return "JPEG"
    if content[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return "TIFF"
    if content.startswith(b"BM") and len(content) >= 26:
        return "BMP"
    if re.match(rb"P[2356]\s", content[:3]):
        return "PNM"
    return None


def structure_problem(content: bytes, container: str) -> str:
    """What is wrong with the container's structure, as the end of a sentence about the file; empty if nothing is."""
    check = {
        "PNG": _png_problem,
        "JPEG": _jpeg_problem,
        "TIFF": _tiff_problem,
        "BMP": _bmp_problem,
        "PNM": _pnm_problem,
    }
    try:
        return check[container](content)
    except (struct.error, IndexError, OverflowError):
        return f"is a truncated {container} file"


def _png_problem(content: bytes) -> str:
    position = 8
    while position < len(content):
        length, kind = struct.unpack_from(">I4s", content, position)
        end = position + 12 + length
        if end > len(content):
            return "is a truncated PNG file"
        (checksum,) = struct.unpack_from(">I", content, end - 4)
        if zlib.crc32(memoryview(content)[position + 4 : end - 4]) != checksum:
            return "is a damaged PNG file (a checksum does not match)"
        if kind == b"IEND":
            return ""
        position = end
    return "is a truncated PNG file"


def _jpeg_problem(content: bytes) -> str:
    position = 2
    while match := _JPEG_MARKER.search(content, position):
        marker = match[1][0]
        if marker == 0xD9:
            return ""
        (length,) = struct.unpack_from(">H", content, match.end())
        position = match.end() + length
    return "is a truncated JPEG file"


def _bmp_problem(content: bytes) -> str:
    (pixels_at,) = struct.unpack_from("<I", content, 10)
    (header,) = struct.unpack_from("<I", content, 14)
    if header == 12:
        width, height, _, depth = struct.unpack_from("<HHHH", content, 18)
        compression = 0
    else:
        width, height, _, depth, compression = struct.unpack_from("<iiHHI", content, 18)
    is_plain = compression in (0, 3, 6)
    needed = pixels_at + (abs(width) * depth + 31) // 32 * 4 * abs(height) if is_plain else pixels_at
    if not is_plain:
        (stored,) = struct.unpack_from("<I", content, 34)
        needed += stored
    return "is a truncated BMP file" if len(content) < needed else ""


def _pnm_problem(content: bytes) -> str:
    if content[1:2] in b"23":  # plain text: the decoder itself counts the numbers
        return ""
    header = re.match(rb"P[56](?:\s+|#[^\n]*\n)+(\d+)(?:\s+|#[^\n]*\n)+(\d+)(?:\s+|#[^\n]*\n)+(\d+)\s", content[:4096])
    if not header:
        return "is a damaged PNM file"
    width, height, most = (int(field) for field in header.groups())
    needed = header.end() + width * height * (3 if content[1:2] == b"6" else 1) * (2 if most > 255 else 1)
    return "is a truncated PNM file" if len(content) < needed else ""


def _tiff_problem(content: bytes) -> str:
    order = "<" if content[:1] == b"I" else ">"
    is_big = b"+" in content[2:4]
    tags = _read_tiff_directory(content, order, is_big)
    if tags is None:
        return "is a truncated TIFF file"
    for offsets, counts in ((273, 279), (324, 325)):  # strips, tiles
        if offsets in tags and counts in tags:
            ends = [at + length for at, length in zip(tags[offsets], tags[counts], strict=False)]
            return "is a truncated TIFF file" if not ends or max(ends) > len(content) else ""
    return ""  # no byte counts (old writers): the decoder decides


def _read_tiff_directory(content: bytes, order: str, is_big: bool) -> dict[int, tuple[int, ...]] | None:
    """The integer tags of the first directory; None where the directory lies beyond the end of the file."""
    word, word_size = ("Q", 8) if is_big else ("I", 4)
    (at,) = struct.unpack_from(order + word, content, 8 if is_big else 4)
    (n_entries,) = struct.unpack_from(order + ("Q" if is_big else "H"), content, at)
    at += 8 if is_big else 2
    tags = {}
    for index in range(n_entries):
        entry = at + index * (20 if is_big else 12)
        tag, kind = struct.unpack_from(order + "HH", content, entry)
        (count,) = struct.unpack_from(order + word, content, entry + 4)
        value_at = entry + 4 + word_size
        if _TIFF_SIZES.get(kind, 1) * count > word_size:
            (value_at,) = struct.unpack_from(order + word, content, value_at)
        if value_at + _TIFF_SIZES.get(kind, 1) * count > len(content):
            return None
        if kind in _TIFF_FORMATS:
            tags[tag] = struct.unpack_from(f"{order}{count}{_TIFF_FORMATS[kind]}", content, value_at)
    return tags
