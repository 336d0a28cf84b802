"""The code of PuzzleBoards: one bit on every edge between two corners of a chessboard, a black dot (0) or a white one (1).

Corner (x, y) counts columns and rows from the pattern's top left one, (0, 0); all corners make a square of 501. The bit between
(x, y) and (x + 1, y) is ``BESIDE[x mod 3][y mod 167]``, that between (x, y) and (x, y + 1) is ``BELOW[y mod 3][x mod 167]``. In each
table no two of the 501 windows of 3 x 3 bits are alike, around its ends too. The square whose lower right corner is (x, y)
is black where x + y is even.

Source: Stelldinger, Schönherr and Biermann 2024, "PuzzleBoard: A New Camera Calibration Pattern with Position Encoding", and the
tables of their board generator and decoder (dedicated to the public domain, CC0 1.0), which agree.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Int

PERIOD = 167
REPEATS = 3
SIDE = PERIOD * REPEATS
"""Corners of the whole pattern along a side."""
DOT_RADIUS = 1 / 6  # squares

_BELOW = (
    0x05C3AA91AD8771488FC15FA64AEB87EDACDF73D3D1,
    0x30FDFE89078982230C0E351DD6EC90D31D47131EA4,
    0x20A1D0F5F41242E9B3AD65925997B9C056FAD987A3,
)
_BESIDE = (
    0x7D4FC29BC8264FC68ED211CF404E02F96BEE96B272,
    0x5989ACEC3512AC160705B0FAB6C6792576CE65C719,
    0x182A3D4B0C90187A3D95494BF405AD7F11EBB286FF,
)


def _table(rows: tuple[int, ...]) -> Int[ndarray, "3 167"]:
    """Bits of numbers, the highest first."""
    table = np.array([[int(bit) for bit in f"{row:0{PERIOD}b}"] for row in rows])
    table.setflags(write=False)
    return table


BELOW, BESIDE = _table(_BELOW), _table(_BESIDE)


def bits_beside(x: Int[ndarray, "*n"], y: Int[ndarray, "*n"]) -> Int[ndarray, "*n"]:
    """The bits between corners (x, y) and (x + 1, y) of the pattern."""
    return BESIDE[x % REPEATS, y % PERIOD]


def bits_below(x: Int[ndarray, "*n"], y: Int[ndarray, "*n"]) -> Int[ndarray, "*n"]:
    """The bits between corners (x, y) and (x, y + 1) of the pattern."""
    return BELOW[y % REPEATS, x % PERIOD]
