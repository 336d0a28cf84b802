"""Lattices of X-corners whose faces bear markers: faces, what is printed in them, votes and growth.

Images are C-contiguous (h, w). Points are (x, y), (0, 0) the centre of the top-left pixel. The kernel holds no lock while it works.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import as_floats
from binocal.shapes import Bool, Float, Float32, Int

REACH_OF_VOTES = 3.2  # pitches: farther markers hardly tell of each other through a lens


@dataclass(frozen=True, slots=True)
class FieldLens:
    """An equidistant lens about (cx, cy) with ``f_px`` pixels a radian, roughly the image's own; 0: the image is a plane."""

    cx: float = 0.0
    cy: float = 0.0
    f_px: float = 0.0

    @staticmethod
    def of_field(size_wh: tuple[int, int], field_rad: float) -> FieldLens:
        """The lens that sees such a field across the image's width; of 0 the one that leaves the image a plane."""
        width, height = size_wh
        return FieldLens((width - 1) / 2, (height - 1) / 2, width / field_rad if field_rad else 0.0)

    def scaled(self, scale: float, shift: float) -> FieldLens:
        """The lens of a scaled image."""
        return FieldLens(scale * self.cx + shift, scale * self.cy + shift, scale * self.f_px)


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """The lines at whose crossings a board has X-corners: their x and y on the board, ascending; ``pitch`` of its markers."""

    x: Float[ndarray, "columns"]
    y: Float[ndarray, "rows"]
    pitch: float


def find_faces(
    neighbour: Int[ndarray, "n 4"], back_ray: Int[ndarray, "n 4"]
) -> tuple[Int[ndarray, "m 4"], Bool[ndarray, "m"]]:
    """Faces that four links enclose: their corners, clockwise on the screen, and which are bright.

    Links are :func:`binocal.kernels.images.link_corners`'.
    """
    faces, parity = np.empty((len(neighbour), 4), np.int64), np.empty(len(neighbour), np.int64)
    count = _kernel.find_faces(np.ascontiguousarray(neighbour), np.ascontiguousarray(back_ray), faces, parity)
    return faces[:count], parity[:count] == 0


def read_cells(
    image: ndarray, quads_px: Float[ndarray, "n 4 2"], places: Float[ndarray, "cells k 2"], lens: FieldLens
) -> Float32[ndarray, "n cells"]:
    """Mean grey value of each cell in each face of a uint8 or float32 image; a cell's ``places`` are in the face's unit square."""
    n_cells, per_cell = places.shape[:2]
    values = np.empty((len(quads_px), n_cells), np.float32)
    _kernel.read_cells(
        np.ascontiguousarray(image),
        as_floats(quads_px),
        as_floats(places),
        per_cell,
        lens.cx,
        lens.cy,
        lens.f_px,
        values,
    )
    return values


def vote_on_tags(
    quads_px: Float[ndarray, "n 4 2"], places: Float[ndarray, "n 4 2"], lens: FieldLens, pitch: float
) -> tuple[Int[ndarray, "n"], Int[ndarray, "n"], Int[ndarray, "n"]]:
    """Groups of markers each of which lies where one beside it puts it, and how many agree and disagree with each.

    ``places`` are the corners on the board. One marker's homography puts another's corners to 0.2 and 0.15 a pitch of their
    distance, in sides of the other.
    """
    n = len(quads_px)
    group, agreeing, disagreeing = (np.empty(n, np.int64) for _ in range(3))
    _kernel.vote_on_tags(
        as_floats(quads_px),
        as_floats(places),
        lens.cx,
        lens.cy,
        lens.f_px,
        float(pitch),
        REACH_OF_VOTES,
        group,
        agreeing,
        disagreeing,
    )
    return group, agreeing, disagreeing


def predict_places(
    lines: Lines, known_px: Float[ndarray, "rows columns 2"], lens: FieldLens, places: Float[ndarray, "*n 2"]
) -> Float[ndarray, "*n 2"]:
    """Where places of the board lie in the image by the known corners nearest to them; NaN where those do not tell."""
    flat = as_floats(places.reshape(-1, 2))
    points = np.empty(flat.shape)
    known = np.array(known_px, dtype=float)
    _kernel.predict_places(
        as_floats(lines.x), as_floats(lines.y), float(lines.pitch), known, lens.cx, lens.cy, lens.f_px, flat, points
    )
    return points.reshape(places.shape)


def predict_each(
    lines: Lines,
    known_px: Float[ndarray, "rows columns 2"],
    lens: FieldLens,
    trust: Float[ndarray, "rows columns"] | None = None,
) -> Float[ndarray, "rows columns 2"]:
    """Where each known corner would be expected by those around it; NaN where it is unknown, or they do not tell.

    ``trust`` are the corners' weights.
    """
    known = np.array(known_px, dtype=float)
    points = np.empty(known.shape)
    weight = as_floats(np.ones(known.shape[:2]) if trust is None else trust)
    _kernel.predict_each(
        as_floats(lines.x), as_floats(lines.y), float(lines.pitch), known, weight, lens.cx, lens.cy, lens.f_px, points
    )
    return points


def predict_steps(
    lines: Lines, known_px: Float[ndarray, "rows columns 2"], lens: FieldLens, probe: float
) -> Float[ndarray, "rows columns 2 2"]:
    """What a unit of the board along its x, and along its y, is in the image at each known corner.

    By differences over ``probe`` to both sides; NaN where unknown, or where the corners around do not tell.
    """
    known = np.array(known_px, dtype=float)
    steps = np.empty((*known.shape, 2))
    _kernel.predict_steps(
        as_floats(lines.x),
        as_floats(lines.y),
        float(lines.pitch),
        known,
        lens.cx,
        lens.cy,
        lens.f_px,
        float(probe),
        steps,
    )
    return steps


def grow_lattice(
    image: ndarray,
    lines: Lines,
    sign: float,
    free: float,
    known_px: Float[ndarray, "rows columns 2"],
    candidates_px: Float[ndarray, "n 2"],
    lens: FieldLens,
    *,
    has_dots: bool = False,
) -> tuple[Float[ndarray, "rows columns 2"], Bool[ndarray, "rows columns"]]:
    """The known corners with those candidates that lie where the ones around put them, and which are new.

    ``sign`` is 1 where the face beyond the first corner is bright, -1 where it is dark; ``free`` is how far from a corner,
    along both axes, nothing else is printed, in the unit of the lines; ``has_dots`` where the middle of every edge bears one.
    """
    known = np.array(known_px, dtype=float)
    is_new = np.zeros(known.shape[:2], bool)
    _kernel.grow_lattice(
        np.ascontiguousarray(image),
        as_floats(lines.x),
        as_floats(lines.y),
        float(lines.pitch),
        float(sign),
        float(free),
        has_dots,
        known,
        as_floats(candidates_px),
        lens.cx,
        lens.cy,
        lens.f_px,
        is_new,
    )
    return known, is_new
