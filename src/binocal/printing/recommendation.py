"""Which board suits cameras and a range of distances: its kind, its squares and its size, each with the reason.

Two ends bind it. At the far end a square must have enough pixels to be found, and markers enough for their cells. At the near end
the board must lie within what the cameras see, and yet fill enough of it to reach the corners of the image.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from binocal.boards import Board
from binocal.boards.dictionaries import DICTIONARY_SIZES
from binocal.cameras import Camera, StereoRig
from binocal.printing.board_shapes import board_size_mm
from binocal.printing.paper import ISO, LARGEST_MM, PAPERS, has_room_for, smallest_paper
from binocal.printing.sheet import SheetOptions, sheet_size_mm
from binocal.simulation.visibility import visible_px

LEAST_SQUARE_PX = {"chessboard": 15.0, "charuco": 20.0}  # at the far end; a cell of a 4x4 marker then has 2.5 px
MOST_SHARE = {"chessboard": 0.6, "charuco": 0.9}  # of the image's width or height at the near end
GOOD_SHARE = 0.4
LEAST_SHARE = 0.25
MOST_SQUARES = 12  # in a row: more corners tell little more
LEAST_SQUARES = (6, 5)
WIDE_RAD = math.radians(
    110
)  # of the horizontal field: boards that may be partly out of view then reach the image's corners
MARKER_SHARE = 0.75  # of a ChArUco square
PINHOLE_DEG = 120.0  # the field up to which a lens is taken for a pinhole, beyond it for an equidistant one
N_GRID = 41


@dataclass(frozen=True, slots=True, eq=False)
class Recommendation:
    """A board, the page for it (its name, or its size), and the sentences that say why."""

    board: Board
    page: str
    reasons: tuple[str, ...]
    square_px: float
    """A square at the far end, pixels."""
    share: float
    """Of the image's width or height, whichever is more, at the near end."""


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What binds a board: pixels of a metre at the far end, and what room there is at the near end, metres."""

    px_per_metre_far: float
    image_near_m: tuple[float, float]
    """Width and height of the plane that an image shows at the near end, at the scale of its middle."""
    common: tuple[float, float]
    """Shares of it that all cameras see."""


def camera_of_field(field_deg: float, size_wh: tuple[int, int]) -> Camera:
    """A camera with this horizontal field of view: a pinhole, or from 120 degrees on an equidistant lens.

    Raises:
        ValueError: The field or the size is none.
    """
    if not 1 <= field_deg <= 220:
        raise ValueError(f"a field of view of {field_deg:g} deg is none; it runs from 1 to 220 deg")
    width, height = size_wh
    half = math.radians(field_deg) / 2
    is_pinhole = field_deg < PINHOLE_DEG
    focal_px = width / 2 / (math.tan(half) if is_pinhole else half)
    parameters = np.r_[focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, 0.0, np.zeros(4)]
    return Camera("brown4" if is_pinhole else "fisheye4", size_wh, parameters)


def recommend_board(seen_by: StereoRig | Camera, near_m: float, far_m: float) -> Recommendation:
    """The board for distances from ``near_m`` to ``far_m``: a chessboard if one can be whole in all images, else ChArUco.

    The smallest ISO page is taken on which it fills a good part of the image at the near end; where none is large enough, a size.

    Raises:
        ValueError: No board serves the whole range, or the cameras see too little together.
    """
    if not 0 < near_m <= far_m < math.inf:
        raise ValueError(f"a range runs from near to far, above 0; got {near_m} to {far_m} m")
    cameras = (seen_by,) if isinstance(seen_by, Camera) else (seen_by.left, seen_by.right)
    scene = _scene(seen_by, cameras, near_m, far_m)
    is_wide = max(_field_rad(camera) for camera in cameras) > WIDE_RAD
    kinds = ("charuco",) if is_wide else ("chessboard", "charuco")
    for kind in kinds:
        found = [
            (board, name, share)
            for board, name in _boards(kind, scene)
            if (share := _share(board, scene)) >= LEAST_SHARE
        ]
        if not found:
            continue
        board, name, share = next((entry for entry in found if entry[2] >= GOOD_SHARE), found[-1])
        square_px = board.pitch_m * scene.px_per_metre_far
        reasons = _reasons(board, name, (square_px, share), (near_m, far_m), is_wide=is_wide)
        return Recommendation(board, name, reasons, square_px, share)
    square_mm, rooms_mm = _bounds("charuco", scene)
    ratio = far_m / near_m * min(room / least / square_mm for room, least in zip(rooms_mm, LEAST_SQUARES, strict=True))
    columns, rows = LEAST_SQUARES
    if ratio < 1:
        room_px = [room / square_mm * LEAST_SQUARE_PX["charuco"] * far_m / near_m for room in rooms_mm]
        raise ValueError(
            f"the images are too small for a board at any distance: one of {columns}x{rows} squares needs "
            f"{columns * LEAST_SQUARE_PX['charuco']:g} x {rows * LEAST_SQUARE_PX['charuco']:g} pixels, {room_px[0]:.0f} x {room_px[1]:.0f} "
            "are there for it"
        )
    if far_m <= ratio * near_m:
        raise ValueError(
            f"at {near_m:g} m {rooms_mm[0]:.3g} x {rooms_mm[1]:.3g} mm of board are in view: there is no board that small to print; "
            "begin the range farther away"
        )
    raise ValueError(
        f"no board serves {near_m:g} to {far_m:g} m: a square must have {square_mm:.3g} mm to be seen at the far end, and "
        f"{rooms_mm[0]:.3g} x {rooms_mm[1]:.3g} mm of board are in view at the near end; take several boards, each for a range "
        f"whose far end is at most {ratio:.2g} times the near one"
    )


def _field_rad(camera: Camera) -> float:
    """The horizontal field of view; an end at which the lens has no ray counts as that of a half space."""
    width, height = camera.size_wh
    rays = camera.unproject(np.array([[-0.5, (height - 1) / 2], [width - 0.5, (height - 1) / 2]]))
    angles = np.abs(np.arctan2(rays[:, 0], rays[:, 2]))
    return float(np.where(np.isfinite(angles), angles, np.pi / 2).sum())


def _scene(seen_by: StereoRig | Camera, cameras: tuple[Camera, ...], near_m: float, far_m: float) -> _Scene:
    focal_px = [float(camera.parameters[:2].min()) for camera in cameras]
    sizes = np.array([np.array(c.size_wh) / f for c, f in zip(cameras, focal_px, strict=True)]).min(axis=0) * near_m
    common = (1.0, 1.0) if isinstance(seen_by, Camera) else _common_share(seen_by, near_m)
    if min(common) < LEAST_SHARE:
        raise ValueError(
            f"at {near_m:g} m both cameras see only {100 * min(common):.0f} % of the image together; begin the range farther away"
        )
    return _Scene(min(focal_px) / far_m, (float(sizes[0]), float(sizes[1])), common)


def _common_share(rig: StereoRig, depth_m: float) -> tuple[float, float]:
    """The longest stretches, along rows and along columns, that both cameras see of the plane at this depth, over the left image."""
    width, height = rig.left.size_wh
    u, v = np.meshgrid(np.linspace(0, width - 1, N_GRID), np.linspace(0, height - 1, N_GRID))
    rays = rig.left.unproject(np.stack([u, v], axis=-1).reshape(-1, 2))
    is_ahead = np.isfinite(rays).all(axis=-1) & (rays[:, 2] > 0.05 * np.linalg.norm(rays, axis=-1))
    points = np.where(is_ahead[:, None], rays / np.where(is_ahead, rays[:, 2], 1.0)[:, None] * depth_m, np.nan)
    is_common = np.isfinite(visible_px(rig.right, rig.T_right_left.apply(points))[:, 0]).reshape(N_GRID, N_GRID)
    return float(is_common.sum(axis=1).max() / N_GRID), float(is_common.sum(axis=0).max() / N_GRID)


def _boards(kind: str, scene: _Scene) -> Iterator[tuple[Board, str]]:
    """The largest board for each ISO page, and last the largest of all, where it is larger than A0."""
    least_mm, limits = _bounds(kind, scene)
    for name in (*ISO, ""):
        page = PAPERS.get(name, (LARGEST_MM, LARGEST_MM))
        board = _largest(kind, limits, least_mm, page)
        if board is None:
            continue
        sheet = sheet_size_mm(board, SheetOptions())
        fitting = smallest_paper(*sheet) or f"{math.ceil(sheet[0])}x{math.ceil(sheet[1])}mm"
        yield board, fitting


def _bounds(kind: str, scene: _Scene) -> tuple[float, tuple[float, float]]:
    """The least pitch, and the most room in width and height, millimetres."""
    width, height = (
        1e3 * room * min(MOST_SHARE[kind], common)
        for room, common in zip(scene.image_near_m, scene.common, strict=True)
    )
    return 1e3 * LEAST_SQUARE_PX[kind] / scene.px_per_metre_far, (width, height)


def _largest(kind: str, limits_mm: tuple[float, float], least_mm: float, page_mm: tuple[float, float]) -> Board | None:
    """The board with the most room covered whose sheet lies on the page, upright or turned."""
    best: tuple[float, Board] | None = None
    for columns in range(LEAST_SQUARES[0], MOST_SQUARES + 1):
        for rows in range(LEAST_SQUARES[1], columns):
            if (columns + rows) % 2 == 0:  # one odd, one even: such a board looks like itself in one way alone
                continue
            pitch_mm = _rounded(least_mm)
            if pitch_mm * columns > limits_mm[0] or pitch_mm * rows > limits_mm[1]:
                continue
            pitch_mm = _fitting_pitch(kind, (columns, rows), pitch_mm, limits_mm, page_mm)
            board = _board(kind, columns, rows, pitch_mm)
            if board is None or not _is_on(board, page_mm):
                continue
            merit = (columns * rows) ** 1.25 * pitch_mm**2  # its area, and a little for more corners
            if best is None or merit > best[0]:
                best = merit, board
    return None if best is None else best[1]


def _fitting_pitch(
    kind: str, squares: tuple[int, int], least_mm: float, limits_mm: tuple[float, float], page_mm: tuple[float, float]
) -> float:
    """The largest round pitch with which the board stays within the limits and on the page; at least ``least_mm``."""
    pitch_mm = least_mm
    while True:
        following = _rounded(1.0001 * pitch_mm)
        board = _board(kind, *squares, following)
        if following * squares[0] > limits_mm[0] or following * squares[1] > limits_mm[1]:
            return pitch_mm
        if board is None or not _is_on(board, page_mm):
            return pitch_mm
        pitch_mm = following


def _is_on(board: Board, page_mm: tuple[float, float]) -> bool:
    sheet = sheet_size_mm(board, SheetOptions())
    return has_room_for(page_mm, sheet) or has_room_for((page_mm[1], page_mm[0]), sheet)


def _rounded(length_mm: float) -> float:
    """The next round length from this one on."""
    step = next(
        step for limit, step in ((5, 0.1), (20, 0.5), (60, 1.0), (200, 5.0), (math.inf, 10.0)) if length_mm < limit
    )
    return round(math.ceil(round(length_mm / step, 6)) * step, 6)


def _board(kind: str, columns: int, rows: int, pitch_mm: float) -> Board | None:
    """The board of so many squares; None where no dictionary has enough markers, or no board is so large."""
    pitch_m = 1e-3 * pitch_mm  # as a SPEC of so many mm says it
    try:
        if kind == "chessboard":
            return Board("chessboard", columns - 1, rows - 1, pitch_m)
        n_markers = columns * rows // 2
        dictionary = next(name for name in ("DICT_4X4_50", "DICT_4X4_100") if DICTIONARY_SIZES[name] >= n_markers)
        return Board(
            "charuco", columns, rows, pitch_m, marker_m=1e-3 * round(MARKER_SHARE * pitch_mm, 1), dictionary=dictionary
        )
    except ValueError:
        return None


def _share(board: Board, scene: _Scene) -> float:
    width, height = board_size_mm(board)
    return max(1e-3 * width / scene.image_near_m[0], 1e-3 * height / scene.image_near_m[1])


def _reasons(
    board: Board, page: str, figures: tuple[float, float], range_m: tuple[float, float], *, is_wide: bool
) -> tuple[str, ...]:
    square_px, share = figures
    near_m, far_m = range_m
    if board.kind == "chessboard":
        kind = "chessboard: the most exact corners, and all of it is in view over the whole range"
    elif is_wide:
        kind = "ChArUco: it may be partly out of view, and so reaches the corners of a wide image"
    else:
        kind = "ChArUco: over so long a range it will not always be whole in view, and need not be"
    return (
        kind,
        f"squares of {1e3 * board.pitch_m:g} mm: {square_px:.1f} px at {far_m:g} m, where {LEAST_SQUARE_PX[board.kind]:g} are needed",
        f"at {near_m:g} m it fills {100 * share:.0f} % of the image's width or height ({100 * LEAST_SHARE:.0f} to "
        f"{100 * MOST_SHARE[board.kind]:.0f} % are good)",
        f"{page}: the smallest page on which it fills {100 * GOOD_SHARE:.0f} %"
        if share >= GOOD_SHARE
        else f"{page}: the largest that is in view at the near end",
        *_how_to_print(page),
    )


def _how_to_print(page: str) -> tuple[str, ...]:
    """What to do where no printer has the page."""
    if page in PAPERS:
        return ()
    return (
        "larger than any paper: split it over pages (--tiles) on a flat plate, have it painted, or calibrate nearer",
    )
