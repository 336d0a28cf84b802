"""Rendered images of circle and square grids: points found, wrongly named, how far off, and the time that it takes, beside OpenCV.

Cases change one thing of an ordinary image, as those of ChArUco boards and AprilGrids do (:mod:`.marker_boards`). Plain grids are
whole in view, marked ones in a case of their own partly. A grid that looks the same turned is compared with the truth turned
alike. In the case "none" there is no board, but discs or squares of chance: all that is found there is wrong. OpenCV has no detector of
square grids.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.benchmark.marker_boards import format_rows, run_marker_board_benchmark
from binocal.boards import Board, parse_board
from binocal.cameras import Camera
from binocal.detection import detect
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from binocal.initialization.symmetries import board_symmetries
from binocal.shapes import Bool, Float, Int, UInt8
from binocal.simulation import RenderOptions, render_image
from binocal.simulation.layout import disc_print

BOARDS = (
    "circles:10x10:30mm",
    "acircles:4x11:20mm",
    "circles:11x9:30mm:large",
    "circles:11x9:30mm:hollow",
    "circles:10x9:30mm:rings",
    "squares:4x3:30mm:30mm",
    "squares:8x6:30mm:15mm",
)
CASES: dict[str, dict[str, Any]] = {
    "ordinary": {},
    "tilt 60": {},
    "blur 3": {"blur_px": 3.0},
    "noise 10": {"noise_dn": 10.0},
    "small": {"blur_px": 0.6},
    "partial": {},
    "wide": {},
    "stray": {},
    "light": {"vignetting": 0.5, "gamma": 2.2},
    "low contrast": {"black_dn": 100.0, "white_dn": 130.0},
    "none": {},
}
SIZE_WH = (1280, 960)
WIDE_RAD = np.radians(150)
RIM_SQUARES = 0.15  # sides about a square that are in view where it is to be found
RIM_DISCS = 1.35  # radii about a circle's centre that are in view where the circle is to be found
MAX_OFF_PX, MAX_OFF_SPACINGS = 1.5, 0.1  # the larger of both is near enough to count as found
WRONG_SPACINGS = 0.4  # farther off, a circle has the name of another one
LEAST_SHARE = 0.35  # of the circles, that a partial view shows
N_STRAYS = 12
_ANGLES = np.arange(16) * np.pi / 8
_OUTLINE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(16)], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class CircleScene:
    """An image, its board, the true centres (NaN: outside, or no board) and which are to be found."""

    image: UInt8[ndarray, "h w"]
    board: Board
    centres_px: Float[ndarray, "n 2"]
    is_visible: Bool[ndarray, "n"]


@dataclass(slots=True)
class _Tally:
    n_visible: int = 0
    n_found: int = 0
    n_wrong: int = 0
    n_boards: int = 0
    errors_px: list[ndarray] = field(default_factory=list)
    elapsed_ms: list[float] = field(default_factory=list)


def cases_of(board: Board) -> tuple[str, ...]:
    """All, but those of a partly seen board where its circles have no names of their own."""
    return tuple(case for case in CASES if case != "partial" or board.allows_partial)


def draw_circle_scene(spec: str, case: str, seed: int, index: int) -> CircleScene:
    """The ``index``-th image of a board in a case."""
    rng = np.random.default_rng([seed, index, list(CASES).index(case), len(spec)])
    board = parse_board(spec)
    given: dict[str, Any] = {"blur_px": rng.uniform(0.5, 1.2), "noise_dn": rng.uniform(1, 4)} | CASES[case]
    if case == "light":
        given["shading"] = tuple(rng.uniform(-0.6, 0.6, 2))
    options = RenderOptions(**given)
    width, height = SIZE_WH
    f = width / WIDE_RAD if case == "wide" else 1.1 * width
    distortion = np.zeros(5) if case == "wide" else np.array([0, -0.1, 0.02, 0, 0])
    camera = Camera("fisheye4" if case == "wide" else "brown4", SIZE_WH, np.r_[f, f, width / 2, height / 2, distortion])
    least = LEAST_SHARE if case == "partial" else 1.0
    while True:
        T_camera_board = _draw_pose(board, f, case, rng)
        is_visible = np.zeros(board.n_points, bool)
        if T_camera_board.inverse().t[2] < 0 and T_camera_board.apply(board.object_points_m)[:, 2].min() > 0:
            is_visible = _in_view(camera, T_camera_board, board)
        if is_visible.mean() >= least:
            break
    if case == "none":
        T_camera_board = SE3(np.eye(3), np.array([1e3, 0.0, 1.0]))  # far beside the image
    rendered = render_image(camera, T_camera_board, board, options, rng)
    image = rendered.image.astype(np.uint8)
    if case in ("stray", "none"):
        image = _draw_strays(image, rendered.corners_px, rng, are_squares=board.kind == "squares")
    return CircleScene(image, board, rendered.corners_px, is_visible & (case != "none"))


def _draw_pose(board: Board, f: float, case: str, rng: np.random.Generator) -> SE3:
    points = board.object_points_m
    extent = float(np.ptp(points[:, :2], axis=0).max())
    share = rng.uniform(*{"partial": (1.2, 2.0), "small": (0.15, 0.3)}.get(case, (0.4, 0.8)))
    tilt = np.radians(60) if case == "tilt 60" else rng.uniform(0, np.radians(40))
    way, roll = rng.uniform(0, 2 * np.pi), rng.uniform(-np.pi, np.pi)
    R = exp(tilt * np.array([np.cos(way), np.sin(way), 0.0])) @ exp(np.array([0.0, 0.0, roll]))
    if case == "wide":
        centre = np.r_[rng.uniform(-0.3, 0.3, 2), rng.uniform(0.4, 0.7)] * extent
    else:
        distance = f * extent / (share * SIZE_WH[1])
        half = 0.5 * distance / f * np.array(SIZE_WH)
        centre = np.r_[rng.uniform(-0.5, 0.5, 2) * half, distance]
    return SE3(R, centre - R @ points.mean(axis=0))


def _in_view(camera: Camera, T_camera_board: SE3, board: Board) -> Bool[ndarray, "n"]:
    """Which circles lie in the image, with a rim about them."""
    reach = (RIM_SQUARES if board.kind == "squares" else RIM_DISCS * disc_print(board).radius) * board.pitch_m
    rims = board.object_points_m + reach * _OUTLINE[:, None]
    pixels = camera.project(T_camera_board.apply(rims.reshape(-1, 3))).reshape(len(_OUTLINE), -1, 2)
    return np.logical_and.reduce((pixels > 1) & (pixels < np.array(SIZE_WH) - 2), axis=(0, 2))


def _draw_strays(
    image: ndarray, centres: ndarray, rng: np.random.Generator, *, are_squares: bool
) -> UInt8[ndarray, "h w"]:
    """Discs or squares with bright rims, of all sizes, beside the board."""
    import cv2

    image = image.copy()
    for _ in range(N_STRAYS):
        radius = int(rng.integers(6, 30))
        place = rng.integers(2 * radius, np.array(SIZE_WH) - 2 * radius)
        if np.nanmin(np.linalg.norm(centres - place, axis=1), initial=np.inf) > 2.2 * radius + 25:
            cv2.circle(image, place.tolist(), int(1.5 * radius), 200, -1, cv2.LINE_AA)
            if are_squares:
                turn = rng.uniform(0, np.pi) + np.pi / 2 * np.arange(4)
                corners = place + radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
                cv2.fillPoly(image, [np.rint(corners).astype(np.int32)], 40, cv2.LINE_AA)
            else:
                cv2.circle(image, place.tolist(), radius, 40, -1, cv2.LINE_AA)
    return np.clip(image + rng.normal(0, 1, image.shape), 0, 255).astype(np.uint8)


def circle_finders(board: Board) -> dict[str, Callable[[ndarray], Float[ndarray, "n 2"]]]:
    """Binocal's finder, and OpenCV's where it has one."""
    import cv2

    if board.kind == "squares":
        return {"binocal": lambda image: detect(image, board).points_px}
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID if board.kind == "acircles" else cv2.CALIB_CB_SYMMETRIC_GRID

    def find(image: ndarray) -> ndarray:
        ok, centres = cv2.findCirclesGrid(image, (board.columns, board.rows), flags=flags)
        return centres.reshape(-1, 2).astype(float) if ok else np.full((board.n_points, 2), np.nan)

    return {"binocal": lambda image: detect(image, board).points_px, "OpenCV": find}


def run_board_benchmark(*, images: int = 20, seed: int = 0) -> dict[str, Any]:
    """ChArUco boards and AprilGrids, then circle grids: visible points found, wrong names, RMS error, CPU time on one core."""
    import cv2

    table, own_threads = run_marker_board_benchmark(images=images, seed=seed), cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        rows = table["rows"] + circle_board_rows(images=images, seed=seed)
    finally:
        cv2.setNumThreads(own_threads)
    notes = table["text"].removeprefix(format_rows(table["rows"], images, seed, table["machine"]))
    return {**table, "rows": rows, "text": format_rows(rows, images, seed, table["machine"]) + notes}


def circle_board_rows(
    *, images: int, seed: int, cases: Sequence[str] | None = None, boards: Sequence[str] = BOARDS
) -> list[dict[str, Any]]:
    """For each board, case and finder what :func:`.marker_boards.run_marker_board_benchmark` has in its rows."""
    rows = []
    for spec in boards:
        board = parse_board(spec)
        finders = circle_finders(board)
        for case in [case for case in cases_of(board) if cases is None or case in cases]:
            tallies = {name: _Tally() for name in finders}
            for index in range(images):
                scene = draw_circle_scene(spec, case, seed, index)
                for name, finder in finders.items():
                    _score(tallies[name], scene, finder, is_named=bool(board.marked_points) and name == "binocal")
            rows += [_row(spec, case, name, tally) for name, tally in tallies.items()]
    return rows


def _score(tally: _Tally, scene: CircleScene, finder: Callable[[ndarray], ndarray], *, is_named: bool) -> None:
    begin = time.thread_time()
    points = finder(scene.image)
    tally.elapsed_ms.append(1e3 * (time.thread_time() - begin))
    tally.n_visible += int(scene.is_visible.sum())
    is_seen = np.isfinite(points[:, 0])
    if not scene.is_visible.any():
        tally.n_wrong += int(is_seen.sum())
        return
    centres = scene.centres_px
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1) + np.where(np.eye(len(centres)), np.inf, 0)
    spacing = np.where(np.isfinite(apart), apart, np.inf).min(axis=1)
    off = min((np.linalg.norm(points[turn] - centres, axis=1) for turn in _turns(scene.board, is_named)), key=np.nansum)
    is_found = scene.is_visible & (off < np.maximum(MAX_OFF_PX, MAX_OFF_SPACINGS * spacing))
    tally.n_found += int(is_found.sum())
    tally.n_wrong += int((off > WRONG_SPACINGS * spacing).sum())
    tally.n_boards += int(is_found.sum() >= 0.5 * scene.is_visible.sum())
    tally.errors_px.append(off[is_found])


def _turns(board: Board, is_named: bool) -> list[Int[ndarray, "n"]]:
    """The orders in which a finder may number the circles; one where marks name them."""
    symmetries = board_symmetries(board.object_points_m)
    turns = [order for order, R in zip(symmetries.order, symmetries.motions.R, strict=True) if R[2, 2] > 0]
    return turns[:1] if is_named else turns


def _row(spec: str, case: str, name: str, tally: _Tally) -> dict[str, Any]:
    errors = np.concatenate([*tally.errors_px, np.empty(0)])
    return {
        "board": spec,
        "case": case,
        "finder": name,
        "n_visible": tally.n_visible,
        "n_found": tally.n_found,
        "n_wrong": tally.n_wrong,
        "n_boards": tally.n_boards,
        "rms_px": float(np.sqrt(0.5 * np.mean(errors**2))) if len(errors) else None,
        "median_ms": float(np.median(tally.elapsed_ms)),
    }
