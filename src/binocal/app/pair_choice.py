"""Which pairs of a drive to use: many are glanced at, and those that together tell a pose best are chosen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from binocal.app.pair_matching import for_each_pair, read_pair
from binocal.cameras import Camera
from binocal.datasets import StereoPair
from binocal.evidence.point_matches import PointMatches
from binocal.geometry import SE3
from binocal.matching.glance import glance_at_pair
from binocal.progress import ProgressCallback, ShouldStop
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.epipolar_descent import SCHEDULE_PX, descend
from binocal.solvers.relative_pose import RelativePose

GLANCES_PER_PAIR = 12  # 96 for the 8 that are used
GLANCE_SCALE_PX = 4.0  # of the kernel: matches of a glance are a pixel or two off


def choose_pairs(
    pairs: Sequence[StereoPair],
    cameras: tuple[Camera, Camera],
    near: SE3,
    n_wanted: int,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
) -> list[int]:
    """So many of the pairs, in their order; as many images are in memory at a time as threads are used.

    ``near`` is a pose that is right to some degrees.

    Raises:
        DataError: An image cannot be read or is not of these cameras' size.
        CancelledError: ``should_stop`` said so.
    """
    looked = looked_at(len(pairs), n_wanted)
    if len(looked) <= n_wanted:
        return looked

    def glance(pair: StereoPair) -> PointMatches:
        return glance_at_pair(*read_pair(pair, cameras), pair.name)

    glances = list(for_each_pair(glance, [pairs[i] for i in looked], "glances", progress, should_stop))
    return [looked[i] for i in most_telling(cameras, near, glances, n_wanted)]


def looked_at(n_pairs: int, n_wanted: int) -> list[int]:
    """Which pairs to glance at: evenly over the drive."""
    n = min(n_pairs, GLANCES_PER_PAIR * n_wanted)
    return np.unique(np.linspace(0, n_pairs - 1, n).round().astype(int)).tolist()


def most_telling(
    cameras: tuple[Camera, Camera], near: SE3, glances: Sequence[PointMatches], n_wanted: int
) -> list[int]:
    """The pairs that together tell the pose best: each next one lowers the trace of its covariance most.

    Greedy choice comes within 1 % of exchanging until nothing improves.
    """
    problems = [EpipolarProblem.of_matches(cameras, found)[0] for found in glances]
    pooled, _ = EpipolarProblem.of_matches(cameras, PointMatches.joined(glances))
    coarse = tuple(scale for scale in SCHEDULE_PX if scale >= GLANCE_SCALE_PX)
    pose = descend(pooled, RelativePose.of(near), coarse)
    scale_px = np.asarray(GLANCE_SCALE_PX)
    informations = np.stack([problem.linearize(pose, scale_px, "geman").information for problem in problems])
    total = informations.sum(axis=0)
    size = 1 / np.sqrt(np.maximum(np.diagonal(total), 1e-300))
    scaled = informations * size[:, None] * size
    chosen: list[int] = []
    known = 1e-6 * np.eye(5)
    while len(chosen) < n_wanted:
        rest = [i for i in range(len(glances)) if i not in chosen]
        traces = np.trace(np.linalg.inv(known + scaled[rest]), axis1=-2, axis2=-1)
        chosen.append(rest[int(np.argmin(traces))])
        known = known + scaled[chosen[-1]]
    return sorted(chosen)
