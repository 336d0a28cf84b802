"""What two cameras both see, in the coordinates of an epipolar projection, and the window that shows it.

A point is seen by both where the left camera sees its ray and the right one a ray on the same row, on the side to which points come as
they come nearer, and not much farther from it than the middles of both images are apart. Cameras that converge need not share a single
direction for that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras.camera import Camera
from binocal.cameras.epipolar_projection import EpipolarProjection, ProjectionKind, coordinates, rays_at
from binocal.cameras.rectifying_rotations import RectifyingRotations
from binocal.errors import DegenerateGeometryError
from binocal.shapes import Bool, Float

ROWS, COLUMNS = 72, 96  # of the raster: windows come out to 1 % of their sides
SAMPLES = 25  # pixels along each side of an image, its border included
FARTHEST_FROM_MIDDLE_DEG = 85.0  # along the baseline: nearer to it, depth vanishes and rows meet
FARTHEST_ACROSS_DEG = 110.0
MOST_STRETCH = 10.0  # of areas, between the places of one image: a pinhole from its middle to 62 deg
LEAST_SHARE = 0.5  # of a row or column that is seen: with less, a window grows more by black than by image


@dataclass(frozen=True, slots=True, eq=False)
class CommonField:
    """A raster of rays of one rectified frame each, and what is seen of it.

    ``across`` are the coordinates of its rows (of its columns, if vertical), which both cameras share; ``along`` those along the
    baseline, one row for each camera. ``is_seen`` (camera, row, column) says where the camera sees something,
    ``is_common`` where the other one sees the same.
    """

    kind: ProjectionKind
    across: Float[ndarray, "rows"]
    along: Float[ndarray, "2 columns"]
    is_seen: Bool[ndarray, "2 rows columns"]
    is_common: Bool[ndarray, "2 rows columns"]
    baseline_axis: int

    @property
    def rays(self) -> Float[ndarray, "2 rows columns 3"]:
        """Those of the raster, in the rectified frames."""
        places = np.empty((*self.is_common.shape, 2))
        places[..., 1 - self.baseline_axis], places[..., self.baseline_axis] = self.across[:, None], self.along[:, None]
        return rays_at(self.kind, self.baseline_axis, places)


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """The part of a field that a rectified image shows: ranges [least, most] of the coordinates, along for each camera."""

    across: Float[ndarray, "2"]
    along: Float[ndarray, "2 2"]

    @property
    def width(self) -> float:
        """The mean of both cameras' ranges along the baseline."""
        return float((self.along[:, 1] - self.along[:, 0]).mean())

    @property
    def height(self) -> float:
        """The range across the baseline."""
        return float(self.across[1] - self.across[0])


def common_field(cameras: tuple[Camera, Camera], rotations: RectifyingRotations, kind: ProjectionKind) -> CommonField:
    """What both cameras see of each other's field, at any distance.

    Raises:
        DegenerateGeometryError: They see nothing in common.
    """
    R = (rotations.R_rect_left, rotations.R_rect_right)
    seen = [_seen_places(camera, turn, kind, rotations.along) for camera, turn in zip(cameras, R, strict=True)]
    if any(len(places) == 0 for places in seen):
        raise _nothing_common("a camera looks 90 deg or more away from the rectified direction")
    a, b = rotations.along, 1 - rotations.along
    least, most = max(places[:, b].min() for places in seen), min(places[:, b].max() for places in seen)
    if not least < most:
        raise _nothing_common("no row of one image meets the other")
    across = least + (most - least) * (np.arange(ROWS) + 0.5) / ROWS
    step = (np.arange(COLUMNS) + 0.5) / COLUMNS
    along = np.array([places[:, a].min() + np.ptp(places[:, a]) * step for places in seen])
    nothing = np.zeros((2, ROWS, COLUMNS), bool)
    rays = CommonField(kind, across, along, nothing, nothing, a).rays
    is_seen = np.array([camera.sees(rays[i] @ R[i]) for i, camera in enumerate(cameras)])
    is_seen &= _is_near_middle(rays, rotations.along)
    if kind == "pinhole" and is_seen.any():
        is_seen &= _is_little_stretched(np.where(is_seen[..., None], rays[..., :2], np.inf))
    angle = np.arctan2(rays[..., a], np.hypot(rays[..., b], rays[..., 2]))
    least_turn, most_turn = _turns(angle, is_seen, cameras, rotations)
    is_common = np.zeros_like(is_seen)
    for own, other, side in ((0, 1, np.sign(rotations.offset_m)), (1, 0, -np.sign(rotations.offset_m))):
        where = np.where(is_seen[other], angle[other], np.nan)
        first, last = np.fmin.reduce(where, axis=1)[:, None], np.fmax.reduce(where, axis=1)[:, None]
        ends = angle[own] + side * least_turn, angle[own] + side * most_turn
        with np.errstate(invalid="ignore"):
            is_common[own] = is_seen[own] & (np.maximum(*ends) >= first) & (np.minimum(*ends) <= last)
    rows = _longest_run(np.asarray(is_common.any(axis=2).all(axis=0)))
    is_common[:, ~rows] = False
    if not is_common.any():
        raise _nothing_common("nothing that one sees lies where the other looks")
    return CommonField(kind, across, along, is_seen, is_common, a)


def _turns(
    angle: Float[ndarray, "2 rows columns"],
    is_seen: Bool[ndarray, "2 rows columns"],
    cameras: tuple[Camera, Camera],
    rotations: RectifyingRotations,
) -> tuple[float, float]:
    """By how much the two rays of a point may differ along the baseline, radians: never less than 0, which is at infinity.

    About as much as the directions of both images' middles, by half of the narrower field to either side: what lies nearer or farther
    is no nearer to the middle of one image than its border is.
    """
    middles = []
    for i, (camera, R) in enumerate(zip(cameras, (rotations.R_rect_left, rotations.R_rect_right), strict=True)):
        x, y, z = R @ camera.unproject((np.array(camera.size_wh) - 1) / 2)
        along, across = (y, x) if rotations.is_vertical else (x, y)
        middle = np.arctan2(along, np.hypot(across, z))
        middles.append(middle if np.isfinite(middle) else angle[i][is_seen[i]].mean())
    half = 0.5 * min(float(np.ptp(angle[i][is_seen[i]])) if is_seen[i].any() else 0.0 for i in range(2))
    turn = float(np.sign(rotations.offset_m) * (middles[1] - middles[0]))
    return max(turn - half, 0.0), max(turn, 0.0) + half


def choose_projection(rays: Float[ndarray, "n 3"], along: int) -> ProjectionKind:
    """The straightest projection that shows these rays without stretching one place ten times as much as another."""
    length2 = np.sum(rays * rays, axis=-1)
    rho2 = length2 - rays[:, along] ** 2
    # areas on the sphere grow as the cube of a ray's length over z (pinhole) or rho (cylinder)
    with np.errstate(all="ignore"):
        pinhole = np.where(rays[:, 2] > 1e-6, (length2 / rays[:, 2] ** 2) ** 1.5, np.inf)
    cylinder = (length2 / rho2) ** 1.5
    if pinhole.max() <= MOST_STRETCH * pinhole.min():
        return "pinhole"
    return "cylindrical" if cylinder.max() <= MOST_STRETCH * cylinder.min() else "equirectangular"


def trimmed(field: CommonField) -> Bool[ndarray, "2 rows columns"]:
    """What is common, without the rows and columns of which less than half is, by solid angle: emptiest first.

    By solid angle, because rows meet on the baseline: what lies there must not decide which rows are worth showing.
    """
    length = np.linalg.norm(field.rays, axis=-1)
    area = 1 / length if field.kind == "equirectangular" else length**-3.0
    rows, columns = np.ones(area.shape[1], bool), np.ones((2, area.shape[2]), bool)
    common = field.is_common * area
    while True:
        box = rows[:, None] & columns[:, None, :]
        seen, whole = common * box, area * box
        of_rows = seen.sum(axis=(0, 2)) / np.maximum(whole.sum(axis=(0, 2)), 1e-300)
        of_columns = seen.sum(axis=1) / np.maximum(whole.sum(axis=1), 1e-300)
        of_rows[~rows], of_columns[~columns] = 1.0, 1.0
        if min(of_rows.min(), of_columns.min()) >= LEAST_SHARE:
            return field.is_common & box
        if of_rows.min() <= of_columns.min():
            new_rows, new_columns = rows & (of_rows > of_rows.min()), columns
        else:
            new_rows, new_columns = rows, columns & (of_columns > of_columns.min())
        if not (new_rows.any() and new_columns.any(axis=1).all()):
            return field.is_common & box
        rows, columns = new_rows, new_columns


def window_of(field: CommonField, shown: Bool[ndarray, "2 rows columns"]) -> Window:
    """The smallest window around part of a field."""
    half = 0.5 * (field.across[1] - field.across[0])
    rows = field.across[shown.any(axis=(0, 2))]
    along = []
    for i in range(2):
        step = 0.5 * (field.along[i, 1] - field.along[i, 0])
        columns = field.along[i, shown[i].any(axis=0)]
        along.append([columns.min() - step, columns.max() + step])
    return Window(np.array([rows.min() - half, rows.max() + half]), np.array(along))


def whole_window(cameras: tuple[Camera, Camera], rotations: RectifyingRotations, kind: ProjectionKind) -> Window:
    """The window around everything that either camera sees and the projection can show."""
    R = (rotations.R_rect_left, rotations.R_rect_right)
    seen = [_seen_places(camera, turn, kind, rotations.along) for camera, turn in zip(cameras, R, strict=True)]
    a, b = rotations.along, 1 - rotations.along
    across = np.concatenate(seen)[:, b]
    return Window(
        np.array([across.min(), across.max()]), np.array([[places[:, a].min(), places[:, a].max()] for places in seen])
    )


def _seen_places(
    camera: Camera, R_rect_camera: Float[ndarray, "3 3"], kind: ProjectionKind, along: int
) -> Float[ndarray, "n 2"]:
    width, height = camera.size_wh
    u, v = np.meshgrid(np.linspace(-0.5, width - 0.5, SAMPLES), np.linspace(-0.5, height - 0.5, SAMPLES))
    rays = camera.unproject(np.stack([u, v], axis=-1).reshape(-1, 2)) @ R_rect_camera.T
    rays = rays[np.isfinite(rays).all(axis=1)]
    rays = rays[_is_near_middle(rays, along)]
    places = coordinates(kind, along, rays)
    is_there = np.asarray(np.isfinite(places).all(axis=1))
    if kind == "pinhole" and is_there.any():
        is_there &= _is_little_stretched(np.where(is_there[:, None], places, np.inf))
    return places[is_there]


def _is_near_middle(rays: Float[ndarray, "*batch 3"], along: int) -> Bool[ndarray, "*batch"]:
    """Rays neither along the baseline nor far behind."""
    rho = np.hypot(rays[..., 1 - along], rays[..., 2])
    angle = np.arctan2(np.abs(rays[..., along]), rho)
    across = np.abs(np.arctan2(rays[..., 1 - along], rays[..., 2]))
    return (angle <= np.radians(FARTHEST_FROM_MIDDLE_DEG)) & (across <= np.radians(FARTHEST_ACROSS_DEG))


def _is_little_stretched(places: Float[ndarray, "*batch 2"]) -> Bool[ndarray, "*batch"]:
    """Where a pinhole's area is at most ``MOST_STRETCH`` times that of its least stretched place, of one image or two."""
    stretch = (1 + np.sum(places * places, axis=-1)) ** 1.5
    return stretch <= MOST_STRETCH * stretch.min()


def _longest_run(is_kept: Bool[ndarray, "n"]) -> Bool[ndarray, "n"]:
    """The longest unbroken run of True."""
    edges = np.flatnonzero(np.diff(np.r_[False, is_kept, False].astype(int)))
    run = np.zeros_like(is_kept)
    if len(edges):
        starts, ends = edges[::2], edges[1::2]
        best = int(np.argmax(ends - starts))
        run[starts[best] : ends[best]] = True
    return run


def _nothing_common(why: str) -> DegenerateGeometryError:
    return DegenerateGeometryError(
        f"the cameras have no field in common ({why}): their images cannot be rectified; check that left and right are not "
        "exchanged and that the rig is that of these cameras."
    )


def fits(
    cameras: tuple[Camera, Camera],
    rotations: RectifyingRotations,
    projections: tuple[EpipolarProjection, EpipolarProjection],
    size_wh: tuple[int, int],
) -> bool:
    """Whether every pixel of both rectified images is seen, by their borders (an image's field has no holes)."""
    width, height = size_wh
    x, y = np.linspace(0, width - 1, SAMPLES), np.linspace(0, height - 1, SAMPLES)
    border = np.concatenate(
        [np.column_stack([x, np.full(SAMPLES, end)]) for end in (0, height - 1)]
        + [np.column_stack([np.full(SAMPLES, end), y]) for end in (0, width - 1)]
    )
    for camera, R, projection in zip(
        cameras, (rotations.R_rect_left, rotations.R_rect_right), projections, strict=True
    ):
        rays = projection.unproject(border)
        if not np.isfinite(rays).all() or not camera.sees(rays @ R).all():
            return False
    return True
