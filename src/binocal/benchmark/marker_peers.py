"""Other finders of boards with markers or marked squares, as :mod:`binocal.benchmark.marker_boards` runs them beside binocal's."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection import detect
from binocal.shapes import Float

APRILTAG_NOTE = "AprilTag 3 reads tags with one bit of border alone, and stands in that case only"
APRILTAG_MISSING = "it is not installed (pip install pupil-apriltags)"


def has_apriltag() -> bool:
    """Whether AprilTag 3's wheel is installed."""
    return find_spec("pupil_apriltags") is not None


def marker_board_finders(
    board: Board, *, border_bits: int = 2
) -> dict[str, Callable[[ndarray], Float[ndarray, "n 2"]]]:
    """Binocal's finder and those of the installed peers, by name; ``border_bits`` about an AprilGrid's tags."""
    finders: dict[str, Callable[[ndarray], ndarray]] = {"binocal": lambda image: detect(image, board).points_px}
    if board.kind == "puzzleboard":
        return finders  # OpenCV reads no dots
    if board.kind == "charuco":
        return finders | {"OpenCV": _opencv_charuco(board)}
    if board.kind == "chessboard":
        return finders | {"OpenCV": _opencv_marked(board)}
    finders["OpenCV"] = _opencv_tags(board, border_bits)
    if border_bits == 1 and has_apriltag():
        finders["AprilTag 3"] = _apriltag(board)
    return finders


def _opencv_charuco(board: Board) -> Callable[[ndarray], ndarray]:
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.marker_dictionary))
    printed = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, dictionary)
    detector = cv2.aruco.CharucoDetector(printed)

    def find(image: ndarray) -> ndarray:
        corners, ids, _, _ = detector.detectBoard(image)
        points = np.full((board.n_points, 2), np.nan)
        if ids is not None:
            points[ids.ravel().astype(int)] = corners.reshape(-1, 2)
        return points

    return find


def _opencv_tags(board: Board, border_bits: int) -> Callable[[ndarray], ndarray]:
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_bits
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.marker_dictionary))
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    place = {int(tag): i for i, tag in enumerate(board.tag_ids)}

    def find(image: ndarray) -> ndarray:
        quads, ids, _ = detector.detectMarkers(image)
        points = np.full((board.n_points, 2), np.nan)
        for quad, tag in zip(quads, [] if ids is None else ids.ravel(), strict=True):
            if int(tag) in place:  # OpenCV holds the family turned by 180 degrees
                first = 4 * place[int(tag)]
                points[first : first + 4] = np.roll(quad.reshape(4, 2), 2, axis=0)
        return points

    return find


def _apriltag(board: Board) -> Callable[[ndarray], ndarray]:
    from pupil_apriltags import Detector  # type: ignore[import-not-found]

    # As its authors ship it, but the whole image: halved, it loses small tags.
    detector = Detector(families=board.dictionary or "tag36h11", nthreads=1, quad_decimate=1.0)
    place = {int(tag): i for i, tag in enumerate(board.tag_ids)}

    def find(image: ndarray) -> ndarray:
        points = np.full((board.n_points, 2), np.nan)
        for tag in detector.detect(image):
            if tag.tag_id in place:
                first = 4 * place[tag.tag_id]
                # From its bottom-left corner, counter-clockwise; (0, 0) is its top-left pixel's outer corner.
                points[first : first + 4] = tag.corners[::-1] - 0.5
        return points

    return find


def _opencv_marked(board: Board) -> Callable[[ndarray], ndarray]:
    """The sector-based detector with all its flags, which finds parts and says in which squares it sees discs."""
    import cv2

    flags = cv2.CALIB_CB_MARKER | cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    turns = [np.array(turn) for turn in ([[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]])]
    wanted = {tuple(square) for square in board.discs}

    def find(image: ndarray) -> ndarray:
        points = np.full((board.n_points, 2), np.nan)
        is_found, corners, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), flags)
        if not is_found:
            return points
        grid = corners.reshape(*meta.shape, 2)
        marks = np.argwhere(meta > 2)[:, ::-1] if meta is not None else np.zeros((0, 2), int)
        across, along = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
        flip = np.diag([1 if across[0] * along[1] > across[1] * along[0] else -1, 1])  # its rows may run the other way
        cells = np.stack(np.meshgrid(np.arange(grid.shape[1]), np.arange(grid.shape[0])), axis=-1)
        for turn in turns:
            # Twice the middles of squares, in corners: that of the board's square (0, 0) is at (-1, -1).
            way = turn @ flip
            middles = (2 * marks + 1) @ way.T
            for square in board.discs:
                shift = 2 * np.array(square) - 1 - middles[0]
                if {tuple(each) for each in ((middles + shift + 1) // 2).tolist()} != wanted:
                    continue
                column, row = np.moveaxis(cells @ way.T + shift // 2, -1, 0)
                inside = (column >= 0) & (column < board.columns) & (row >= 0) & (row < board.rows)
                points[row[inside] * board.columns + column[inside]] = grid[inside]
                return points
        return points

    return find
