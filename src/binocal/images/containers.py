"""Is an image file whole? The container's structure, walked without decoding a pixel.

Sources: PNG specification (ISO/IEC 15948) section 5, JPEG (ITU-T T.81) annex B, TIFF 6.0 section 2, BITMAPINFOHEADER,
Netpbm.
"""

from __future__ import annotations

import re
import struct
import zlib
from functools import partial

from binocal.images.tiff import tiff_problem

# Possessive: a run of spaces and comments is looked at in one way only.
_PNM_SPACE = rb"(?:\s|#[^\n]*+\n)++"
# Entropy-coded JPEG data end at an FF that is followed by neither a stuffed zero, a restart marker nor a fill byte. Of fill bytes
# only the last counts: a pattern that takes them all in looks at a long run of them once for each of its bytes.
_JPEG_MARKER = re.compile(rb"\xff([^\x00\xd0-\xd7\xff])")
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
MOST_PIXELS = 1 << 28  # the largest cameras have 150 million
MOST_PIXELS_PER_BYTE = (
    1100  # what deflate and arithmetic coding of a plain image reach; less content is a damaged header
)


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
    check = {  # each also says how large the image claims to be, before the decoder makes room for it
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


def _size_problem(content: bytes, container: str, width: int, height: int) -> str:
    """What is wrong with the size that a header states."""
    n_pixels = width * height
    if width < 1 or height < 1:
        return f"is a damaged {container} file (its header states {width} x {height} pixels)"
    if n_pixels > MOST_PIXELS:
        return f"is too large, or its header is damaged: it states {width} x {height} pixels"
    if n_pixels > MOST_PIXELS_PER_BYTE * len(content):
        return f"is a damaged {container} file (its header states {width} x {height} pixels for {len(content)} bytes)"
    return ""


def _png_problem(content: bytes) -> str:
    width, height = struct.unpack_from(">II", content, 16)
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
            return _size_problem(content, "PNG", width, height)
        position = end
    return "is a truncated PNG file"


def _jpeg_problem(content: bytes) -> str:
    position, problem = 2, ""
    while match := _JPEG_MARKER.search(content, position):
        marker = match[1][0]
        if marker == 0xD9:
            return problem
        (length,) = struct.unpack_from(">H", content, match.end())
        if marker in _JPEG_FRAMES:
            height, width = struct.unpack_from(">HH", content, match.end() + 3)
            problem = problem or _size_problem(content, "JPEG", width, height)
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
    if len(content) < needed:
        return "is a truncated BMP file"
    return _size_problem(content, "BMP", abs(width), abs(height))


def _pnm_problem(content: bytes) -> str:
    if content[1:2] in b"23":  # plain text: the decoder itself counts the numbers
        header = re.match(rb"P[23]" + 2 * (_PNM_SPACE + rb"(\d{1,9})") + rb"\s", content[:4096])
        return _size_problem(content, "PNM", *map(int, header.groups())) if header else "is a damaged PNM file"
    header = re.match(rb"P[56]" + 3 * (_PNM_SPACE + rb"(\d{1,9})") + rb"\s", content[:4096])
    if not header:
        return "is a damaged PNM file"
    width, height, most = (int(field) for field in header.groups())
    needed = header.end() + width * height * (3 if content[1:2] == b"6" else 1) * (2 if most > 255 else 1)
    return "is a truncated PNM file" if len(content) < needed else _size_problem(content, "PNM", width, height)


def _tiff_problem(content: bytes) -> str:
    return tiff_problem(content, partial(_size_problem, content, "TIFF"))
