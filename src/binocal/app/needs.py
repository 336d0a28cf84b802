"""A rig against requirements: verdicts, and for what is not met the views that would help most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from binocal.boards import Board, BoardSet
from binocal.cameras import StereoRig
from binocal.evidence import Detections
from binocal.metrics.image import PixelError
from binocal.planning import ViewPlan, plan_views
from binocal.requirements import Figure, Outcome, Requirement, Verdict, decide, figure_of_calibration
from binocal.requirements.agreement import Agreement
from binocal.requirements.measured import reprojection_figure, row_figure, shifted_figure, true_figure
from binocal.result import StereoCalibration

UNSTATED = "the rig's file states no standard deviations; give the rig.json of its calibration"


@dataclass(frozen=True, slots=True, eq=False)
class NeedReport:
    """Verdicts in the order of the requirements, and a plan for each that is not passed and that views could help."""

    verdicts: tuple[Verdict, ...] = ()
    plans: tuple[ViewPlan, ...] = ()

    @property
    def is_met(self) -> bool:
        """Whether all requirements are passed; undecided ones are not."""
        return all(verdict.outcome is Outcome.PASS for verdict in self.verdicts)


def judge_calibration(
    calibration: StereoCalibration, requirements: Sequence[Requirement], board: Board | BoardSet | None
) -> NeedReport:
    """A calibration against requirements by what it states of itself; plans for ``board``, none without.

    Raises:
        DataError: A requirement is in metres and the rig in board pitches, or the other way round.
    """
    verdicts = tuple(decide(need, figure_of_calibration(calibration, need)) for need in requirements)
    return NeedReport(verdicts, _plans(calibration, verdicts, board))


def judge_on_images(
    rig: StereoRig,
    calibration: StereoCalibration | None,
    requirements: Sequence[Requirement],
    seen: tuple[Detections, PixelError],
    agreement: Agreement | None,
    board: Board | BoardSet,
) -> NeedReport:
    """A rig against requirements on images that it has not seen: rows and reprojection as measured, the rest by its own covariance.

    Where the images do not agree with the rig (``agreement``), the
    difference that they show is the error, if it is larger. Without a calibration, what needs its covariance is undecided.
    """
    detections, pixel_error = seen
    has_drifted = agreement is not None and not agreement.agrees

    def figure(need: Requirement) -> Figure:
        if need.quantity == "reprojection":
            return reprojection_figure(pixel_error, detections.names)
        if need.quantity == "row":
            return row_figure(rig, detections)
        if calibration is None:
            return Figure(float("nan"), float("nan"), need.quantity, why=UNSTATED)
        stated = figure_of_calibration(calibration, need)
        if agreement is None or not has_drifted:
            return stated
        if agreement.is_gross and agreement.cause is None:
            return Figure(
                float("nan"), float("nan"), need.quantity, why="the rig does not fit these images", is_impossible=True
            )
        shown = shifted_figure(calibration, need, agreement.names, agreement.shift, agreement.shift_covariance)
        return shown if shown.value > stated.value else stated

    verdicts = tuple(decide(need, figure(need)) for need in requirements)
    plans = () if calibration is None or has_drifted else _plans(calibration, verdicts, board)
    return NeedReport(verdicts, plans)


def judge_against_truth(
    calibration: StereoCalibration, truth: StereoRig, requirements: Sequence[Requirement]
) -> NeedReport:
    """A calibration against requirements by its true errors."""
    return NeedReport(tuple(decide(need, true_figure(calibration, truth, need)) for need in requirements))


def _plans(
    calibration: StereoCalibration, verdicts: Sequence[Verdict], board: Board | BoardSet | None
) -> tuple[ViewPlan, ...]:
    board = board.boards[0] if isinstance(board, BoardSet) else board
    if board is None:
        return ()
    open_ones = [v for v in verdicts if v.outcome is not Outcome.PASS and not v.figure.is_impossible]
    told = [v for v in open_ones if v.figure.value > 0 and v.requirement.quantity != "reprojection"]
    return tuple(plan_views(calibration, board, v.requirement) for v in told)
