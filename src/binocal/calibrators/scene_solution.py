"""Which focal length makes the families of one camera's images orthogonal: starts, their solves, images that contradict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.evidence.line_segments import LineSegments
from binocal.geometry.vanishing import PencilForms
from binocal.initialization.scene_families import SURE, Family, FrameAt, best_frame, focal_steps
from binocal.shapes import Float
from binocal.solvers.manhattan import (
    ManhattanEstimate,
    ManhattanMinimum,
    ManhattanProblem,
    SharedPrior,
    solve_manhattan,
)

START_FLOOR_PX = 1.0
FLOORS_PX = np.r_[
    0.0, np.geomspace(0.02, 5.0, 40)
]  # of ends beyond what their edges state: walls and lenses are not straight
ROUNDS = 3  # of solving and finding that floor, and of leaving out images that contradict
N_STARTS, STEPS_APART = 4, 3
OTHER_VIEW_DEG = 10.0  # turned by less, a camera sees a wrong right angle as the same wrong focal length


@dataclass(frozen=True, slots=True, eq=False)
class SceneImage:
    """An image's distinct segments, and the families that they are of."""

    name: str
    index: int
    forms: PencilForms
    families: Sequence[Family]

    @property
    def single(self) -> float:
        """Log odds of the surest family alone."""
        if not self.families:
            return 0.0
        points = np.stack([family.point for family in self.families])
        return float(self.forms.evidence(self.forms.distances(points) ** 2, 1).sum(axis=1).max())

    def frame(self, focal_px: float, centre_px: Float[ndarray, "2"]) -> FrameAt | None:
        """The best frame, if it explains more than one family does."""
        if len(self.families) < 2:
            return None
        found = best_frame(self.families, self.forms, focal_px, centre_px)
        return found if found is not None and found.log_odds > self.single else None


@dataclass(frozen=True, slots=True, eq=False)
class SceneSolution:
    """A minimum, the images and segments that it is of, the floor of their ends, and the log odds that it explains."""

    minimum: ManhattanMinimum
    problem: ManhattanProblem
    images: tuple[SceneImage, ...]
    used: LineSegments
    floor_px: float
    log_odds: float

    @property
    def is_checked(self) -> bool:
        """Whether something would have told that families are not at right angles: a third one, or another view of two."""
        if self.problem.counts.all(axis=1).any():
            return True
        rotations = self.minimum.estimate.rotations
        # the turn that takes one frame's axes to the nearest ones of the other, whichever way round they are numbered
        turned = np.abs(np.einsum("aji,bjk->abik", rotations, rotations)).max(axis=3).sum(axis=2)
        return bool((0.5 * (turned - 1) < np.cos(np.radians(OTHER_VIEW_DEG))).any())


def best_solution(segments: LineSegments, images: Sequence[SceneImage], prior: SharedPrior) -> SceneSolution | None:
    """The solution that explains most of the images' segments; None where no two families are orthogonal at any focal length."""
    half = 0.5 * float(np.hypot(*segments.size_wh))
    steps = focal_steps([image.families for image in images], prior.centre_px, half)
    frames = [[image.frame(f, prior.centre_px) for f in steps] for image in images]
    best: SceneSolution | None = None
    for k in _peaks(images, frames):
        framed = [(image, own[k]) for image, own in zip(images, frames, strict=True)]
        chosen = [(image, frame) for image, frame in framed if frame is not None]
        solution = _solved(segments, [c[0] for c in chosen], [c[1] for c in chosen], float(steps[k]), prior)
        used = {image.index for image in solution.images}
        rest = sum(image.single for image in images if image.index not in used)
        solution = replace(solution, log_odds=solution.log_odds + rest)
        if best is None or solution.log_odds > best.log_odds:
            best = solution
    return None if best is None else _without_contradicting(best, segments, prior, steps)


def _peaks(images: Sequence[SceneImage], frames: Sequence[Sequence[FrameAt | None]]) -> list[int]:
    """Focal lengths at which the images' frames explain most, by themselves best among their neighbours."""
    odds = np.array(
        [[image.single if f is None else f.log_odds for f in own] for image, own in zip(images, frames, strict=True)]
    )
    has_any = np.array([[f is not None for f in own] for own in frames]).any(axis=0)
    total = np.where(has_any, odds.sum(axis=0), -np.inf)
    chosen: list[int] = []
    for k in np.argsort(-total):
        if len(chosen) == N_STARTS or not np.isfinite(total[k]):
            break
        if all(abs(int(k) - other) > 3 for other in chosen):
            chosen.append(int(k))
    return chosen


def _solved(
    segments: LineSegments, images: Sequence[SceneImage], frames: Sequence[FrameAt], focal_px: float, prior: SharedPrior
) -> SceneSolution:
    place = np.full(len(segments.names), -1)
    place[[image.index for image in images]] = np.arange(len(images))
    used = segments.select(place[segments.image] >= 0)
    image = place[used.image]
    estimate = ManhattanEstimate(focal_px, prior.centre_px, np.stack([frame.R_camera_scene for frame in frames]))
    counts = np.stack([frame.counts for frame in frames])
    floor_px = START_FLOOR_PX
    problem = ManhattanProblem(PencilForms.of(used.ends_px, used.covariance_px2, floor_px), image, counts, prior)
    minimum = solve_manhattan(problem, estimate)
    for _ in range(1, ROUNDS):
        floor_px = _likeliest_floor(used, problem, minimum.estimate)
        problem = replace(problem, forms=PencilForms.of(used.ends_px, used.covariance_px2, floor_px))
        minimum = solve_manhattan(problem, minimum.estimate, ())
    odds = 0.0
    for k, own in enumerate(images):
        distances = own.forms.distances(minimum.estimate.points[k][counts[k]])
        odds += float(own.forms.evidence((distances**2).min(axis=0), int(counts[k].sum())).sum())
    return SceneSolution(minimum, problem, tuple(images), used, floor_px, odds)


def _likeliest_floor(used: LineSegments, problem: ManhattanProblem, estimate: ManhattanEstimate) -> float:
    """What ends are off by beyond their edges' covariance, by maximum likelihood with segments of no family among them."""
    odds = []
    for floor in FLOORS_PX:
        forms = PencilForms.of(used.ends_px, used.covariance_px2, float(floor))
        odds.append(float(replace(problem, forms=forms).log_odds(estimate).sum()))
    return float(FLOORS_PX[int(np.argmax(odds))])


def _without_contradicting(
    solution: SceneSolution, segments: LineSegments, prior: SharedPrior, steps: Float[ndarray, "k"]
) -> SceneSolution:
    """Solved again without images whose lines surely ask for another focal length, as long as two agree."""
    for _ in range(ROUNDS):
        if len(solution.images) < 3:
            break  # of two nobody says which is right
        estimate, problem = solution.minimum.estimate, solution.problem
        odds = problem.log_odds(estimate)
        lost = np.zeros(len(solution.images))
        for k, image in enumerate(solution.images):
            own = problem.forms.select(problem.image == k)
            frames = [best_frame(image.families, own, f, prior.centre_px) for f in steps]
            best = max((frame.log_odds for frame in frames if frame is not None), default=0.0)
            lost[k] = best - float(odds[problem.image == k].sum())
        kept = np.flatnonzero(lost <= SURE)
        if len(kept) == len(lost) or len(kept) < 2:
            break
        frames = [FrameAt(estimate.rotations[k], problem.counts[k], 0.0) for k in kept]
        solution = _solved(segments, [solution.images[k] for k in kept], frames, estimate.focal_px, prior)
    return solution
