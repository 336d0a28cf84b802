"""Recordings with known truth for `binocal bench uncertainty`, and errors of their calibrations over what these state.

Corners are simulated, not rendered: 11x8 corners 20 mm apart, random rigs of two alike cameras (brown4). A case says what is wrong with
a recording; the calibration is told of none of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.boards import Board, parse_board
from binocal.cameras import StereoRig
from binocal.evidence import Detections
from binocal.geometry import SE3
from binocal.metrics.image import triangulate
from binocal.rectification import rectify_points, row_rectification
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.simulation import PoseOptions, StereoScene, random_rig, sample_board_poses, simulate_detections
from binocal.simulation.visibility import visible_px
from binocal.uncertainty import common_field, depth_sigma, projection_covariance_px2, row_sigma_px
from binocal.uncertainty.field import image_grid
from binocal.uncertainty.projection import Side

BOARD = "chessboard:11x8:20mm"
NOISE_PX = 0.2
DEPTHS_M = (0.5, 1.0, 5.0, 20.0)
GRID_WH = (9, 7)
ROWS_AT_M = 1.0
LEAST_CORNERS = 12  # of an image that one-sided coverage cuts


@dataclass(frozen=True, slots=True)
class Case:
    """A kind of recording.

    ``noise_px`` is a range where images differ (log-uniform); ``covered`` the left part of both images in which
    corners are seen; ``bow_m`` the standard deviation of the board's bow over its extent.
    """

    n_views: int = 20
    noise_px: tuple[float, float] = (NOISE_PX, NOISE_PX)
    covered: float = 1.0
    visible_share: float = 1.0
    outlier_share: float = 0.0
    bow_m: float = 0.0


CASES: Mapping[str, Case] = {
    "20 views": Case(),
    "6 views": Case(n_views=6),
    "one-sided coverage": Case(covered=0.6),
    "partial boards": Case(visible_share=0.5),
    "5 % outliers": Case(outlier_share=0.05),
    "mixed blur": Case(noise_px=(0.05, 0.5)),
    "bowed board": Case(bow_m=0.5e-3),
}


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A recording and its truth."""

    rig: StereoRig
    T_left_board: SE3
    detections: Detections


def simulate_case(case: Case, rng: np.random.Generator) -> Drawn:
    """A random rig, and a recording of that kind with it."""
    rig, board = random_rig(rng), parse_board(BOARD)
    options = PoseOptions(min_visible_share=case.visible_share)
    poses = sample_board_poses(rig, board, case.n_views, rng, options)
    if case.bow_m:
        detections = _of_bowed_board(rig, board, poses, case.bow_m, rng)
    else:
        detections = simulate_detections(StereoScene(rig, board, poses), rng)
    if case.covered < 1:
        detections = _cut(detections, case.covered)
    return Drawn(rig, poses, _with_noise(detections, case, rng))


def _of_bowed_board(rig: StereoRig, board: Board, poses: SE3, bow_m: float, rng: np.random.Generator) -> Detections:
    """Exact corners of a board that is bent to a random quadratic surface, in the frame of its mean plane; as drawn in its own."""
    points = board.object_points_m
    x, y = ((points[:, :2] - points[:, :2].mean(axis=0)) / (0.5 * np.ptp(points[:, 0]))).T
    height = np.stack([x * x, x * y, y * y], axis=-1) @ (bow_m * rng.standard_normal(3))
    plane = np.stack([np.ones_like(x), x, y], axis=-1)
    height = height - plane @ np.linalg.lstsq(plane, height, rcond=None)[0]
    bent = points + np.stack([np.zeros_like(x), np.zeros_like(x), height], axis=-1)
    left = visible_px(rig.left, poses.apply(bent))
    right = visible_px(rig.right, (rig.T_right_left @ poses).apply(bent))
    return Detections.from_arrays(points, left, right, rig.left.size_wh, right_image_size_wh=rig.right.size_wh)


def _cut(detections: Detections, covered: float) -> Detections:
    """Without the corners beyond that share of the images' width; images that keep too few keep none."""
    sides = []
    for px, (width, _) in (
        (detections.left_px, detections.left_size_wh),
        (detections.right_px, detections.right_size_wh),
    ):
        kept = np.where(px[..., :1] < covered * width, px, np.nan)
        is_enough = np.isfinite(kept[..., 0]).sum(axis=1) >= LEAST_CORNERS
        sides.append(np.where(is_enough[:, None, None], kept, np.nan))
    both = np.isfinite(sides[0][..., 0]).any(axis=1) & np.isfinite(sides[1][..., 0]).any(axis=1)
    sides = [np.where(both[:, None, None], px, np.nan) for px in sides]
    return replace(detections, left_px=sides[0], right_px=sides[1])


def _with_noise(detections: Detections, case: Case, rng: np.random.Generator) -> Detections:
    from binocal.simulation.noise import add_outliers

    low, high = np.log(case.noise_px)
    sides = [
        px + np.exp(rng.uniform(low, high, (len(px), 1, 1))) * rng.standard_normal(px.shape)
        for px in (detections.left_px, detections.right_px)
    ]
    noisy = replace(detections, left_px=sides[0], right_px=sides[1])
    return add_outliers(noisy, rng, share=case.outlier_share, distance_px=5.0) if case.outlier_share else noisy


def standardised_errors(drawn: Drawn, calibration: StereoCalibration) -> dict[str, Float[ndarray, "k"]]:
    """Errors over their stated standard deviations, by figure: projection over both images, depth over the common field, rows.

    A projection's error is that of a thing fixed to the boards, which the definition is about: it goes through every used view's
    board from the true poses to the estimated ones, and the mean of these is projected.
    """
    place = {name: i for i, name in enumerate(drawn.detections.names)}
    used = [place[view.name] for view in calibration.views]
    poses = SE3(drawn.T_left_board.R[used], drawn.T_left_board.t[used])
    range_m = float(np.median(np.linalg.norm(poses.t, axis=-1)))
    errors: dict[str, Float[ndarray, "k"]] = {}
    sides: tuple[Side, Side] = ("left", "right")
    for side in sides:
        errors[f"{side} projection"] = _projection(drawn.rig, calibration, poses, side, range_m)
        errors[f"{side} projection at infinity"] = _projection(drawn.rig, calibration, poses, side, np.inf)
    for depth_m in DEPTHS_M:
        field = common_field(drawn.rig, depth_m, GRID_WH)
        points = field.points[field.is_common]
        if not len(points):
            continue
        pixels = drawn.rig.left.project(points), drawn.rig.right.project(drawn.rig.T_right_left.apply(points))
        measured, _ = triangulate(calibration.rig, *pixels)
        relative = np.linalg.norm(measured, axis=1) / np.linalg.norm(points, axis=1) - 1
        told = depth_sigma(calibration.rig, calibration.stated_covariance, points)
        errors[f"depth at {depth_m:g} m"] = relative * told.depth_m / told.calibration_m
        if depth_m == ROWS_AT_M:
            errors["rows"] = _rows(calibration, points, pixels)
    return {figure: z[np.isfinite(z)] for figure, z in errors.items()}


def _projection(
    truth: StereoRig, calibration: StereoCalibration, poses: SE3, side: Side, range_m: float
) -> Float[ndarray, "k"]:
    camera, estimated = getattr(truth, side), getattr(calibration.rig, side)
    px = image_grid(camera, GRID_WH).reshape(-1, 2)
    own, other = poses, calibration.T_left_board
    assert other is not None and calibration.mean_board_pose is not None
    if side == "right":
        own, other = truth.T_right_left @ own, calibration.rig.T_right_left @ other
    rays = camera.unproject(px)
    if np.isinf(range_m):
        through = np.einsum("vij,vkj,nk->vni", other.R, own.R, rays)
    else:
        in_board = np.einsum("vji,vnj->vni", own.R, (range_m * rays)[None] - own.t[:, None])
        through = np.einsum("vij,vnj->vni", other.R, in_board) + other.t[:, None]
    error = estimated.project(through.mean(axis=0)) - px
    C = projection_covariance_px2(
        calibration.rig, calibration.stated_covariance, calibration.mean_board_pose, side, px, range_m
    )
    return (error / np.sqrt(C[:, [0, 1], [0, 1]])).ravel()


def _rows(
    calibration: StereoCalibration,
    points: Float[ndarray, "n 3"],
    pixels: tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2"]],
) -> Float[ndarray, "n"]:
    rig = calibration.rig
    rectified = row_rectification(rig)
    left, right = (
        rectify_points(camera, R, P, px)[:, 0 if rectified.is_vertical else 1]
        for camera, R, P, px in (
            (rig.left, rectified.R_rect_left, rectified.P_left, pixels[0]),
            (rig.right, rectified.R_rect_right, rectified.P_right, pixels[1]),
        )
    )
    told = row_sigma_px(rig, calibration.stated_covariance, pixels[0], np.linalg.norm(points, axis=1))
    return (left - right) / told
