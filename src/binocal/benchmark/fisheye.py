"""Images of fisheye lenses to the rig: errors against the truth, binocal beside ``cv2.fisheye`` and mrcal's stereographic models.

Random rigs (fisheye4, 640x480) of 110 to 200 degrees across, rendered pairs of a 9x6 board, blur 0.8 px, noise 2 grey levels. Peers get
corners of OpenCV (``findChessboardCornersSB``, then ``cornerSubPix``) or binocal's, from the same files. ``cv2.fisheye`` works on the
plane at distance 1 and starts from a fixed lens: it gets the views within 88 degrees of both true axes, and in a second row the true lens
to start from; mrcal gets the nominal focal length and the size of the noise. A splined lens may absorb a turn of its camera, so
rotations are compared after each camera was turned to where its rays of the true corners fit the true rays best.
"""

from __future__ import annotations

import platform
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.benchmark.mrcal_peer import find_mrcal, rays_by_mrcal
from binocal.benchmark.opencv_peer import calibrate_rig
from binocal.benchmark.scenes import render_scene_pairs
from binocal.boards import Board, parse_board
from binocal.calibrators import calibrate
from binocal.cameras import StereoRig
from binocal.datasets.folder import ImagePair
from binocal.detection import detect_pairs
from binocal.detection.opencv_finder import find_corners_by_sector, pair_corners, read_grey
from binocal.errors import BinocalError
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.shapes import Bool, Float
from binocal.simulation import RenderOptions, random_rig

BOARD = "chessboard:9x6:30mm"
SIZE_WH = (640, 480)
FIELDS_DEG = (110, 150, 180, 200)
PLANE_DEG = 88.0  # from the axis: beyond, cv2.fisheye ends in an error or far off
N_RAYS = 500  # of each camera, evenly chosen among the corners that were seen
STEREOGRAPHIC = "LENSMODEL_STEREOGRAPHIC"
SPLINED = "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=16_Ny=12_fov_x_deg={}"
SPLINED_MARGIN_DEG = 10
NOISE_PX = 0.05  # as mrcal is told: with its own 1 px the regularisation turned rigs by 0.05 to 0.5 degrees, with 0.01 px solves failed
OURS = "binocal"
Way = Callable[[], "_Estimate"]


@dataclass(frozen=True, slots=True, eq=False)
class _Estimate:
    """A rig as its pose, the rays of either camera's pixels that are compared, and the number of views used."""

    T_right_left: SE3
    rays: Sequence[Float[ndarray, "n 3"]]
    n_views: int


def run_fisheye_benchmark(*, pairs: int = 20, rigs: int = 10, seed: int = 0) -> dict[str, Any]:
    """RMS and median errors of baseline and rotation of each way, ours over them, failures, and the views that each could use."""
    rows = []
    for field_deg in FIELDS_DEG:
        errors: dict[str, list[tuple[float, float, int]]] = {}
        for index in range(rigs):
            for name, found in _one_rig(field_deg, pairs, np.random.default_rng([seed, index, field_deg])).items():
                errors.setdefault(name, []).append(found)
        own = np.array(errors[OURS])
        rows += [_row(field_deg, name, np.array(of_rigs), own) for name, of_rigs in errors.items()]
    machine = f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}"
    return {
        "benchmark": "fisheye",
        "board": BOARD,
        "image_size": list(SIZE_WH),
        "pairs": pairs,
        "rigs": rigs,
        "seed": seed,
        "machine": machine,
        "rows": rows,
        "text": _format(rows, pairs, rigs, machine),
    }


def _one_rig(field_deg: int, pairs: int, rng: np.random.Generator) -> dict[str, tuple[float, float, int]]:
    """Errors of baseline (mm) and rotation (degrees), NaN where it failed, and the number of views, of each way on one rig."""
    rig, board = random_rig(rng, "fisheye4", size_wh=SIZE_WH, field_deg=field_deg), parse_board(BOARD)
    options = RenderOptions(blur_px=0.8, noise_dn=2.0)
    with tempfile.TemporaryDirectory(prefix="binocal-bench-") as folder:
        scene_seed = int(rng.integers(2**31))
        _, listed = render_scene_pairs(Path(folder), pairs, BOARD, SIZE_WH, scene_seed, rig=rig, options=options)
        ours, theirs = detect_pairs(listed, board).detections, _detect_with_opencv(listed, board)
    pixels = _compared_pixels(ours)
    true_rays = [camera.unproject(pixels) for camera in (rig.left, rig.right)]
    found = {}
    for name, way in _ways(rig, field_deg, ours, theirs, pixels).items():
        try:
            estimate = way()
        except (BinocalError, RuntimeError, ValueError, *_opencv_errors()):
            found[name] = (np.nan, np.nan, 0)
            continue
        T, T_true = estimate.T_right_left, rig.T_right_left
        baseline_mm = 1e3 * float(np.linalg.norm(T.t) - np.linalg.norm(T_true.t))
        left, right = (_turn(rays, true) for rays, true in zip(estimate.rays, true_rays, strict=True))
        rotation_deg = float(np.degrees(so3.angle_rad(right @ T.R @ left.T @ T_true.R.T)))
        found[name] = (baseline_mm, rotation_deg, estimate.n_views)
    return found


def _compared_pixels(corners: Detections) -> Float[ndarray, "n 2"]:
    """Places of corners in either image, where every lens is held by data."""
    px = np.concatenate([corners.left_px, corners.right_px]).reshape(-1, 2)
    px = px[np.isfinite(px[:, 0])]
    return px[:: max(len(px) // N_RAYS, 1)]


def _turn(rays: Float[ndarray, "n 3"], true_rays: Float[ndarray, "n 3"]) -> Float[ndarray, "3 3"]:
    """The rotation that takes rays to the true ones with the least squares. Source: Kabsch 1976."""
    is_ray = np.isfinite(rays).all(axis=1) & rays.any(axis=1)
    a, b = (r[is_ray] / np.linalg.norm(r[is_ray], axis=1, keepdims=True) for r in (rays, true_rays))
    U, _, Vt = np.linalg.svd(b.T @ a)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def _opencv_errors() -> tuple[type[Exception], ...]:
    import cv2

    return (cv2.error,)


def _ways(
    rig: StereoRig, field_deg: int, ours: Detections, theirs: Detections, pixels: Float[ndarray, "n 2"]
) -> dict[str, Way]:
    def of_rig(found: StereoRig, n_views: int) -> _Estimate:
        return _Estimate(found.T_right_left, [c.unproject(pixels) for c in (found.left, found.right)], n_views)

    def binocal() -> _Estimate:
        calibration = calibrate(ours, model="fisheye4")
        return of_rig(calibration.rig, len(calibration.views))

    def opencv(corners: Detections, start: StereoRig | None = None) -> Way:
        def way() -> _Estimate:
            usable = corners.select(np.flatnonzero(_on_plane(corners, rig)))
            return of_rig(calibrate_rig(usable, "fisheye4", start=start), usable.n_views)

        return way

    def mrcal(corners: Detections, lens: str) -> Way:
        focal_px = SIZE_WH[0] / np.radians(field_deg)

        def way() -> _Estimate:
            T_right_left, rays = rays_by_mrcal(corners, lens, focal_px, pixels, noise_px=NOISE_PX)
            return _Estimate(T_right_left, rays, corners.n_views)

        return way

    ways: dict[str, Way] = {
        OURS: binocal,
        "cv2.fisheye": opencv(theirs),
        "cv2.fisheye from the true lens": opencv(theirs, rig),
        "cv2.fisheye from it, binocal's corners": opencv(ours, rig),
    }
    if find_mrcal() is not None:
        splined = SPLINED.format(field_deg + SPLINED_MARGIN_DEG)
        ways |= {
            "mrcal, splined": mrcal(theirs, splined),
            "mrcal, splined, binocal's corners": mrcal(ours, splined),
            "mrcal, stereographic, binocal's corners": mrcal(ours, STEREOGRAPHIC),
        }
    return ways


def _on_plane(corners: Detections, rig: StereoRig) -> Bool[ndarray, "views"]:
    """Views whose corners all lie within the angle from both true axes at which ``cv2.fisheye`` can still use them."""
    is_usable = np.ones(corners.n_views, dtype=bool)
    for camera, px in ((rig.left, corners.left_px), (rig.right, corners.right_px)):
        rays = camera.unproject(np.nan_to_num(px, nan=SIZE_WH[1] / 2))
        angles = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
        is_usable &= (angles < np.radians(PLANE_DEG)).all(axis=1)
    return is_usable


def _detect_with_opencv(listed: list[ImagePair], board: Board) -> Detections:
    """Corners of the pairs in both images of which OpenCV finds the board."""
    paths = [path for pair in listed for path in (pair.left_path, pair.right_path)]
    sides = pair_corners([find_corners_by_sector(read_grey(path), board) for path in paths])
    n = len(board.object_points_m)
    left, right = (np.array(side, dtype=float).reshape(-1, n, 2) for side in sides)
    return Detections.from_arrays(board.object_points_m, left, right, SIZE_WH)


def _row(field_deg: int, name: str, found: ndarray, own: ndarray) -> dict[str, Any]:
    """``found`` and ``own``: errors of baseline and rotation, and views, of the rigs. Ratios are of the rigs where both succeeded."""
    is_found = np.isfinite(found[:, 0])
    row: dict[str, Any] = {
        "field_deg": field_deg,
        "way": name,
        "failed": int((~is_found).sum()),
        "views": float(np.median(found[is_found, 2])) if is_found.any() else 0.0,
    }
    both = is_found & np.isfinite(own[:, 0])
    for column, key in enumerate(("baseline_error_mm", "rotation_error_deg")):
        values = np.abs(found[is_found, column])
        row[key] = {"rms": _rms(values), "median": float(np.median(values)) if values.size else np.nan}
        row[f"binocal_over_{key}"] = _rms(own[both, column]) / _rms(found[both, column]) if both.any() else np.nan
    return row


def _rms(values: ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def _format(rows: list[dict[str, Any]], pairs: int, rigs: int, machine: str) -> str:
    lines = [
        f"{rigs} rigs of {pairs} rendered pairs a field, {BOARD}, {SIZE_WH[0]}x{SIZE_WH[1]} ({machine}); RMS and median of the errors",
        f"{'field':>5}  {'way':<40}{'failed':>7}{'views':>7}{'baseline, mm':>20}{'rotation, deg':>20}{'binocal over it':>18}",
    ]
    for row in rows:
        baseline, rotation = row["baseline_error_mm"], row["rotation_error_deg"]
        ratios = f"{row['binocal_over_baseline_error_mm']:.3f}, {row['binocal_over_rotation_error_deg']:.3f}"
        lines.append(
            f"{row['field_deg']:>5}  {row['way']:<40}{row['failed']:>7}{row['views']:>7.0f}"
            f"{baseline['rms']:>11.4f}, {baseline['median']:.4f}{rotation['rms']:>12.4f}, {rotation['median']:.4f}{ratios:>18}"
        )
    return "\n".join(lines)
