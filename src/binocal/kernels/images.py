"""X-corners of images, the links between them and the lattices that they form.

Images are C-contiguous (h, w). Points are (x, y), (0, 0) the centre of the top-left pixel. The kernel holds no lock while
it works. tests/kernels states each function plainly in NumPy and compares.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.shapes import Bool, Float, Float32, Int


def saddle_response(
    smooth: Float32[ndarray, "h w"], out: Float32[ndarray, "h w"] | None = None
) -> Float32[ndarray, "h w"]:
    """Minus the determinant of the Hessian: positive at saddles, zero along edges and in the image's outermost pixels."""
    response = np.empty(smooth.shape, np.float32) if out is None else out
    _kernel.saddle_response(np.ascontiguousarray(smooth), response)
    return response


def find_peaks(
    response: Float32[ndarray, "h w"], reach: int, margin: int, least: float, most: int
) -> Float[ndarray, "n 2"]:
    """The ``most`` greatest values that are the greatest within ``reach`` columns and rows, at least ``least``.

    Places are in reading order, ``margin`` pixels from the border, to a fraction of a pixel by parabolas through the
    neighbours in x and in y.
    """
    points = np.empty((most, 2))
    return points[: _kernel.find_peaks(response, reach, margin, float(least), points)]


def sample(image: ndarray, points_px: Float[ndarray, "*n 2"]) -> Float32[ndarray, "*n"]:
    """Bilinear values at points of a uint8 or float32 image; the border's value beyond it, 0 where a point is NaN."""
    flat = _places(points_px)
    values = np.empty(len(flat), np.float32)
    _kernel.sample(np.ascontiguousarray(image), flat, values)
    return values.reshape(points_px.shape[:-1])


def read_rings(
    smooth: ndarray, points_px: Float[ndarray, "n 2"], radius_px: float, min_contrast_dn: float, max_unlikeness: float
) -> tuple[Bool[ndarray, "n"], Float[ndarray, "n 4"], Float[ndarray, "n"]]:
    """Which points of a uint8 or float32 image are X-corners, their edge directions, and the rings' contrasts.

    A ring's values cross its middle level four times, opposite values differ by ``max_unlikeness`` of its contrast at most,
    both edges run straight through to 40 degrees and no sector is below 18. Directions are radians in rising order, the
    first with its bright sector after it; 0 where the point is none.
    """
    n = len(points_px)
    is_corner, rays, contrast = np.empty(n, bool), np.empty((n, 4)), np.empty(n)
    limits = (float(radius_px), float(min_contrast_dn), float(max_unlikeness))
    _kernel.read_rings(np.ascontiguousarray(smooth), _places(points_px), *limits, is_corner, rays, contrast)
    return is_corner, rays, contrast


def localize_saddles(
    image: ndarray, points_px: Float[ndarray, "n 2"], fit: Float[ndarray, "5 k2"], reach: int
) -> Float[ndarray, "n 2"]:
    """Points moved, twice, to the saddle of the quadratic that fits the (2 reach + 1)^2 pixels around them.

    ``fit`` takes the pixels to the coefficients of x^2, xy, y^2, x and y. A point stays where there is no saddle, where it
    would move by more than ``reach`` from its start, and near the border.
    """
    points = _places(points_px).copy()
    _kernel.localize_saddles(np.ascontiguousarray(image), np.ascontiguousarray(fit, dtype=float), reach, points)
    return points


def follow_edges(
    smooth: ndarray,
    start_px: Float[ndarray, "n 2"],
    way_px: Float[ndarray, "n 2"],
    sign: Float[ndarray, "n"],
    contrast_dn: Float[ndarray, "n"],
) -> Bool[ndarray, "n"]:
    """Where one side of the way is brighter than the other all along it, by at least 0.3 of the contrast.

    Read at 0.3, 0.5 and 0.7 of the way; ``sign`` is 1 where the side at larger angles is the bright one.
    """
    is_seen = np.empty(len(start_px), bool)
    signs, contrasts = (np.ascontiguousarray(a, dtype=float) for a in (sign, contrast_dn))
    _kernel.follow_edges(np.ascontiguousarray(smooth), _places(start_px), _places(way_px), signs, contrasts, is_seen)
    return is_seen


def link_corners(
    smooth: ndarray,
    points_px: Float[ndarray, "n 2"],
    rays_rad: Float[ndarray, "n 4"],
    contrast_dn: Float[ndarray, "n"],
    max_turn_rad: float,
    *,
    has_markers: bool = False,
    is_oblique: bool = False,
    has_dots: bool = False,
) -> tuple[Int[ndarray, "n 4"], Int[ndarray, "n 4"]]:
    """For each corner and ray the neighbour along it (-1: none) and which of the neighbour's rays points back.

    Among the 14 nearest: along both corners' rays to ``max_turn_rad``, with the bright side the same from both ends,
    contrasts within a factor of 7, and an edge (:func:`follow_edges`) between. The nearest counts; mutual links only.
    With ``has_dots`` edges are read near them, on both sides of the dot that covers their middle third.
    With ``has_markers`` 24 nearest, and edges are read near them, at 0.15 to 0.85 of the way: markers are printed beside them; 96 nearest if
    ``is_oblique``.
    """
    neighbour, back_ray = np.empty((len(points_px), 4), np.int64), np.empty((len(points_px), 4), np.int64)
    rays, contrast = (np.ascontiguousarray(a, dtype=float) for a in (rays_rad, contrast_dn))
    _kernel.link_corners(
        np.ascontiguousarray(smooth),
        _places(points_px),
        rays,
        contrast,
        float(max_turn_rad),
        has_markers,
        is_oblique,
        has_dots,
        neighbour,
        back_ray,
    )
    return neighbour, back_ray


def grow_groups(
    points_px: Float[ndarray, "n 2"], neighbour: Int[ndarray, "n 4"], back_ray: Int[ndarray, "n 4"]
) -> list[tuple[Int[ndarray, "m"], Int[ndarray, "m 2"], Int[ndarray, "m"]]]:
    """Connected corners: members from the seed outwards, integer cells (column, row), and the turn of their rays.

    Seeds are taken by falling number of links, at least two. A corner whose links disagree is left out, and so is a link
    that ends more than half a step from where the row behind it, or a row beside it, leads.
    """
    n = len(neighbour)
    members, cells, turns, groups = (np.empty(shape, np.int64) for shape in (n, (n, 2), n, n))
    count = _kernel.grow_groups(_places(points_px), neighbour, back_ray, members, cells, turns, groups)
    ends = (np.flatnonzero(np.diff(groups[:count], append=-1)) + 1).tolist()
    return [(members[a:b], cells[a:b], turns[a:b]) for a, b in pairwise([0, *ends])]


def _places(points_px: ndarray) -> Float[ndarray, "n 2"]:
    return np.ascontiguousarray(points_px, dtype=float).reshape(-1, 2)
