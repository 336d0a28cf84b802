"""Rectification of two cameras: rotations, projection, and the canvas that shows what both see."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
from numpy import ndarray

from binocal.cameras.camera import MOST_SIDE_PX, Camera
from binocal.cameras.common_field import choose_projection, common_field, fits, trimmed, whole_window, window_of
from binocal.cameras.epipolar_projection import PROJECTIONS, EpipolarProjection, ProjectionKind
from binocal.cameras.rectified_canvas import Canvas, between, covered_canvas, fit_canvas
from binocal.cameras.rectifying_rotations import RectifyingRotations, rectifying_rotations
from binocal.errors import DegenerateGeometryError
from binocal.geometry import SE3
from binocal.shapes import Float
from binocal.values import ArrayValue, frozen_array

COVERAGE_GRID = (64, 48)
PINHOLE_COSINE = float(np.cos(np.radians(75.0)))  # rows of a pinhole are 15 times as far apart there as in the middle
BORDER_PLACES = 9  # along each side of an image

Projection: TypeAlias = "Float[ndarray, '3 4'] | EpipolarProjection"
"""A pinhole's 3x4 matrix, or a projection that has none."""


@dataclass(frozen=True, slots=True, eq=False)
class Rectification(ArrayValue):
    """How both images are brought to common rows.

    ``R_rect_left`` and ``R_rect_right`` (OpenCV's R1, R2) rotate camera coordinates into the rectified frames; ``left`` and ``right``
    are the projections there. They differ at most in their centre along the baseline: they share it, so that disparity is zero at
    infinity (OpenCV's ``CALIB_ZERO_DISPARITY``), unless the cameras converge so much that no common window shows both fields.
    """

    R_rect_left: Float[ndarray, "3 3"]
    R_rect_right: Float[ndarray, "3 3"]
    left: EpipolarProjection
    right: EpipolarProjection
    offset_m: float
    """What takes a coordinate along the baseline from ``rect_left`` to ``rect_right``: minus the baseline, plus it if swapped."""
    size_wh: tuple[int, int]
    covered: tuple[float, float] = (float("nan"), float("nan"))
    """The share of the left and the right rectified image that is covered by the camera's image; NaN where it was not asked for."""
    kept: float = float("nan")
    """The share of what both cameras see of each other's field that the rectified images show; the lower one of both."""

    def __post_init__(self) -> None:
        for name in ("R_rect_left", "R_rect_right"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    @property
    def projection(self) -> ProjectionKind:
        """What kind of projection both images have."""
        return self.left.kind

    @property
    def is_vertical(self) -> bool:
        """The cameras stand one above the other: matching points share a column, not a row."""
        return self.left.is_vertical

    @property
    def is_swapped(self) -> bool:
        """The camera called right stands on the other's left (above it, if vertical); disparity is negative at infinity and below."""
        return self.offset_m > 0

    @property
    def P_left(self) -> Projection:
        """OpenCV's P1, which projects points of ``rect_left`` to rectified left pixels; the projection itself where it is no pinhole."""
        return _matrix(self.left, 0.0) if self.projection == "pinhole" else self.left

    @property
    def P_right(self) -> Projection:
        """OpenCV's P2, which projects points of ``rect_left`` to rectified right pixels; the projection where it is no pinhole."""
        return _matrix(self.right, self.offset_m) if self.projection == "pinhole" else self.right

    @property
    def infinity_px(self) -> float:
        """Disparity of a point at infinity straight ahead: 0 where both images share their principal point."""
        a = self.left.along
        return float(self.left.centre_px[a] - self.right.centre_px[a])

    @property
    def Q(self) -> Float[ndarray, "4 4"]:
        """Depth matrix: ``Q @ (x, y, disparity, 1)`` is the homogeneous point in ``rect_left``.

        Disparity is left minus right, along x (along y if vertical); it is negative where ``is_swapped``, and so is the
        baseline entry, so that depth stays positive.

        Raises:
            DegenerateGeometryError: The projection is no pinhole: its depth is not linear in the disparity; use
                :func:`binocal.rectification.points_from_disparity`.
        """
        if self.projection != "pinhole":
            raise DegenerateGeometryError(
                f"these cameras are rectified by a {self.projection} projection, which has no matrix Q; use points_from_disparity, "
                "or rectify with projection='pinhole' for the part that a pinhole can show."
            )
        focal_px = self.left.focal_px[0]
        Q = np.zeros((4, 4))
        Q[0, 0] = Q[1, 1] = 1.0
        Q[:2, 3] = -self.left.centre_px
        Q[2, 3] = focal_px
        Q[3, 2] = -1.0 / self.offset_m
        Q[3, 3] = self.infinity_px / self.offset_m
        return Q


def rectify_cameras(
    left: Camera,
    right: Camera,
    T_right_left: SE3,
    *,
    size_wh: tuple[int, int] | None = None,
    alpha: float | None = None,
    projection: Literal["auto"] | ProjectionKind = "auto",
) -> Rectification:
    """Rectification of two cameras of any model: see :meth:`binocal.StereoRig.rectify`.

    Raises:
        DegenerateGeometryError: The baseline is zero, or lies along the viewing direction; or the cameras see nothing in common.
        ValueError: A size, ``alpha`` or a projection that is none.
    """
    if alpha is not None and not 0 <= alpha <= 1:
        raise ValueError(f"alpha is between 0 (valid pixels only) and 1 (every pixel of both images); got {alpha}")
    if size_wh is not None and not all(1 <= side <= MOST_SIDE_PX and side == int(side) for side in size_wh):
        raise ValueError(f"size_wh is (width, height) in whole pixels; got {size_wh}")
    if projection not in ("auto", *PROJECTIONS):
        raise ValueError(f"unknown projection {projection!r}; known: auto, {', '.join(PROJECTIONS)}")
    cameras = left, right
    rotations = rectifying_rotations(T_right_left)
    everything = common_field(cameras, rotations, "equirectangular")
    if projection == "auto":
        shown = trimmed(everything)
        kind = choose_projection(everything.rays[shown], rotations.along)
    else:
        kind = projection
    field = everything if kind == "equirectangular" else common_field(cameras, rotations, kind)
    canvas = fit_canvas(window_of(field, trimmed(field)), rotations.along, cameras, size_wh)
    if alpha is not None:
        whole = fit_canvas(whole_window(cameras, rotations, kind), rotations.along, cameras, canvas.size_wh)
        is_covered = partial(_covers, cameras, rotations, kind)
        canvas = between(canvas if alpha == 1 else covered_canvas(canvas, is_covered), whole, alpha)
    projections = canvas.projections(kind)
    R = rotations.R_rect_left, rotations.R_rect_right
    covered, kept = [], []
    for i, (camera, shown) in enumerate(zip(cameras, projections, strict=True)):
        covered.append(_covered(camera, R[i], shown, canvas.size_wh))
        kept.append(_kept(everything.rays[i][everything.is_common[i]], shown, canvas.size_wh))
    return Rectification(*R, *projections, rotations.offset_m, canvas.size_wh, (covered[0], covered[1]), min(kept))


def rectify_at_camera_scale(left: Camera, right: Camera, T_right_left: SE3) -> Rectification:
    """A projection of the cameras' own scale, whatever of the images it shows: rows are then in pixels of the cameras.

    A pinhole, or a cylinder about the baseline where a camera sees farther than 75° from the rectified direction: a pinhole's rows
    grow beyond bounds there. The focal length is the smaller of the vertical ones (the horizontal ones if vertical), the common
    principal point centres the middles of both images. For row errors of single points; to see images, rectify them by
    :func:`rectify_cameras`.

    Raises:
        DegenerateGeometryError: As :func:`rectifying_rotations`; or a camera looks 90° or more away from the rectified direction.
    """
    rotations = rectifying_rotations(T_right_left)
    axis = rotations.along
    focal_px = min(camera.parameters[1 - axis] for camera in (left, right))
    R = rotations.R_rect_left, rotations.R_rect_right
    is_wide = any(_sees_far_aside(camera, turn) for camera, turn in zip((left, right), R, strict=True))
    kind: ProjectionKind = "cylindrical" if is_wide else "pinhole"
    ahead = EpipolarProjection("pinhole", np.ones(2), np.zeros(2), rotations.is_vertical)
    middle = [
        ahead.project(R @ camera.unproject((np.array(camera.size_wh) - 1) / 2)) * focal_px
        for camera, R in ((left, rotations.R_rect_left), (right, rotations.R_rect_right))
    ]
    if not np.all(np.isfinite(middle)):
        raise DegenerateGeometryError(
            "a camera looks 90 deg or more away from the rectified direction, or its model has no ray at the image's "
            "centre: the images cannot be rectified."
        )
    centre = (np.array(left.size_wh) - 1) / 2 - np.mean(middle, axis=0)
    shown = EpipolarProjection(kind, np.full(2, focal_px), centre, rotations.is_vertical)
    return Rectification(*R, shown, shown, rotations.offset_m, left.size_wh)


def _sees_far_aside(camera: Camera, R_rect_camera: Float[ndarray, "3 3"]) -> bool:
    """Whether places at the image's border lie too far from the rectified direction for a pinhole's rows."""
    steps = np.linspace(0, 1, BORDER_PLACES)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    border = np.stack([x, y], axis=-1)[(np.minimum(x, 1 - x) == 0) | (np.minimum(y, 1 - y) == 0)]
    rays = camera.unproject(border * (np.array(camera.size_wh) - 1)) @ R_rect_camera.T
    with np.errstate(invalid="ignore"):
        return bool((rays[:, 2] < PINHOLE_COSINE * np.linalg.norm(rays, axis=-1)).any())


def _covers(
    cameras: tuple[Camera, Camera], rotations: RectifyingRotations, kind: ProjectionKind, canvas: Canvas
) -> bool:
    return fits(cameras, rotations, canvas.projections(kind), canvas.size_wh)


def _covered(
    camera: Camera, R_rect_camera: Float[ndarray, "3 3"], shown: EpipolarProjection, size_wh: tuple[int, int]
) -> float:
    """The share of the canvas where the camera sees something."""
    columns, rows = ((np.arange(n) + 0.5) * side / n - 0.5 for side, n in zip(size_wh, COVERAGE_GRID, strict=True))
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    return float(camera.sees(shown.unproject(pixels) @ R_rect_camera).mean())


def _kept(rays: Float[ndarray, "n 3"], shown: EpipolarProjection, size_wh: tuple[int, int]) -> float:
    """The share of these rays, in equal steps of angles along and across the baseline, that the canvas shows."""
    pixels = shown.project(rays)
    with np.errstate(invalid="ignore"):
        is_shown = np.all((pixels >= -0.5) & (pixels <= np.array(size_wh) - 0.5), axis=-1)
    area = np.hypot(rays[:, 1 - shown.along], rays[:, 2]) / np.linalg.norm(rays, axis=-1)  # of a step, on the sphere
    return float(area[is_shown].sum() / area.sum())


def _matrix(shown: EpipolarProjection, offset_m: float) -> Float[ndarray, "3 4"]:
    P = np.zeros((3, 4))
    P[[0, 1], [0, 1]], P[:2, 2], P[2, 2] = shown.focal_px, shown.centre_px, 1.0
    P[shown.along, 3] = shown.focal_px[shown.along] * offset_m
    return P
