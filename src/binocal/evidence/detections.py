"""Measured board points of both cameras, view by view: where the images end and the geometry begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy import ndarray

from binocal.errors import DataError
from binocal.shapes import Bool, Float, Int
from binocal.values import ArrayValue, frozen_array

COVARIANCES = (
    "left_covariance_px2",
    "right_covariance_px2",
    "left_cross_covariance_px2",
    "right_cross_covariance_px2",
)
PER_CORNER = ("left_px", "right_px", *COVARIANCES)  # the arrays (views, n, ...)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Detections(ArrayValue):
    """Corners of ``n_views`` views of one board of n points in two cameras.

    NaN marks a corner that was not seen; a view may lack a camera altogether. ``is_metric`` says that object points
    are metres. Covariances say how well each corner was measured, NaN (or None for all of a camera's) where that is not
    known; the solver weighs corners accordingly. ``board_spec`` is the board's SPEC text, where somebody said it.
    Cross-covariances are, for each corner, the sum of its covariances with the image's other corners (symmetric part),
    where corners were measured from some of the same pixels; None where their errors are independent.
    ``shots`` says of which pair of images each view is, where a pair shows several boards: every board of a pair is then a view of its
    own, and views are of different boards even where these are alike. None where every view is a pair, and all are of one board.
    Object points may lie anywhere in space. ``object_sigma_m`` is the standard deviation of each one's coordinates where it is only
    roughly known; the solver then moves it. None where all are exact, or a flat board's whose shape is estimated otherwise.
    """

    object_points_m: Float[ndarray, "n 3"]
    left_px: Float[ndarray, "views n 2"]
    right_px: Float[ndarray, "views n 2"]
    left_size_wh: tuple[int, int]
    right_size_wh: tuple[int, int]
    names: tuple[str, ...]
    is_metric: bool = True
    left_covariance_px2: Float[ndarray, "views n 2 2"] | None = None
    right_covariance_px2: Float[ndarray, "views n 2 2"] | None = None
    board_spec: str | None = None
    left_cross_covariance_px2: Float[ndarray, "views n 2 2"] | None = None
    right_cross_covariance_px2: Float[ndarray, "views n 2 2"] | None = None
    shots: tuple[int, ...] | None = None
    object_sigma_m: Float[ndarray, "n"] | None = None

    def __post_init__(self) -> None:
        arrays = {}
        for name in ("object_points_m", "left_px", "right_px"):
            array = arrays[name] = frozen_array(getattr(self, name))
            object.__setattr__(self, name, array)
        points, left, right = arrays.values()
        if points.ndim != 2 or points.shape[1] != 3 or not np.all(np.isfinite(points)):
            raise ValueError(f"object_points_m must be finite (n, 3); got {points.shape}")
        if self.object_sigma_m is not None:
            sigma = frozen_array(self.object_sigma_m)
            object.__setattr__(self, "object_sigma_m", sigma)
            if sigma.shape != (len(points),):
                raise ValueError(f"object_sigma_m must be one for each of the {len(points)} points; got {sigma.shape}")
            if not np.all(np.isfinite(sigma) & (sigma >= 0)):
                at = int(np.argmin(np.isfinite(sigma) & (sigma >= 0)))
                raise ValueError(f"object_sigma_m must be finite and 0 or more; that of point {at} is {sigma[at]}")
        if (
            left.ndim != 3
            or right.ndim != 3
            or left.shape[1:] != (len(points), 2)
            or right.shape[1:] != (len(points), 2)
        ):
            raise ValueError(
                f"corners must be (views, {len(points)}, 2), one row per object point; got left {left.shape}, right {right.shape}"
            )
        if len(left) != len(right):
            raise DataError(
                f"{len(left)} left views against {len(right)} right views: each view needs both; "
                "pair them first and mark a missing camera's corners as NaN."
            )
        if len(self.names) != len(left):
            raise ValueError(f"{len(self.names)} names for {len(left)} views")
        if self.shots is not None:
            object.__setattr__(self, "shots", tuple(int(shot) for shot in self.shots))
            if len(self.shots) != len(left):
                raise ValueError(f"{len(self.shots)} shots for {len(left)} views")
        for side, px in (("left", left), ("right", right)):
            if np.any(np.isinf(px)):
                raise DataError(f"{side} corners hold infinite values; mark corners that were not seen as NaN.")
            half = np.isnan(px[..., 0]) != np.isnan(px[..., 1])
            if half.any():
                view, corner = np.argwhere(half)[0]
                raise DataError(
                    f"{side} view {self.names[view]}, corner {corner}: one coordinate is NaN and the other is not; "
                    "a corner that was not seen has both NaN."
                )
        for size in (self.left_size_wh, self.right_size_wh):
            if len(size) != 2 or min(size) < 1:
                raise ValueError(f"an image size is (width, height) in pixels; got {size}")
        self._keep_covariances()

    def _keep_covariances(self) -> None:
        for side, kind in ((side, kind) for side in ("left", "right") for kind in ("covariance", "cross_covariance")):
            if getattr(self, f"{side}_{kind}_px2") is None:
                continue
            covariance = frozen_array(getattr(self, f"{side}_{kind}_px2"))
            if covariance.shape != (*self.left_px.shape, 2):
                raise ValueError(f"{side} covariances must be {(*self.left_px.shape, 2)}; got {covariance.shape}")
            xx, xy, yx, yy = (covariance[..., i, j] for i in (0, 1) for j in (0, 1))
            size2 = xx * yy * (1 + 1e-9)  # rounding makes a matrix of rank one no worse than that
            is_covariance = (xx >= 0) & (yy >= 0) & ((xy - yx) ** 2 <= 1e-12 * size2) & (xy * yx <= size2)
            is_wrong = ~is_covariance & ~np.isnan(covariance).any(axis=(-1, -2))
            if is_wrong.any():
                view, corner = np.argwhere(is_wrong)[0]
                raise ValueError(
                    f"{side} view {self.names[view]}, corner {corner}: not a covariance (NaN where unknown)"
                )
            object.__setattr__(self, f"{side}_{kind}_px2", covariance)

    @staticmethod
    def from_arrays(
        object_points_m: Float[ndarray, "n 3"],
        left_px: Float[ndarray, "views n 2"],
        right_px: Float[ndarray, "views n 2"],
        image_size_wh: tuple[int, int],
        *,
        right_image_size_wh: tuple[int, int] | None = None,
        names: tuple[str, ...] | None = None,
        is_metric: bool = True,
        left_covariance_px2: Float[ndarray, "views n 2 2"] | None = None,
        right_covariance_px2: Float[ndarray, "views n 2 2"] | None = None,
        board_spec: str | None = None,
        object_sigma_m: Float[ndarray, "n"] | float | None = None,
    ) -> Detections:
        """Detections of plain arrays. The right camera's image size is the left's unless given.

        ``object_sigma_m`` may be one number for all points.

        Raises:
            ValueError: A shape is wrong, or a covariance is none.
            DataError: The numbers cannot be corners, or left and right differ in their number of views.
        """
        left_size = (int(image_size_wh[0]), int(image_size_wh[1]))
        right_size = (
            left_size if right_image_size_wh is None else (int(right_image_size_wh[0]), int(right_image_size_wh[1]))
        )
        n_views = len(left_px)
        width = len(str(max(n_views - 1, 0)))
        return Detections(
            object_points_m,
            left_px,
            right_px,
            left_size,
            right_size,
            tuple(names) if names is not None else tuple(f"{i:0{width}d}" for i in range(n_views)),
            is_metric,
            left_covariance_px2,
            right_covariance_px2,
            board_spec,
            object_sigma_m=None if object_sigma_m is None else _for_each_point(object_sigma_m, len(object_points_m)),
        )

    def __repr__(self) -> str:
        sides = []
        for side in ("left", "right"):
            (width, height), is_seen = getattr(self, f"{side}_size_wh"), getattr(self, f"{side}_is_seen")
            sides.append(f"{side} {width}x{height}: {is_seen.sum()} corners in {is_seen.any(axis=1).sum()} views")
        board = self.board_spec or f"{len(self.object_points_m)} points"
        covariances = ", with covariances" if self.has_covariances else ""
        return f"<Detections: {self.n_views} views of {board}; {'; '.join(sides)}{covariances}>"

    @property
    def n_views(self) -> int:
        """Number of views, used or not."""
        return len(self.names)

    @property
    def left_is_seen(self) -> Bool[ndarray, "views n"]:
        """Which corners the left camera saw."""
        return np.isfinite(self.left_px[..., 0])

    @property
    def right_is_seen(self) -> Bool[ndarray, "views n"]:
        """Which corners the right camera saw."""
        return np.isfinite(self.right_px[..., 0])

    @property
    def has_covariances(self) -> bool:
        """Whether it is known of any corner how well it was measured."""
        sides = (self.left_covariance_px2, self.right_covariance_px2)
        return any(side is not None and bool(np.isfinite(side).any()) for side in sides)

    def select(self, views: Int[ndarray, "k"] | Bool[ndarray, "views"]) -> Detections:
        """The detections of some views only, in the order given."""
        index = np.arange(self.n_views)[views]
        arrays = {name: value[index] for name in PER_CORNER if (value := getattr(self, name)) is not None}
        shots = None if self.shots is None else tuple(self.shots[i] for i in index)
        return replace(self, names=tuple(self.names[i] for i in index), shots=shots, **arrays)

    def reorder(self, side: Literal["left", "right"], orders: Mapping[int, Int[ndarray, "n"]]) -> Detections:
        """The detections with one camera's corners in another order, view by view: corner i becomes ``order[i]``."""
        changed = {}
        for name in (name for name in PER_CORNER if name.startswith(side)):
            if orders and getattr(self, name) is not None:
                array = getattr(self, name).copy()
                for view, order in orders.items():
                    array[view] = array[view][order]
                changed[name] = array
        return replace(self, **changed) if changed else self


def _for_each_point(sigma_m: Float[ndarray, "n"] | float, n: int) -> Float[ndarray, "m"]:
    """One number for all points is that of each."""
    sigma = np.asarray(sigma_m, dtype=float)
    return np.full(n, float(sigma)) if sigma.ndim == 0 else sigma
