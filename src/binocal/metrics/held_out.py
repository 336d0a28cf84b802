"""The paper's criteria on exact views of the true rig, each beside what the Cramér-Rao bound allows.

Exact views are corners without noise, seen by the true rig at board poses that no calibration used. What an estimated rig measures on
them is its own error alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.metrics import image
from binocal.result import Covariance
from binocal.shapes import Bool, Float
from binocal.simulation import sample_board_poses
from binocal.solvers.poses import estimate_board_poses

HELD_OUT_STREAM = 999  # far from the streams that rendered views are drawn from
N_BOUND_RIGS = 40  # rigs drawn from the bound; its RMS is then known to 11 %


@dataclass(frozen=True, slots=True)
class Criterion:
    """One figure: its value, and the RMS value over rigs whose errors are drawn from the bound (NaN without a bound)."""

    name: str
    unit: str
    value: float
    bound: float

    @property
    def ratio(self) -> float:
        """Value over bound."""
        return self.value / self.bound if self.bound > 0 else float("nan")


def criteria_on_exact_views(
    rig: StereoRig,
    exact: Detections,
    T_left_board: SE3,
    side_m: float,
    bounded: tuple[StereoRig, Covariance] | None,
    rng: np.random.Generator,
) -> tuple[Criterion, ...]:
    """Pixel error (eq. 19), rectified row error and relative length error of a rig on exact views.

    The board's pose is fitted with the rig under test, as it would be on images. ``bounded`` is the true rig in the
    estimated camera model, and the bound there.
    """
    values = _figures(rig, exact, T_left_board, side_m)
    if bounded is None:
        bounds = np.full(len(values), np.nan)
    else:
        truth, bound = bounded
        draws = [_figures(r, exact, T_left_board, side_m) for r in draw_rigs(truth, bound, N_BOUND_RIGS, rng)]
        bounds = np.sqrt(np.mean(np.square(draws), axis=0))
    labels = (("pixel error (eq. 19)", "px"), ("rectified row error", "px"), ("relative length error", "%"))
    return tuple(
        Criterion(name, unit, float(value), float(limit))
        for (name, unit), value, limit in zip(labels, values, bounds, strict=True)
    )


def exact_views(rig: StereoRig, board: Board, n_views: int, seed: int) -> tuple[Detections, SE3]:
    """Exact corners of new views of a board by a rig, NaN outside the images, and the board's poses in the left frame."""
    points = board.object_points_m
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(HELD_OUT_STREAM,)))
    T_left_board = sample_board_poses(rig, board, n_views, rng)
    sides = []
    for camera, poses in ((rig.left, T_left_board), (rig.right, rig.T_right_left @ T_left_board)):
        pixels = camera.project(poses.apply(points))
        pixels[~is_inside(pixels, camera.size_wh)] = np.nan
        sides.append(pixels)
    exact = Detections.from_arrays(points, sides[0], sides[1], rig.left.size_wh, right_image_size_wh=rig.right.size_wh)
    return exact, T_left_board


def is_inside(pixels: Float[ndarray, "*n 2"], size_wh: tuple[int, int]) -> Bool[ndarray, "*n"]:
    """Which points lie in an image of that size; its outermost pixels count to their edges. False where NaN."""
    with np.errstate(invalid="ignore"):
        return np.all((pixels >= -0.5) & (pixels <= np.array(size_wh) - 0.5), axis=-1)


def draw_rigs(truth: StereoRig, covariance: Covariance, n: int, rng: np.random.Generator) -> list[StereoRig]:
    """``n`` rigs scattered about the truth with that covariance (Gaussian, to first order).

    Where there are more than parameters, their mean and covariance are exactly these: an RMS over them, of what is linear in the
    parameters, has no chance in it.
    """
    values, vectors = np.linalg.eigh(covariance.matrix)
    root = vectors * np.sqrt(np.clip(values, 0, None))
    draws = rng.standard_normal((n, len(root)))
    if n > len(root):
        draws = draws - draws.mean(axis=0)
        draws = np.linalg.qr(draws)[0] * np.sqrt(n)
    return [_moved(truth, dict(zip(covariance.names, root @ draw, strict=True))) for draw in draws]


def _moved(rig: StereoRig, step: dict[str, float]) -> StereoRig:
    def camera(side: str, old: Camera) -> Camera:
        names = camera_model(old.model).parameter_names
        return Camera(old.model, old.size_wh, old.parameters + [step.get(f"{side}.{name}", 0.0) for name in names])

    turn, shift = (np.array([step[f"{part}.{axis}"] for axis in "xyz"]) for part in ("rotation", "translation"))
    T = SE3(so3.exp(turn) @ rig.T_right_left.R, rig.T_right_left.t + shift)
    return StereoRig(camera("left", rig.left), camera("right", rig.right), T, rig.is_metric)


def _figures(rig: StereoRig, exact: Detections, T_left_board: SE3, side_m: float) -> Float[ndarray, "3"]:
    poses = estimate_board_poses(rig, exact, T_left_board)
    measures: tuple[Callable[[], float], ...] = (
        lambda: image.pixel_error(rig, exact, poses.T_left_board).all_px,
        lambda: image.rectified_row_error(rig, exact).rms_px,
        lambda: image.length_error(rig, exact, side_m=side_m).scale_rms_percent,
    )
    return np.array([measure() for measure in measures])
