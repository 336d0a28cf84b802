"""``binocal report``: a calibration as one page, with everything that says whether its depth will be right."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from binocal.app.corners import find_corners
from binocal.app.needs import NeedReport, judge_calibration
from binocal.app.report_images import report_images, require_same_images
from binocal.app.uncertainty import tell_uncertainty
from binocal.boards import Board, parse_board
from binocal.errors import BinocalError, DataError
from binocal.evidence import Detections
from binocal.findings import Finding, finding
from binocal.formats.detections_npz import is_detections_file, read_detections
from binocal.formats.rig_json import read_calibration, require_calibration
from binocal.images import CHANNELS
from binocal.images.preprocessing import Preparation
from binocal.output import check_output, write_together
from binocal.planning import ViewPlan, plan_views
from binocal.progress import ProgressCallback
from binocal.report.contents import ReportContents
from binocal.report.headline import Headline, headline_of
from binocal.report.page import report_page, require_drawing
from binocal.report.printing import find_browser, page_as_pdf
from binocal.requirements import Requirement, parse_requirement
from binocal.requirements.figures import usual_range
from binocal.result import StereoCalibration
from binocal.uncertainty.depth import MATCHING_PX
from binocal.uncertainty.maps import ProjectionMap, RangeMap, projection_map, range_map
from binocal.validation import overview, validate

NEAREST, FARTHEST = 0.5, 8.0  # times the boards' distance: the ranges that are shown
USUAL_VIEWS = 5  # of the plan where no need was stated
MOST_FILES_TRIED = 20  # beside the rig, for the corners that it was made from
NO_CORNERS = (
    "coverage, residuals and checks need the corners of the calibration, and none were given: name them with --evidence "
    "(`binocal calibrate --evidence` keeps them), or give the images with --left and --right"
)


@dataclass(frozen=True, slots=True)
class ReportRequest:
    """What the report is made from, besides the rig.

    ``evidence`` are the corners that ``binocal calibrate --evidence`` kept; without them, a file of corners that lies beside the rig
    and is of it is used, and without that, the board is found again in the images, ``left`` and ``right``, which are shown. ``board``
    is by default the one that the rig names.
    """

    evidence: Path | None = None
    left: str | None = None
    right: str | None = None
    board: Board | None = None
    requirements: tuple[Requirement, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ReportRun:
    """The page, the verdict, and how the needs stand."""

    page: str
    headline: Headline
    needs: NeedReport
    notes: tuple[str, ...] = ()


def write_report(
    rig: Path,
    output: Path,
    request: ReportRequest | None = None,
    *,
    pdf: Path | None = None,
    force: bool = False,
    progress: ProgressCallback | None = None,
) -> ReportRun:
    """Make the report of a ``rig.json`` and write it, printed as ``pdf`` too where that is named.

    Raises:
        FormatError: The rig or the corners cannot be read.
        DataError: The corners or images are not those of this rig, a need is in another unit, no browser is there to print a PDF, or
            the output cannot be written.
        MissingExtraError: Jinja or Matplotlib is not installed.
    """
    require_drawing()
    browser = "" if pdf is None else find_browser()
    for path in (output, pdf):
        if path is not None:
            check_output(path, force=force)
    require_calibration(rig, "a report")
    run = make_report(read_calibration(rig), rig, request, progress=progress)
    contents: dict[str | Path, str | bytes] = {output: run.page}
    if pdf is not None:
        contents[pdf] = page_as_pdf(run.page, browser)
    write_together(contents, force=force)
    return run


def make_report(
    calibration: StereoCalibration,
    rig: Path,
    request: ReportRequest | None = None,
    *,
    progress: ProgressCallback | None = None,
) -> ReportRun:
    """The report of a calibration that was read from ``rig``. Raises as :func:`write_report`."""
    request = request or ReportRequest()
    board = request.board or _board_of(calibration)
    calibration, detections, notes = _with_corners(calibration, rig, request, board, progress)
    needs = judge_calibration(calibration, request.requirements, board)
    validation = validate(calibration)
    at_boards, ranges, projection, more = _uncertainty(calibration)
    checks = overview(calibration, validation)
    images, rectified = (), None
    if request.left is not None and request.right is not None:
        images, rectified, said = report_images(calibration, request.left, request.right, progress)
        more = (*more, *said)
    contents = ReportContents(
        name=rig.name,
        calibration=calibration,
        checks=checks if calibration.evidence is not None else (),
        validation=validation,
        verdicts=needs.verdicts,
        plans=needs.plans or _usual_plan(calibration, request, board),
        detections=detections,
        ranges=ranges,
        at_boards=at_boards,
        projection=projection,
        matching_px=MATCHING_PX,
        notes=(*notes, *more),
        commands=_commands(calibration, rig, request),
        board=board,
        images=images,
        rectified=rectified,
    )
    headline = headline_of(calibration, contents.findings, needs.verdicts, at_boards)
    return ReportRun(report_page(contents, headline), headline, needs, contents.notes)


def _board_of(calibration: StereoCalibration) -> Board | None:
    """The board that the rig's file names; None where it names none that is known."""
    spec = calibration.provenance.get("board")
    with contextlib.suppress(ValueError):
        return parse_board(str(spec)) if spec else None
    return None


def _with_corners(
    calibration: StereoCalibration,
    rig: Path,
    request: ReportRequest,
    board: Board | None,
    progress: ProgressCallback | None,
) -> tuple[StereoCalibration, Detections | None, tuple[str, ...]]:
    """The calibration with the corners it was made from, all corners as detected, and what is to be said of them."""
    if request.evidence is not None:
        detections = read_detections(request.evidence)
        calibration = calibration.with_evidence(detections)
        _require_same_images(calibration, request, board)
        return calibration, detections, ()
    calibration, beside = _corners_beside(calibration, rig)
    if beside is not None:
        _require_same_images(calibration, request, board)
        return calibration, beside, ()
    if request.left is None or request.right is None:
        return calibration, None, (NO_CORNERS,)
    if board is None:
        raise DataError(f"{rig} does not name the board; give it with --board.")
    detections = find_corners(
        request.left, request.right, board, _preparation_of(calibration), progress, None
    ).detections
    return calibration.with_evidence(detections), detections, ()


def _corners_beside(calibration: StereoCalibration, rig: Path) -> tuple[StereoCalibration, Detections | None]:
    """The calibration with the corners in the first file beside the rig that holds its own, and these; None where none does.

    A file that holds the same views but other corners is a finding.
    """
    doubts: list[Finding] = []
    views = {view.name for view in calibration.views}
    for path in sorted(rig.parent.glob("*.npz"))[:MOST_FILES_TRIED]:
        with contextlib.suppress(BinocalError, ValueError):
            if not is_detections_file(path):
                continue
            detections = read_detections(path)
            try:
                return calibration.with_evidence(detections), detections
            except DataError as error:
                if calibration.T_left_board is not None and views and views <= set(detections.names):
                    doubts.append(finding("corners-not-of-rig", path=path.name, why=str(error).rstrip(".")))
    return replace(calibration, findings=(*calibration.findings, *doubts[:1])), None


def _preparation_of(calibration: StereoCalibration) -> Preparation:
    """How the images were prepared before the board was looked for."""
    made = calibration.provenance
    channel = made.get("channel")
    return Preparation(channel if channel in CHANNELS else "grey", made.get("preprocess") is True)


def _require_same_images(calibration: StereoCalibration, request: ReportRequest, board: Board | None) -> None:
    """Images beside a file of corners are those that the corners were found in, as far as the board is known."""
    if request.left is not None and request.right is not None and board is not None:
        require_same_images(calibration, request.left, request.right, board, _preparation_of(calibration))


def _uncertainty(
    calibration: StereoCalibration,
) -> tuple[RangeMap | None, tuple[RangeMap, ...], tuple[ProjectionMap, ...], tuple[str, ...]]:
    """Depth at the boards' distance and over a span of ranges, projection of both cameras; and what could not be told."""
    range_m = usual_range(calibration)
    if not np.isfinite(range_m):
        return None, (), (), ("no depth error over range: the file does not say where the boards were",)
    try:
        run = tell_uncertainty(calibration, NEAREST * range_m, FARTHEST * range_m, matching_px=MATCHING_PX)
    except DataError as error:
        return None, (), (), (str(error).rstrip("."),)
    at_boards = range_map(
        calibration.rig,
        calibration.stated_covariance,
        range_m,
        matching_px=MATCHING_PX,
        board_scale_sigma=calibration.board_scale_sigma,
    )
    projection: tuple[ProjectionMap, ...] = ()
    if calibration.mean_board_pose is not None:
        projection = tuple(
            projection_map(calibration.rig, calibration.stated_covariance, calibration.mean_board_pose, side, range_m)
            for side in ("left", "right")
        )
    return at_boards, run.ranges, projection, run.notes


def _usual_plan(calibration: StereoCalibration, request: ReportRequest, board: Board | None) -> tuple[ViewPlan, ...]:
    """Where no need was stated: the few views that lower depth's error at the boards' distance fastest."""
    range_m = usual_range(calibration)
    if request.requirements or board is None or not np.isfinite(range_m) or not calibration.covariance.names:
        return ()
    need = parse_requirement(f"depth 1% at {range_m:.3g}{'m' if calibration.rig.is_metric else ''}")
    with contextlib.suppress(BinocalError):
        return (plan_views(calibration, board, need, n_views=USUAL_VIEWS),)
    return ()


def _commands(calibration: StereoCalibration, rig: Path, request: ReportRequest) -> tuple[str, ...]:
    """The commands that make the rig and the report again, as far as they are known."""
    spec = calibration.provenance.get("board")
    lines = []
    if spec:
        calibrator = calibration.provenance.get("calibrator", "drl")
        lines.append(
            f"binocal calibrate --left 'LEFT*' --right 'RIGHT*' --board {spec} --calibrator {calibrator} --output {rig.name} "
            f"--evidence corners.npz{_preparation_options(calibration)}"
        )
    needs = "".join(f" --require '{need.text}'" for need in request.requirements)
    return (*lines, f"binocal report {rig.name} --evidence corners.npz{needs}")


def _preparation_options(calibration: StereoCalibration) -> str:
    made = calibration.provenance
    channel = made.get("channel", "grey")
    return ("" if channel == "grey" else f" --channel {channel}") + (" --preprocess" if made.get("preprocess") else "")
