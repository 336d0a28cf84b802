"""Images as files: colour PNG, TIFF of floating-point numbers; and pictures of depth and of rows for the eye."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.images.png import encode_png
from binocal.shapes import Bool, Float, Float32, UInt8

ROW_LINES = 24  # over an image's height
LINE_BGR = (0, 220, 255)


def encode_image(image: ndarray) -> bytes:
    """PNG file of a grey image or one in blue-green-red order, uint8 or uint16."""
    if image.ndim == 2:
        return encode_png(image)
    import cv2

    return _encoded(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])


def encode_float_tiff(image: Float32[ndarray, "h w"]) -> bytes:
    """TIFF file of 32-bit floating-point numbers, NaN included."""
    import cv2

    return _encoded(".tiff", image, [cv2.IMWRITE_TIFF_COMPRESSION, 1])


def encode_jpeg(image: ndarray, *, quality: int = 75) -> bytes:
    """JPEG file for the eye, of a grey image or one in blue-green-red order; of 16 bits as :func:`to_8_bit` has it."""
    import cv2

    return _encoded(".jpg", to_8_bit(image), [cv2.IMWRITE_JPEG_QUALITY, quality])


def shrunk(image: ndarray, most_width: int) -> ndarray:
    """The image no wider than that, by averaging; a narrower one as it is."""
    height, width = image.shape[:2]
    if width <= most_width:
        return image
    import cv2

    size_wh = most_width, max(1, round(height * most_width / width))
    return cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA)


def to_8_bit(image: ndarray) -> UInt8[ndarray, "..."]:
    """An image of 8 bits a channel; of 16 bits, its darkest to brightest thousandth are spread over them."""
    if image.dtype == np.uint8:
        return image
    low, high = np.quantile(image, (1e-3, 1 - 1e-3))
    return np.clip((image.astype(np.float32) - low) * (255 / max(high - low, 1)), 0, 255).astype(np.uint8)


def draw_rows(left: ndarray, right: ndarray, *, is_vertical: bool = False) -> UInt8[ndarray, "h2 w2 3"]:
    """Both rectified images side by side (one above the other, if vertical) with lines that matching points share."""
    pair = np.concatenate([_colour(left), _colour(right)], axis=0 if is_vertical else 1)
    length = left.shape[1] if is_vertical else left.shape[0]
    for place in ((np.arange(ROW_LINES) + 0.5) * length / ROW_LINES).astype(int):
        line = pair[:, place] if is_vertical else pair[place]
        line[:] = LINE_BGR
    return pair


def draw_depth(distance: Float[ndarray, "h w"] | Float32[ndarray, "h w"]) -> UInt8[ndarray, "h w 3"]:
    """Distances by colour, near red, far blue, even steps of 1 / distance; black where there is none."""
    import cv2

    known: Bool[ndarray, "h w"] = np.isfinite(distance) & (distance > 0)
    if not known.any():
        return np.zeros((*distance.shape, 3), np.uint8)
    inverse = np.zeros(distance.shape, np.float32)
    inverse[known] = 1 / distance[known]
    low, high = np.quantile(inverse[known], (0.02, 0.98))
    level = np.clip((inverse - low) / max(high - low, 1e-12) * 255, 0, 255).astype(np.uint8)
    picture = cv2.applyColorMap(level, cv2.COLORMAP_TURBO)
    picture[~known] = 0
    return picture


def _colour(image: ndarray) -> UInt8[ndarray, "h w 3"]:
    image = to_8_bit(image)
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image.copy()


def _encoded(suffix: str, image: ndarray, options: list[int]) -> bytes:
    import cv2

    is_done, content = cv2.imencode(suffix, np.ascontiguousarray(image), options)
    assert is_done, f"OpenCV encodes every {image.dtype} image as {suffix}"
    return content.tobytes()
