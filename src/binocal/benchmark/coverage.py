"""Whether stated standard deviations hold from images to the rig where corners share pixels: squares of 12 to 30 px.

Random ordinary rigs (640x480, brown4), an 11x8 board at random distances, tilts and places, blur of 0.5 to 1.3 px and noise of 2.5 grey
levels, as they are, with gamma, and through JPEG; corners are found in the files as a user's are. Every parameter's error is compared
with the covariance that the calibration states.
"""

from __future__ import annotations

import platform
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cameras import Camera, StereoRig
from binocal.datasets.folder import ImagePair
from binocal.detection import detect_pairs
from binocal.errors import BinocalError
from binocal.geometry import SE3, so3
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.simulation import RenderOptions, render_image, visible_px

BOARD = "chessboard:11x8:20mm"
SIZE_WH = (640, 480)
SQUARES_PX = (12.0, 30.0)
BLURS_PX = (0.5, 1.3)
NOISE_DN = 2.5
LEAST_SEEN = 0.7  # of the corners, in both images of a view


@dataclass(frozen=True, slots=True)
class _Case:
    """One row of the table; ``quality`` is that of JPEG, None for PNG."""

    name: str
    gamma: float = 1.0
    quality: int | None = None


CASES = (_Case("as it is"), _Case("gamma 2.2", gamma=2.2), _Case("JPEG 90", quality=90), _Case("JPEG 75", quality=75))


def run_coverage_benchmark(*, pairs: int = 10, rigs: int = 200, seed: int = 0) -> dict[str, Any]:
    """Squared errors over the stated covariance, per parameter, and shares within one and two standard deviations."""
    rows = []
    for case in CASES:
        scores, standardised, n_failed = [], [], 0
        for index in range(rigs):
            truth, calibration = _calibrate_one(case, pairs, np.random.default_rng([seed, index]))
            if calibration is None:
                n_failed += 1
                continue
            error = _errors(calibration, truth)
            covariance = calibration.covariance.matrix
            scores.append(float(error @ np.linalg.solve(covariance, error)) / len(error))
            standardised.append(np.abs(error) / np.sqrt(np.diag(covariance)))
        rows.append(_row(case.name, scores, standardised, n_failed))
    machine = f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}"
    return {
        "benchmark": "coverage",
        "board": BOARD,
        "image_size": list(SIZE_WH),
        "pairs": pairs,
        "rigs": rigs,
        "seed": seed,
        "machine": machine,
        "rows": rows,
        "text": _format(rows, pairs, rigs, machine),
    }


def _calibrate_one(case: _Case, pairs: int, rng: np.random.Generator) -> tuple[StereoRig, StereoCalibration | None]:
    """A rig, and what is made of its images; None where they are refused."""
    rig = _draw_rig(rng)
    with tempfile.TemporaryDirectory(prefix="binocal-bench-") as folder:
        listed = [_shoot(case, rig, Path(folder), view, rng) for view in range(pairs)]
        try:
            return rig, calibrate(detect_pairs(listed, parse_board(BOARD)).detections, model="brown4")
        except BinocalError:
            return rig, None


def _draw_rig(rng: np.random.Generator) -> StereoRig:
    width, height = SIZE_WH
    focal = rng.uniform(0.9, 1.4) * width

    def camera() -> Camera:
        linear = [*(focal * rng.uniform(0.98, 1.02, 2)), *(np.array([width, height]) / 2 + rng.uniform(-10, 10, 2)), 0]
        lens = [rng.uniform(-0.2, 0), rng.uniform(0, 0.05), *rng.uniform(-1e-3, 1e-3, 2)]
        return Camera("brown4", SIZE_WH, np.array(linear + lens))

    left, right = camera(), camera()
    t = np.array([-rng.uniform(0.06, 0.14), *rng.uniform(-0.004, 0.004, 2)])
    return StereoRig(left, right, SE3(so3.exp(rng.uniform(-0.03, 0.03, 3)), t), True)


def _draw_pose(rig: StereoRig, rng: np.random.Generator) -> SE3:
    """A board that both cameras see most of, its squares of a size within the limits."""
    board = parse_board(BOARD)
    points, focal, size = board.object_points_m, rig.left.parameters[0], np.array(SIZE_WH)
    while True:
        distance = focal * board.pitch_m / rng.uniform(*SQUARES_PX)
        tilt, way = np.radians(rng.uniform(10, 45)), rng.uniform(0, 2 * np.pi)
        R = so3.exp(tilt * np.array([np.cos(way), np.sin(way), 0])) @ so3.exp(np.array([0, 0, rng.uniform(-0.5, 0.5)]))
        place = (rng.uniform(0.15, 0.85, 2) - 0.5) * size * distance / focal
        pose = SE3(R, np.array([*place, distance]) - R @ points.mean(axis=0))
        seen = [
            np.isfinite(visible_px(camera, T.apply(points))[:, 0]).mean()
            for camera, T in ((rig.left, pose), (rig.right, rig.T_right_left @ pose))
        ]
        if min(seen) >= LEAST_SEEN:
            return pose


def _shoot(case: _Case, rig: StereoRig, folder: Path, view: int, rng: np.random.Generator) -> ImagePair:
    """The files of one view."""
    import cv2

    pose = _draw_pose(rig, rng)
    options = RenderOptions(blur_px=float(rng.uniform(*BLURS_PX)), noise_dn=NOISE_DN, gamma=case.gamma)
    paths = []
    for side, camera, T in (("left", rig.left, pose), ("right", rig.right, rig.T_right_left @ pose)):
        path = folder / f"{side}_{view:03d}.{'png' if case.quality is None else 'jpg'}"
        image = render_image(camera, T, parse_board(BOARD), options, rng).image
        flags = [] if case.quality is None else [cv2.IMWRITE_JPEG_QUALITY, case.quality]
        path.write_bytes(cv2.imencode(path.suffix, image, flags)[1].tobytes())
        paths.append(path)
    return ImagePair(f"{view:03d}", *paths)


def _errors(calibration: StereoCalibration, truth: StereoRig) -> Float[ndarray, "p"]:
    """Errors in the covariance's order: both cameras without the skew, rotation, translation."""
    found, T, T_true = calibration.rig, calibration.rig.T_right_left, truth.T_right_left
    cameras = [
        np.delete(one.parameters - other.parameters, 4)
        for one, other in ((found.left, truth.left), (found.right, truth.right))
    ]
    return np.concatenate([*cameras, so3.log(T.R @ T_true.R.T), T.t - T_true.t])


def _row(name: str, scores: list[float], standardised: list[ndarray], n_failed: int) -> dict[str, Any]:
    row: dict[str, Any] = {"case": name, "n_failed": n_failed}
    if scores:
        all_of_them = np.concatenate(standardised)
        row |= {
            "squared_over_covariance": float(np.mean(scores)),
            "standard_error": float(np.std(scores) / np.sqrt(len(scores))),
            "within_1_sigma": float(np.mean(all_of_them < 1)),
            "within_2_sigma": float(np.mean(all_of_them < 2)),
        }
    return row


def _format(rows: list[dict[str, Any]], pairs: int, rigs: int, machine: str) -> str:
    low, high = SQUARES_PX
    lines = [
        f"{rigs} rigs of {pairs} pairs a row, {BOARD}, squares of {low:g} to {high:g} px ({machine})",
        f"{'case':<12}{'squared error / covariance':>28}{'1, 2 sigma %':>16}{'refused':>9}",
    ]
    for row in rows:
        shown = "none"
        inside = ""
        if "standard_error" in row:
            shown = f"{row['squared_over_covariance']:.3f} ± {row['standard_error']:.3f}"
            inside = f"{100 * row['within_1_sigma']:.1f}, {100 * row['within_2_sigma']:.1f}"
        lines.append(f"{row['case']:<12}{shown:>28}{inside:>16}{row['n_failed']:>9}")
    return "\n".join(lines)
