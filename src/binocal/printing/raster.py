"""A page as grey pixels: each is the share of its area that is white, so that edges lie where they should between pixels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy import ndarray

from binocal.printing.drawing import ADVANCE, Area, Disc, Group, Page, Text
from binocal.shapes import Float, Float32, Int, UInt8

BAND_ROWS = 256


def raster_size(page: Page, dots_per_mm: float) -> tuple[int, int]:
    """Width and height in pixels; the last ones may reach over the page's edge."""
    return tuple(int(np.ceil(side * dots_per_mm - 1e-6)) for side in (page.width, page.height))  # type: ignore[return-value]


def raster_bands(page: Page, dots_per_mm: float) -> Iterator[UInt8[ndarray, "rows width"]]:
    """The pixels from the top on, some rows at a time, 255 white.

    An area is the double sum, over rows and columns, of a signed unit at each of its corners; a corner within a pixel is shared
    between that one and the next. Discs are exact where their rim is straight within a pixel.
    """
    width, height = raster_size(page, dots_per_mm)
    layers = [_Layer(group, dots_per_mm, width) for group in page.groups]
    for top in range(0, height, BAND_ROWS):
        ink = np.zeros((min(BAND_ROWS, height - top), width), dtype=np.float32)
        for layer in layers:
            layer.add_to(ink, top)
        yield np.rint(255 * (1 - np.clip(ink, 0, 1))).astype(np.uint8)


class _Layer:
    """A group that is drawn from the top on, band by band; bands are asked for in order."""

    def __init__(self, group: Group, scale: float, width: int) -> None:
        self._scale, self._shift = scale, np.array(group.shift)
        self._clip = None if group.clip is None else scale * np.array(group.clip)
        self._discs = [shape for shape in group.shapes if isinstance(shape, Disc)]
        self._texts = [shape for shape in group.shapes if isinstance(shape, Text)]
        outlines = [o for shape in group.shapes if isinstance(shape, Area) for o in shape.outlines]
        corners, signs = _signed_corners(outlines)
        self._rows, self._columns, self._weights = _shared_corners(scale * (corners + self._shift), signs, width)
        self._above = np.zeros(width)  # what the rows before add to each column

    def add_to(self, ink: Float32[ndarray, "rows width"], top: int) -> None:
        """The group's ink, 0 to 1, added to that of the rows from ``top`` on."""
        if self._clip is None:
            self._draw(ink, top)
            return
        own = np.zeros_like(ink)
        self._draw(own, top)
        x0, y0, x1, y1 = self._clip
        rows, width = ink.shape
        ink += own * _covered(x0, x1, 0, width)[None] * _covered(y0, y1, top, rows)[:, None]

    def _draw(self, ink: Float32[ndarray, "rows width"], top: int) -> None:
        self._add_areas(ink, top)
        for disc in self._discs:
            self._add_disc(ink, disc, top)
        for text in self._texts:
            self._add_text(ink, text, top)

    def _add_areas(self, ink: Float32[ndarray, "rows width"], top: int) -> None:
        start, end = np.searchsorted(self._rows, (top, top + len(ink)))
        # only rows with corners differ from the row above them
        changed, of_corner = np.unique(self._rows[start:end] - top, return_inverse=True)
        delta = np.zeros((len(changed) + 1, ink.shape[1]))
        delta[0] = self._above
        np.add.at(delta, (of_corner + 1, self._columns[start:end]), self._weights[start:end])
        np.cumsum(delta, axis=0, out=delta)
        self._above = delta[-1].copy()
        if not delta.any():
            return
        lines = np.cumsum(delta, axis=1).astype(np.float32)
        ink += np.repeat(lines, np.diff(np.r_[0, changed, len(ink)]), axis=0)

    def _add_disc(self, ink: Float32[ndarray, "rows width"], disc: Disc, top: int) -> None:
        x, y = self._scale * (np.array([disc.x, disc.y]) + self._shift)
        radius = self._scale * disc.radius
        reach = int(np.ceil(radius)) + 1
        rows = slice(max(int(y) - reach - top, 0), max(int(y) + reach + 1 - top, 0))
        columns = slice(max(int(x) - reach, 0), max(int(x) + reach + 1, 0))
        part = ink[rows, columns]
        if part.size:
            v = np.arange(part.shape[0])[:, None] + rows.start + top + 0.5 - y
            u = np.arange(part.shape[1])[None] + columns.start + 0.5 - x
            share = _disc_share(u, v, radius)
            if disc.hole:
                share -= _disc_share(u, v, self._scale * disc.hole)
            part += share if disc.is_black else -share

    def _add_text(self, ink: Float32[ndarray, "rows width"], text: Text, top: int) -> None:
        import cv2

        x, y = self._scale * (np.array([text.x, text.y]) + self._shift)
        size = self._scale * text.size
        rows = slice(max(int(y - size) - top, 0), max(int(y + size) + 1 - top, 0))
        columns = slice(max(int(x), 0), max(int(x + ADVANCE * size * len(text.text)) + 2, 0))
        part = ink[rows, columns]
        if not part.size:
            return
        # OpenCV's letters are 22 units high; they are spread over the width that Courier would take, the widest of which just fit.
        advance, scale, thickness = ADVANCE * size, 0.6 * size / 22, max(1, round(0.05 * size))
        patch = np.zeros(part.shape, np.uint8)
        for i, letter in enumerate(text.text):
            (wide, _), _ = cv2.getTextSize(letter, cv2.FONT_HERSHEY_SIMPLEX, scale, thickness)
            place = round(x + i * advance + (advance - wide) / 2) - columns.start, round(y) - top - rows.start
            cv2.putText(patch, letter, place, cv2.FONT_HERSHEY_SIMPLEX, scale, 255, thickness, cv2.LINE_AA)
        np.maximum(part, patch.astype(np.float32) / 255, out=part)


def _shared_corners(
    corners: Float[ndarray, "n 2"], signs: Float[ndarray, "n"], width: int
) -> tuple[Int[ndarray, "m"], Int[ndarray, "m"], Float[ndarray, "m"]]:
    """Rows, columns and weights of the pixels that corners are shared between, by rows."""
    column, row = np.floor(corners.T).astype(int)
    part_x, part_y = corners.T - [column, row]
    rows, columns, weights = [], [], []
    for down, by_row in ((0, 1 - part_y), (1, part_y)):
        for right, by_column in ((0, 1 - part_x), (1, part_x)):
            # what lies above or left of the page counts from its first row or column on
            rows.append(np.maximum(row + down, 0))
            columns.append(np.maximum(column + right, 0))
            weights.append(signs * by_row * by_column)
    all_rows, all_columns, all_weights = map(np.concatenate, (rows, columns, weights))
    index = np.flatnonzero(all_columns < width)
    index = index[np.argsort(all_rows[index], kind="stable")]
    return all_rows[index], all_columns[index], all_weights[index]


def _signed_corners(outlines: list[Float[ndarray, "_ 2"]]) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n"]]:
    """All corners, each with +1 where the outline leaves it in x direction and -1 where in y direction."""
    if not outlines:
        return np.zeros((0, 2)), np.zeros(0)
    signs = []
    for outline in outlines:
        along = np.roll(outline, -1, axis=0) - outline
        signs.append(np.where(np.abs(along[:, 0]) > np.abs(along[:, 1]), 1.0, -1.0))
    return np.concatenate(outlines), np.concatenate(signs)


def _disc_share(
    u: Float[ndarray, "1 columns"], v: Float[ndarray, "rows 1"], radius: float
) -> Float32[ndarray, "rows columns"]:
    """Share of each pixel that a disc covers; u and v from its centre, pixels."""
    distance = np.hypot(u, v)
    inside = radius - distance
    share = (inside > 0).astype(np.float32)
    rim = np.nonzero(np.abs(inside) < 1)
    normals = np.stack([u[0, rim[1]], v[rim[0], 0]]) / np.maximum(distance[rim], 1e-9)
    share[rim] = _half_plane(inside[rim], normals)
    return share


def _half_plane(inside: Float[ndarray, "n"], normals: Float[ndarray, "2 n"]) -> Float[ndarray, "n"]:
    """Share of a pixel that a half plane covers whose edge is so far beyond the pixel's centre, pixels."""
    a, b = np.maximum(np.abs(normals), 1e-3)

    def twice_summed(at: ndarray) -> ndarray:
        return np.maximum(at, 0) ** 2 / 2

    ends = twice_summed(inside + (a + b) / 2) + twice_summed(inside - (a + b) / 2)
    return (ends - twice_summed(inside + (a - b) / 2) - twice_summed(inside - (a - b) / 2)) / (a * b)


def _covered(start: float, end: float, first: int, n: int) -> Float[ndarray, "n"]:
    """Share of each of n pixels from the first on that lies between start and end."""
    edges = np.arange(first, first + n)
    return np.clip(np.minimum(edges + 1, end) - np.maximum(edges, start), 0, 1)
