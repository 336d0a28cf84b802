"""A board as it is printed and mounted: bent, and with every corner a little off its place."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.shapes import Float
from binocal.simulation.layout import printed_extent_m

_EVERY = 4  # pixels
_FLAT_SHARE = 2e-3  # of the print error: heights that are no bow, for an inverse
_DIRECTIONS = 36  # of bows, over half a turn
_ROUNDS = 30  # of fixed points whose error falls a hundredfold each


@dataclass(frozen=True, eq=False)
class PrintedShape:
    """Where the print of a board lies in space; all in pitches of the board, in its frame.

    What is drawn at p is found on the sheet at x with x - d(x) = p, where d is a smooth field (a cubic spline through the
    ``offsets`` at the ``x_nodes`` and ``y_nodes``, constant beyond them), and the sheet is a cylinder of height ``bow`` about a line in its
    middle: z = bow (1 - (s / half)²), s the distance from that line.
    """

    x_nodes: Float[ndarray, "columns"]
    y_nodes: Float[ndarray, "rows"]
    offsets: Float[ndarray, "2 rows columns"]
    bow: float
    middle: Float[ndarray, "2"]
    across: Float[ndarray, "2"]
    """Unit vector along which the sheet bends."""
    half: float

    @cached_property
    def _splines(self) -> tuple:
        from scipy.interpolate import RectBivariateSpline

        return tuple(RectBivariateSpline(self.y_nodes, self.x_nodes, field) for field in self.offsets)

    def drawn_at(self, x: ndarray, y: ndarray) -> tuple[ndarray, ndarray]:
        """Which place of the drawing is printed at places of the sheet."""
        inside = np.clip(x, self.x_nodes[0], self.x_nodes[-1]), np.clip(y, self.y_nodes[0], self.y_nodes[-1])
        dx, dy = (spline.ev(inside[1], inside[0]) for spline in self._splines)
        return x - dx, y - dy

    def drawn_over_image(self, x: Float[ndarray, "h w"], y: Float[ndarray, "h w"]) -> tuple[ndarray, ndarray]:
        """The same for the places that neighbouring pixels see, which vary smoothly over the image, at a quarter of the cost.

        The field is looked up at every fourth pixel; a cubic spline over the image is 1e-4 px off where a pitch is 25 pixels.
        """
        from scipy.interpolate import RectBivariateSpline

        height, width = x.shape
        if min(height, width) < 4 * _EVERY:
            return self.drawn_at(x, y)
        rows, columns = (np.unique(np.r_[0:n:_EVERY, n - 1]) for n in (height, width))
        some = np.ix_(rows, columns)
        drawn = self.drawn_at(x[some], y[some])
        off = (a - b for a, b in zip(drawn, (x[some], y[some]), strict=True))
        over = (RectBivariateSpline(rows, columns, field)(np.arange(height), np.arange(width)) for field in off)
        dx, dy = over
        return x + dx, y + dy

    def height(self, x: ndarray, y: ndarray) -> ndarray:
        """Z of the sheet."""
        s = (self.across[0] * (x - self.middle[0]) + self.across[1] * (y - self.middle[1])) / self.half
        return self.bow * (1 - s * s)

    def points(self, drawn: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Where points of the drawing are in space."""
        x, y = drawn[:, 0].copy(), drawn[:, 1].copy()
        for _ in range(_ROUNDS):
            there = self.drawn_at(x, y)
            x, y = x + drawn[:, 0] - there[0], y + drawn[:, 1] - there[1]
        return np.stack([x, y, self.height(x, y)], axis=-1)

    def points_m(self, board: Board) -> Float[ndarray, "n 3"]:
        """The board's points as they are, metres."""
        return self.points(board.object_points_m / board.pitch_m) * board.pitch_m


def draw_printed_shape(board: Board, rng: np.random.Generator, *, bow_m: float, error_m: float) -> PrintedShape:
    """A random shape: bent by ``bow_m`` about any direction, to either side; offsets of standard deviation ``error_m`` in x and in y.

    The offsets are independent from one pitch to the next.
    """
    x0, y0, x1, y1 = np.array(printed_extent_m(board)) / board.pitch_m
    nodes = [np.arange(np.floor(a), np.ceil(b) + 1) for a, b in ((x0, x1), (y0, y1))]
    nodes = [np.concatenate([n, n[-1] + np.arange(1, max(0, 4 - len(n)) + 1)]) for n in nodes]  # a cubic takes four
    angle = rng.uniform(0, np.pi)
    across = np.array([np.cos(angle), np.sin(angle)])
    half = 0.5 * float(np.abs(across) @ [x1 - x0, y1 - y0])
    bow = float(rng.choice([-1.0, 1.0])) * bow_m / board.pitch_m
    offsets = error_m / board.pitch_m * rng.standard_normal((2, len(nodes[1]), len(nodes[0])))
    return PrintedShape(nodes[0], nodes[1], offsets, bow, np.array([x0 + x1, y0 + y1]) / 2, across, half)


def printed_points_information(board: Board, *, bow_m: float, error_m: float) -> Float[ndarray, "m m"]:
    """Inverse covariance of how far the points of such a board are from where they are drawn: x of all, then y, z; per square metre.

    The bow's sign and direction are random, so its heights have mean 0; their covariance is the mean over directions. Both figures must
    be above 0.
    """
    n, (x0, y0, x1, y1) = len(board.object_points_m), printed_extent_m(board)
    covariance = np.zeros((3 * n, 3 * n))
    covariance[range(2 * n), range(2 * n)] = error_m**2
    middle, extent = np.array([x0 + x1, y0 + y1]) / 2, np.array([x1 - x0, y1 - y0])
    angles = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    across = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    from_line = (board.object_points_m[:, :2] - middle) @ across.T / (0.5 * np.abs(across) @ extent)
    heights = bow_m * (1 - from_line**2)
    covariance[2 * n :, 2 * n :] = heights @ heights.T / _DIRECTIONS + (_FLAT_SHARE * error_m) ** 2 * np.eye(n)
    return np.linalg.inv(covariance)
