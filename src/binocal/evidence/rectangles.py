"""Rectangles of unknown size that two turning cameras saw, one per pair, with what an attitude sensor said of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.errors import DataError
from binocal.shapes import Float, Int
from binocal.values import ArrayValue, frozen_array

SIDES = ("left", "right")


@dataclass(frozen=True, slots=True, eq=False)
class RectanglePairs(ArrayValue):
    """One rectangle per pair: its four corners in both images, in turn around it, and both cameras' rough attitudes.

    An attitude is yaw and pitch, radians: from its pose in the initial rig a camera is turned by yaw about its y axis (down), then by
    pitch about its own new x axis (right). ``attitude_sigma_rad`` is the standard deviation of each of the four angles, pair by pair;
    0 where the cameras stand as in the initial rig. Pairs with one number in ``rectangle`` show one rectangle that does not move.
    """

    left_px: Float[ndarray, "pairs 4 2"]
    right_px: Float[ndarray, "pairs 4 2"]
    left_attitude_rad: Float[ndarray, "pairs 2"]
    right_attitude_rad: Float[ndarray, "pairs 2"]
    attitude_sigma_rad: Float[ndarray, "pairs"]
    rectangle: Int[ndarray, "pairs"]
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        n = len(self.names)
        for name, shape in (
            ("left_px", (n, 4, 2)),
            ("right_px", (n, 4, 2)),
            ("left_attitude_rad", (n, 2)),
            ("right_attitude_rad", (n, 2)),
            ("attitude_sigma_rad", (n,)),
            ("rectangle", (n,)),
        ):
            array = frozen_array(getattr(self, name), int if name == "rectangle" else float)
            if array.shape != shape:
                raise ValueError(f"{name} must be {shape} for {n} pairs; got {array.shape}")
            if not np.isfinite(array).all():
                pair = int(np.argwhere(~np.isfinite(array))[0][0])
                raise DataError(f"pair {self.names[pair]}: {name} holds a number that is not finite.")
            object.__setattr__(self, name, array)
        if (self.attitude_sigma_rad < 0).any():
            raise ValueError("attitude_sigma_rad must be 0 or more")
        for side in SIDES:
            areas = np.abs([_signed_area(px) for px in getattr(self, f"{side}_px")])
            extent = np.ptp(getattr(self, f"{side}_px"), axis=1).max(axis=-1)
            flat = np.flatnonzero(areas < MIN_AREA_SHARE * extent**2)
            if len(flat):
                raise DataError(
                    f"pair {self.names[flat[0]]}: the {side} corners lie on a line or cross; give the four corners in turn around "
                    "the rectangle."
                )

    @property
    def n_pairs(self) -> int:
        """Number of pairs."""
        return len(self.names)

    @property
    def n_views(self) -> int:
        """The same, as every kind of evidence has it."""
        return len(self.names)

    def select(self, rows: Sequence[int]) -> RectanglePairs:
        """These pairs alone."""
        i = np.array(rows, dtype=int)
        return RectanglePairs(
            self.left_px[i],
            self.right_px[i],
            self.left_attitude_rad[i],
            self.right_attitude_rad[i],
            self.attitude_sigma_rad[i],
            self.rectangle[i],
            tuple(self.names[k] for k in i),
        )

    def in_one_turn(self) -> RectanglePairs:
        """The pairs with the corners of both images in the same turn around the rectangle, from the same corner.

        Corner order is matched within each pair, and to the first pair that shows the rectangle, by shape: cameras that yaw and
        pitch hardly roll an image.
        """
        first: dict[int, ndarray] = {}
        left, right = self.left_px.copy(), self.right_px.copy()
        for i, number in enumerate(self.rectangle.tolist()):
            first.setdefault(number, _clockwise(left[i]))
            left[i] = _matched(first[number], left[i])
            right[i] = _matched(left[i], right[i])
        return RectanglePairs(
            left,
            right,
            self.left_attitude_rad,
            self.right_attitude_rad,
            self.attitude_sigma_rad,
            self.rectangle,
            self.names,
        )


MIN_AREA_SHARE = 0.02  # of the square of the extent: 60:1 foreshortened, or corners that cross


def _signed_area(px: Float[ndarray, "4 2"]) -> float:
    x, y = px.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _clockwise(px: Float[ndarray, "4 2"]) -> Float[ndarray, "4 2"]:
    """In the turn that is clockwise on the screen, y down."""
    return px if _signed_area(px) > 0 else px[[0, 3, 2, 1]]


def _matched(reference: Float[ndarray, "4 2"], px: Float[ndarray, "4 2"]) -> Float[ndarray, "4 2"]:
    """The corners from the one that makes their shape most like the reference's, whatever its size."""
    turned = [np.roll(_clockwise(px), -k, axis=0) for k in range(4)]
    shape = (reference - reference.mean(axis=0)) / np.sqrt(abs(_signed_area(reference)))
    away = [np.sum(((p - p.mean(axis=0)) / np.sqrt(abs(_signed_area(p))) - shape) ** 2) for p in turned]
    return turned[int(np.argmin(away))]
