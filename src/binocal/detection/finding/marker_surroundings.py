"""What a board's own lattice bears beyond the board that the SPEC says, and which of the SPEC's rows it lacks.

Ids run on from row to row, so that each place beside a board would bear one known id if the board went on there. Where such markers
are read, the board has another first id, or more rows, than the SPEC says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.boards import Board, format_board
from binocal.boards.dictionaries import DICTIONARY_SIZES
from binocal.detection.finding.marker_codes import cell_places, code_templates
from binocal.detection.finding.marker_grid import MarkerGrid
from binocal.detection.finding.marker_search import FOREIGN, READ, SURE, MarkerSighting
from binocal.kernels.marker_grids import predict_places, read_cells
from binocal.shapes import Float, Int, UInt8

LEAST_BEYOND = 2  # markers beside the board that are read for sure: one may be chance
MOST_STEPS = 6  # rows and columns beside it that are looked at
LEAST_IN_LINE = 3  # markers of a row that should be in view, for it to be missed


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Ids that are read beside the SPEC's board, the SPEC they prove ("": none), and what a note says of lines that are missing."""

    ids_beyond: tuple[int, ...] = ()
    spec: str = ""
    note: str = ""

    @property
    def reason(self) -> str:
        """Why the board is not the SPEC's; empty where it may be."""
        if not self.ids_beyond:
            return ""
        ids = ", ".join(map(str, self.ids_beyond[:4])) + ", ..." * (len(self.ids_beyond) > 4)
        advice = f"the SPEC is probably {self.spec}" if self.spec else "check the SPEC's size and first id"
        return f"the board continues beyond the SPEC's with markers of the ids {ids}; {advice}"


def read_surroundings(image: UInt8[ndarray, "h w"], board: Board, sighting: MarkerSighting) -> Surroundings:
    """What stands beside a board that was found, and whether its outer rows and columns are there; ``image`` has 8 bits."""
    low, high = np.array([0, 0]), np.array([board.columns, board.rows])
    cells = _cells_between(board, sighting.grid, low, high)
    likeness = sighting.of_faces.copy()  # faces run as ids do
    is_open = np.isnan(likeness)
    if is_open.any():
        likeness[is_open] = _read(image, board, sighting, cells[is_open])
    read = cells[likeness >= READ]
    beyond: list[Int[ndarray, "k 2"]] = []
    n_sure = 0
    can_widen = board.kind == "aprilgrid" or board.columns % 2 == 0  # ids of odd columns run on in pairs of rows alone
    for _ in range(MOST_STEPS):
        low, high = low - [can_widen, 1], high + [can_widen, 1]
        around = _cells_between(board, sighting.grid, low, high)
        is_outer = (around[:, 1] == low[1]) | (around[:, 1] == high[1] - 1)
        if can_widen:
            is_outer |= (around[:, 0] == low[0]) | (around[:, 0] == high[0] - 1)
        around = around[is_outer]
        of_around = _read(image, board, sighting, around)
        n_sure += int(np.count_nonzero(of_around >= SURE))
        if n_sure == 0 or not (of_around >= READ).any():
            break
        beyond.append(around[of_around >= READ])
    outside = np.concatenate(beyond) if beyond else np.zeros((0, 2), int)
    if n_sure >= LEAST_BEYOND:
        ids = tuple(sorted(int(i) for i in _ids(board, sighting.grid, outside)))
        return Surroundings(ids, _prove_spec(board, sighting.grid, np.concatenate([read, outside])))
    return Surroundings(note=_missing_lines(board, cells, likeness))


def _parity(grid: MarkerGrid) -> int:
    """Of a ChArUco board's squares with markers: that of column plus row, counted from the top-left square."""
    return int((grid.faces[0] + 1).sum()) % 2


def _cells_between(
    board: Board, grid: MarkerGrid, low: Int[ndarray, "2"], high: Int[ndarray, "2"]
) -> Int[ndarray, "m 2"]:
    """Places (column, row) of markers, row by row as their ids run; of a ChArUco board the squares of one colour."""
    row, column = (axis.ravel() for axis in np.mgrid[low[1] : high[1], low[0] : high[0]])
    cells = np.stack([column, row], axis=-1)
    return cells if board.kind == "aprilgrid" else cells[cells.sum(axis=1) % 2 == _parity(grid)]


def _ids(board: Board, grid: MarkerGrid, cells: Int[ndarray, "m 2"]) -> Int[ndarray, "m"]:
    """The ids that these places would bear if the board went on there."""
    column, row = cells.T
    if board.kind == "aprilgrid":
        return board.first_tag_id + row * board.columns + column
    first = _parity(grid)
    in_even_rows = (board.columns - first + 1) // 2
    before = row // 2 * board.columns + row % 2 * in_even_rows
    return board.first_tag_id + before + (column - (first - row) % 2) // 2


def _read(
    image: UInt8[ndarray, "h w"], board: Board, sighting: MarkerSighting, cells: Int[ndarray, "m 2"]
) -> Float[ndarray, "m"]:
    """The likeness of each place to the marker that it would bear; NaN where it is not in view, or there is no such id."""
    grid, way = sighting.grid, sighting.reading
    likeness = np.full(len(cells), np.nan)
    ids = _ids(board, grid, cells)
    if board.kind == "aprilgrid":
        steps = cells * (1 + board.tag_gap_ratio)
        if grid.faces[0, 1] > 0:  # ids that run upwards
            steps = steps * [1, -1]
    else:
        steps = cells - (grid.faces[0] + 1)
    places = grid.corners[0] + steps[:, None]
    quads = predict_places(grid.lines, sighting.known_px, way.lens, places)
    size_wh = np.array(image.shape[::-1])
    with np.errstate(invalid="ignore"):
        is_inside = np.isfinite(quads[..., 0]).all(axis=1) & ((quads > -0.5) & (quads < size_wh - 0.5)).all(axis=(1, 2))
    is_inside &= (ids >= 0) & (ids < DICTIONARY_SIZES[board.marker_dictionary])
    if is_inside.any():
        values = read_cells(image, quads[is_inside], cell_places(way.kind), way.lens) * (-1 if way.is_inverted else 1)
        low = int(ids[is_inside].min())
        templates = code_templates(way.kind, low, int(ids[is_inside].max()) - low + 1, way.blur_cells)
        likeness[is_inside] = (templates.residual(values) * templates.turned[ids[is_inside] - low, 0]).sum(axis=1)
    return likeness


def _prove_spec(board: Board, grid: MarkerGrid, cells: Int[ndarray, "m 2"]) -> str:
    """The SPEC of the board whose markers were read at these places; "" where they leave it open."""
    low, high = cells.min(axis=0), cells.max(axis=0) + 1
    columns, rows = high - low
    if low[0] >= 0 and high[0] <= board.columns:
        low[0], columns = 0, board.columns
    if board.kind == "charuco":  # whose outer squares bear a marker in every other row only
        low[0], columns = (_parity(grid) - low[1]) % 2, board.columns
    first = int(_ids(board, grid, low[None])[0])
    if board.kind == "charuco" and columns % 2 == 0:
        ids = _ids(board, grid, cells)
        first, n_markers = int(ids.min()), int(np.ptp(ids)) + 1
        rows = 2 * n_markers / columns
    if columns != board.columns or rows < board.rows or rows % 1:
        return ""
    try:
        return format_board(replace(board, rows=int(rows), first_tag_id=first))
    except ValueError:
        return ""


def _missing_lines(board: Board, cells: Int[ndarray, "m 2"], likeness: Float[ndarray, "m"]) -> str:
    """A note on outer rows or columns none of whose markers is seen though all should be in view; "" without."""
    if not (likeness < FOREIGN).any():
        return ""
    left = []
    for axis, n in ((0, board.columns), (1, board.rows)):
        lines = [likeness[cells[:, axis] == k] for k in range(n)]
        is_missing = [len(line) >= LEAST_IN_LINE and bool((line < FOREIGN).all()) for line in lines]
        is_read = [bool((line >= READ).mean() >= 0.5) for line in lines]
        n_missing = 0
        for order in (range(n), range(n - 1, -1, -1)):
            gone = next((k for k, line in enumerate(order) if not is_missing[line]), n)
            if 0 < gone < n and is_read[order[gone]]:
                n_missing += gone
        left.append(n - n_missing)
    if left == [board.columns, board.rows]:
        return ""
    return (
        f"outer rows or columns of the SPEC's {board.columns}x{board.rows} should be in view and bear no markers: "
        f"covered, or is the board one of {left[0]}x{left[1]}?"
    )
