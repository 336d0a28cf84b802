"""What markers look like, cell by cell: codes of a dictionary as soft templates.

A cell of a small marker holds its neighbours' light too. Templates are therefore blurred as the image is, and what all of them
share (border, rim, light slopes) is taken out before they are compared: a board's mirror image would read as the board otherwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy import ndarray

from binocal.detection.finding.markers import get_dictionary
from binocal.shapes import Float, Float32, Int

BLURS_CELLS = (0.2, 0.5, 0.8, 1.1)  # sigmas, cells: with 1.1 and more no marker is read
SAMPLES = (-0.25, 0.25)  # of a cell, along both axes


@dataclass(frozen=True, slots=True)
class CodeKind:
    """How a board's markers are printed in the faces of its lattice."""

    dictionary: str
    border_bits: int
    inset: float
    """Of the marker in its face, in sides of the face."""
    rim: float
    """Width of the plain rim about the marker, in its sides."""


@dataclass(frozen=True, slots=True, eq=False)
class CodeTemplates:
    """Codes at one blur: rows for ids, for the four quarter turns (and mirrored), of unit length without what all share."""

    ids: Int[ndarray, "m"]
    turned: Float32[ndarray, "m 4 cells"]
    mirrored: Float32[ndarray, "m 4 cells"]
    shared: Float32[ndarray, "cells k"]
    """Orthonormal: constant, slopes and the mean of all codes."""

    def residual(self, values: Float32[ndarray, "n cells"]) -> Float32[ndarray, "n cells"]:
        """Readings without what all codes share, of unit length; zero where nothing is left."""
        rest = values - (values @ self.shared) @ self.shared.T
        length = np.linalg.norm(rest, axis=1, keepdims=True)
        return np.where(length > 1e-3, rest / np.maximum(length, 1e-3), 0).astype(np.float32)


def face_cells(kind: CodeKind) -> float:
    """A face's side in cells of its marker's code."""
    return (get_dictionary(kind.dictionary).markerSize + 2 * kind.border_bits) / (1 - 2 * kind.inset)


@lru_cache(maxsize=16)
def cell_places(kind: CodeKind) -> Float[ndarray, "cells 4 2"]:
    """Where the cells of :func:`code_templates` are read, in a face's unit square."""
    n = get_dictionary(kind.dictionary).markerSize + 2 * kind.border_bits
    cell = (1 - 2 * kind.inset) / n
    rim = min(cell, kind.rim * (1 - 2 * kind.inset))
    middle = np.r_[kind.inset - rim / 2, kind.inset + cell * (np.arange(n) + 0.5), 1 - kind.inset + rim / 2]
    width = np.r_[rim, np.full(n, cell), rim]
    at = middle[:, None] + width[:, None] * np.array(SAMPLES)  # (n + 2, 2)
    y, x = np.meshgrid(at.ravel(), at.ravel(), indexing="ij")
    places = np.stack([x, y], axis=-1).reshape(n + 2, 2, n + 2, 2, 2).swapaxes(1, 2).reshape(n + 2, n + 2, 4, 2)
    return places.reshape(-1, 4, 2)[_is_used(n + 2)]


@lru_cache(maxsize=64)
def code_templates(kind: CodeKind, first_id: int, n_ids: int, blur_cells: float) -> CodeTemplates:
    """Templates of the ids from ``first_id`` on."""
    dictionary = get_dictionary(kind.dictionary)
    size, border = dictionary.markerSize, kind.border_bits
    n = size + 2 * border + 2
    ids = np.arange(first_id, min(first_id + n_ids, len(dictionary.bytesList)))
    cells = np.zeros((len(ids), n, n))
    cells[:, [0, -1], :] = cells[:, :, [0, -1]] = 1
    for k, index in enumerate(ids):
        bits = cv2.aruco.Dictionary.getBitsFromByteList(dictionary.bytesList[index : index + 1], size)
        cells[k, border + 1 : n - 1 - border, border + 1 : n - 1 - border] = bits
    B = _blur_of_cells(n, blur_cells)
    cells = B @ cells @ B.T
    used = _is_used(n)
    # A marker whose own first corner is the face's k-th is turned clockwise k times.
    turned = np.stack([np.rot90(cells, -k, axes=(1, 2)) for k in range(4)], axis=1)
    # Seen from behind, the marker's own corners run the other way round.
    mirrored = turned.swapaxes(2, 3)
    flat = [a.reshape(len(ids), 4, -1)[:, :, used] for a in (turned, mirrored)]
    y, x = (axis.ravel()[used] for axis in np.mgrid[:n, :n])
    basis = np.stack([np.ones(len(x)), x - x.mean(), y - y.mean(), flat[0].mean(axis=(0, 1))], axis=1)
    shared = np.linalg.qr(basis)[0]
    rest = [a - (a @ shared) @ shared.T for a in flat]
    rest = [(a / np.maximum(np.linalg.norm(a, axis=-1, keepdims=True), 1e-9)).astype(np.float32) for a in rest]
    return CodeTemplates(ids, rest[0], rest[1], shared.astype(np.float32))


def _is_used(n: int) -> ndarray:
    """The rim's corners are left out: an AprilGrid has black squares there."""
    used = np.ones((n, n), bool)
    used[[0, 0, -1, -1], [0, -1, 0, -1]] = False
    return used.ravel()


def _blur_of_cells(n: int, blur_cells: float) -> Float[ndarray, "n n"]:
    """Each cell's share in what is read in another, along one axis; the outermost cells reach on."""
    edge = np.arange(n + 1, dtype=float)
    edge[[0, -1]] = -np.inf, np.inf
    read = np.arange(n)[:, None] + 0.5 + np.array(SAMPLES)
    below = np.vectorize(lambda z: 0.5 * (1 + math.erf(z / math.sqrt(2))))((edge - read[..., None]) / blur_cells)
    return np.diff(below, axis=-1).mean(axis=1)
