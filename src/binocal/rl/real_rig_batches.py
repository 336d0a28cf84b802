"""Training rigs from real detections: many small calibrations drawn from the views of one rig.

No truth is known and rewards look at none, but at how far the robust cost lies above the lowest that a classical solve found
(:func:`binocal.rl.rig_batches.remaining_sigma`); the calibration of these very views supplies the intrinsics that are held, and the
place around which starts are drawn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from binocal.cameras import camera_model
from binocal.errors import TooFewViewsError
from binocal.result import StereoCalibration
from binocal.rl.rig_batches import RIG_SETS, RigBatch, RigDistribution, solved_rigs
from binocal.solvers.board_views import BundleEstimate, BundleProblem, CameraObservations

MIN_VIEWS_PER_RIG = 3
MAX_VIEWS_PER_RIG = 12


def rigs_from_calibration(calibration: StereoCalibration, n_rigs: int, rng: np.random.Generator) -> RigBatch:
    """Random subsets of the calibration's views, half of them at a time, each a rig of its own.

    Raises:
        TooFewViewsError: Fewer than six views: a half would not hold three.
        DataError: The calibration holds no corners (it was read from a file).
    """
    detections, poses = calibration.corners.detections, calibration.corners.T_left_board
    n_views = min(detections.n_views // 2, MAX_VIEWS_PER_RIG)
    if n_views < MIN_VIEWS_PER_RIG:
        raise TooFewViewsError(detections.n_views, 2 * MIN_VIEWS_PER_RIG)
    pick = np.argsort(rng.random((n_rigs, detections.n_views)), axis=1)[:, :n_views]
    rig = calibration.rig
    cameras = tuple(
        CameraObservations.from_corners(camera_model(camera.model), px[pick], intrinsics=False)
        for camera, px in ((rig.left, detections.left_px), (rig.right, detections.right_px))
    )
    problem = BundleProblem(np.ascontiguousarray(detections.object_points_m.T), cameras)
    known = BundleEstimate.of_rig(rig, poses[pick])
    options: RigDistribution = replace(RIG_SETS["standard"], n_views=n_views)
    return solved_rigs(options, problem, known, np.full(n_rigs, calibration.noise_px), has_truth=False)


def tolerance_sigma(n_views: int) -> float:
    """What counts as arrived: 0.1 for six unknowns; the cost is that of all of them, the board poses too."""
    return 0.1 * float(np.sqrt(1 + n_views))


def network_widths(n_views: int) -> tuple[int, ...]:
    """Layers and nodes by the amount of training data (the paper's second step).

    A layer of 16 nodes up to 12 views, two of 32 up to 48, two of 64 beyond: a few hundred views distinguish more solves than
    a dozen. The rule is ours; the paper states none.
    """
    if n_views <= 12:
        return (16,)
    return (32, 32) if n_views <= 48 else (64, 64)
