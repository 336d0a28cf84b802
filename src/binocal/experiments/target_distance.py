"""How depth and length err with the target's distance (the paper's section 5 leaves it open), beside what the calibration predicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from binocal.boards import parse_board
from binocal.cameras import StereoRig
from binocal.evidence import Detections
from binocal.experiments.boards import FILL, MODEL, nominal_rig
from binocal.experiments.case import AtBound, Case, Made, Method, PriorUnchanged, Sample, by_calibrator
from binocal.experiments.row import NAN, Measured
from binocal.metrics.held_out import draw_rigs, is_inside
from binocal.metrics.image import triangulate
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.simulation import PoseOptions, sample_board_poses, table2_rig
from binocal.solvers.covariance import cramer_rao_bound

TABLE = "distance"
DISTANCES_M = (0.3, 0.5, 1.0, 2.0, 5.0, 10.0)
SPEC = "chessboard:11x8:20mm"
N_PAIRS = 20
NOISE_PX = 0.05  # of a corner; also of a match, in each image
GRID = 7  # points along each side of the target
FIELD = 0.8  # of what both cameras see at the distance, which the target fills
N_MATCHED = 40  # times that the target is matched, with other noise
N_DRAWN = 30  # rigs, from which the predicted deviation of a length comes


class Target(NamedTuple):
    """Points of a plane before the rig at one distance: in the left frame, and exact pixels in both images."""

    points: Float[ndarray, "k 3"]
    left_px: Float[ndarray, "k 2"]
    right_px: Float[ndarray, "k 2"]


@dataclass(frozen=True, slots=True)
class NoisyCorners:
    """Exact corners of the rig of table 2 with Gaussian noise; the same for every distance."""

    n_pairs: int = N_PAIRS

    def __call__(self, seed: int) -> Sample:
        """See :class:`binocal.experiments.case.Case`."""
        rng, rig, board = np.random.default_rng([seed, 11]), table2_rig(), parse_board(SPEC)
        poses = sample_board_poses(rig, board, self.n_pairs, rng, PoseOptions(fill=FILL))
        sides = []
        for camera, placed in ((rig.left, poses), (rig.right, rig.T_right_left @ poses)):
            pixels = camera.project(placed.apply(board.object_points_m))
            pixels[~is_inside(pixels, camera.size_wh)] = np.nan
            sides.append(pixels + rng.normal(0, NOISE_PX, pixels.shape))
        evidence = Detections.from_arrays(board.object_points_m, sides[0], sides[1], rig.left.size_wh)
        bound = cramer_rao_bound(
            rig,
            board.object_points_m,
            poses,
            NOISE_PX,
            left_is_seen=evidence.left_is_seen,
            right_is_seen=evidence.right_is_seen,
        )
        return Sample(evidence, rig, board, bound, {"model": MODEL}, prior=nominal_rig())


@dataclass(frozen=True, slots=True)
class TargetErrors:
    """Errors of depth and of lengths on a target at a distance, RMS relative to the truth.

    ``Measured.bound`` holds the standard deviation that the method's own calibration predicts; NaN where it states none.
    """

    distance_m: float

    def __call__(self, made: Made, sample: Sample) -> list[Measured]:
        """See :class:`binocal.experiments.case.Case`."""
        truth: StereoRig = sample.truth
        target = target_at(truth, self.distance_m)
        rng = np.random.default_rng(12)  # the same matches for every method
        noise = rng.normal(0, NOISE_PX, (2, N_MATCHED, *target.left_px.shape))
        exact, _ = triangulate(made.rig, target.left_px, target.right_px)
        matched, _ = triangulate(made.rig, target.left_px + noise[0], target.right_px + noise[1])
        calibration = made.calibration
        alone, together = _predicted_depth(calibration, target)
        length = NAN if calibration is None else _predicted_length(calibration, target)
        depth = target.points[:, 2]
        return [
            Measured("depth error, exact matches", "%", _percent(exact[:, 2] / depth - 1), alone),
            Measured(f"depth error, matches of {NOISE_PX} px", "%", _percent(matched[..., 2] / depth - 1), together),
            Measured(
                "length error, exact matches", "%", _percent(_lengths(exact) / _lengths(target.points) - 1), length
            ),
        ]


def target_at(rig: StereoRig, distance_m: float) -> Target:
    """A grid over the middle of what both cameras see of the plane at that depth."""
    width, height = rig.left.size_wh
    u, v = np.meshgrid(np.linspace(0, width - 1, 65), np.linspace(0, height - 1, 49))
    rays = rig.left.unproject(np.stack([u, v], axis=-1).reshape(-1, 2))
    points = rays * (distance_m / rays[:, 2:])
    seen = points[is_inside(rig.right.project(rig.T_right_left.apply(points)), rig.right.size_wh)]
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    middle, half = (low + high) / 2, FIELD * (high - low) / 2
    x, y = (np.linspace(middle[axis] - half[axis], middle[axis] + half[axis], GRID) for axis in range(2))
    points = np.stack([*np.broadcast_arrays(x, y[:, None], distance_m)], axis=-1).reshape(-1, 3)
    return Target(points, rig.left.project(points), rig.right.project(rig.T_right_left.apply(points)))


def _lengths(points: Float[ndarray, "k 3"]) -> Float[ndarray, "_"]:
    """Width and height of the target, along each of its lines."""
    grid = points.reshape(GRID, GRID, 3)
    return np.linalg.norm(np.concatenate([grid[:, -1] - grid[:, 0], grid[-1] - grid[0]]), axis=-1)


def _percent(relative: Float[ndarray, "*k"]) -> float:
    return float(100 * np.sqrt(np.mean(relative**2)))


def _predicted_depth(calibration: StereoCalibration | None, target: Target) -> tuple[float, float]:
    """RMS over the target of the relative standard deviation of depth, percent: from the calibration alone, and with matching."""
    if calibration is None or not np.isfinite(calibration.covariance.matrix).all():
        return NAN, NAN
    depth = target.points[:, 2]
    sigma = calibration.depth_sigma(target.points, matching_px=NOISE_PX * np.sqrt(2))
    return _percent(sigma.calibration_m / depth), _percent(sigma.total_m / depth)


def _predicted_length(calibration: StereoCalibration, target: Target) -> float:
    """RMS relative error of the lengths for rigs drawn from the calibration's covariance, percent."""
    covariance = calibration.covariance
    if not np.isfinite(covariance.matrix).all():
        return NAN
    rig = calibration.rig
    exact = triangulate(rig, target.left_px, target.right_px)[0]
    drawn = draw_rigs(rig, covariance, N_DRAWN, np.random.default_rng(13))
    errors = [_lengths(triangulate(one, target.left_px, target.right_px)[0]) / _lengths(exact) - 1 for one in drawn]
    return _percent(np.concatenate(errors))


def distance_cases() -> list[Case]:
    """A case for each distance."""
    methods: tuple[Method, ...] = (
        *(by_calibrator(name) for name in ("drl", "lm", "opencv", "absolute-orientation")),
        PriorUnchanged(),
        AtBound(),
    )
    return [Case(f"{d:g} m", NoisyCorners(), TargetErrors(d), methods, table=TABLE) for d in DISTANCES_M]
