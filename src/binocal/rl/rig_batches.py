"""Simulated rigs on which agents train and are evaluated: corners, intrinsics that are held, starts, the robust optimum.

A case is a rig with its detections. Its board poses start at the left camera's own robust optimum, as any pose solver
would leave them; the rig starts off by a rotation and a share of the baseline that are drawn anew for every episode.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy import ndarray

from binocal.boards import parse_board
from binocal.cameras import camera_model
from binocal.geometry import SE3, so3
from binocal.rl.task import Judgement, TaskState, has_arrived, reward
from binocal.shapes import Float
from binocal.simulation import PoseOptions, StereoScene, random_rig, sample_board_poses
from binocal.solvers.arrays import SHARED, stack_rigs, take_rigs
from binocal.solvers.board_views import (
    BundleEstimate,
    BundleProblem,
    BundleState,
    CameraObservations,
)
from binocal.solvers.minimization import LoopOptions, minimize

MODEL = "brown4"
SIZE_WH = (1280, 960)
MAX_START_DRAWS = 60  # a start with a board behind the right camera is drawn again; of 70 deg starts one in five is


@dataclass(frozen=True, slots=True)
class RigDistribution:
    """A distribution of rigs, images and starts. Ranges are uniform unless said otherwise."""

    board: str = "chessboard:11x8:20mm"
    n_views: int = 20
    field_deg: tuple[float, float] = (38.0, 50.0)
    """Horizontal field; the paper's rig has 43.6."""
    baseline_m: tuple[float, float] = (0.05, 0.08)
    poses: PoseOptions = field(default_factory=PoseOptions)
    noise_px: tuple[float, float] = (0.1, 0.5)
    outlier_share: tuple[float, float] = (0.0, 0.1)
    outlier_px: tuple[float, float] = (2.0, 100.0)
    """Log-uniform distance of an outlying corner from its place, in any direction."""
    reversed_share: float = 0.0
    """Share of right views whose corners come in reverse order."""
    rotation_deg: tuple[float, float] = (0.0, 20.0)
    """Angle of the start from the truth, about any axis."""
    translation_share: tuple[float, float] = (0.0, 0.3)
    """Distance of the start's translation from the truth over the baseline, in any direction."""


_FAR = PoseOptions(fill=(0.15, 0.30), tilt_deg=(0.0, 12.0))  # 11x8 squares of 20 mm at 1 to 2 m

RIG_SETS: dict[str, RigDistribution] = {
    "standard": RigDistribution(),
    "weak": RigDistribution(n_views=6, poses=_FAR),
    "stress": RigDistribution(
        n_views=12,
        outlier_share=(0.1, 0.3),
        reversed_share=0.2,
        rotation_deg=(0.0, 70.0),
        translation_share=(0.0, 1.0),
    ),
    "good start": RigDistribution(rotation_deg=(2.0, 2.0), translation_share=(0.05, 0.05)),
    "unseen": RigDistribution(board="chessboard:9x6:35mm", n_views=14, field_deg=(60.0, 75.0), baseline_m=(0.12, 0.25)),
}
"""The sets on which every controller is evaluated. ``unseen`` has another focal length, board, view count and baseline."""


@dataclass(frozen=True, slots=True, eq=False)
class LowestCost:
    """The lowest robust cost that is known of each rig, and the kernel's scale that it was found under."""

    cost_px2: Float[ndarray, "rigs"]
    scale_px: Float[ndarray, "rigs"]


@dataclass(frozen=True, slots=True, eq=False)
class RigBatch:
    """A batch of rigs with the same board and number of views; intrinsics are held at the truth.

    ``whitening`` turns a left step from the optimum (rotation, translation) into standard deviations.
    """

    options: RigDistribution = field(metadata=SHARED)
    problem: BundleProblem
    optimum: BundleEstimate
    left_poses: SE3
    whitening: Float[ndarray, "rigs 6 6"]
    noise_px: Float[ndarray, "rigs"]
    lowest: LowestCost | None = None
    """What rewards look at in place of the optimum where the truth is unknown: real images."""

    @property
    def n_rigs(self) -> int:
        """Rigs of the batch."""
        return len(self.noise_px)

    def select(self, index: ndarray) -> RigBatch:
        """Those rigs."""
        return take_rigs(self, index)


def sample_rigs(options: RigDistribution, n_rigs: int, rng: np.random.Generator) -> RigBatch:
    """Rigs of a distribution, each solved to its robust optimum from the truth."""
    board = parse_board(options.board)
    points = np.ascontiguousarray(board.object_points_m.T)
    rigs, poses, pixels = [], [], ([], [])
    for _ in range(n_rigs):
        rig = random_rig(
            rng,
            MODEL,
            size_wh=SIZE_WH,
            baseline_m=rng.uniform(*options.baseline_m),
            field_deg=rng.uniform(*options.field_deg),
        )
        scene = StereoScene(rig, board, sample_board_poses(rig, board, options.n_views, rng, options.poses))
        rigs.append(rig)
        poses.append(scene.T_left_board)
        for side, px in zip(pixels, scene.project(), strict=True):
            side.append(px)
    noise_px = rng.uniform(*options.noise_px, n_rigs)
    measured = [corrupt_corners(np.stack(px), noise_px, options, rng) for px in pixels]
    n_reversed = round(options.reversed_share * options.n_views)
    if n_reversed:
        wrong = np.argsort(rng.random((n_rigs, options.n_views)), axis=1)[:, :n_reversed]
        rows = np.arange(n_rigs)[:, None]
        measured[1][rows, wrong] = measured[1][rows, wrong][:, :, ::-1]
    model = camera_model(MODEL)
    problem = BundleProblem(
        points, tuple(CameraObservations.from_corners(model, px, intrinsics=False) for px in measured)
    )
    truth = BundleEstimate(
        tuple(np.stack([getattr(rig, side).parameters for rig in rigs]) for side in ("left", "right")),
        stack_rigs(poses),
        stack_rigs([rig.T_right_left for rig in rigs]),
    )
    return solved_rigs(options, problem, truth, noise_px)


def solved_rigs(
    options: RigDistribution,
    problem: BundleProblem,
    known: BundleEstimate,
    noise_px: Float[ndarray, "rigs"],
    *,
    has_truth: bool = True,
) -> RigBatch:
    """The rigs of a problem whose solution is known well enough to start a classical solve near its optimum."""
    minimum = minimize(problem, known, LoopOptions(tolerance_sigma=1e-3))
    optimum = minimum.estimate
    left = replace(problem, cameras=problem.cameras[:1], is_rig_free=False)
    alone = minimize(
        left, BundleEstimate(known.parameters[:1], known.T_left_board, known.T_right_left), LoopOptions()
    ).estimate
    information = problem.shared_information(optimum, problem.linearize(optimum, noise_px, "hampel"))
    # the upper triangular factor: |whitening @ xi|² = xi' information xi / noise²
    whitening = np.linalg.cholesky(information).swapaxes(-1, -2) / noise_px[:, None, None]
    lowest = None if has_truth else LowestCost(minimum.equations.cost_px2, minimum.equations.scale_px)
    return RigBatch(options, problem, optimum, alone.T_left_board, whitening, noise_px, lowest)


def corrupt_corners(
    px: Float[ndarray, "rigs views n 2"],
    noise_px: Float[ndarray, "rigs"],
    options: RigDistribution,
    rng: np.random.Generator,
) -> Float[ndarray, "rigs views n 2"]:
    """Noise on every coordinate, and outlying corners."""
    out = px + noise_px[:, None, None, None] * rng.standard_normal(px.shape)
    least, most = options.outlier_share
    share = rng.uniform(least, most, len(px))[:, None, None]
    is_outlier = rng.random(px.shape[:-1]) < share
    angle = rng.uniform(0, 2 * np.pi, px.shape[:-1])
    near, far = np.log(options.outlier_px)
    distance = np.exp(rng.uniform(near, far, px.shape[:-1]))
    shift = distance[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.where(is_outlier[..., None], out + shift, out)


def sample_starts(rigs: RigBatch, rng: np.random.Generator) -> BundleEstimate:
    """One start for each rig: left camera's own board poses, the rig off by the options' rotation and translation.

    Starts that put a corner behind the right camera are drawn again; NaN where that never ended.
    """
    options, n = rigs.options, rigs.n_rigs
    R, t = rigs.optimum.T_right_left.R.copy(), rigs.optimum.T_right_left.t.copy()
    todo = np.arange(n)
    for _ in range(MAX_START_DRAWS):
        w = _directions(len(todo), rng) * np.radians(rng.uniform(*options.rotation_deg, (len(todo), 1)))
        baseline = np.linalg.norm(rigs.optimum.T_right_left.t[todo], axis=1, keepdims=True)
        shift = _directions(len(todo), rng) * rng.uniform(*options.translation_share, (len(todo), 1)) * baseline
        R[todo] = so3.exp(w) @ rigs.optimum.T_right_left.R[todo]
        t[todo] = rigs.optimum.T_right_left.t[todo] + shift
        start = replace(rigs.optimum, T_left_board=rigs.left_poses, T_right_left=SE3.unchecked(R, t))
        r2 = rigs.select(todo).problem.residual_lengths2(take_rigs(start, todo))
        todo = todo[~np.all([np.isfinite(side).all(axis=(1, 2)) for side in r2], axis=0)]
        if not len(todo):
            break
    R[todo] = np.nan
    return replace(rigs.optimum, T_left_board=rigs.left_poses, T_right_left=SE3.unchecked(R, t))


def distance_sigma(rigs: RigBatch, estimate: BundleEstimate) -> Float[ndarray, "rigs"]:
    """Mahalanobis distance of R and T from the robust optimum, in standard deviations (norm over all six)."""
    omega = so3.log(estimate.T_right_left.R @ rigs.optimum.T_right_left.R.swapaxes(-1, -2))
    tau = estimate.T_right_left.t - rigs.optimum.T_right_left.t - np.cross(omega, rigs.optimum.T_right_left.t)
    xi = np.concatenate([omega, tau], axis=-1)
    return np.linalg.norm((rigs.whitening @ xi[..., None])[..., 0], axis=-1)


def remaining_sigma(rigs: RigBatch, loop: BundleState) -> Float[ndarray, "rigs"]:
    """What is left to the optimum: :func:`distance_sigma`, or without truth the same from the robust cost.

    Near the optimum the cost exceeds the lowest one by half the squared distance over all unknowns, in standard deviations
    and times the noise squared; far from it and in a wrong minimum it stays large, as it should.
    """
    if rigs.lowest is None:
        return distance_sigma(rigs, loop.estimate)
    excess = loop.equations.cost_under(rigs.lowest.scale_px, "hampel") - rigs.lowest.cost_px2
    return np.sqrt(2 * np.maximum(excess, 0.0)) / rigs.lowest.scale_px


def judge(rigs: RigBatch, before_sigma: Float[ndarray, "rigs"], state: TaskState, tolerance_sigma: float) -> Judgement:
    """Of a step: :func:`binocal.rl.task.reward`, and arrival, which ends the episode."""
    sigma = remaining_sigma(rigs, state.loop)
    arrived = has_arrived(sigma, tolerance_sigma)
    return Judgement(sigma, reward(before_sigma, sigma, tolerance_sigma), arrived, arrived)


def _directions(n: int, rng: np.random.Generator) -> Float[ndarray, "n 3"]:
    v = rng.standard_normal((n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)
