"""Faults of whole sets on random rigs: how often they are named, and how often a damaged rig passes without a word.

Corners of a 9x6 chessboard in 6 to 40 views (lens brown4 or fisheye4, noise 0.05 to 0.5 px), spoiled in one way each. A result is
damaged where its depth error is more than 1.5 times that of the same views unspoiled and its errors exceed 2.5 of its stated
standard deviations (RMS over baseline, rotation, focal lengths and principal points).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cameras import Camera, StereoRig
from binocal.errors import BinocalError
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.simulation import random_rig, sample_board_poses

BOARD = "chessboard:9x6:30mm"
DAMAGE_RATIO, DAMAGE_SIGMAS = 1.5, 2.5


@dataclass
class _Set:
    """A recording before the cameras see it: the board's points in both frames and each view's cameras, to be spoiled in place."""

    rng: np.random.Generator
    rig: StereoRig
    noise_px: float
    points: Float[ndarray, "n 3"]
    in_left: Float[ndarray, "V n 3"]
    in_right: Float[ndarray, "V n 3"]
    left: list[Camera] = field(default_factory=list)
    right: list[Camera] = field(default_factory=list)
    rows: Float[ndarray, "n"] | None = None

    @property
    def n_views(self) -> int:
        return len(self.in_left)

    @property
    def half(self) -> int:
        return self.n_views // 2


def _random_set(seed: int, index: int) -> _Set:
    rng = np.random.default_rng([seed, index])
    rig = random_rig(rng, ("brown4", "fisheye4")[index % 2])
    board = parse_board(BOARD)
    n_views, noise_px = int(rng.integers(6, 40)), float(np.exp(rng.uniform(np.log(0.05), np.log(0.5))))
    T = sample_board_poses(rig, board, n_views, rng)
    in_left = T.apply(board.object_points_m)
    views = _Set(rng, rig, noise_px, board.object_points_m, in_left, rig.T_right_left.apply(in_left))
    views.left, views.right = [rig.left] * n_views, [rig.right] * n_views
    return views


def _lens(camera: Camera, focal: float = 1.0, shift_px: float = 0.0) -> Camera:
    parameters = camera.parameters.copy()
    parameters[:2] *= focal
    parameters[2] += shift_px
    return Camera(camera.model, camera.size_wh, parameters)


def _turn(rng: np.random.Generator, degrees: float) -> Float[ndarray, "3 3"]:
    axis = rng.normal(size=3)
    return so3.exp(np.radians(degrees) * axis / np.linalg.norm(axis))


def _knocked(degrees: float, side: str) -> Callable[[_Set], None]:
    def spoil(s: _Set) -> None:
        inside = s.in_left if side == "left" else s.in_right
        inside[s.half :] = inside[s.half :] @ _turn(s.rng, degrees).T

    return spoil


def _drifting(degrees: float) -> Callable[[_Set], None]:
    def spoil(s: _Set) -> None:
        axis = s.rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        for view in range(s.n_views):
            s.in_right[view] = s.in_right[view] @ so3.exp(np.radians(degrees) * view / (s.n_views - 1) * axis).T

    return spoil


def _refocused(percent: float, side: str) -> Callable[[_Set], None]:
    def spoil(s: _Set) -> None:
        cameras = getattr(s, side)
        setattr(s, side, [*cameras[: s.half], *(_lens(c, focal=1 + percent / 100) for c in cameras[s.half :])])

    return spoil


def _shifted(px: float, *, at_random: bool) -> Callable[[_Set], None]:
    def spoil(s: _Set) -> None:
        is_moved = s.rng.random(s.n_views) < 0.5 if at_random else np.arange(s.n_views) >= s.half
        s.left = [_lens(c, shift_px=px) if moved else c for c, moved in zip(s.left, is_moved, strict=True)]

    return spoil


def _untriggered(low: float, high: float, share: float = 1.0) -> Callable[[_Set], None]:
    def spoil(s: _Set) -> None:
        square = 0.03 * s.rng.uniform(low, high) / 100
        is_moved = s.rng.random((s.n_views, 1, 1)) < share
        s.in_right = s.in_right + square * s.rng.normal(size=(s.n_views, 1, 3)) * is_moved

    return spoil


def _bent(share: float) -> Callable[[_Set], None]:
    def spoil(s: _Set) -> None:
        x = s.points[:, 0] - s.points[:, 0].mean()
        height = 0.03 * share * (1 - (x / np.abs(x).max()) ** 2)
        for inside in (s.in_left, s.in_right):
            for view in range(s.n_views):
                corners = inside[view]
                along, down = corners[8] - corners[0], corners[45] - corners[0]
                normal = np.cross(along, down)
                inside[view] = corners + height[:, None] * normal / np.linalg.norm(normal)

    return spoil


def _stretched(share: float) -> Callable[[_Set], None]:
    def spoil(s: _Set) -> None:
        for inside in (s.in_left, s.in_right):
            along = (inside[:, 8] - inside[:, 0]) / 8
            steps = (s.points[:, 0] - s.points[:, 0].mean()) / 0.03
            inside += share * steps[None, :, None] * along[:, None, :]

    return spoil


FAULTS: dict[str, tuple[Callable[[_Set], None], tuple[str, ...]]] = {
    # name: what is done, codes that name it
    "none": (lambda s: None, ()),
    "right camera knocked 0.05 deg": (_knocked(0.05, "right"), ("rig-changed",)),
    "right camera knocked 0.2 deg": (_knocked(0.2, "right"), ("rig-changed", "changed-from-view")),
    "left camera knocked 0.1 deg": (_knocked(0.1, "left"), ("rig-changed", "changed-from-view")),
    "drift 0.2 deg": (_drifting(0.2), ("rig-drifts",)),
    "left refocused 1 %": (_refocused(1.0, "left"), ("rig-changed", "changed-from-view")),
    "right refocused 1 %": (_refocused(1.0, "right"), ("rig-changed", "changed-from-view")),
    "left image shifted 2 px": (_shifted(2.0, at_random=False), ("rig-changed", "changed-from-view")),
    "left image shifted 2 px in half of the views": (
        _shifted(2.0, at_random=True),
        ("rig-has-two-states", "exposures-apart"),
    ),
    "not together, 1-5 % of a square": (_untriggered(1, 5), ("exposures-apart", "pairs-not-together")),
    "not together, 5-20 % of a square": (_untriggered(5, 20), ("exposures-apart", "pairs-not-together")),
    "not together in a fifth of the views": (
        _untriggered(5, 20, 0.2),
        ("exposures-apart", "many-views-left-out", "changed-from-view"),
    ),
    "board bowed 5 % of a square": (_bent(0.05), ("board-not-as-drawn",)),
    "board stretched 1 %": (_stretched(0.01), ("board-not-as-drawn",)),
}


def run_faults_benchmark(*, rigs: int = 30, seed: int = 0) -> dict[str, Any]:
    """For each fault: sets refused, warned of, named rightly, damaged, and damaged without any warning."""
    rows = [_row(name, rigs, seed) for name in FAULTS]
    lines = [f"{'fault':<46} refused  warned   named  damaged  silently"]
    lines += [
        f"{r['fault']:<46} {r['refused']:7d} {r['warned']:7d} {r['named']:7d} {r['damaged']:8d} {r['silent']:9d}"
        for r in rows
    ]
    lines.append(
        f"{rigs} rigs each; damaged: depth error above {DAMAGE_RATIO} of the unspoiled set's, and z above {DAMAGE_SIGMAS}"
    )
    return {"benchmark": "faults", "rigs": rigs, "seed": seed, "rows": rows, "text": "\n".join(lines)}


def _row(name: str, rigs: int, seed: int) -> dict[str, Any]:
    spoil, codes = FAULTS[name]
    counts, said = Counter[str](), Counter[str]()
    silent_rigs = []
    for index in range(rigs):
        clean = _calibrated(_random_set(seed, index))
        views = _random_set(seed, index)
        spoil(views)
        found = _calibrated(views)
        if not isinstance(found, StereoCalibration):
            counts["refused"] += 1
            counts["named"] += bool({f.code for f in found.findings} & set(codes))
            said.update(f.code for f in found.findings)
            continue
        here = {f.code for f in found.findings}
        is_warned = bool(found.warnings) or "board-not-as-drawn" in here
        said.update(here)
        counts["warned"] += is_warned
        counts["named"] += bool(here & set(codes))
        is_damaged = isinstance(clean, StereoCalibration) and _is_damaged(found, clean, views.rig)
        counts["damaged"] += is_damaged
        if is_damaged and not is_warned:
            silent_rigs.append(index)
    row = {key: counts[key] for key in ("refused", "warned", "named", "damaged")}
    return {"fault": name, **row, "silent": len(silent_rigs), "silent_rigs": silent_rigs, "findings": dict(said)}


def _calibrated(views: _Set) -> StereoCalibration | BinocalError:
    pixels = []
    rng = np.random.default_rng([views.n_views, 1])
    for cameras, inside in ((views.left, views.in_left), (views.right, views.in_right)):
        px = np.stack([camera.project(x) for camera, x in zip(cameras, inside, strict=True)])
        px = px + views.noise_px * rng.normal(size=px.shape)
        px[((px < 0) | (px > np.array(cameras[0].size_wh) - 1)).any(axis=-1)] = np.nan
        pixels.append(px)
    rig = views.rig
    detections = Detections.from_arrays(
        views.points, pixels[0], pixels[1], rig.left.size_wh, right_image_size_wh=rig.right.size_wh, board_spec=BOARD
    )
    try:
        return calibrate(detections, model=rig.left.model)
    except BinocalError as error:
        return error


def _is_damaged(found: StereoCalibration, clean: StereoCalibration, truth: StereoRig) -> bool:
    ratio = _depth_error(found.rig, truth) / max(_depth_error(clean.rig, truth), 1e-12)
    return ratio > DAMAGE_RATIO and _standardised_error(found, truth) > DAMAGE_SIGMAS


def _depth_error(rig: StereoRig, truth: StereoRig) -> float:
    """Relative error of the depth of points 20 baselines away all over the left image, as their true pixels triangulate (median)."""
    (width, height), b = truth.left.size_wh, truth.baseline_m
    u, v = np.meshgrid(np.linspace(0.2, 0.8, 4) * width, np.linspace(0.2, 0.8, 4) * height)
    rays = truth.left.unproject(np.stack([u.ravel(), v.ravel()], axis=1))
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    points = 20 * b * rays
    left_px, right_px = truth.left.project(points), truth.right.project(truth.T_right_left.apply(points))
    a = rig.left.unproject(left_px)
    c = rig.right.unproject(right_px) @ rig.T_right_left.R
    a, c = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a, c))
    centre = -rig.T_right_left.R.T @ rig.T_right_left.t
    cosine = np.sum(a * c, axis=1)
    depth = (a @ centre - cosine * (c @ centre)) / np.maximum(1 - cosine**2, 1e-12)
    return float(np.median(np.abs(depth / (20 * b) - 1)))


def _standardised_error(found: StereoCalibration, truth: StereoRig) -> float:
    sigma, rig = found.covariance.sigma, found.rig
    errors = [(rig.baseline_m - truth.baseline_m) / found.baseline_sigma_m]
    turn = so3.log(rig.T_right_left.R @ truth.T_right_left.R.T)
    errors += [turn[i] / sigma[f"rotation.{axis}"] for i, axis in enumerate("xyz")]
    for side in ("left", "right"):
        away = getattr(rig, side).parameters - getattr(truth, side).parameters
        errors += [away[i] / sigma[f"{side}.{name}"] for i, name in enumerate(("fx", "fy", "cx", "cy"))]
    return float(np.sqrt(np.mean(np.square(errors))))
