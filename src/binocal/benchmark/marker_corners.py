"""Corners of ChArUco boards and AprilGrids: binocal's errors over what the images allow at best, bias and coverage, by case.

The scenes are those of :mod:`.marker_boards`. A corner's bound is that of :mod:`.corner_bound` in the disc that the fit takes, without
what lies nearer than two blurs to a marker, for the contrast and the noise that were rendered.
"""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.benchmark.corner_bound import corner_bound
from binocal.benchmark.marker_boards import BOARDS, CASES, NARROW, MarkerBoardScene, draw_marker_board
from binocal.boards import parse_board
from binocal.detection import detect
from binocal.shapes import Float
from binocal.simulation import printed_extent_m

MARKER_BOARDS = BOARDS[:2]
FAR_PX = 0.5  # an error beyond it is counted as a failure
MOST_RADIUS_PX, LEAST_RADIUS_PX, PER_REACH = 14.0, 2.5, 0.85
LEAST_STRIP_PX = 1.0
CODE_BITS = 6  # of tag36h11, along a side
_STEP = 1e-3  # pitches


@dataclass(slots=True)
class _Tally:
    errors_px: list[ndarray] = field(default_factory=list)
    bounds_px2: list[ndarray] = field(default_factory=list)
    covariances_px2: list[ndarray] = field(default_factory=list)
    n_visible: int = 0
    n_far: int = 0


def marker_corner_bounds(scene: MarkerBoardScene) -> Float[ndarray, "n 2 2"]:
    """The least covariance of each corner in view, px^2; NaN elsewhere."""
    board, options = scene.board, scene.options
    points, h = board.object_points_m, _STEP * board.pitch_m
    axes = []
    for axis in np.eye(3)[:2]:
        ends = [scene.camera.project(scene.T_camera_board.apply(points + sign * h * axis)) for sign in (1, -1)]
        axes.append((ends[0] - ends[1]) / (2 * h) * board.pitch_m)
    lengths = np.linalg.norm(axes, axis=-1)
    height = np.abs(axes[0][:, 0] * axes[1][:, 1] - axes[0][:, 1] * axes[1][:, 0]) / lengths.max(axis=0)
    if board.kind == "charuco":
        reach, strip = height, 0.5 * (1 - board.marker_m / board.pitch_m) * height
    else:
        border = options.april_border_bits
        reach, strip = board.tag_gap_ratio * height, border / (CODE_BITS + 2 * border) * height
    edges = np.stack([np.arctan2(axis[:, 1], axis[:, 0]) for axis in axes], axis=-1)
    x0, y0, x1, y1 = printed_extent_m(board)
    away = (points[:, :2] - [(x0 + x1) / 2, (y0 + y1) / 2]) / [x1 - x0, y1 - y0]
    width, height_px = scene.camera.size_wh
    off2 = np.sum((scene.corners_px - np.array([width - 1, height_px - 1]) / 2) ** 2, axis=1)
    light = (1 + away @ options.shading) * (1 - options.vignetting * off2 / (np.hypot(width, height_px) / 2) ** 2)
    blur = float(np.sqrt(options.blur_px**2 + 1 / 12))
    bounds = np.full((len(points), 2, 2), np.nan)
    for i in np.flatnonzero(scene.is_visible):
        dark, bright = (
            255 * np.clip(level * light[i] / 255, 0, 1) ** (1 / options.gamma)
            for level in (options.black_dn, options.white_dn)
        )
        bounds[i] = corner_bound(
            scene.corners_px[i],
            edges[i],
            blur_px=blur,
            contrast_dn=float(bright - dark),
            noise_dn=float(np.sqrt(options.noise_dn**2 + 1 / 12)),
            radius_px=float(np.clip(PER_REACH * reach[i], LEAST_RADIUS_PX, MOST_RADIUS_PX)),
            strip_px=float(max(strip[i] - 2 * blur, LEAST_STRIP_PX)),
            size_wh=(width, height_px),
        )
    return bounds


def run_marker_corners_benchmark(
    *, images: int = 6, seed: int = 0, cases: Sequence[str] = CASES, boards: Sequence[str] = MARKER_BOARDS
) -> dict[str, Any]:
    """For each board and case: corners kept, RMS error and its ratio to the bound, bias, and coverage."""
    import cv2

    rows = []
    for spec in boards:
        board = parse_board(spec)
        for case in cases:
            if case == NARROW and board.kind != "aprilgrid":
                continue
            tally = _Tally()
            for index in range(images):
                _score(tally, draw_marker_board(spec, case, seed, index))
            rows.append({"board": spec, "case": case, **_figures(tally)})
    machine = f"{platform.machine()}, Python {platform.python_version()}, OpenCV {cv2.__version__}"
    text = _format(rows, images, seed, machine)
    return {"benchmark": "markers", "images": images, "seed": seed, "machine": machine, "rows": rows, "text": text}


def _score(tally: _Tally, scene: MarkerBoardScene) -> None:
    found = detect(scene.image, scene.board)
    tally.n_visible += int(scene.is_visible.sum())
    bounds = marker_corner_bounds(scene)
    error = found.points_px - scene.corners_px
    off = np.linalg.norm(error, axis=1)
    seen = scene.is_visible & np.isfinite(off) & np.isfinite(bounds[:, 0, 0])
    good = seen & (off < FAR_PX)
    tally.n_far += int((seen & ~good).sum())
    if not good.any():
        return
    tally.errors_px.append(error[good])
    tally.bounds_px2.append(bounds[good])
    tally.covariances_px2.append(found.covariance_px2[good])


def _figures(tally: _Tally) -> dict[str, Any]:
    row: dict[str, Any] = {"n_visible": tally.n_visible, "n_far": tally.n_far, "n_corners": 0}
    if not tally.errors_px:
        return row
    errors, bounds = np.concatenate(tally.errors_px), np.concatenate(tally.bounds_px2)
    root = np.linalg.cholesky(np.concatenate(tally.covariances_px2))
    whitened = np.abs(np.linalg.solve(root, errors[..., None])[..., 0])
    square = (errors**2).sum(axis=1)
    return row | {
        "n_corners": len(errors),
        "rms_px": float(np.sqrt(0.5 * square.mean())),
        "over_bound": float(np.sqrt(np.mean(square / np.trace(bounds, axis1=1, axis2=2)))),
        "bias_px": errors.mean(axis=0).tolist(),
        "bias_error_px": float(np.sqrt(0.5 * square.mean() / len(errors))),
        "within_1_sigma": float(np.mean(whitened < 1)),
        "within_2_sigma": float(np.mean(whitened < 2)),
    }


def _format(rows: list[dict[str, Any]], images: int, seed: int, machine: str) -> str:
    lines = [
        f"{images} rendered images 1280x960 a case, seed {seed} ({machine})",
        "kept: of the visible corners; far: beyond 0.5 px; ratio: error over the image-level bound, root mean square; bias: mean error "
        "in x and y with its standard error; 1 and 2 sigma: share of the errors within what is stated",
        f"{'board':>9} {'case':>9} {'kept':>7} {'far':>4} {'rms, px':>8} {'ratio':>6} {'bias, px':>17} {'error':>7} {'1, 2 sigma':>11}",
    ]
    for row in rows:
        text = f"{row['board'].split(':')[0]:>9} {row['case']:>9} {row['n_corners'] / max(row['n_visible'], 1):>7.1%} {row['n_far']:>4} "
        if "rms_px" in row:
            x, y = row["bias_px"]
            text += (
                f"{row['rms_px']:>8.4f} {row['over_bound']:>6.2f} {x:>+8.4f} {y:>+8.4f} {row['bias_error_px']:>7.4f} "
            )
            text += f"{row['within_1_sigma']:>6.2f} {row['within_2_sigma']:.2f}"
        else:
            text += f"{'-':>8} {'-':>6} {'-':>17} {'-':>7} {'-':>11}"
        lines.append(text)
    return "\n".join(lines)
