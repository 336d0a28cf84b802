"""Rendered images of boards with markers, marked squares or dots: corners found, wrongly named, how far off, and the time that it takes.

Each case changes one thing of an ordinary image: tilt, blur, noise, small markers, a part out of view or covered, stray
markers of the board's own dictionary, a lens of 150 degrees, harsh light, ink and paper exchanged, tags with one bit of border.
Every image is drawn from its own seed and seen by every finder in turn.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.benchmark.marker_peers import APRILTAG_MISSING, APRILTAG_NOTE, has_apriltag, marker_board_finders
from binocal.boards import Board, parse_board
from binocal.cameras import Camera
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from binocal.shapes import Bool, Float, UInt8
from binocal.simulation import RenderOptions, printed_extent_m, render_image

BOARDS = (
    "charuco:11x8:30mm:22mm:DICT_5X5_50",
    "aprilgrid:6x6:40mm:0.3",
    "chessboard:14x9:20mm:marked",
    "puzzleboard:14x9:20mm:start=50,100",
)
NARROW = "one bit"  # of border about AprilGrids' tags, in place of Kalibr's two: the only ones that AprilTag 3 reads
CASES = (
    "ordinary", "tilt 60", "blur 3", "noise 10", "small", "partial", "wide", "covered", "stray", "light", "inverted",
    NARROW,
)  # fmt: skip
SIZE_WH = (1280, 960)
FIELD_RAD = np.radians(150)
INSIDE_PX = 6.0  # of the image's border: corners nearer to it are not asked for
MAX_OFF_PX, MAX_OFF_SPACINGS = 1.5, 0.1  # the larger of both is near enough to count as found
WRONG_SPACINGS = 0.4  # farther off, a corner has the name of another one
LEAST_SHARE = 0.3  # of the corners, that an image shows


@dataclass(frozen=True, slots=True, eq=False)
class MarkerBoardScene:
    """An image, its board, the true corners (NaN: outside), the distance to the nearest other one, and which are to be found.

    ``camera``, ``T_camera_board`` and ``options`` are what it was rendered with.
    """

    image: UInt8[ndarray, "h w"]
    board: Board
    corners_px: Float[ndarray, "n 2"]
    spacing_px: Float[ndarray, "n"]
    is_visible: Bool[ndarray, "n"]
    camera: Camera
    T_camera_board: SE3
    options: RenderOptions


@dataclass(slots=True)
class _Tally:
    n_visible: int = 0
    n_found: int = 0
    n_wrong: int = 0
    n_boards: int = 0
    errors_px: list[ndarray] = field(default_factory=list)
    elapsed_ms: list[float] = field(default_factory=list)


def draw_marker_board(spec: str, case: str, seed: int, index: int) -> MarkerBoardScene:
    """The ``index``-th image of a board in a case."""
    rng = np.random.default_rng([seed, index, CASES.index(case), len(spec)])
    board = parse_board(spec)
    camera = _camera(case)
    options = _options(case, rng)
    while True:
        T_camera_board = _draw_pose(camera, board, case, rng)
        if T_camera_board is None:
            continue
        rendered = render_image(camera, T_camera_board, board, options, rng)
        corners = rendered.corners_px
        if np.isfinite(corners[:, 0]).mean() >= LEAST_SHARE:
            break
    image = rendered.image.astype(np.uint8)
    hidden = np.zeros(len(corners), bool)
    if case == "covered":
        image, hidden = _cover(image, corners, rng)
    if case == "stray":
        image, hidden = _paste_strays(image, corners, board, rng)
    if case == "inverted":
        image = 255 - image
    inside = ((corners > INSIDE_PX) & (corners < np.array(SIZE_WH) - 1 - INSIDE_PX)).all(axis=1)
    apart = np.linalg.norm(corners[:, None] - corners, axis=-1) + np.where(np.eye(len(corners)), np.inf, 0)
    spacing = np.where(np.isfinite(apart), apart, np.inf).min(axis=1)
    return MarkerBoardScene(image, board, corners, spacing, inside & ~hidden, camera, T_camera_board, options)


def _camera(case: str) -> Camera:
    width, height = SIZE_WH
    if case == "wide":
        f = width / FIELD_RAD
        return Camera("fisheye4", SIZE_WH, np.r_[f, f, width / 2, height / 2, np.zeros(5)])
    return Camera("brown4", SIZE_WH, np.r_[1.1 * width, 1.1 * width, width / 2, height / 2, 0, -0.1, 0.02, 0, 0])


def _options(case: str, rng: np.random.Generator) -> RenderOptions:
    given: dict[str, Any] = {"blur_px": rng.uniform(0.5, 1.2), "noise_dn": rng.uniform(1, 4)}
    if case == "blur 3":
        given["blur_px"] = 3.0
    elif case == "noise 10":
        given["noise_dn"] = 10.0
    elif case == "small":
        given["blur_px"] = rng.uniform(0.4, 0.8)
    elif case == NARROW:
        given["april_border_bits"] = 1
    elif case == "light":
        given |= {"shading": tuple(rng.uniform(-0.6, 0.6, 2)), "vignetting": 0.5, "gamma": 2.2}
    return RenderOptions(**given)


def _draw_pose(camera: Camera, board: Board, case: str, rng: np.random.Generator) -> SE3 | None:
    """A pose, None where the camera would see the board's back."""
    x0, y0, x1, y1 = printed_extent_m(board)
    low, high = {"partial": (1.1, 1.9), "blur 3": (0.75, 0.95)}.get(case, (0.45, 0.85))
    share = rng.uniform(low, high)
    if case == "small":  # squares of 10 to 20 px, tags of 14 to 30
        share = (
            rng.uniform(*((14, 30) if board.kind == "aprilgrid" else (10, 20))) * (x1 - x0) / board.pitch_m / SIZE_WH[0]
        )
    tilt = np.radians(60) if case == "tilt 60" else rng.uniform(0, np.radians(40))
    way, roll = rng.uniform(0, 2 * np.pi), rng.uniform(-np.pi, np.pi)
    R = exp(tilt * np.array([np.cos(way), np.sin(way), 0.0])) @ exp(np.array([0.0, 0.0, roll]))
    if case == "wide":
        centre = np.r_[rng.uniform(-0.3, 0.3, 2), rng.uniform(0.28, 0.6)] * (x1 - x0)
    else:
        distance = 1.1 * (x1 - x0) / share
        half = distance / 2.2 * np.array([1, SIZE_WH[1] / SIZE_WH[0]])
        reach = 0.6 if case == "partial" else 0.5 * (1.1 - min(share, 0.9))
        centre = np.r_[rng.uniform(-reach, reach, 2) * half, distance]
    pose = SE3(R, centre - R @ np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0]))
    is_near = pose.apply(board.object_points_m)[:, 2].min() < 0.02 and case != "wide"
    return None if is_near or not pose.inverse().t[2] < 0 else pose


def _cover(image: ndarray, corners: ndarray, rng: np.random.Generator) -> tuple[ndarray, ndarray]:
    """Two to four ellipses over the board, and the corners that they cover or come near."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    hidden = np.zeros(len(corners), bool)
    for _ in range(rng.integers(2, 5)):
        middle = corners[rng.choice(np.flatnonzero(np.isfinite(corners[:, 0])))] + rng.uniform(-20, 20, 2)
        axes, turn = rng.uniform(30, 110, 2), rng.uniform(0, np.pi)
        c, s = np.cos(turn), np.sin(turn)

        def ratio(u: ndarray, v: ndarray, grow: float = 0.0, axes=axes, middle=middle, c=c, s=s) -> ndarray:
            du, dv = u - middle[0], v - middle[1]
            return np.hypot((c * du + s * dv) / (axes[0] + grow), (c * dv - s * du) / (axes[1] + grow))

        cloth = np.clip(rng.uniform(60, 180) + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)
        image = np.where(ratio(x, y) < 1, cloth, image)
        hidden |= ratio(corners[:, 0], corners[:, 1], grow=5.0) < 1
    return image, hidden


def _paste_strays(image: ndarray, corners: ndarray, board: Board, rng: np.random.Generator) -> tuple[ndarray, ndarray]:
    """Five markers of the board's own dictionary anywhere, and the corners under them."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.marker_dictionary))
    image, hidden, rim = image.copy(), np.zeros(len(corners), bool), 6
    for _ in range(5):
        side, marker = int(rng.integers(30, 70)), int(rng.integers(0, 36))
        drawn = cv2.aruco.generateImageMarker(dictionary, marker, side, borderBits=1 if board.kind == "charuco" else 2)
        x, y = (int(rng.integers(0, n - side - 2 * rim)) for n in SIZE_WH)
        whole = np.s_[y : y + side + 2 * rim, x : x + side + 2 * rim]
        image[whole] = np.pad(drawn, rim, constant_values=230)
        low, high = np.array([x, y]) - 8, np.array([x, y]) + side + 2 * rim + 8
        hidden |= ((corners > low) & (corners < high)).all(axis=1)
    return image, hidden


def run_marker_board_benchmark(
    *, images: int = 20, seed: int = 0, cases: Sequence[str] = CASES, boards: Sequence[str] = BOARDS
) -> dict[str, Any]:
    """For each board, case and finder: visible corners found, wrong names, RMS error of the found ones, CPU time on one core.

    Boards without markers have no stray ones.
    """
    import cv2

    rows, own_threads = [], cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        for spec in boards:
            board = parse_board(spec)
            for case in cases:
                if (case == NARROW and board.kind != "aprilgrid") or (case == "stray" and not board.marker_dictionary):
                    continue
                finders = marker_board_finders(board, border_bits=1 if case == NARROW else 2)
                tallies = {name: _Tally() for name in finders}
                for index in range(images):
                    scene = draw_marker_board(spec, case, seed, index)
                    for name, finder in finders.items():
                        _score(tallies[name], scene, finder)
                rows += [_row(spec, case, name, tally) for name, tally in tallies.items()]
    finally:
        cv2.setNumThreads(own_threads)
    machine = f"{platform.machine()}, Python {platform.python_version()}, OpenCV {cv2.__version__}"
    text = format_rows(rows, images, seed, machine)
    if NARROW in cases and any(parse_board(spec).kind == "aprilgrid" for spec in boards):
        text += f"\n{APRILTAG_NOTE}" + ("" if has_apriltag() else f"; left out: {APRILTAG_MISSING}")
    return {"benchmark": "boards", "images": images, "seed": seed, "machine": machine, "rows": rows, "text": text}


def _score(tally: _Tally, scene: MarkerBoardScene, finder: Callable[[ndarray], ndarray]) -> None:
    begin = time.thread_time()
    points = finder(scene.image)
    tally.elapsed_ms.append(1e3 * (time.thread_time() - begin))
    off = np.linalg.norm(points - scene.corners_px, axis=1)
    is_found = scene.is_visible & (off < np.maximum(MAX_OFF_PX, MAX_OFF_SPACINGS * scene.spacing_px))
    tally.n_visible += int(scene.is_visible.sum())
    tally.n_found += int(is_found.sum())
    tally.n_wrong += int((off > WRONG_SPACINGS * scene.spacing_px).sum())
    tally.n_boards += int(is_found.sum() >= 0.5 * scene.is_visible.sum())
    tally.errors_px.append(off[is_found])


def _row(spec: str, case: str, name: str, tally: _Tally) -> dict[str, Any]:
    errors = np.concatenate(tally.errors_px)
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


def _kind(spec: str) -> str:
    """A SPEC's kind, with the style of its circles."""
    board = parse_board(spec)
    return board.kind + f":{board.circle_style}" * bool(board.circle_style)


def format_rows(rows: list[dict[str, Any]], images: int, seed: int, machine: str) -> str:
    """A table of the rows of boards, cases and finders."""
    lines = [
        f"{images} rendered images {SIZE_WH[0]}x{SIZE_WH[1]} a case, seed {seed} ({machine}); boards: half of the corners or more",
        f"{'board':>14} {'case':>12} {'finder':>10} {'corners':>8} {'boards':>7} {'wrong':>6} {'rms, px':>8} {'CPU, ms':>8}",
    ]
    for row in rows:
        share = row["n_found"] / max(row["n_visible"], 1)
        rms = "-" if row["rms_px"] is None else f"{row['rms_px']:.4f}"
        lines.append(
            f"{_kind(row['board']):>14} {row['case']:>12} {row['finder']:>10} {share:>8.1%} {row['n_boards']:>7} "
            f"{row['n_wrong']:>6} {rms:>8} {row['median_ms']:>8.1f}"
        )
    return "\n".join(lines)
