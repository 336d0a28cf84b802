"""``binocal calibrate``: from images of a board to a rig."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from binocal.app.corners import explained, find_corners
from binocal.app.measured import checked_board, scale_as_measured
from binocal.boards import Board, BoardSet, parse_board
from binocal.calibrators.base import MIN_VIEWS, CalibrationRequest
from binocal.errors import DataError
from binocal.evidence import Detections
from binocal.result import BoardShape, StereoCalibration
from binocal.validation.overview import CheckLine

SAME_BOARD_SHARE = 0.05  # of the board's size; prints are off by 1 %, bows by 2 %
_OF_ONE_BOARD = (
    "the images are of several boards: what was measured of one board does not hold for the others; leave it out."
)


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationRun:
    """A calibration from images: the result, and what became of every file.

    ``ignored`` holds (path, reason) of files left out of the pairing; ``notes`` are remarks that need no action.
    """

    calibration: StereoCalibration
    detections: Detections | None
    """All corners as detected, those of rejected views too; None where the evidence is of another kind."""
    ignored: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    elapsed_s: Mapping[str, float] = field(default_factory=dict)
    checks: tuple[CheckLine, ...] = ()
    """The calibration put to the test on its own corners, in ten lines; empty where that was not asked for."""


def with_checks(run: CalibrationRun, request: CalibrationRequest | None = None) -> CalibrationRun:
    """The run with its calibration put to the test; what is found wrong joins the calibration's findings, the gravest first.

    Raises:
        CancelledError: ``request.should_stop`` returned True.
    """
    from binocal.validation import overview, validate

    started = time.perf_counter()
    report = validate(run.calibration, request)
    calibration = replace(run.calibration, findings=(*run.calibration.findings, *report.warnings))
    return replace(
        run,
        calibration=calibration,
        checks=overview(calibration, report),
        elapsed_s={**run.elapsed_s, "checks": time.perf_counter() - started},
    )


def calibrate_images(
    left: str,
    right: str,
    board: Board | BoardSet,
    request: CalibrationRequest | None = None,
    *,
    calibrator: str = "drl",
    preprocess: bool = False,
    channel: str = "grey",
    measured_board: BoardShape | None = None,
    measured_m: tuple[float, float] | None = None,
) -> CalibrationRun:
    """Calibrate from the images that two globs or folders name; ``preprocess`` strengthens their edges first.

    Images may show several boards, of one SPEC or of the :class:`binocal.BoardSet`: each is a view of its own, so that one pair may do.

    ``channel`` is that of colour images whose corners are measured: grey, red, green or blue.

    With ``measured_board``, the shape that an earlier calibration found of this very board, its points take the drawing's place.
    ``measured_m`` are the board's two distances by the ruler (:mod:`binocal.boards.measured`), metres.

    Raises:
        DataError: The images cannot be used, the measured board is another one, or a distance is far from what the board has.
        CalibrationError: No trustworthy rig follows from them.
        CancelledError: ``request.should_stop`` returned True.
    """
    from binocal.images.preprocessing import Preparation

    request = request or CalibrationRequest()
    boards = board if isinstance(board, BoardSet) else BoardSet((board,))
    as_drawn = boards.boards[0]
    if len(boards.boards) > 1 and (measured_board is not None or measured_m is not None):
        raise DataError(_OF_ONE_BOARD)
    if measured_m is not None:
        boards = BoardSet((checked_board(as_drawn, measured_m)[0],))
    started = time.perf_counter()
    preparation = Preparation(channel, preprocess)
    with ThreadPoolExecutor(1) as aside:
        # What the solver needs is loaded while the first images are, of which one core is enough.
        loading = aside.submit(_load_calibrator, calibrator)
        found = find_corners(
            left, right, boards, preparation, request.progress, request.should_stop, least_pairs=MIN_VIEWS
        )
        calibrate = loading.result()
    detections = replace(found.detections, board_spec=boards.spec)
    if detections.shots is not None and (measured_board is not None or measured_m is not None):
        raise DataError(_OF_ONE_BOARD)
    if measured_board is not None:
        detections = _on_measured_board(detections, measured_board)
    measured: dict[str, Any] = {}
    if measured_m is not None:
        detections, measured = scale_as_measured(detections, as_drawn, measured_m)
    detected = time.perf_counter()
    inputs = {
        "opencv": _opencv_version(),
        "board": detections.board_spec,
        "preprocess": preprocess,
        "channel": channel,
        "input_sha256": dict(found.input_sha256),
        **measured,
    }
    with explained(found.ignored, found.rejected, found.notes):
        calibration = calibrate(detections, request, calibrator=calibrator, inputs=inputs)
    solved = time.perf_counter()
    calibration = replace(calibration, rejected=found.rejected + calibration.rejected)
    choice = calibration.provenance.get("view_choice")
    notes = (*found.notes, f"{choice['reason']}.") if choice else found.notes
    elapsed_s = {"images": detected - started, "solve": solved - detected, "all": time.perf_counter() - started}
    return CalibrationRun(calibration, detections, found.ignored, notes, elapsed_s)


def calibrate_corners(
    path: str | Path,
    request: CalibrationRequest | None = None,
    *,
    calibrator: str = "drl",
    measured_m: tuple[float, float] | None = None,
) -> CalibrationRun:
    """Calibrate from a file of corners: detections, as ``--evidence`` writes them, or rectangles that turning cameras saw.

    ``measured_m`` are the board's two distances by the ruler, metres; they take the place of those that the file was written with.

    Raises:
        FormatError: The file is missing, damaged or foreign.
        DataError: It holds another kind of evidence than the calibrator works from, or a distance is far from what the board has.
        CalibrationError: No trustworthy rig follows from it.
    """
    from binocal.calibrators import calibrate_as_requested
    from binocal.calibrators.registry import evidence_of
    from binocal.formats.detections_npz import is_detections_file, read_detections
    from binocal.formats.rectangles_npz import read_rectangles

    started = time.perf_counter()
    kind = evidence_of(calibrator)
    is_board = is_detections_file(path)
    if is_board and kind != "board":
        raise DataError(f"{path} holds corners of a board; calibrator {calibrator!r} works from {kind}.")
    evidence: Any = read_detections(path) if is_board else read_rectangles(path)
    if not is_board and kind != "rectangles":
        raise DataError(f"{path} holds rectangles of turning cameras; calibrator {calibrator!r} works from a {kind}.")
    measured: dict[str, Any] = {}
    if measured_m is not None:
        if not is_board or evidence.board_spec is None:
            raise DataError(f"{path} does not say which board its corners are of: --measured needs the board's SPEC.")
        if evidence.shots is not None:
            raise DataError(_OF_ONE_BOARD)
        evidence, measured = scale_as_measured(evidence, parse_board(evidence.board_spec), measured_m)
    loaded = time.perf_counter()
    inputs = {"input_sha256": {"corners": hashlib.sha256(Path(path).read_bytes()).hexdigest()}, **measured}
    calibration = calibrate_as_requested(
        evidence, request or CalibrationRequest(), calibrator=calibrator, inputs=inputs
    )
    solved = time.perf_counter()
    elapsed_s = {"images": loaded - started, "solve": solved - loaded, "all": solved - started}
    return CalibrationRun(calibration, evidence if is_board else None, elapsed_s=elapsed_s)


def _on_measured_board(detections: Detections, shape: BoardShape) -> Detections:
    """The detections of a board whose points were measured before."""
    drawn, measured = detections.object_points_m, shape.points_m
    if len(drawn) != len(measured):
        raise DataError(
            f"the measured board has {len(measured)} points, the board given {len(drawn)}: they are not the same."
        )
    size = float(np.ptp(drawn, axis=0).max())
    away = float(np.linalg.norm(measured - drawn, axis=1).max())
    if away > SAME_BOARD_SHARE * size:
        raise DataError(
            f"the measured board is another one: a point lies {100 * away / size:.0f} % of the board's size from where the board "
            "given has it; give the SPEC of the board that was measured."
        )
    return replace(detections, object_points_m=measured)


def _load_calibrator(name: str) -> Callable[..., StereoCalibration]:
    """The calibrating function, with the method's own modules in memory."""
    from binocal.calibrators import CALIBRATORS, calibrate_as_requested

    if name in CALIBRATORS:
        CALIBRATORS[name]()
    return calibrate_as_requested


def _opencv_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    for package in (
        "opencv-python-headless",
        "opencv-python",
        "opencv-contrib-python-headless",
        "opencv-contrib-python",
    ):
        with contextlib.suppress(PackageNotFoundError):
            return version(package)
    return "unknown"
