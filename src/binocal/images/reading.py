"""Reading images strictly: a file is a whole image of a supported kind, or a named error.

Decoders are forgiving where a calibration must not be: a truncated JPEG decodes to an image whose lower half is grey.
So the container's own structure is walked first (:mod:`binocal.images.containers`), and only then is it decoded. What the decoders
say of damage they print; it is caught, and refuses the file.
"""

from __future__ import annotations

import hashlib
import re
import struct
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy import ndarray

from binocal.errors import FormatError
from binocal.images.containers import identify_container, structure_problem
from binocal.images.opencv_settings import quiet_opencv
from binocal.images.tiff import count_pages, without_orientation
from binocal.input_file import read_file
from binocal.kernels.library_words import caught_words
from binocal.shapes import UInt8, UInt16

Image: TypeAlias = "UInt8[ndarray, 'h w'] | UInt16[ndarray, 'h w'] | UInt8[ndarray, 'h w 3'] | UInt16[ndarray, 'h w 3']"
GreyImage: TypeAlias = "UInt8[ndarray, 'h w'] | UInt16[ndarray, 'h w']"

# What libjpeg and libpng print, and in no other way say, of pixels that they could not decode and made up. Bytes before the end
# marker are padding, which some cameras write. Source: jerror.h of libjpeg-turbo 3, its warnings JWRN_...; pngerror.c of libpng 1.6.
_DAMAGE = re.compile(r"Corrupt JPEG data|Premature end of JPEG|Inconsistent progression|libpng error")
_HARMLESS = re.compile(r"Corrupt JPEG data: \d+ extraneous bytes before marker 0xd9")

CHANNELS = ("grey", "red", "green", "blue")
_PLANES = {"blue": 0, "green": 1, "red": 2}  # of an image in OpenCV's order

_REMEDY = "export it as 8- or 16-bit PNG, TIFF, JPEG or BMP"


def read_image(path: str | PathLike[str]) -> Image:
    """The pixels of a PNG, JPEG, TIFF, BMP or PNM file as the sensor wrote them.

    Grey images are (h, w), colour ones (h, w, 3) in OpenCV's blue-green-red order; uint8 or uint16. Transparency is
    dropped. An orientation tag, of EXIF in JPEG or of TIFF, is ignored on purpose: a calibration belongs to the sensor's
    pixels as they are stored, not to their display. Of a TIFF file with several images the first is read.

    Raises:
        FormatError: The file is missing, empty, truncated, no image, or of an unsupported depth; the text says which.
    """
    return _decode(Path(path), _read_bytes(Path(path)), as_grey=False)


def read_grey_image(path: str | PathLike[str]) -> GreyImage:
    """As :func:`read_image`, then :func:`to_grey`; a colour JPEG's own luma is taken, which is faster and as good.

    Raises:
        FormatError: As in :func:`read_image`.
    """
    return to_grey(_decode(Path(path), _read_bytes(Path(path)), as_grey=True))


@dataclass(frozen=True, slots=True, eq=False)
class StoredImage:
    """An image file: its grey levels, the SHA-256 of its bytes, and how many images (pages) it holds."""

    grey: GreyImage
    sha256: str
    n_pages: int = 1


def read_stored_image(path: str | PathLike[str], channel: str = "grey") -> StoredImage:
    """As :func:`read_grey_image`, and what else is known of the file, which is read once for all.

    ``channel`` is one of :data:`CHANNELS`; a single colour's own levels take the place of the luma.

    Raises:
        FormatError: As in :func:`read_image`, or there is a ``channel`` asked for and the image has no colours.
    """
    content = _read_bytes(Path(path))
    if channel == "grey":
        grey = to_grey(_decode(Path(path), content, as_grey=True))
    else:
        image = _decode(Path(path), content, as_grey=False)
        if image.ndim != 3:
            raise FormatError(
                path, f"has no colours, so it has no {channel} channel; give colour images, or measure in grey"
            )
        grey = np.ascontiguousarray(image[..., _PLANES[channel]])
    n_pages = count_pages(content) if identify_container(content) == "TIFF" else 1
    return StoredImage(grey, hashlib.sha256(content).hexdigest(), n_pages)


def read_image_size(path: str | PathLike[str]) -> tuple[int, int]:
    """Width and height of an image file, pixels; of a PNG from its first bytes, which are all that is read.

    Raises:
        FormatError: As in :func:`read_image`, of a PNG only where the file is missing or has no header.
    """
    try:
        with Path(path).open("rb") as file:
            head = file.read(24)
    except OSError:
        head = b""  # reading the whole says what is wrong
    if len(head) == 24 and identify_container(head) == "PNG" and head[12:16] == b"IHDR":
        width, height = struct.unpack(">II", head[16:24])
        return width, height
    height, width = read_grey_image(path).shape
    return width, height


def to_grey(image: Image) -> GreyImage:
    """Luma of an image (h, w) or (h, w, 3) or (h, w, 4), blue-green-red order, in its own depth (uint8 or uint16).

    Raises:
        ValueError: The shape or the depth is not an image's.
    """
    image = np.asarray(image)
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"an image is uint8 or uint16; got {image.dtype}")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (3, 4)) or 0 in image.shape:
        raise ValueError(f"an image is (h, w) or (h, w, 3); got {image.shape}")
    if image.ndim == 2:
        return image
    import cv2

    return cv2.cvtColor(np.ascontiguousarray(image[..., :3]), cv2.COLOR_BGR2GRAY)


def _decode(path: Path, content: bytes, *, as_grey: bool) -> ndarray:
    import cv2

    container = identify_container(content)
    if container is None:
        raise FormatError(path, f"is not an image{_describe_content(content)}; {_REMEDY}")
    problem = structure_problem(content, container)
    if problem:
        raise FormatError(path, f"{problem}; copy or record the image again")
    if container == "TIFF":
        content = without_orientation(content)
    flags = cv2.IMREAD_UNCHANGED
    if as_grey and container == "JPEG":
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    with quiet_opencv(), caught_words() as words:
        try:
            image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
        except (cv2.error, MemoryError):
            image = None
    damage = next((word for word in words if _DAMAGE.match(word) and not _HARMLESS.match(word)), "")
    if damage:
        raise FormatError(path, f"is a damaged {container} file ({damage.strip()}); copy or record the image again")
    if image is None or image.size == 0:
        raise FormatError(path, f"is a damaged or unsupported {container} file; {_REMEDY}")
    if image.dtype not in (np.uint8, np.uint16):
        raise FormatError(path, f"holds {image.dtype} pixels, but only 8- and 16-bit ones can be read; {_REMEDY}")
    if image.ndim == 3:
        image = image[..., 0] if image.shape[2] < 3 else image[..., :3]
    return np.ascontiguousarray(image)


def _read_bytes(path: Path) -> bytes:
    content = read_file(path)
    if not content:
        raise FormatError(path, "is an empty file; copy or record the image again")
    return content


def _describe_content(content: bytes) -> str:
    head = content[:512]
    is_text = b"\0" not in head and all(byte >= 32 or byte in b"\t\r\n\f\b\x1b" for byte in head)
    return " but text" if is_text else ""
