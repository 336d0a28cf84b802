"""Sound sets of kinds that are hard to solve: none may be refused, and errors must lie within what is stated.

Corners of 20 views on random rigs: images of unlike noise (half and half, any mixture, one noisy camera; with and without their
covariances given), telephoto lenses of 3 to 30 image widths with up to 5 % of distortion, and brown8. And corners found in rendered
images of boards on white, back-lit, dark and noisy ground (:mod:`.grounds`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.benchmark.grounds import GROUNDS, find_set_on
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.errors import BinocalError
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections

N_VIEWS = 20
MODELS = ("brown4", "brown5", "fisheye4")
BOARD, LONG_BOARD = "chessboard:9x6:30mm", "chessboard:9x6:20mm"
FAR_SIGMAS = 3.5
SIZES_WH = ((640, 480), (1280, 960), (1920, 1200))
Noise = Callable[[np.random.Generator], Float[ndarray, "2 views"]]


def _halves(low_px: float, high_px: float, share: float = 0.5) -> Noise:
    def noise(rng: np.random.Generator) -> Float[ndarray, "2 views"]:
        n_high = round(share * N_VIEWS)
        values = np.r_[np.full(N_VIEWS - n_high, low_px), np.full(n_high, high_px)]
        return np.tile(rng.permutation(values), (2, 1))

    return noise


def _any(rng: np.random.Generator) -> Float[ndarray, "2 views"]:
    return np.exp(rng.uniform(np.log(0.01), np.log(0.5), (2, N_VIEWS)))


def _one_camera(rng: np.random.Generator) -> Float[ndarray, "2 views"]:
    return np.repeat([[0.03], [0.4]], N_VIEWS, axis=1)


def _even(rng: np.random.Generator) -> Float[ndarray, "2 views"]:
    return np.full((2, N_VIEWS), rng.uniform(0.02, 0.3))


KINDS: dict[str, tuple[str, Noise]] = {
    "half of the views 0.05, half 0.5 px": ("random", _halves(0.05, 0.5)),
    "half 0.01, half 0.06 px": ("random", _halves(0.01, 0.06)),
    "a fifth 0.5, others 0.03 px": ("random", _halves(0.03, 0.5, 0.2)),
    "every image between 0.01 and 0.5 px": ("random", _any),
    "left 0.03, right 0.4 px": ("random", _one_camera),
    "half 0.05, half 0.5 px, covariances given": ("known", _halves(0.05, 0.5)),
    "telephoto, 3 to 30 image widths": ("long", _even),
    "brown8": ("brown8", _even),
}


def run_sound_benchmark(*, rigs: int = 200, seed: int = 0) -> dict[str, Any]:
    """For each kind: sets refused, iterations, coverage, and parameters further off than 3.5 stated standard deviations."""
    rows = [_row(name, rigs, seed) for name in (*KINDS, *GROUNDS)]
    lines = [f"{'kind':<44} refused  iterations (most)  within 1, 2 sigma  z RMS  beyond {FAR_SIGMAS} sigma"]
    lines += [
        f"{r['kind']:<44} {r['refused']:7d}  {r['iterations']:10.0f} ({r['most_iterations']:4d})  "
        f"{100 * r['within_1']:7.1f}, {100 * r['within_2']:.1f} %  {r['z_rms']:5.2f}  {r['far']} of {r['parameters']}"
        for r in rows
    ]
    return {"benchmark": "sound", "rigs": rigs, "seed": seed, "rows": rows, "text": "\n".join(lines)}


def _row(name: str, rigs: int, seed: int) -> dict[str, Any]:
    iterations, scores, refused = [], [], {}
    for index in range(rigs):
        rng = np.random.default_rng([seed, index, len(name)])
        try:
            rig, detections = find_set_on(name, rng) if name in GROUNDS else _noisy_set(name, rng)
            found = calibrate(detections, model=rig.left.model)
        except BinocalError as error:
            refused[index] = str(error)
            continue
        iterations.append(found.n_iterations)
        scores.append(_standardised(found, rig))
    z = np.abs(np.concatenate(scores)) if scores else np.zeros(0)
    return {
        "kind": name,
        "refused": len(refused),
        "refusals": refused,
        "iterations": float(np.median(iterations)) if iterations else np.nan,
        "most_iterations": max(iterations, default=0),
        "within_1": float(np.mean(z < 1)) if z.size else np.nan,
        "within_2": float(np.mean(z < 2)) if z.size else np.nan,
        "z_rms": float(np.sqrt(np.mean(z**2))) if z.size else np.nan,
        "far": int((z > FAR_SIGMAS).sum()),
        "parameters": int(z.size),
    }


def _noisy_set(name: str, rng: np.random.Generator) -> tuple[StereoRig, Detections]:
    kind, noise = KINDS[name]
    rig, detections = _long_set(rng) if kind == "long" else _random_set(rng, kind)
    return rig, _with_noise(detections, noise(rng), rng, is_known=kind == "known")


def _random_set(rng: np.random.Generator, kind: str) -> tuple[StereoRig, Detections]:
    model = "brown8" if kind == "brown8" else MODELS[int(rng.integers(len(MODELS)))]
    rig, board = random_rig(rng, model), parse_board(BOARD)
    return rig, simulate_detections(StereoScene(rig, board, sample_board_poses(rig, board, N_VIEWS, rng)), rng)


def _long_set(rng: np.random.Generator) -> tuple[StereoRig, Detections]:
    """A rig that looks at a board which fills half of the image or more, and corners of it at tilts of 10 to 45 degrees."""
    board = parse_board(LONG_BOARD)
    size = SIZES_WH[int(rng.integers(len(SIZES_WH)))]
    focal_px = size[0] * float(np.exp(rng.uniform(np.log(3), np.log(30))))
    distance_m = focal_px / size[0] * 0.18 * rng.uniform(1.2, 2.0)
    baseline_m = rng.uniform(0.006, 0.03) * distance_m
    turn = so3.exp(rng.normal(0, 0.03 * size[0] / focal_px, 3) + [0, baseline_m / distance_m, 0])
    left, right = _long_camera(rng, size, focal_px), _long_camera(rng, size, focal_px)
    rig = StereoRig(left, right, SE3(turn, -turn @ [baseline_m, 0, 0]))
    points, pixels = board.object_points_m, ([], [])
    while len(pixels[0]) < N_VIEWS:
        axis, tilt = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(10, 45))
        tilted = so3.exp(tilt * np.array([np.cos(axis), np.sin(axis), 0.0]))
        R = tilted @ so3.exp(np.array([0.0, 0.0, rng.uniform(-0.4, 0.4)]))
        z = distance_m * rng.uniform(0.85, 1.25)
        in_left = (points - points.mean(axis=0)) @ R.T + [*(rng.uniform(-0.25, 0.25, 2) * size / focal_px * z), z]
        seen = rig.left.project(in_left), rig.right.project(rig.T_right_left.apply(in_left))
        if all(((px > 2) & (px < np.array(size) - 3)).all() for px in seen):
            pixels[0].append(seen[0])
            pixels[1].append(seen[1])
    return rig, Detections.from_arrays(points, np.array(pixels[0]), np.array(pixels[1]), size)


def _long_camera(rng: np.random.Generator, size_wh: tuple[int, int], focal_px: float) -> Camera:
    width, height = size_wh
    half = np.hypot(width, height) / 2 / focal_px
    f = focal_px * (1 + rng.normal(0, 0.01))
    centre = width / 2 + rng.normal(0, 0.015 * width), height / 2 + rng.normal(0, 0.015 * height)
    return Camera(
        "brown4",
        size_wh,
        np.array([f, f * (1 + rng.normal(0, 1e-3)), *centre, 0, rng.uniform(-0.05, 0.05) / half**2, 0, 0, 0]),
    )


def _with_noise(
    exact: Detections, sigma_px: Float[ndarray, "2 views"], rng: np.random.Generator, *, is_known: bool
) -> Detections:
    left, right = (
        px + s[:, None, None] * rng.normal(size=px.shape)
        for px, s in zip((exact.left_px, exact.right_px), sigma_px, strict=True)
    )
    noisy = replace(exact, left_px=left, right_px=right)
    if not is_known:
        return noisy
    n = len(exact.object_points_m)
    left, right = (np.repeat(s[:, None, None, None] ** 2 * np.eye(2), n, axis=1) for s in sigma_px)
    return replace(noisy, left_covariance_px2=left, right_covariance_px2=right)


def _standardised(found: StereoCalibration, truth: StereoRig) -> Float[ndarray, "p"]:
    """Errors of all estimated parameters over their standard deviations."""
    T, true_T = found.rig.T_right_left, truth.T_right_left
    error = dict(zip((f"rotation.{a}" for a in "xyz"), so3.log(T.R @ true_T.R.T), strict=True))
    error |= dict(zip((f"translation.{a}" for a in "xyz"), T.t - true_T.t, strict=True))
    for side in ("left", "right"):
        camera, true = getattr(found.rig, side), getattr(truth, side)
        names = camera_model(camera.model).parameter_names
        error |= dict(zip((f"{side}.{name}" for name in names), camera.parameters - true.parameters, strict=True))
    return np.array([error[name] / sigma for name, sigma in found.covariance.sigma.items()])
