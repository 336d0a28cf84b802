"""Groups of X-corners: neighbours are linked along their edges, links make groups with integer cells.

A group is a part of a grid whose cells count columns and rows from any of its corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.detection.finding.planes import fit_homography
from binocal.detection.finding.xcorners import SaddleImage, XCorners, wrap_angle
from binocal.kernels import images
from binocal.shapes import Bool, Float, Int

MAX_TURN_RAD = np.radians(25)  # between an edge at a corner and the way to the neighbour; fisheye edges bend up to 15
MIN_SHARE_LINKED = 0.97  # of a whole grid's links; with fewer its holes and borders are looked at again
MIN_TO_JOIN = 12  # corners that fix a homography well enough to look two cells ahead
MAX_OFF_CELL = 0.2  # of a cell: lens distortion over the cells that are bridged; a foreign corner lies anywhere
MAX_CELLS_BRIDGED = 2  # at a time, so that the lens's distortion stays within the fifth of a cell that is allowed
MAX_JOINS = 4  # rounds; each may bridge another gap


@dataclass(frozen=True, slots=True, eq=False)
class CornerGroup:
    """Corners linked along their edges: indices, integer cells (column, row), turns of their rays, number of links."""

    members: Int[ndarray, "m"]
    cells: Int[ndarray, "m 2"]
    turns: Int[ndarray, "m"]
    n_links: int

    def __len__(self) -> int:
        return len(self.members)

    def is_whole(self, size: tuple[int, int] | None) -> bool:
        """Whether it is a grid of ``size`` without holes and (nearly) without missing links."""
        columns, rows = (int(n) for n in np.ptp(self.cells, axis=0) + 1)
        n_edges = 2 * columns * rows - columns - rows
        is_full = len(self) == columns * rows and self.n_links >= MIN_SHARE_LINKED * n_edges
        return is_full and size == (max(columns, rows), min(columns, rows))


def link_corners(saddles: SaddleImage, corners: XCorners, *, has_dots: bool = False) -> list[CornerGroup]:
    """The corners in connected groups, the largest first; ``has_dots`` where the middle of every edge bears one."""
    if len(corners) < 2:
        return []
    neighbour, back_ray = images.link_corners(
        saddles.smooth, corners.points_px, corners.rays_rad, corners.contrast_dn, MAX_TURN_RAD, has_dots=has_dots
    )
    n_ends = (neighbour >= 0).sum(axis=1)
    groups = [
        CornerGroup(*group, int(n_ends[group[0]].sum()) // 2)
        for group in images.grow_groups(corners.points_px, neighbour, back_ray)
    ]
    return sorted(groups, key=lambda group: -len(group))


def join_across_gaps(corners: XCorners, group: CornerGroup) -> tuple[Int[ndarray, "k"], Int[ndarray, "k 2"]]:
    """The group with corners beyond gaps in it: those that its homography puts on free cells, with the right colours.

    A shadow's border, or a blurred strip, breaks the links between two parts of one board.
    """
    members, cells, turns = group.members, group.cells, group.turns
    extent = np.ptp(cells, axis=0) + 1
    if len(members) < MIN_TO_JOIN or extent.min() < 3:
        return members, cells
    parity_of_first = int((turns[0] + cells[0].sum()) % 2)  # of ray 0's turn at even cells
    is_free = np.ones(len(corners), bool)
    is_free[members] = False
    for _ in range(MAX_JOINS):
        H = fit_homography(cells.astype(float), corners.points_px[members].astype(float))
        free = np.nonzero(is_free)[0]
        if len(free) == 0 or not np.isfinite(H).all():
            break
        fits, near = _lay_on_cells(corners, free, cells, H, parity_of_first)
        new, places = free[fits], near[fits].astype(int)
        taken = {tuple(cell) for cell in cells.tolist()}
        chosen = []
        for i, cell in enumerate(map(tuple, places.tolist())):
            if cell not in taken:
                taken.add(cell)
                chosen.append(i)
        if not chosen:
            break
        members, cells = np.r_[members, new[chosen]], np.concatenate([cells, places[chosen]])
        is_free[new[chosen]] = False
    return members, cells


def _lay_on_cells(
    corners: XCorners, free: Int[ndarray, "f"], cells: Int[ndarray, "k 2"], H: Float[ndarray, "3 3"], parity: int
) -> tuple[Bool[ndarray, "f"], Float[ndarray, "f 2"]]:
    """Which free corners lie on a cell as its corner would, near the group and with its colours; and the cells."""
    points = corners.points_px[free].astype(float)
    back = np.linalg.inv(H)
    homogeneous = points @ back[:, :2].T + back[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = homogeneous[:, :2] / homogeneous[:, 2:]
    side = (cells @ H[2, :2] + H[2, 2]).mean()
    near = np.rint(np.clip(np.nan_to_num(uv, nan=1e6, posinf=1e6, neginf=-1e6), -1e6, 1e6))
    fits = (np.abs(uv - near) < MAX_OFF_CELL).all(axis=1) & (homogeneous[:, 2] * side > 0)
    low, high = cells.min(axis=0) - MAX_CELLS_BRIDGED, cells.max(axis=0) + MAX_CELLS_BRIDGED
    fits &= ((near >= low) & (near <= high)).all(axis=1)
    # The direction of the step to the next column, from the homography's derivative.
    w = near @ H[2, :2] + H[2, 2]
    step = H[:2, 0] - points * H[2, 0]
    heading = np.arctan2(step[:, 1] * np.sign(w), step[:, 0] * np.sign(w))
    turn = np.abs(wrap_angle(heading[:, None] - corners.rays_rad[free]))
    ray = turn.argmin(axis=1)
    fits &= (turn.min(axis=1) < MAX_TURN_RAD) & ((ray + near.sum(axis=1)) % 2 == parity)
    return fits, near
