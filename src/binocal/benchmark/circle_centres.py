"""Centres of circle grids, and corners of square grids, in rendered images: errors over what the images allow at best, beside OpenCV's.

The bound of a centre is the inverse Fisher information of a ten-parameter blurred ellipse (:mod:`.ellipse_bound`) over the pixels about
its true outline, for the noise that was rendered. Errors are those of the projected centres, which a board's points are:
binocal takes the shift between them and the ellipses' centres out, OpenCV does not, so its points are also held against the
ellipses' own centres. The bound of a square's corner is that of fourteen numbers of its outline (:mod:`.square_bound`); OpenCV has no
detector of square grids. All find the grid themselves; a grid that looks the same turned is compared with the truth turned alike.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.benchmark.ellipse_bound import ellipse_bound
from binocal.benchmark.square_bound import square_bound
from binocal.boards import Board, parse_board
from binocal.cameras import Camera
from binocal.detection import detect
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from binocal.shapes import Float
from binocal.simulation import RenderOptions, printed_extent_m, render_image

BOARDS = ("circles:10x10:30mm", "acircles:4x11:20mm", "squares:6x5:30mm:20mm")
SIZE_WH = (1280, 960)
CASES: dict[str, dict[str, Any]] = {
    "ordinary": {},
    "tilt 45": {"tilt_deg": 45.0},
    "tilt 60": {"tilt_deg": 60.0},
    "blur 0.5": {"blur_px": 0.5},
    "blur 3": {"blur_px": 3.0},
    "noise 1": {"noise_dn": 1.0},
    "noise 10": {"noise_dn": 10.0},
    "small": {"share": 0.25},
    "shading": {"shading": (0.7, 0.5), "white_dn": 150.0},
    "shading, clipped": {"shading": (0.7, 0.5), "white_dn": 210.0},
    "vignetting, gamma": {"shading": (0.4, 0.3), "vignetting": 0.5, "gamma": 2.2},
    "back light": {"shading": (0.8, -0.5), "black_dn": 12.0, "white_dn": 160.0, "blur_px": 1.5},
    "wide 150": {"field_rad": np.radians(150)},
}
TOP_DN = 255.0
FAR_PX = 0.5  # an error beyond it is counted as a failure
_N_OUTLINE = 24
_OF_ELLIPSES = "OpenCV, ellipses"


@dataclass(slots=True)
class _Tally:
    errors_px: list[ndarray] = field(default_factory=list)
    bounds_px2: list[ndarray] = field(default_factory=list)
    whitened: list[ndarray] = field(default_factory=list)
    along_light_px: list[ndarray] = field(default_factory=list)
    elapsed_ms: list[float] = field(default_factory=list)
    n_failed: int = 0
    n_images: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class CircleScene:
    """An image of a grid: projected centres, centroids of the circles' images, bounds (px^2), the light's direction.

    Of a square grid both are the projected corners.
    """

    image: ndarray
    board: Board
    centres_px: Float[ndarray, "n 2"]
    ellipses_px: Float[ndarray, "n 2"]
    bounds_px2: Float[ndarray, "n 2 2"]
    light: Float[ndarray, "2"]


def draw_circle_scene(spec: str, case: str, seed: int) -> CircleScene:
    """An image of a case; poses, sizes and places differ by seed."""
    given = dict(CASES[case])
    rng = np.random.default_rng([seed, list(CASES).index(case), len(spec)])
    board, (width, height) = parse_board(spec), SIZE_WH
    tilt_deg, share = given.pop("tilt_deg", rng.uniform(0, 35)), given.pop("share", rng.uniform(0.6, 0.9))
    field_rad = given.pop("field_rad", None)
    if field_rad is None:
        camera = Camera("brown4", SIZE_WH, np.r_[1.1 * width, 1.1 * width, width / 2, height / 2, 0, -0.1, 0.02, 0, 0])
    else:
        f = width / field_rad
        camera = Camera("fisheye4", SIZE_WH, np.r_[f, f, width / 2, height / 2, np.zeros(5)])
    options = RenderOptions(**{"blur_px": 0.9, "noise_dn": 3.0, "clutter_dn": 0.0, **given})
    x0, y0, x1, y1 = printed_extent_m(board)
    way, roll = rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0.5)
    R = exp(np.radians(tilt_deg) * np.array([np.cos(way), np.sin(way), 0.0])) @ exp(np.array([0.0, 0.0, roll]))
    distance = 1.1 * max(x1 - x0, (y1 - y0) * width / height) / share
    if field_rad is not None:
        distance = 0.55 * max(x1 - x0, y1 - y0)
    place = np.r_[rng.uniform(-0.05, 0.05, 2) * distance, distance]
    T = SE3(R, place - R @ np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0]))
    image = render_image(camera, T, board, options, rng).image
    centres = camera.project(T.apply(board.object_points_m))
    along = np.array([*options.shading, 0.0]) / np.array([x1 - x0, y1 - y0, 1.0])
    step = 1e-3 * board.pitch_m * along / max(np.linalg.norm(along), 1e-12)
    middle = board.object_points_m.mean(axis=0)
    moved = np.diff(camera.project(T.apply(np.stack([middle - step, middle + step]))), axis=0)[0]
    light = moved / max(np.linalg.norm(moved), 1e-12)
    if board.kind == "squares":
        bounds = _bounds_of_squares(board, options, camera, T)
        return CircleScene(image, board, centres, centres, bounds, light)
    turn = 2 * np.pi * np.arange(_N_OUTLINE) / _N_OUTLINE
    spacing_m = board.pitch_m * (np.sqrt(2) if board.kind == "acircles" else 1.0)
    radius_m = 0.5 * board.circle_diameter_ratio * spacing_m
    rim = radius_m * np.stack([np.cos(turn), np.sin(turn), np.zeros(_N_OUTLINE)], axis=-1)
    outlines = camera.project(T.apply((board.object_points_m[:, None] + rim).reshape(-1, 3))).reshape(-1, _N_OUTLINE, 2)
    bounds = _bounds(board, options, outlines, centres)
    return CircleScene(image, board, centres, _centroids(outlines), bounds, light)


def _centroids(outlines: Float[ndarray, "n k 2"]) -> Float[ndarray, "n 2"]:
    following = np.roll(outlines, -1, axis=1)
    cross = outlines[..., 0] * following[..., 1] - outlines[..., 1] * following[..., 0]
    return ((outlines + following) * cross[..., None]).sum(axis=1) / (3 * cross.sum(axis=1))[:, None]


def _bounds(
    board: Board, options: RenderOptions, outlines: Float[ndarray, "n k 2"], centres: Float[ndarray, "n 2"]
) -> Float[ndarray, "n 2 2"]:
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1) + np.where(np.eye(len(centres)), np.inf, 0)
    radius = np.linalg.norm(outlines - centres[:, None], axis=-1)
    noise_dn = float(np.sqrt(options.noise_dn**2 + 1 / 12))
    bounds = np.full((len(centres), 2, 2), np.nan)
    for i, outline in enumerate(outlines):
        if not np.isfinite(outline).all():
            continue
        bounds[i] = ellipse_bound(
            outline,
            blur_px=float(np.sqrt(options.blur_px**2 + 1 / 12)),
            noise_dn=noise_dn,
            gap_px=float(apart[i].min() - 2 * radius[i].mean()),
            most_dn=TOP_DN - 2 * noise_dn,
            levels_dn=_levels_at(board, options, board.object_points_m[i, :2], centres[i]),
        )
    return bounds


def _bounds_of_squares(board: Board, options: RenderOptions, camera: Camera, T: SE3) -> Float[ndarray, "n 2 2"]:
    grid = np.arange(board.n_points).reshape(2 * board.rows, 2 * board.columns)
    squares = np.stack([grid[i::2, j::2].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0))], axis=-1)
    noise_dn, bounds = float(np.sqrt(options.noise_dn**2 + 1 / 12)), np.full((board.n_points, 2, 2), np.nan)
    half_gap = 0.5 * board.gap_m * np.array([[0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0.0]])
    for square in squares:
        points = board.object_points_m[square]
        middles = 0.5 * (points + np.roll(points, -1, axis=0))
        corners, sides, beyond = (camera.project(T.apply(p)) for p in (points, middles, middles + half_gap))
        if not (np.isfinite(corners).all() and np.isfinite(beyond).all()):
            continue
        bounds[square] = square_bound(
            corners,
            blur_px=float(np.sqrt(options.blur_px**2 + 1 / 12)),
            noise_dn=noise_dn,
            outward_px=np.linalg.norm(beyond - sides, axis=1),
            most_dn=TOP_DN - 2 * noise_dn,
            levels_dn=_levels_at(board, options, points[:, :2].mean(axis=0), corners.mean(axis=0)),
        )
    return bounds


def _levels_at(
    board: Board, options: RenderOptions, place_m: Float[ndarray, "2"], pixel: Float[ndarray, "2"]
) -> tuple[float, float]:
    """Grey levels of ink and paper at a place of the board."""
    box = board.object_points_m[:, :2]
    share = (place_m - box.mean(axis=0)) / np.ptp(box, axis=0)
    from_middle = np.sum((pixel - np.array(SIZE_WH) / 2) ** 2) / (np.hypot(*SIZE_WH) / 2) ** 2
    light = (1 + share @ options.shading) * (1 - options.vignetting * from_middle)
    dark, bright = (
        float(255 * max(level * light / 255, 0.0) ** (1 / options.gamma))
        for level in (options.black_dn, options.white_dn)
    )
    return dark, bright


def run_circle_centres_benchmark(
    *, images: int = 6, seed: int = 0, cases: Sequence[str] = tuple(CASES), boards: Sequence[str] = BOARDS
) -> dict[str, Any]:
    """For each board, case and finder: RMS error and its ratio to the bound, bias, coverage, time on one core."""
    import cv2

    rows, own_threads = [], cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        for spec in boards:
            for case in cases:
                is_of_squares = parse_board(spec).kind == "squares"
                names = ("binocal",) if is_of_squares else ("binocal", "OpenCV", _OF_ELLIPSES)
                tallies = {name: _Tally() for name in names}
                for index in range(images):
                    scene = draw_circle_scene(spec, case, seed + index)
                    _score(tallies["binocal"], scene, *_timed(_find_ours, scene))
                    if is_of_squares:
                        continue
                    theirs = _timed(_find_opencv, scene)
                    _score(tallies["OpenCV"], scene, *theirs)
                    _score(tallies[_OF_ELLIPSES], replace(scene, centres_px=scene.ellipses_px), *theirs)
                rows += [_row(spec, case, name, tally) for name, tally in tallies.items()]
    finally:
        cv2.setNumThreads(own_threads)
    machine = f"{platform.machine()}, Python {platform.python_version()}, OpenCV {cv2.__version__}"
    text = _format(rows, images, seed, machine)
    return {"benchmark": "circles", "images": images, "seed": seed, "machine": machine, "rows": rows, "text": text}


def _find_ours(scene: CircleScene) -> tuple[ndarray, ndarray | None]:
    found = detect(scene.image, scene.board)
    return found.points_px, found.covariance_px2


def _find_opencv(scene: CircleScene) -> tuple[ndarray, ndarray | None]:
    import cv2

    is_staggered = scene.board.kind == "acircles"
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if is_staggered else cv2.CALIB_CB_SYMMETRIC_GRID
    found, points = cv2.findCirclesGrid(scene.image, (scene.board.columns, scene.board.rows), flags=kind)
    if not found or points is None:
        return np.full(scene.centres_px.shape, np.nan), None
    return points.reshape(-1, 2).astype(float), None


def _timed(find: Any, scene: CircleScene) -> tuple[ndarray, ndarray | None, float]:
    begin = time.thread_time()
    points, covariance = find(scene)
    return points, covariance, 1e3 * (time.thread_time() - begin)


def _score(tally: _Tally, scene: CircleScene, points: ndarray, covariance: ndarray | None, elapsed_ms: float) -> None:
    tally.elapsed_ms.append(elapsed_ms)
    seen = np.flatnonzero(np.isfinite(points[:, 0]))
    if not len(seen):
        return
    tally.n_images += 1
    nearest = np.linalg.norm(points[seen, None] - scene.centres_px, axis=-1).argmin(axis=1)
    error, bound = points[seen] - scene.centres_px[nearest], scene.bounds_px2[nearest]
    good = (np.linalg.norm(error, axis=1) < FAR_PX) & np.isfinite(bound[:, 0, 0])
    tally.n_failed += int((~good).sum())
    tally.errors_px.append(error[good])
    tally.bounds_px2.append(bound[good])
    tally.along_light_px.append(error[good] @ scene.light)
    if covariance is not None:
        root = np.linalg.cholesky(covariance[seen][good])
        tally.whitened.append(np.linalg.solve(root, error[good][..., None])[..., 0])


def _row(spec: str, case: str, name: str, tally: _Tally) -> dict[str, Any]:
    row: dict[str, Any] = {"board": spec, "case": case, "finder": name, "n_images": tally.n_images}
    row |= {"n_failed": tally.n_failed, "median_ms": float(np.median(tally.elapsed_ms))}
    if not tally.errors_px or not sum(len(e) for e in tally.errors_px):
        return row
    errors, bounds = np.concatenate(tally.errors_px), np.concatenate(tally.bounds_px2)
    along = np.concatenate(tally.along_light_px)
    best2 = np.trace(bounds, axis1=1, axis2=2)
    row |= {
        "n_centres": len(errors),
        "rms_px": float(np.sqrt(np.mean(errors**2))),
        "over_bound": float(np.sqrt(np.mean((errors**2).sum(axis=1) / best2))),
        "bias_px": errors.mean(axis=0).tolist(),
        "along_light_px": float(along.mean()),
        "bias_error_px": float(np.sqrt(np.mean(errors**2) / len(errors))),
    }
    if tally.whitened:
        whitened = np.abs(np.concatenate(tally.whitened))
        row |= {"within_1_sigma": float(np.mean(whitened < 1)), "within_2_sigma": float(np.mean(whitened < 2))}
    return row


def _format(rows: list[dict[str, Any]], images: int, seed: int, machine: str) -> str:
    lines = [
        f"{images} rendered images {SIZE_WH[0]}x{SIZE_WH[1]} a case, seed {seed} ({machine})",
        "ratio: error over the image-level bound, root mean square; bias: mean error in x and y, and along the light's slope, with its "
        "standard error; 1 and 2 sigma: share of the errors within what is stated",
        f"{'board':>9} {'case':>18} {'finder':>16} {'images':>6} {'far':>4} {'rms, px':>8} {'ratio':>6} "
        f"{'bias, px':>17} {'light':>8} {'error':>7} {'1, 2 sigma':>11} {'CPU, ms':>8}",
    ]
    for row in rows:
        text = f"{row['board'].split(':')[0]:>9} {row['case']:>18} {row['finder']:>16} {row['n_images']:>6} {row['n_failed']:>4} "
        if "rms_px" in row:
            x, y = row["bias_px"]
            text += (
                f"{row['rms_px']:>8.4f} {row['over_bound']:>6.2f} {x:>+8.4f} {y:>+8.4f} {row['along_light_px']:>+8.4f} "
            )
            text += f"{row['bias_error_px']:>7.4f} "
        else:
            text += f"{'-':>8} {'-':>6} {'-':>17} {'-':>8} {'-':>7} "
        inside = f"{row['within_1_sigma']:.2f} {row['within_2_sigma']:.2f}" if "within_1_sigma" in row else "-"
        lines.append(f"{text}{inside:>11} {row['median_ms']:>8.1f}")
    return "\n".join(lines)
