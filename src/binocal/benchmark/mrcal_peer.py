"""mrcal as a peer: seed and solve in a process of its own, in the Python that has mrcal, which times itself.

The solve is what ``mrcal-calibrate-cameras`` does: stereographic seed, poses alone, core, then everything with
LENSMODEL_OPENCV5 and outlier rejection; the board is held flat, as it is for the others.
"""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
from functools import cache

import numpy as np

from binocal.boards import Board
from binocal.evidence import Detections
from binocal.geometry import so3

ENVIRONMENT = "BINOCAL_MRCAL_PYTHON"  # a Python that can import mrcal, where neither this one nor the system's can

_SCRIPT = """
import io, os, sys, time
import numpy as np
data = np.load(io.BytesIO(sys.stdin.buffer.read()))
import mrcal
observations, focal = data["observations"], float(data["focal"])
sizes, spacing = data["sizes"], float(data["spacing"])
n = len(observations) // 2
frame_camera = np.stack([np.repeat(np.arange(n), 2), np.tile([0, 1], n)], axis=-1).astype(np.int32)
indices = np.concatenate([frame_camera, frame_camera[:, 1:] - 1], axis=-1).astype(np.int32)
stdout, null = os.dup(1), os.open(os.devnull, os.O_WRONLY)
os.dup2(null, 1), os.dup2(null, 2)
start = time.perf_counter()
intrinsics, rig, frames = mrcal.seed_stereographic(sizes, focal, frame_camera, observations, spacing)
def solve(model, intrinsics, **options):
    mrcal.optimize(intrinsics, rig, frames, None, observations, indices, None, None, model, imagersizes=sizes,
                   do_optimize_calobject_warp=False, calibration_object_spacing=spacing, verbose=False, **options)
for core in (False, True):
    solve("LENSMODEL_STEREOGRAPHIC", intrinsics, do_optimize_intrinsics_core=core, do_optimize_intrinsics_distortions=False,
          do_apply_outlier_rejection=False, do_apply_regularization=False)
more = mrcal.lensmodel_num_params("LENSMODEL_OPENCV5") - 4
intrinsics = np.concatenate([intrinsics, (np.random.default_rng(0).random((2, more)) - 0.5) * 2e-6], axis=-1)
solve("LENSMODEL_OPENCV5", intrinsics, do_optimize_intrinsics_core=True, do_optimize_intrinsics_distortions=True,
      do_apply_outlier_rejection=True, do_apply_regularization=True)
elapsed = time.perf_counter() - start
with os.fdopen(stdout, "w") as out:
    out.write(" ".join(repr(float(x)) for x in (elapsed, *rig[0])))
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
    """Seconds that seed and solve took, R and t of the rig. Corners must be complete, row by row.

    Raises:
        RuntimeError: mrcal failed.
    """
    columns, rows = board.columns, board.rows
    pixels = np.stack([detections.left_px, detections.right_px], axis=1).reshape(-1, rows, columns, 2)
    observations = np.concatenate([pixels, np.ones((*pixels.shape[:-1], 1))], axis=-1)
    data = io.BytesIO()
    sizes = np.array([detections.left_size_wh, detections.right_size_wh], dtype=np.int32)
    np.savez(data, observations=observations, focal=1.2 * sizes[0, 0], sizes=sizes, spacing=spacing_m)
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(
        [find_mrcal() or "", "-c", _SCRIPT], input=data.getvalue(), capture_output=True, env=environment, timeout=600
    )
    if done.returncode != 0:
        raise RuntimeError(f"mrcal failed: {done.stderr.decode(errors='replace')[-500:]}")
    values = np.array(done.stdout.split(), dtype=float)
    return float(values[0]), so3.exp(values[1:4]), values[4:7]
