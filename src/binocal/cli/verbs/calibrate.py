"""The verb ``calibrate``: from images of a board, or corners, to a rig."""

from __future__ import annotations

import enum
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from binocal.cli.arguments import (
    check_calibrator,
    check_distinct,
    only_board,
    parse_boards,
    parse_measured,
    parse_needs,
)
from binocal.cli.exits import BELOW_QUALITY, FINE
from binocal.cli.options import Boards, Force, Json, Measured, Needs, Seed, Threads, app, finite, present
from binocal.errors import CalibrationError, DataError, FormatError

if TYPE_CHECKING:
    from binocal.app import CalibrationRequest, CalibrationRun
    from binocal.boards import Board, BoardSet
    from binocal.solvers.prior import RigPrior


class Model(enum.StrEnum):
    """Camera models; a test holds them equal to the registry, which is too heavy to import here."""

    auto = "auto"
    brown4 = "brown4"
    brown5 = "brown5"
    brown8 = "brown8"
    fisheye4 = "fisheye4"


class BoardShapes(enum.StrEnum):
    """What the board may be; those of :data:`binocal.calibrators.base.BoardShapeChoice`."""

    auto = "auto"
    flat = "flat"
    warp = "warp"
    free = "free"


class Exposures(enum.StrEnum):
    """When the cameras saw a view; those of :data:`binocal.calibrators.base.ExposureChoice`."""

    auto = "auto"
    together = "together"
    apart = "apart"


class Channels(enum.StrEnum):
    """Whose levels corners are measured in; those of :data:`binocal.images.CHANNELS`."""

    grey = "grey"
    red = "red"
    green = "green"
    blue = "blue"


MODELS = "|".join(Model)


@app.command()
def calibrate(
    left: Annotated[
        str | None, typer.Option("--left", help="Left images: a glob in quotes, or a folder.", metavar="GLOB")
    ] = None,
    right: Annotated[
        str | None, typer.Option("--right", help="Right images, paired with the left by name.", metavar="GLOB")
    ] = None,
    board: Boards = None,
    corners: Annotated[
        Path | None,
        typer.Option(
            "--corners",
            help="In place of images: corners that --evidence wrote, or rectangles that turning cameras saw.",
            metavar="CORNERS.NPZ",
        ),
    ] = None,
    zoom: Annotated[
        Path | None,
        typer.Option(
            "--zoom",
            help="In place of --left and --right: images at several zoom settings, in a CSV file of setting,left,right.",
            metavar="SETTINGS.CSV",
        ),
    ] = None,
    at: Annotated[
        float | None,
        typer.Option("--at", help="The zoom setting of the rig (default: the middle).", metavar="X", callback=finite),
    ] = None,
    output: Annotated[Path, typer.Option("--output", help="Where the rig goes.", metavar="RIG.JSON")] = Path(
        "rig.json"
    ),
    evidence: Annotated[
        Path | None,
        typer.Option(
            "--evidence",
            help="Also write all corners as detected: from them and the rig every later step runs without the images.",
            metavar="CORNERS.NPZ",
        ),
    ] = None,
    calibrator: Annotated[
        str,
        typer.Option(
            "--calibrator",
            help="drl, drl-increments, lm, from-guess, opencv, alternating, absolute-orientation, heterogeneous, wide-field, "
            "rectangles, zoom, weights that train wrote, or what another package adds.",
            metavar="NAME",
        ),
    ] = "drl",
    model: Annotated[
        Model, typer.Option("--model", help="Camera model; auto picks by held-out error.", metavar=MODELS)
    ] = Model.auto,
    board_shape: Annotated[
        BoardShapes,
        typer.Option(
            "--board-shape",
            help="flat: as drawn; warp: bowed, stretched, sheared; free: any; auto: what the views say.",
            metavar="SHAPE",
        ),
    ] = BoardShapes.auto,
    board_file: Annotated[
        Path | None,
        typer.Option(
            "--board-file",
            help="A rig.json, or corners of --evidence, whose calibration measured this very board: its points are used, "
            "not the drawing's.",
            metavar="FILE",
        ),
    ] = None,
    measured: Measured = None,
    exposure: Annotated[
        Exposures,
        typer.Option(
            "--exposure",
            help="Whether both cameras saw each view at one moment: together, apart, or auto, what the views say.",
            metavar="WHEN",
        ),
    ] = Exposures.auto,
    skew: Annotated[bool, typer.Option("--skew", help="Estimate the skew of both cameras.")] = False,
    prior: Annotated[
        Path | None,
        typer.Option(
            "--prior",
            help="An earlier calibration of the rig, which counts along with its covariance.",
            metavar="RIG.JSON",
        ),
    ] = None,
    hold: Annotated[
        str | None,
        typer.Option(
            "--hold",
            help="What of the prior is exact: left,right (known intrinsics), rotation, translation, left.fx, ...",
            metavar="NAMES",
        ),
    ] = None,
    preprocess: Annotated[
        bool, typer.Option("--preprocess", help="Filter the images and strengthen their edges first.")
    ] = False,
    channel: Annotated[
        Channels,
        typer.Option(
            "--channel",
            help="Of colour images: measure corners in one colour's own levels.",
            metavar="|".join(Channels),
        ),
    ] = Channels.grey,
    max_views: Annotated[
        int | None,
        typer.Option(
            "--max-views",
            help="Use at most N views, those that determine depth best, and say what that costs.",
            metavar="N",
            min=3,
        ),
    ] = None,
    seed: Seed = 0,
    max_rms: Annotated[
        float | None,
        typer.Option("--max-rms", help="Exit with 4 if the RMS is above.", metavar="PX", min=0.0, callback=finite),
    ] = None,
    require: Needs = None,
    checks: Annotated[
        bool,
        typer.Option(
            "--checks/--no-checks",
            help="Put the rig to the test on its own corners: two halves of the views, a freer lens, the residuals.",
        ),
    ] = True,
    opencv: Annotated[
        Path | None,
        typer.Option("--opencv", help="Also write OpenCV YAML: a .yml file, or a folder for two.", metavar="PATH"),
    ] = None,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Calibrate a stereo rig from images of a board, or from corners in a file."""
    from binocal import app as verbs
    from binocal.calibrators import CALIBRATORS, load_calibrator
    from binocal.calibrators.registry import evidence_of, unsuited
    from binocal.cli import documents, tables
    from binocal.cli.checks import checks_document, show_checks
    from binocal.cli.progress import progress_on_terminal
    from binocal.formats.board_file import read_measured_board
    from binocal.formats.opencv_yaml import check_opencv_output
    from binocal.output import check_output

    parsed = _parse_source((left, right), board, corners, zoom)
    parsed, measured_m = parse_measured(measured, parsed)
    needs = parse_needs(require, is_metric=None if parsed is None else parsed.is_metric)
    check_calibrator(calibrator, CALIBRATORS, load_calibrator)
    kind = evidence_of(calibrator)
    if kind == "rectangles" and corners is None:
        raise typer.BadParameter(f"calibrator {calibrator!r} works from rectangles in a file: give --corners FILE.")
    if (kind == "zoom") != (zoom is not None):
        raise typer.BadParameter("--calibrator zoom and --zoom SETTINGS.CSV belong together.")
    if at is not None and zoom is None:
        raise typer.BadParameter("--at is a setting of --zoom.")
    if board_file is not None and zoom is not None:
        raise typer.BadParameter("--board-file does not go with --zoom.")
    if measured is not None and (zoom is not None or board_file is not None or kind != "board"):
        raise typer.BadParameter(
            "--measured is of a board as drawn; leave it out, or --zoom, --board-file, --calibrator."
        )
    if corners is not None and (preprocess or channel is not Channels.grey or board_file is not None):
        text = "--preprocess, --channel and --board-file belong to images; leave them out, or --corners."
        raise typer.BadParameter(text)
    if evidence is not None and kind != "board":
        raise typer.BadParameter("--evidence keeps corners of a board; leave it out.")
    if opencv is not None and skew:
        raise typer.BadParameter("OpenCV's functions ignore skew; leave out --skew or --opencv.")
    outputs = {"--output": [output], "--evidence": [] if evidence is None else [evidence]}
    for path in (output, *outputs["--evidence"]):
        check_output(path, force=force)
        _refuse_input_as_output(path, *(str(source) for source in (left, right, corners, zoom) if source is not None))
    outputs["--opencv"] = [] if opencv is None else check_opencv_output(opencv, force=force)
    check_distinct(outputs)
    known = _read_prior(prior, hold, model.value)
    measured_board = None if board_file is None else read_measured_board(board_file)
    request = verbs.CalibrationRequest(
        model.value, skew, seed, max_views, prior=known, board_shape=board_shape.value, exposure=exposure.value
    )
    if why := unsuited(calibrator, request):
        raise typer.BadParameter(f"{why}.")
    with progress_on_terminal() as progress:
        request = replace(request, progress=progress)
        if corners is not None or parsed is None:
            assert corners is not None  # there is no other source without a board
            run = verbs.calibrate_corners(corners, request, calibrator=calibrator, measured_m=measured_m)
        elif zoom is not None:
            run = _calibrate_zoom(zoom, parsed, request, at, preprocess, channel.value)
        else:
            run = verbs.calibrate_images(
                *(str(left), str(right), parsed, request),
                calibrator=calibrator,
                preprocess=preprocess,
                channel=channel.value,
                measured_board=measured_board,
                measured_m=measured_m,
            )
        run = verbs.with_checks(run, request) if checks else run
    tables.list_left_out(run.ignored, run.calibration.rejected, run.notes)
    _write_calibration(run, output, evidence, opencv, force)
    is_good = max_rms is None or run.calibration.rms.all_px <= max_rms
    document = documents.calibration_run_document(run, output, max_rms)
    if evidence is not None:
        document["evidence"] = str(evidence)
    beside = [path for path in (evidence, opencv) if path is not None]
    text = tables.calibration_text(run, output, beside, max_rms)
    if needs:
        from binocal.app.needs import judge_calibration
        from binocal.cli.needs import needs_document, needs_text

        report = judge_calibration(run.calibration, needs, parsed)
        is_good = is_good and report.is_met
        document |= needs_document(report)
        text = "\n".join([*needs_text(report, run.calibration.rig.printed_unit), "", text])
    document["checks"] = checks_document(run.checks)
    present(document, text, json)
    if not json:
        show_checks(run.checks)
    return FINE if is_good else BELOW_QUALITY


def _parse_source(
    images: tuple[str | None, str | None], board: list[str] | None, corners: Path | None, zoom: Path | None
) -> Board | BoardSet | None:
    """The board of the images, or the boards; None where the corners are in a file."""
    left, right = images
    if zoom is not None:
        if (left, right, corners) != (None, None, None) or not board:
            raise typer.BadParameter("--zoom SETTINGS.CSV goes with --board alone: the file names the images.")
        return only_board(parse_boards(board), "--zoom")
    if corners is None:
        for name, given in (("--left", left), ("--right", right), ("--board", board or None)):
            if given is None:
                raise typer.BadParameter(
                    f"missing option {name!r}: give --left, --right and --board, or --corners FILE."
                )
        return parse_boards(board or [])
    if (left, right, board or None) != (None, None, None):
        raise typer.BadParameter("give either --left, --right and --board, or --corners FILE.")
    return None


def _refuse_input_as_output(path: Path, *sources: str) -> None:
    """An output that is one of the images would replace it."""
    if not path.exists():
        return
    import glob

    for source in sources:
        folder = Path(source)
        found = folder.iterdir() if folder.is_dir() else map(Path, glob.iglob(source, recursive=True))
        if any(entry.exists() and entry.samefile(path) for entry in found):
            raise typer.BadParameter(f"{path} is one of the input images; give the output a name of its own.")


def _read_prior(path: Path | None, hold: str | None, model: str) -> RigPrior | None:
    """The prior that ``--prior`` and ``--hold`` name."""
    held = [] if hold is None else [name.strip() for name in hold.split(",")]
    if "" in held:
        raise typer.BadParameter(f"--hold {hold!r} has an empty name; give names with commas between them.")
    if path is None:
        if held:
            raise typer.BadParameter("--hold says what of a prior is exact; name the prior with --prior.")
        return None
    from binocal.formats.rig_json import read_calibration
    from binocal.solvers.prior import RigPrior

    earlier = read_calibration(path)
    if model not in ("auto", earlier.rig.left.model):
        raise typer.BadParameter(f"the prior's cameras are {earlier.rig.left.model}; leave out --model, or name that.")
    try:
        return RigPrior.from_calibration(earlier, held=held)
    except ValueError as error:
        if "covariance" in str(error):  # what the file says, not what was asked for
            raise FormatError(path, f"is no prior: {error}") from None
        raise typer.BadParameter(f"--prior, --hold: {error}.") from None


def _calibrate_zoom(
    zoom: Path, board: Board, request: CalibrationRequest, at: float | None, preprocess: bool, channel: str
) -> CalibrationRun:
    from binocal import app as verbs

    try:
        return verbs.calibrate_zoom_images(zoom, board, request, setting=at, preprocess=preprocess, channel=channel)
    except ValueError as error:
        raise typer.BadParameter(f"--at: {error}.") from None


def _write_calibration(
    run: CalibrationRun, output: Path, evidence: Path | None, opencv: Path | None, force: bool
) -> None:
    """The rig, and what was asked for beside it: all of it, or nothing where the disk is full."""
    from binocal.formats.detections_npz import detections_content
    from binocal.formats.opencv_yaml import opencv_texts
    from binocal.formats.rig_json import calibration_text
    from binocal.output import write_together

    contents: dict[str | Path, Any] = {}
    if evidence is not None and run.detections is not None:
        contents[evidence] = detections_content(run.detections, run.calibration.board_shape)
    refusal = None
    try:
        contents |= {} if opencv is None else opencv_texts(opencv, run.calibration.rig, force=force)
    except (DataError, CalibrationError) as error:  # such as a lens that OpenCV cannot hold: the rig itself is not lost
        refusal = error
    contents[output] = calibration_text(run.calibration)
    write_together(contents, force=force)
    if refusal is not None:
        refusal.add_note(f"note: wrote {' and '.join(str(path) for path in contents)} all the same")
        raise refusal
