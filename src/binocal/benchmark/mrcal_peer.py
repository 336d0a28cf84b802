"""mrcal as a peer: seed and solve in a process of its own, in the Python that has mrcal, which times itself.

The solve is what ``mrcal-calibrate-cameras`` does: stereographic seed, poses alone, core, then everything with its model
and outlier rejection; of splined models the core is held in the last solve, which is the same as theirs. The board is held flat, as it
is for the others, unless its warp is asked for.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.cameras import Camera, StereoRig
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.shapes import Float

ENVIRONMENT = "BINOCAL_MRCAL_PYTHON"  # a Python that can import mrcal, where neither this one nor the system's can
LENS_MODELS = {"brown4": "LENSMODEL_OPENCV4", "brown5": "LENSMODEL_OPENCV5", "brown8": "LENSMODEL_OPENCV8"}
LEAST_CORNERS = 6  # of an image: fewer hardly determine the board's pose

_SCRIPT = """
import io, json, os, sys, time
import numpy as np
data = np.load(io.BytesIO(sys.stdin.buffer.read()))
import mrcal
observations, frame_camera, focal = data["observations"], data["frame_camera"], float(data["focal"])
sizes, spacing, lens = data["sizes"], float(data["spacing"]), str(data["lens"])
indices = np.concatenate([frame_camera, frame_camera[:, 1:] - 1], axis=-1).astype(np.int32)
stdout, null = os.dup(1), os.open(os.devnull, os.O_WRONLY)
os.dup2(null, 1), os.dup2(null, 2)
start = time.perf_counter()
seen = np.where(observations[..., 2:] > 0, observations, np.nan)  # 2.2's seed counts corners of negative weight, not NaN
intrinsics, rig, frames = mrcal.seed_stereographic(sizes, focal, frame_camera, seen, spacing)
def solve(model, intrinsics, **options):
    options = {"do_optimize_calobject_warp": False} | options
    return mrcal.optimize(intrinsics, rig, frames, None, observations, indices, None, None, model, imagersizes=sizes,
                          calibration_object_spacing=spacing, verbose=False, **options)
for core in (False, True):
    solve("LENSMODEL_STEREOGRAPHIC", intrinsics, do_optimize_intrinsics_core=core, do_optimize_intrinsics_distortions=False,
          do_apply_outlier_rejection=False, do_apply_regularization=False)
more = mrcal.lensmodel_num_params(lens) - 4
intrinsics = np.concatenate([intrinsics, (np.random.default_rng(0).random((2, more)) - 0.5) * 2e-6], axis=-1)
whole = dict(do_optimize_intrinsics_core="SPLINED" not in lens, do_optimize_intrinsics_distortions=more > 0,
             do_apply_outlier_rejection=True, do_apply_regularization=True)
solve(lens, intrinsics, **whole)
if data["warp"]:
    solve(lens, intrinsics, calobject_warp=np.zeros(2), **(whole | {"do_optimize_calobject_warp": True}))
elapsed = time.perf_counter() - start
sigmas, told = None, 0.0
if len(data["uncertain_left"]):
    inputs = dict(intrinsics=intrinsics, extrinsics_rt_fromref=rig, frames_rt_toref=frames, points=None,
                  observations_board=observations, indices_frame_camintrinsics_camextrinsics=indices,
                  observations_point=None, indices_point_camintrinsics_camextrinsics=None, lensmodel=lens, imagersizes=sizes,
                  calibration_object_spacing=spacing, do_optimize_calobject_warp=False, do_optimize_extrinsics=True,
                  do_optimize_frames=True, verbose=False, **whole)
    models = [mrcal.cameramodel(optimization_inputs=inputs, icam_intrinsics=i) for i in (0, 1)]
    range_m = float(data["range_m"])
    begin = time.perf_counter()
    sigmas = []
    for model, pixels in zip(models, (data["uncertain_left"], data["uncertain_right"])):
        points = mrcal.unproject(pixels, *model.intrinsics(), normalize=True) * (1 if np.isinf(range_m) else range_m)
        sigmas.append(mrcal.projection_uncertainty(points, model, atinfinity=bool(np.isinf(range_m)), what="worstdirection-stdev").tolist())
    told = time.perf_counter() - begin
with os.fdopen(stdout, "w") as out:
    rays = [mrcal.unproject(data["pixels"], lens, i, normalize=True).tolist() for i in intrinsics] if len(data["pixels"]) else None
    json.dump({"elapsed_s": elapsed, "rt_right_left": rig[0].tolist(), "intrinsics": intrinsics.tolist(), "rays": rays,
               "sigmas": sigmas, "told_s": told}, out)
"""


@cache
def find_mrcal() -> str | None:
    """A Python that can import mrcal, or None."""
    candidates = (os.environ.get(ENVIRONMENT), sys.executable, shutil.which("python3", path=os.defpath))
    for python in candidates:
        if python and subprocess.run([python, "-c", "import mrcal"], capture_output=True).returncode == 0:
            return python
    return None


def run_mrcal(detections: Detections, board: Board, spacing_m: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Seconds that seed and solve took, R and t of the rig. Corners are a grid, row by row.

    Raises:
        RuntimeError: mrcal failed.
    """
    elapsed_s, rig = solve_with_mrcal(detections, (board.rows, board.columns, spacing_m))
    return elapsed_s, rig.T_right_left.R, rig.T_right_left.t


def calibrate_rig_with_mrcal(detections: Detections, model: str, *, with_warp: bool = True) -> StereoRig:
    """The rig by mrcal with its outlier rejection and, unless declined, its two-parameter warp of the board.

    Raises:
        ValueError: The board's points are no square grid, row by row: mrcal knows no other board.
        RuntimeError: mrcal failed.
    """
    return solve_with_mrcal(detections, grid_of(detections.object_points_m), model=model, with_warp=with_warp)[1]


def grid_of(points_m: Float[ndarray, "n 3"]) -> tuple[int, int, float]:
    """Rows, columns and spacing of board points that are a square grid, row by row.

    Raises:
        ValueError: They are not.
    """
    columns = int(np.argmax(points_m[:, 1] != points_m[0, 1])) or len(points_m)
    rows = len(points_m) // columns
    spacing_m = float(points_m[1, 0] - points_m[0, 0])
    if rows * columns == len(points_m) and rows > 1 and columns > 1:
        y, x = np.divmod(np.arange(len(points_m)), columns)
        ideal = points_m[0] + spacing_m * np.stack([x, y, np.zeros_like(x)], axis=-1)
        if np.abs(ideal - points_m).max() < 1e-6 * abs(spacing_m):
            return rows, columns, spacing_m
    raise ValueError("mrcal knows boards that are square grids alone; these points are none")


def solve_with_mrcal(
    detections: Detections, grid: tuple[int, int, float], *, model: str = "brown5", with_warp: bool = False
) -> tuple[float, StereoRig]:
    """Seconds that seed and solve took, and the rig. ``grid`` is the board's rows, columns and spacing; ``model`` a brown one.

    Raises:
        RuntimeError: mrcal failed.
    """
    focal_px = 1.2 * detections.left_size_wh[0]
    found = _solve(detections, grid, LENS_MODELS[model], focal_px, with_warp=with_warp)
    left, right = (
        Camera(model, size_wh, np.r_[p[:4], 0.0, p[4:]])
        for size_wh, p in zip(
            (detections.left_size_wh, detections.right_size_wh), np.array(found["intrinsics"]), strict=True
        )
    )
    return found["elapsed_s"], StereoRig(left, right, _T_right_left(found), detections.is_metric)


def rays_by_mrcal(
    detections: Detections, lens: str, focal_px: float, pixels: Float[ndarray, "n 2"], *, noise_px: float
) -> tuple[SE3, list[Float[ndarray, "n 3"]]]:
    """``T_right_left`` by mrcal with a lens model of its own, and both cameras' unit rays of those pixels.

    ``lens`` is ``LENSMODEL_SPLINED_STEREOGRAPHIC_...`` say, ``focal_px`` a rough focal length. ``noise_px`` of the corners sets
    their weight against mrcal's regularisation of the lens, which takes it for 1 px unless told.

    Raises:
        ValueError: The board's points are no square grid, row by row.
        RuntimeError: mrcal failed.
    """
    found = _solve(detections, grid_of(detections.object_points_m), lens, focal_px, pixels=pixels, noise_px=noise_px)
    return _T_right_left(found), [np.array(rays) for rays in found["rays"]]


def uncertainty_by_mrcal(
    detections: Detections, board: Board, pixels: Sequence[Float[ndarray, "n 2"]], range_m: float, model: str = "brown4"
) -> tuple[float, list[Float[ndarray, "n"]]]:
    """Seconds that it took from the solved rig, and mrcal's projection uncertainty at pixels of both cameras, worst direction, px.

    The board is held flat, ``range_m`` may be infinite.

    Raises:
        RuntimeError: mrcal failed.
    """
    grid = (board.rows, board.columns, board.pitch_m)
    focal_px = 1.2 * detections.left_size_wh[0]
    found = _solve(detections, grid, LENS_MODELS[model], focal_px, uncertain=pixels, range_m=range_m)
    return found["told_s"], [np.array(sigma) for sigma in found["sigmas"]]


def _T_right_left(found: dict[str, Any]) -> SE3:
    rt = np.array(found["rt_right_left"])
    return SE3(so3.exp(rt[:3]), rt[3:])


def _solve(
    detections: Detections,
    grid: tuple[int, int, float],
    lens: str,
    focal_px: float,
    *,
    with_warp: bool = False,
    pixels: Float[ndarray, "n 2"] | None = None,
    noise_px: float = 1.0,
    uncertain: Sequence[Float[ndarray, "n 2"]] | None = None,
    range_m: float = np.inf,
) -> dict[str, Any]:
    """What the script prints. Corners that were not seen are given no weight, and images with fewer than six left out.

    Raises:
        RuntimeError: mrcal failed.
    """
    rows, columns, spacing_m = grid
    seen_px = np.stack([detections.left_px, detections.right_px], axis=1).reshape(-1, rows, columns, 2)
    is_seen = np.isfinite(seen_px[..., 0])
    weighted = np.concatenate([np.nan_to_num(seen_px), np.where(is_seen, 1 / noise_px, -1.0)[..., None]], axis=-1)
    frame_camera = np.argwhere(np.ones((detections.n_views, 2))).astype(np.int32)
    is_used = is_seen.sum(axis=(1, 2)) >= min(LEAST_CORNERS, rows * columns)
    used_frames, frames = np.unique(frame_camera[is_used, 0], return_inverse=True)
    if not len(used_frames):
        raise RuntimeError(f"no image has {LEAST_CORNERS} corners")
    frame_camera = np.stack([frames, frame_camera[is_used, 1]], axis=-1).astype(np.int32)
    sizes = np.array([detections.left_size_wh, detections.right_size_wh], dtype=np.int32)
    data = io.BytesIO()
    np.savez(
        data,
        observations=weighted[is_used],
        frame_camera=frame_camera,
        focal=focal_px,
        sizes=sizes,
        spacing=spacing_m,
        lens=lens,
        warp=with_warp,
        pixels=np.zeros((0, 2)) if pixels is None else pixels,
        uncertain_left=np.zeros((0, 2)) if uncertain is None else uncertain[0],
        uncertain_right=np.zeros((0, 2)) if uncertain is None else uncertain[1],
        range_m=range_m,
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(
        [find_mrcal() or "", "-c", _SCRIPT], input=data.getvalue(), capture_output=True, env=environment, timeout=600
    )
    if done.returncode != 0:
        raise RuntimeError(f"mrcal failed: {done.stderr.decode(errors='replace')[-500:]}")
    return json.loads(done.stdout)
