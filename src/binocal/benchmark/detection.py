"""Rendered images with and without a board: found, missed, wrong, and the time that either takes.

An image shows one chessboard of random size, place and tilt before clutter, blurred, noisy and partly in shadow, with the
short side of every square at least ``LEAST_SIDE_PX`` and ``LEAST_SIDE_PER_BLUR`` times the blur; or the clutter alone.
Every image is drawn from its own seed. OpenCV's finders see each ``peer_every``-th image.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.boards import Board, parse_board
from binocal.cameras import Camera
from binocal.detection import detect
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from binocal.shapes import Float, Float32, UInt8
from binocal.simulation import RenderOptions, printed_extent_m, render_light, visible_px

BOARDS = ("chessboard:11x8:20mm", "chessboard:9x6:20mm", "chessboard:8x5:20mm", "chessboard:7x7:20mm")
SIZE_WH = (1280, 960)
SHARE_WITHOUT_BOARD = 0.1
WIDTH_SHARE = (0.15, 0.95)  # of the image's, taken by the printed squares
MAX_TILT_RAD = np.radians(60)
MAX_ROLL_RAD = np.radians(45)
LEAST_SIDE_PX = 8.0
LEAST_SIDE_PER_BLUR = 4.0
BLURS_PX = (0.4, 4.0)
NOISES_DN = (0.5, 8.0)
BESIDE_THE_IMAGE = SE3(np.eye(3), np.array([1000.0, 0.0, 1.0]))
MAX_ERROR_PER_SIDE = 0.25  # a corner farther from its place, in short sides of the squares, makes a grid wrong


@dataclass(frozen=True, slots=True, eq=False)
class DetectionScene:
    """An image, its board (the one asked for, where there is none) and the true corners, None without a board."""

    image: UInt8[ndarray, "h w"]
    board: Board
    corners_px: Float[ndarray, "n 2"] | None
    short_side_px: float
    """Of the smallest square."""
    text: str
    """How it was drawn."""


@dataclass(slots=True)
class _Tally:
    """What one finder made of the images."""

    n_boards: int = 0
    n_found: int = 0
    missed: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    board_ms: list[float] = field(default_factory=list)
    other_ms: list[float] = field(default_factory=list)


def draw_detection_scene(seed: int, index: int) -> DetectionScene:
    """The ``index``-th image of a ``seed``."""
    rng = np.random.default_rng([seed, index])
    board = parse_board(BOARDS[rng.integers(len(BOARDS))])
    width, height = SIZE_WH
    camera = Camera("brown4", SIZE_WH, np.r_[1.1 * width, 1.1 * width, width / 2, height / 2, 0, -0.1, 0.02, 0, 0])
    black, white = rng.uniform(15, 70), rng.uniform(140, 235)
    background_dn, clutter_dn = rng.uniform(60, 170), rng.uniform(15, 60)
    noise_dn = float(np.exp(rng.uniform(*np.log(NOISES_DN))))
    has_board = rng.uniform() >= SHARE_WITHOUT_BOARD
    T_camera_board, text = BESIDE_THE_IMAGE, "no board, "
    corners, short = None, np.inf
    while has_board and corners is None:
        T_camera_board, share, tilt_rad = _draw_pose(camera, board, rng)
        corners, short = _true_corners(camera, T_camera_board, board)
        text = f"{share:.0%} wide, tilt {np.degrees(tilt_rad):.0f} deg, side {short:.1f}, "
    blur_px = float(np.exp(rng.uniform(*np.log(BLURS_PX))))
    if has_board:
        blur_px = min(blur_px, short / LEAST_SIDE_PER_BLUR)
    slope_x, slope_y = rng.uniform(-0.3, 0.3, 2)
    render = RenderOptions(
        blur_px=blur_px,
        shading=(slope_x, slope_y),
        black_dn=black,
        white_dn=white,
        background_dn=background_dn,
        clutter_dn=clutter_dn,
    )
    light = render_light(camera, T_camera_board, board, render, rng)
    shadow, shade = _draw_shadow(rng)
    light = light * shadow + np.float32(noise_dn) * rng.standard_normal(light.shape, dtype=np.float32)
    image = np.rint(np.clip(light, 0, 255)).astype(np.uint8)
    text += f"blur {blur_px:.2f}, noise {noise_dn:.1f}, {black:.0f}..{white:.0f}, shade {shade:.2f}"
    return DetectionScene(image, board, corners, short, f"{seed}/{index} {board.columns}x{board.rows} {text}")


def _draw_pose(camera: Camera, board: Board, rng: np.random.Generator) -> tuple[SE3, float, float]:
    """A pose, the share of the image's width that it takes when seen from the front, and its tilt."""
    x0, y0, x1, y1 = printed_extent_m(board)
    share = rng.uniform(*WIDTH_SHARE)
    tilt, way, roll = rng.uniform(0, MAX_TILT_RAD), rng.uniform(0, 2 * np.pi), rng.uniform(-1, 1) * MAX_ROLL_RAD
    R = exp(tilt * np.array([np.cos(way), np.sin(way), 0.0])) @ exp(np.array([0.0, 0.0, roll]))
    distance = 1.1 * (x1 - x0) / share
    half = distance / 2.2 * np.array([1, SIZE_WH[1] / SIZE_WH[0]])
    centre = np.r_[rng.uniform(-half, half), distance]
    return SE3(R, centre - R @ np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0])), float(share), float(tilt)


def _true_corners(camera: Camera, T_camera_board: SE3, board: Board) -> tuple[Float[ndarray, "n 2"] | None, float]:
    """The corners and the shortest side of a square; None where the print leaves the image or is too small."""
    x0, y0, x1, y1 = printed_extent_m(board)
    outline = T_camera_board.apply(np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]]))
    if outline[:, 2].min() < 0.05 or not T_camera_board.inverse().t[2] < 0:
        return None, 0.0
    rim = camera.project(outline)
    if (rim < 1).any() or (rim > np.array(SIZE_WH) - 2).any():
        return None, 0.0
    corners = visible_px(camera, T_camera_board.apply(board.object_points_m))
    grid = corners.reshape(board.rows, board.columns, 2)
    sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)]
    short = float(min(sides))
    return (corners, short) if short >= LEAST_SIDE_PX else (None, 0.0)


def _draw_shadow(rng: np.random.Generator) -> tuple[Float32[ndarray, "h w"], float]:
    """Light that is left where a straight-edged shadow falls on a part of the scene, its border sharp or soft."""
    width, height = SIZE_WH
    shade = float(rng.uniform(0.35, 1.0))
    angle, softness = rng.uniform(0, 2 * np.pi), np.exp(rng.uniform(0, np.log(60)))
    x, y = rng.uniform(0.2, 0.8, 2) * SIZE_WH
    across = np.cos(angle) * (np.arange(width) - x) + np.sin(angle) * (np.arange(height) - y)[:, None]
    return (shade + (1 - shade) / (1 + np.exp(-np.clip(across / softness, -30, 30)))).astype(np.float32), shade


def is_in_place(points_px: Float[ndarray, "n 2"], scene: DetectionScene) -> bool:
    """Whether every corner that was found is at its place, in an order that the board's colours allow."""
    if scene.corners_px is None:
        return False
    grid = scene.corners_px.reshape(scene.board.rows, scene.board.columns, 2)
    orders = [grid]
    if (scene.board.columns + scene.board.rows) % 2 == 0:  # the outer squares at both ends are of one colour
        orders.append(grid[::-1, ::-1])
    if scene.board.columns == scene.board.rows:
        orders += [np.rot90(order, turns) for order in list(orders) for turns in (1, 3)]
    limit = MAX_ERROR_PER_SIDE * scene.short_side_px
    errors = [np.linalg.norm(points_px - order.reshape(-1, 2), axis=-1) for order in orders]
    return any(bool((error[np.isfinite(error)] < limit).all()) for error in errors)


def _finders() -> dict[str, Callable[[UInt8[ndarray, "h w"], Board], ndarray | None]]:
    import cv2

    def own(image: ndarray, board: Board) -> ndarray | None:
        found = detect(image, board)
        return found.points_px if found.is_found else None

    def legacy(image: ndarray, board: Board) -> ndarray | None:
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, corners = cv2.findChessboardCorners(image, (board.columns, board.rows), flags=flags)
        return corners.reshape(-1, 2) if found else None

    def sector(image: ndarray, board: Board) -> ndarray | None:
        found, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows))
        return corners.reshape(-1, 2) if found else None

    return {"binocal": own, "OpenCV": legacy, "OpenCV SB": sector}


def run_detection_benchmark(*, images: int = 500, peer_every: int = 10, seed: int = 0) -> dict[str, Any]:
    """Boards found, missed and wrong, and CPU time on one core with and without a board, for each finder.

    ``missed`` and ``wrong`` name images as seed/index with how they were drawn. OpenCV's order of corners is not
    held against it: its corners may come from either end.
    """
    import cv2

    finders = _finders()
    tallies = {name: _Tally() for name in finders}
    own_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        for index in range(images):
            scene = draw_detection_scene(seed, index)
            for name, finder in finders.items():
                if name == "binocal" or index % peer_every == 0:
                    _score(tallies[name], scene, finder, any_order=name != "binocal")
    finally:
        cv2.setNumThreads(own_threads)
    rows = [_row(name, tally) for name, tally in tallies.items()]
    machine = f"{platform.machine()}, Python {platform.python_version()}, OpenCV {cv2.__version__}"
    text = _format(rows, images, seed, machine)
    return {
        "benchmark": "detection",
        "images": images,
        "seed": seed,
        "machine": machine,
        "rows": rows,
        "text": text,
    }


def _score(
    tally: _Tally, scene: DetectionScene, finder: Callable[[ndarray, Board], ndarray | None], *, any_order: bool
) -> None:
    begin = time.thread_time()
    points = finder(scene.image, scene.board)
    elapsed_ms = 1e3 * (time.thread_time() - begin)
    if scene.corners_px is None:
        tally.other_ms.append(elapsed_ms)
    else:
        tally.n_boards += 1
        tally.board_ms.append(elapsed_ms)
    if points is None:
        if scene.corners_px is not None:
            tally.missed.append(scene.text)
    elif is_in_place(points, scene) or (any_order and is_in_place(points[::-1], scene)):
        tally.n_found += 1
    else:
        tally.wrong.append(scene.text)


def _row(name: str, tally: _Tally) -> dict[str, Any]:
    row: dict[str, Any] = {"finder": name, "n_boards": tally.n_boards, "n_found": tally.n_found}
    row |= {"missed": tally.missed, "wrong": tally.wrong, "n_without_board": len(tally.other_ms)}
    for key, times in (("board_ms", tally.board_ms), ("no_board_ms", tally.other_ms)):
        if times:
            row[key] = {"median": float(np.median(times)), "p95": float(np.quantile(times, 0.95)), "max": max(times)}
    return row


def _format(rows: list[dict[str, Any]], images: int, seed: int, machine: str) -> str:
    def spread(times: dict[str, float] | None) -> str:
        return "{median:.1f} {p95:.1f} {max:.1f}".format(**times) if times else "-"

    lines = [
        f"{images} rendered images {SIZE_WH[0]}x{SIZE_WH[1]}, seed {seed} ({machine}); CPU ms: median, 95 %, most",
        f"{'finder':>10} {'boards':>7} {'found':>7} {'missed':>7} {'wrong':>6} {'board, ms':>20} {'no board, ms':>20}",
    ]
    for row in rows:
        lines.append(
            f"{row['finder']:>10} {row['n_boards']:>7} {row['n_found']:>7} {len(row['missed']):>7} {len(row['wrong']):>6} "
            f"{spread(row.get('board_ms')):>20} {spread(row.get('no_board_ms')):>20}"
        )
    for row in rows[:1]:
        lines += [f"{kind}: {text}" for kind in ("missed", "wrong") for text in row[kind]]
    return "\n".join(lines)
