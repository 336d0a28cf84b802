"""Corners through lenses of 60 to 200 degrees: bias, error over the bound and over what is stated, by ring of the image.

Boards of 5x4, 9x6 and 11x8 corners anywhere in the field (:mod:`.wide_lenses`), 640x480, blur 0.8 px, noise 2 grey levels. The bound is
that of :mod:`.corner_bound`: a saddle of straight edges, as they run through the true corner. A ring's bias is the mean of the errors away from
the principal point.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.benchmark.corner_bound import corner_bound
from binocal.benchmark.wide_lenses import LENSES, place_board, wide_camera
from binocal.boards import Board, parse_board
from binocal.cameras import Camera
from binocal.detection.finding.grid import grid_reach
from binocal.detection.measuring.corner_fit import fit_corners
from binocal.geometry import SE3
from binocal.kernels.corner_fits import BoardPlaces
from binocal.shapes import Float
from binocal.simulation import RenderOptions, render_image

BOARDS = ("chessboard:5x4:60mm", "chessboard:9x6:30mm", "chessboard:11x8:25mm")
OPTIONS = RenderOptions(blur_px=0.8, noise_dn=2.0)
RINGS_PX = (0.0, 60.0, 120.0, 180.0, 240.0, 400.0)  # from the principal point, in images that are 640 px wide
MAX_START_PX = 0.7
OUTLIER_PX = 0.5  # an error beyond it is counted as a failure
_RADIUS_PX, _PER_REACH = (3.0, 14.0), 0.85  # of the disc that the fit takes
_STEP_PITCHES = 1e-4  # along the board, for the tangents of its edges


def measure_rings(images_a_lens: int, seed: int, size_wh: tuple[int, int] = (640, 480)) -> list[dict[str, Any]]:
    """A row for each lens and ring: corners, failures, bias, error over the bound and over its stated standard deviation (RMS).

    The lenses' focal lengths and the rings grow with the images' width.
    """
    rows = []
    for degrees in LENSES:
        camera = wide_camera(degrees, size_wh)
        shots = [_measure(camera, parse_board(BOARDS[i % len(BOARDS)]), seed, i) for i in range(images_a_lens)]
        distance, outward, error2, best2, score2 = np.concatenate(shots).T
        for low, high in pairwise(radius * size_wh[0] / 640 for radius in RINGS_PX):
            inside = (distance >= low) & (distance < high)
            good = inside & (np.nan_to_num(error2, nan=np.inf) < OUTLIER_PX**2)
            if not good.any():
                continue
            rows.append(
                {
                    "field_deg": degrees,
                    "ring_px": [low, high],
                    "n_corners": int(good.sum()),
                    "n_failed": int((inside & ~good).sum()),
                    "bias_px": float(outward[good].mean()),
                    "bias_error_px": float(outward[good].std() / np.sqrt(good.sum())),
                    "over_bound": float(np.sqrt(np.mean(error2[good] / best2[good]))),
                    "z_rms": float(np.sqrt(np.mean(score2[good]) / 2)),
                }
            )
    return rows


def format_rings(rows: list[dict[str, Any]], images_a_lens: int) -> str:
    """The rows as a table."""
    lines = [
        f"lenses, {images_a_lens} images each: bias is away from the principal point, z the error over its stated sigma, RMS",
        f"{'field, deg':<12}{'ring, px':>10}{'corners':>9}{'failed':>8}{'bias, px':>20}{'over the bound':>16}{'z':>7}",
    ]
    for row in rows:
        low, high = row["ring_px"]
        bias = f"{row['bias_px']:+.4f} ± {row['bias_error_px']:.4f}"
        lines.append(
            f"{row['field_deg']:<12}{f'{low:.0f}-{high:.0f}':>10}{row['n_corners']:>9}{row['n_failed']:>8}"
            f"{bias:>20}{row['over_bound']:>16.2f}{row['z_rms']:>7.2f}"
        )
    return "\n".join(lines)


def _measure(camera: Camera, board: Board, seed: int, index: int) -> Float[ndarray, "n 5"]:
    """Of each corner of an image: distance from the principal point, outward error, squared error, bound's variance, z^T z."""
    rng = np.random.default_rng([seed, index])
    T_camera_board = place_board(camera, board, rng)
    rendered = render_image(camera, T_camera_board, board, OPTIONS, rng)
    truth = rendered.corners_px
    reach = grid_reach(truth.reshape(board.rows, board.columns, 2)).ravel()
    start = truth + rng.uniform(-MAX_START_PX, MAX_START_PX, truth.shape)
    places = BoardPlaces(board.object_points_m[:, :2], board.pitch_m)
    fit = fit_corners(rendered.image, start, reach, board=places)
    error, away = fit.points_px - truth, truth - camera.K[:2, 2]
    radius = np.linalg.norm(away, axis=1)
    whitened = np.full(truth.shape, np.nan)
    fitted = np.isfinite(error[:, 0])
    root = np.linalg.cholesky(fit.covariance_px2[fitted])
    whitened[fitted] = np.linalg.solve(root, error[fitted][..., None])[..., 0]
    noise_dn = float(np.sqrt(OPTIONS.noise_dn**2 + 1 / 12))  # rounding included
    bounds = [
        corner_bound(
            corner,
            edges,
            blur_px=float(np.sqrt(OPTIONS.blur_px**2 + 1 / 12)),
            contrast_dn=OPTIONS.white_dn - OPTIONS.black_dn,
            noise_dn=noise_dn,
            radius_px=r,
        )
        for corner, edges, r in zip(
            truth, _tangents(camera, T_camera_board, board), np.clip(_PER_REACH * reach, *_RADIUS_PX), strict=True
        )
    ]
    best2 = np.trace(np.array(bounds), axis1=1, axis2=2)
    outward = (error * away).sum(axis=1) / np.maximum(radius, 1e-9)
    return np.stack([radius, outward, (error**2).sum(axis=1), best2, (whitened**2).sum(axis=1)], axis=-1)


def _tangents(camera: Camera, T_camera_board: SE3, board: Board) -> Float[ndarray, "n 2"]:
    """Directions (radians) of the two edges' images at each corner."""
    angles = []
    for axis in range(2):
        step = np.eye(3)[axis] * _STEP_PITCHES * board.pitch_m
        ends = [camera.project(T_camera_board.apply(board.object_points_m + way * step)) for way in (-1, 1)]
        angles.append(np.arctan2(*(ends[1] - ends[0]).T[::-1]))
    return np.stack(angles, axis=-1)
