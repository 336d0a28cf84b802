"""The views that lower a requirement's figure fastest, chosen one after the other, each with the figure that is then to be expected.

Greedy design of experiments: views add their information to that of the calibration, and each time the one is taken after which the
figure's largest standard deviation over all its places is least; of few views each is then exchanged for a better one, if there is one
beside the others. Source: e.g. Pukelsheim 1993, "Optimal Design of Experiments", 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.errors import DegenerateGeometryError, SceneError
from binocal.geometry import SE3
from binocal.planning.candidates import CandidateViews, candidate_views
from binocal.requirements import Requirement
from binocal.requirements.figures import COVERAGE, Sensitivity, guard_share, sensitivity_of
from binocal.result import StereoCalibration
from binocal.shapes import Bool, Float, Int
from binocal.uncertainty.derivatives import variance_of

MAX_VIEWS = 20
EXCHANGES, MOST_EXCHANGED = 2, 8  # rounds; more views are chosen well enough one by one
MOST_PLACES = 30  # twice as many are compared
DIFFERENT_VIEWS = 6  # in a row
ALIKE_RAD = 0.1  # of the line of sight, and half of the tilt
WORTHWHILE = 0.005  # a view that lowers the figure by less is not asked for


@dataclass(frozen=True, slots=True, eq=False)
class PlannedView:
    """A board pose to show: where its centre is seen in the left image, how far away, how tilted.

    ``tilt_deg`` is the angle between the board and the image plane; ``away`` says which side of the board is farther from the camera.
    ``figure`` is to be expected once this view and those before it were added.
    """

    T_left_board: SE3
    left_px: tuple[float, float]
    distance_m: float
    tilt_deg: float
    away: str
    figure: float


@dataclass(frozen=True, slots=True, eq=False)
class ViewPlan:
    """Views in the order in which they help, the figure before them, and whether they suffice.

    ``why`` says why there is none, or why it does not suffice.
    """

    requirement: Requirement
    figure: float
    views: tuple[PlannedView, ...]
    is_enough: bool
    why: str = ""


def plan_views(
    calibration: StereoCalibration,
    board: Board,
    requirement: Requirement,
    *,
    n_views: int | None = None,
    max_views: int = MAX_VIEWS,
) -> ViewPlan:
    """The views that bring the requirement's figure, with its guard band, below the limit; exactly ``n_views`` where that is given.

    The board is shown whole to both cameras; corners are taken to be as noisy as those of the calibration. Where its standard
    deviations were widened by what its views have in common, those of the new views are too.
    """
    if requirement.quantity == "reprojection":
        return ViewPlan(
            requirement, np.nan, (), False, "more views do not lower the RMS of the corners: better images do"
        )
    if board.is_metric != calibration.rig.is_metric:
        return ViewPlan(
            requirement, np.nan, (), False, "the rig and the board are not in one unit: give both a size, or neither"
        )
    try:
        sensitivity = sensitivity_of(calibration, requirement)
        candidates = candidate_views(calibration.rig, board, calibration.covariance.names)
    except DegenerateGeometryError as error:
        return ViewPlan(requirement, np.nan, (), False, str(error))
    except SceneError:
        return ViewPlan(requirement, np.nan, (), False, "this board cannot be shown whole to both cameras")
    matrix = calibration.stated_covariance.matrix
    before = COVERAGE * float(sensitivity.sigmas(matrix).max(initial=0.0))
    if not len(sensitivity.gradients):
        return ViewPlan(requirement, np.nan, (), False, "the cameras see nothing together at that range")
    wanted = n_views if n_views is not None else max_views
    factor = max(calibration.provenance.get("views_in_common", {}).get("sigma_factor", 1.0), 1.0)
    weight = 1 / (calibration.noise_px * factor) ** 2
    design = _Design.of(candidates, matrix, sensitivity, weight)
    chosen = design.chosen_one_by_one(wanted)
    limits = [requirement.limit / (1 + guard_share(calibration, i + 1)) for i in range(len(chosen))]
    if n_views is None:
        chosen = chosen[: _n_worthwhile(before, design.figures(chosen), limits)]
    chosen = design.exchanged(chosen)
    figures = design.figures(chosen)
    if n_views is None:
        n = _n_worthwhile(before, figures, limits)
        chosen, figures = chosen[:n], figures[:n]
    is_enough = bool(chosen) and figures[-1] <= limits[len(chosen) - 1]
    kept = [_described(calibration, board, design.poses[i], figure) for i, figure in zip(chosen, figures, strict=True)]
    floor = COVERAGE * float(np.sqrt(sensitivity.floor.max(initial=0.0)))
    why = ""
    if not is_enough and floor > requirement.limit:
        why = f"{requirement.shown(floor)} is not the calibration's: matching and the size of the board's print"
    elif not is_enough:
        why = "no more views of this board help enough; take sharper images, a larger board, or one nearer to the need's range"
    return ViewPlan(requirement, before, tuple(kept), is_enough, why)


@dataclass(frozen=True, slots=True, eq=False)
class _Design:
    """What is known before, what every candidate adds, and the figure's forms, all with parameters of unit variance before."""

    known: Float[ndarray, "p p"]
    views: Float[ndarray, "k p p"]
    forms: Float[ndarray, "m p"]
    floor: Float[ndarray, "m"]
    some: Int[ndarray, "s"]
    """Places that stand for all while views are compared."""
    poses: SE3

    @staticmethod
    def of(
        candidates: CandidateViews, matrix: Float[ndarray, "p p"], sensitivity: Sensitivity, weight: float
    ) -> _Design:
        """``weight`` is the inverse variance of a corner coordinate."""
        scale = np.sqrt(np.diag(matrix))
        scale = np.where(scale > 0, scale, 1.0)
        return _Design(
            _inverse(matrix / np.outer(scale, scale)),
            weight * candidates.information * scale[:, None] * scale,
            sensitivity.gradients * scale,
            sensitivity.floor,
            _telling_places(sensitivity, matrix),
            candidates.T_left_board,
        )

    def figure(self, information: Float[ndarray, "p p"]) -> float:
        """The requirement's figure under an information of the parameters, over all places."""
        return COVERAGE * float(np.sqrt((variance_of(self.forms, np.linalg.inv(information)) + self.floor).max()))

    def best_beside(self, information: Float[ndarray, "p p"], is_free: Bool[ndarray, "k"]) -> int:
        """The free candidate after which the worst of some places is best."""
        left = np.flatnonzero(is_free)
        G = self.forms[self.some]
        variance = np.sum((np.linalg.inv(information + self.views[left]) @ G.T).swapaxes(1, 2) * G, axis=2)
        return int(left[np.argmin((variance + self.floor[self.some]).max(axis=1))])

    def is_free(self, chosen: list[int]) -> Bool[ndarray, "k"]:
        """Which candidates may be shown next: none twice, and none that is nearly one of the last."""
        free = np.ones(len(self.views), dtype=bool)
        for index in chosen[-DIFFERENT_VIEWS:]:
            free &= ~_is_alike(self.poses, index)
        free[chosen] = False
        return free

    def chosen_one_by_one(self, n: int) -> list[int]:
        """Each time the view that helps most."""
        chosen: list[int] = []
        information = self.known
        while len(chosen) < n and (free := self.is_free(chosen)).any():
            chosen.append(self.best_beside(information, free))
            information = information + self.views[chosen[-1]]
        return chosen

    def exchanged(self, chosen: list[int]) -> list[int]:
        """The choice with each view in turn exchanged for a better one; then in the order in which they help."""
        chosen = list(chosen)
        for _ in range(EXCHANGES if len(chosen) <= MOST_EXCHANGED else 0):
            for place in range(len(chosen)):
                others = chosen[:place] + chosen[place + 1 :]
                information = self.known + self.views[others].sum(axis=0)
                other = self.best_beside(information, self.is_free(others))
                if self.figure(information + self.views[other]) < self.figure(information + self.views[chosen[place]]):
                    chosen[place] = other
        ordered: list[int] = []
        information = self.known
        while len(ordered) < len(chosen):
            free = np.zeros(len(self.views), dtype=bool)
            free[[index for index in chosen if index not in ordered]] = True
            ordered.append(self.best_beside(information, free))
            information = information + self.views[ordered[-1]]
        return ordered

    def figures(self, chosen: list[int]) -> list[float]:
        """The figure after each of the chosen views."""
        return [self.figure(self.known + self.views[chosen[: i + 1]].sum(axis=0)) for i in range(len(chosen))]


def _n_worthwhile(before: float, figures: list[float], limits: list[float]) -> int:
    """How many views until the figure is below its limit, or a view lowers it by next to nothing."""
    for i, (figure, limit) in enumerate(zip(figures, limits, strict=False)):
        if figure <= limit:
            return i + 1
        if not figure < (1 - WORTHWHILE) * (figures[i - 1] if i else before):
            return i
    return len(figures)


def _telling_places(sensitivity: Sensitivity, matrix: Float[ndarray, "p p"]) -> Int[ndarray, "k"]:
    """Places that stand for all while views are compared: the worst now, and some of the others, which may be worst later."""
    order = np.argsort(-sensitivity.sigmas(matrix))
    return np.unique(np.r_[order[:MOST_PLACES], order[MOST_PLACES :: max(len(order) // MOST_PLACES, 1)]])


def _is_alike(poses: SE3, chosen: int) -> Bool[ndarray, "k"]:
    """Which poses a person could hardly tell from the chosen one: place, distance and tilt."""
    ray = poses.t / np.linalg.norm(poses.t, axis=-1, keepdims=True)
    along = np.arccos(np.clip(ray @ ray[chosen], -1, 1))
    turned = np.arccos(np.clip(np.abs(poses.R[:, :, 2] @ poses.R[chosen, :, 2]), 0, 1))
    nearer = np.abs(np.log(np.linalg.norm(poses.t, axis=-1) / np.linalg.norm(poses.t[chosen])))
    return (along < ALIKE_RAD) & (turned < 2 * ALIKE_RAD) & (nearer < 0.2)


def _inverse(matrix: Float[ndarray, "p p"]) -> Float[ndarray, "p p"]:
    """Information of a covariance; directions that it has none of are held."""
    values, vectors = np.linalg.eigh(matrix)
    floor = 1e-14 * values[-1]
    return (vectors / np.maximum(values, floor)) @ vectors.T


def _described(calibration: StereoCalibration, board: Board, T: SE3, figure: float) -> PlannedView:
    points = board.object_points_m
    middle = T.apply((points.min(axis=0) + points.max(axis=0))[None] / 2)[0]
    x, y = calibration.rig.left.project(middle[None])[0].tolist()
    normal = T.R[:, 2] if T.R[2, 2] > 0 else -T.R[:, 2]
    tilt_deg = float(np.degrees(np.arccos(np.clip(normal[2], -1, 1))))
    # the farther side lies where the plane's depth grows: along -(nx, ny) in the image
    right, down = -normal[0], -normal[1]
    words = []
    if abs(down) > 0.4 * np.hypot(right, down):
        words.append("bottom" if down > 0 else "top")
    if abs(right) > 0.4 * np.hypot(right, down):
        words.append("right" if right > 0 else "left")
    return PlannedView(T, (x, y), float(np.linalg.norm(middle)), tilt_deg, " ".join(words), figure)
