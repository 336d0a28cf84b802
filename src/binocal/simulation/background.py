"""What stands behind the board: a textured wall with objects, drawn from a generator."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Float

_NOISE = ((4, 0.5), (12, 0.3), (60, 0.12))  # cells across the image, share of the contrast


def draw_background(
    size_wh: tuple[int, int], rng: np.random.Generator, *, level: float, contrast: float
) -> Float[ndarray, "h w"]:
    """Grey levels (0-255, float32) of polygons, rectangles, ellipses and lines under smooth noise.

    There is no second regular grid.
    ``level`` is the mean grey level, ``contrast`` the spread of the objects' levels (0: a plain wall).
    """
    import cv2

    width, height = size_wh
    if contrast <= 0:
        return np.full((height, width), level, dtype=np.float32)
    image = np.full((height, width), np.clip(level, 0, 255), dtype=np.uint8)
    shift = 4  # cv2's fixed-point coordinates: 1/16 pixel
    for _ in range(rng.integers(10, 22)):
        grey = float(np.clip(level + contrast * rng.uniform(-1.8, 1.8), 2, 250))
        centre = rng.uniform(-0.05, 1.05, 2) * [width, height]
        size = width * rng.uniform(0.015, 0.14)
        kind = rng.integers(4)
        if kind == 0:
            angle = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 8)))
            ring = centre + size * np.stack([np.cos(angle), np.sin(angle)], axis=-1) * rng.uniform(
                0.5, 1, (len(angle), 1)
            )
            cv2.fillPoly(image, [_fixed(ring, shift)], grey, cv2.LINE_AA, shift)
        elif kind == 1:
            half = size * np.array([rng.uniform(0.4, 1.6), rng.uniform(0.2, 1.0)])
            cosine, sine = np.cos(turn := rng.uniform(-0.4, 0.4)), np.sin(turn)
            corners = (
                np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ np.array([[cosine, sine], [-sine, cosine]])
            )
            cv2.fillPoly(image, [_fixed(centre + corners, shift)], grey, cv2.LINE_AA, shift)
        elif kind == 2:
            axes = _fixed(size * rng.uniform(0.3, 1.0, 2), shift)
            middle, turn_deg = _fixed(centre, shift), rng.uniform(0, 180)
            cv2.ellipse(image, middle.tolist(), axes.tolist(), turn_deg, 0, 360, grey, -1, cv2.LINE_AA, shift)
        else:
            start, end = _fixed(centre + 3 * size * rng.uniform(-1, 1, (2, 2)), shift).tolist()
            cv2.line(image, start, end, grey, int(rng.integers(1, 7)), cv2.LINE_AA, shift)
    out = image.astype(np.float32)
    for cells, share in _NOISE:
        noise = rng.standard_normal((max(2, round(cells * height / width)), cells)).astype(np.float32)
        out += np.float32(share * contrast) * cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(out, 0, 255)


def _fixed(points: ndarray, shift: int) -> ndarray:
    """Coordinates as cv2's drawing functions take them: integers in units of 2^-shift pixels."""
    return np.rint(np.asarray(points) * (1 << shift)).astype(np.int32)
