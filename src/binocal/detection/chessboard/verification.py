"""A candidate at full resolution: is it the board, alone and whole; and where exactly are its corners?"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.chessboard.appearance import (
    LEAST_SQUARE_PX,
    are_faint,
    are_squares_patterned,
    is_board_patterned,
)
from binocal.detection.chessboard.decision import several_boards, too_large
from binocal.detection.chessboard.orientation import orient
from binocal.detection.chessboard.rivals import boards_among
from binocal.detection.chessboard.sightings import MIN_SHARE_SEEN, Candidate
from binocal.detection.finding.grid import grid_reach, grid_spacing
from binocal.detection.finding.lattice import Lattice, continues_beyond
from binocal.detection.finding.planes import expected_points
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.finding.search import SearchLevel
from binocal.detection.found import FoundBoard, not_found
from binocal.detection.measuring.refinement import measure_corners
from binocal.detection.measuring.saddles import localize_saddles
from binocal.kernels.corner_fits import BoardPlaces
from binocal.shapes import Bool, Float, UInt8

MIN_SHARE_TO_LOOK_AGAIN = 0.4  # of the corners, to say where the missing ones are
MIN_CORNERS_TO_LOOK_AGAIN = 12
MIN_CORNERS = 4  # of any board: fewer determine no pose
MAX_MOVE = 0.3  # spacings, between where a corner was looked for and where it was measured


@dataclass(frozen=True, slots=True, eq=False)
class BoardImage:
    """An image, the same stretched to 8 bits, and the board that is looked for in it."""

    grey: ndarray
    image: UInt8[ndarray, "h w"]
    board: Board

    @property
    def size(self) -> tuple[int, int]:
        """The board's corners along its longer and its shorter side."""
        return max(self.board.columns, self.board.rows), min(self.board.columns, self.board.rows)

    @property
    def size_wh(self) -> tuple[int, int]:
        """The image's width and height, pixels."""
        return self.image.shape[1], self.image.shape[0]

    @property
    def board_xy(self) -> Float[ndarray, "n 2"]:
        """The corners on the board."""
        return self.board.object_points_m[:, :2]

    @property
    def places(self) -> BoardPlaces:
        """The same, with the board's lines."""
        return BoardPlaces(self.board_xy, self.board.pitch_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """Corners in the board's order, NaN where not seen, their covariances, and the sums of those with the others."""

    points_px: Float[ndarray, "n 2"]
    covariance_px2: Float[ndarray, "n 2 2"]
    cross_covariance_px2: Float[ndarray, "n 2 2"]

    @property
    def is_seen(self) -> Bool[ndarray, "n"]:
        return np.isfinite(self.points_px[:, 0])


def verify(shot: BoardImage, candidate: Candidate) -> FoundBoard:
    """Orient, measure at full resolution and check a lattice of the board's size."""
    rivals = boards_among(candidate.level.lattices, candidate.lattice, size_wh=candidate.level.size_wh)[1:]
    refused = _find_contradiction(shot, candidate, rivals)
    if refused is not None:
        return refused
    grid = candidate.level.to_image(orient(candidate.lattice, shot.board))
    measured = _measure(shot, candidate.level, grid)
    n_seen, n = int(measured.is_seen.sum()), shot.board.n_points
    if not measured.is_seen.all() and n_seen >= max(MIN_CORNERS_TO_LOOK_AGAIN, MIN_SHARE_TO_LOOK_AGAIN * n):
        measured = _look_again(shot, candidate.level, measured, grid.shape)
        n_seen = int(measured.is_seen.sum())
    if n_seen < max(MIN_CORNERS, MIN_SHARE_SEEN * n):
        text = f"the corners do not lie on a smooth grid ({n_seen} of {n} do); too blurred or covered?"
        return not_found(n, text)
    covariance, cross = (
        np.where(measured.is_seen[:, None, None], of_all, np.nan)
        for of_all in (measured.covariance_px2, measured.cross_covariance_px2)
    )
    return FoundBoard(measured.points_px, covariance, note=_note(n_seen, n, rivals), cross_covariance_px2=cross)


def _find_contradiction(shot: BoardImage, candidate: Candidate, rivals: list[Lattice]) -> FoundBoard | None:
    """Why a lattice of the board's size is not the board after all; None if nothing speaks against it."""
    board, lattice, level = shot.board, candidate.lattice, candidate.level
    if len(rivals) > 1 or any(rival.size == lattice.size for rival in rivals):
        return several_boards(board, [lattice, *rivals])
    if continues_beyond(level.saddles, level.corners, lattice):
        return too_large(board, None)
    if is_patterned(shot, candidate):
        text = "the bright squares hold patterns; is this a ChArUco board (charuco:... in the SPEC)?"
        return replace(not_found(board.n_points, text), is_patterned=True)
    return None


def is_patterned(shot: BoardImage, candidate: Candidate) -> bool:
    """Whether a candidate's bright squares hold patterns: in the level's image where squares are large enough there, else in the image itself."""
    lattice, level = candidate.lattice, candidate.level
    spacing = grid_spacing(lattice.points_px)
    spacing_px = float(np.median(spacing[np.isfinite(spacing)]))
    in_image_px = spacing_px / float(level.matrix[0, 0])
    if spacing_px < LEAST_SQUARE_PX <= in_image_px:
        return is_board_patterned(shot.image, level.to_image(lattice.points_px), in_image_px)
    return are_squares_patterned(level.saddles.smooth, lattice.points_px, lattice.is_dark_first)


def _note(n_seen: int, n: int, rivals: list[Lattice]) -> str:
    notes = [] if n_seen == n else [f"{n_seen} of {n} corners seen"]
    if rivals:
        notes.append("another board of {}x{} corners is in the image".format(*rivals[0].size))
    return "; ".join(notes)


def _measure(shot: BoardImage, level: SearchLevel, grid: Float[ndarray, "rows columns 2"]) -> _Measured:
    """The corners near those of a grid; those that moved far, are faint or lie off the smooth grid are not seen."""
    spacing = grid_spacing(grid).ravel()
    coarse = localize_saddles(shot.image, grid.reshape(-1, 2), spacing)
    points, covariance, cross = measure_corners(shot.grey, coarse, shot.places, grid_reach(grid).ravel())
    points = points.copy()
    points[np.linalg.norm(points - coarse, axis=1) > MAX_MOVE * spacing] = np.nan
    points[are_faint(level, points, grid)] = np.nan
    return _Measured(_without_irregular(shot, points, spacing, MIN_SHARE_SEEN), covariance, cross)


def _without_irregular(
    shot: BoardImage, points: Float[ndarray, "n 2"], spacing: Float[ndarray, "n"], least_share: float
) -> Float[ndarray, "n 2"]:
    """The points, those off the smooth image of the board NaN, if there are enough to say so."""
    is_enough = np.isfinite(points[:, 0]).sum() >= max(MIN_CORNERS, least_share * len(points))
    return keep_regular(shot.board_xy, points, spacing, shot.size_wh) if is_enough else points


def _look_again(shot: BoardImage, level: SearchLevel, measured: _Measured, shape: tuple[int, ...]) -> _Measured:
    """With the corners that are missing, from where the others say that they are: a lattice may be wrong in places.

    They are fitted beside the others, whose image shows how the lens bends the edges.
    """
    xy, seen = shot.board_xy, measured.is_seen
    spacing_px = float(np.nanmedian(grid_spacing(measured.points_px.reshape(shape))))
    expected = expected_points(xy, measured.points_px, spacing_px, shot.size_wh)
    height, width = shot.image.shape
    expected[~((expected > 0) & (expected < [width - 1, height - 1])).all(axis=1)] = np.nan
    whole = np.where(seen[:, None], measured.points_px, expected).reshape(shape)
    spacing, reach = grid_spacing(whole).ravel(), grid_reach(whole).ravel()
    coarse = localize_saddles(shot.image, np.where(seen[:, None], np.nan, expected), spacing)
    starts = np.where(seen[:, None], measured.points_px, coarse)
    found, of_found, cross_of_found = measure_corners(shot.grey, starts, shot.places, reach)
    is_near = np.linalg.norm(found - expected, axis=1) < MAX_MOVE * spacing
    points = np.where(seen[:, None], measured.points_px, np.where(is_near[:, None], found, np.nan))
    covariance = np.where(seen[:, None, None], measured.covariance_px2, of_found)
    cross = np.where(seen[:, None, None], measured.cross_covariance_px2, cross_of_found)
    points[are_faint(level, points, whole) & ~seen] = np.nan
    return _Measured(_without_irregular(shot, points, spacing, MIN_SHARE_TO_LOOK_AGAIN), covariance, cross)
