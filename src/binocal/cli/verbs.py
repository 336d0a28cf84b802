"""The verbs as typer commands. Each parses, calls :mod:`binocal.app`, presents, and returns an exit code."""

from __future__ import annotations

import enum
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from binocal.cli import rectified_verbs as _rectified_verbs  # noqa: F401 - its verbs are the application's too
from binocal.cli.exits import BELOW_QUALITY, FINE
from binocal.cli.options import BOARD_HELP, Force, Json, Seed, Threads, app, parse_range
from binocal.cli.options import finite as _finite
from binocal.cli.options import present as _present
from binocal.errors import CalibrationError, DataError, FormatError

if TYPE_CHECKING:
    from binocal.app import CalibrationRequest, CalibrationRun
    from binocal.boards import Board
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


MOST_BLUR_PX = 100.0  # of the lens of a simulation; the filter's length grows with it
MODELS = "|".join(Model)
TURNING, ZOOM = "turning", "zoom"

Needs = Annotated[
    list[str] | None,
    typer.Option(
        "--require",
        help="A need, repeatable: 'depth 1% at 5m' (also 'with 0.25px' of matching), 'row 0.1px', 'baseline 0.02%', 'focal 0.05%', "
        "'reprojection 0.3px'. Exit with 4 unless all are proven to be met; what is not gets a plan of views that help.",
        metavar="NEED",
    ),
]


@app.command()
def demo(
    output: Annotated[
        Path, typer.Option("--output", help="Folder for images, rig.json and truth.json.", metavar="DIR")
    ] = Path("binocal-demo"),
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Render the paper's rig with two boards, calibrate it from the images, and compare with the truth."""
    from binocal import app as verbs
    from binocal.cli import documents, tables
    from binocal.cli.progress import progress_on_terminal
    from binocal.output import check_output_folder

    check_output_folder(output, force=force)
    with progress_on_terminal() as progress:
        cases = verbs.demo(output, seed=seed, force=force, progress=progress)
    _present(documents.demo_document(cases), tables.demo_text(cases, output), json)
    return FINE


@app.command()
def calibrate(
    left: Annotated[
        str | None, typer.Option("--left", help="Left images: a glob in quotes, or a folder.", metavar="GLOB")
    ] = None,
    right: Annotated[
        str | None, typer.Option("--right", help="Right images, paired with the left by name.", metavar="GLOB")
    ] = None,
    board: Annotated[str | None, typer.Option("--board", help=BOARD_HELP, metavar="SPEC")] = None,
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
        typer.Option("--at", help="The zoom setting of the rig (default: the middle).", metavar="X", callback=_finite),
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
            help="drl, drl-increments, lm, opencv, alternating, absolute-orientation, heterogeneous, wide-field, rectangles, "
            "zoom, weights that train wrote, or what another package adds.",
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
        typer.Option("--max-rms", help="Exit with 4 if the RMS is above.", metavar="PX", min=0.0, callback=_finite),
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
    from binocal.calibrators.registry import evidence_of, unsuited
    from binocal.cli import documents, tables
    from binocal.cli.checks import checks_document, show_checks
    from binocal.cli.progress import progress_on_terminal
    from binocal.formats.board_file import read_measured_board
    from binocal.formats.opencv_yaml import check_opencv_output
    from binocal.output import check_output

    parsed = _parse_source((left, right), board, corners, zoom)
    needs = _parse_needs(require, is_metric=None if parsed is None else parsed.is_metric)
    _check_calibrator(calibrator)
    kind = evidence_of(calibrator)
    if kind == "rectangles" and corners is None:
        raise typer.BadParameter(f"calibrator {calibrator!r} works from rectangles in a file: give --corners FILE.")
    if (kind == "zoom") != (zoom is not None):
        raise typer.BadParameter("--calibrator zoom and --zoom SETTINGS.CSV belong together.")
    if at is not None and zoom is None:
        raise typer.BadParameter("--at is a setting of --zoom.")
    if board_file is not None and zoom is not None:
        raise typer.BadParameter("--board-file does not go with --zoom.")
    if corners is not None and (preprocess or board_file is not None):
        raise typer.BadParameter("--preprocess and --board-file belong to images; leave them out, or --corners.")
    if evidence is not None and kind != "board":
        raise typer.BadParameter("--evidence keeps corners of a board; leave it out.")
    if opencv is not None and skew:
        raise typer.BadParameter("OpenCV's functions ignore skew; leave out --skew or --opencv.")
    outputs = {"--output": [output], "--evidence": [] if evidence is None else [evidence]}
    for path in (output, *outputs["--evidence"]):
        check_output(path, force=force)
        _refuse_input_as_output(path, *(str(source) for source in (left, right, corners, zoom) if source is not None))
    outputs["--opencv"] = [] if opencv is None else check_opencv_output(opencv, force=force)
    _check_distinct(outputs)
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
            run = verbs.calibrate_corners(corners, request, calibrator=calibrator)
        elif zoom is not None:
            run = _calibrate_zoom(zoom, parsed, request, at, preprocess)
        else:
            run = verbs.calibrate_images(
                *(str(left), str(right), parsed, request),
                calibrator=calibrator,
                preprocess=preprocess,
                measured_board=measured_board,
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
    _present(document, text, json)
    if not json:
        show_checks(run.checks)
    return FINE if is_good else BELOW_QUALITY


@app.command()
def simulate(
    pairs: Annotated[int, typer.Option("--pairs", help="Number of image pairs.", metavar="N", min=1, max=1_000_000)],
    output: Annotated[Path, typer.Option("--output", help="Folder for the images and truth.json.", metavar="DIR")],
    rig: Annotated[
        str,
        typer.Option(
            "--rig",
            help="table2 (the paper's rig), colour-thermal, thermal-180, thermal-210, a rig.json, OpenCV's file; zoom: N pairs at "
            "each of 13 settings; turning: cameras that turn before a rectangle, without --board.",
            metavar="NAME",
        ),
    ] = "table2",
    blur: Annotated[
        float,
        typer.Option(
            "--blur",
            help="Blur of the lens, sigma in pixels.",
            metavar="PX",
            min=0.0,
            max=MOST_BLUR_PX,
            callback=_finite,
        ),
    ] = 0.8,
    noise: Annotated[
        float,
        typer.Option(
            "--noise", help="Sensor noise, grey levels of 255.", metavar="DN", min=0.0, max=255.0, callback=_finite
        ),
    ] = 3.0,
    board: Annotated[str | None, typer.Option("--board", help=BOARD_HELP, metavar="SPEC")] = None,
    scene: Annotated[
        str | None, typer.Option("--scene", help="In place of a board: street or room.", metavar="NAME")
    ] = None,
    gap: Annotated[
        float,
        typer.Option(
            "--gap",
            help="For scenes: the right camera exposes so many milliseconds later.",
            metavar="MS",
            min=-1e4,
            max=1e4,
            callback=_finite,
        ),
    ] = 0.0,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Render images of a board, a street or a room as a rig sees it, with the exact truth beside them."""
    from binocal import app as verbs
    from binocal.cli.progress import progress_on_terminal
    from binocal.formats import rig_json
    from binocal.output import check_output_folder

    if rig == ZOOM:
        return _simulate_zoom(pairs, output, (board, scene), (blur, noise, seed), force, json)
    if rig == TURNING:
        return _simulate_turning(pairs, output, (board, scene), seed, force, json)
    if (board is None) == (scene is None):
        raise typer.BadParameter("give either --board SPEC or --scene street|room.")
    if gap and scene is None:
        raise typer.BadParameter("--gap belongs to --scene: boards stand still.")
    parsed = None if board is None else _parse_board(board)
    if parsed is not None and not parsed.is_metric:
        raise typer.BadParameter("a simulated board needs its size: give the length a unit, such as 20mm.")
    if scene is not None:
        _one_of("--scene", scene, ("street", "room"))
    check_output_folder(output, force=force)
    from binocal.formats.rig_file import load_rig
    from binocal.simulation import SETUPS, Setup

    setup = SETUPS[rig]() if rig in SETUPS else Setup(load_rig(rig))
    options = verbs.SimulateOptions(blur, noise, seed, 1e-3 * gap, setup.light)
    with progress_on_terminal() as progress:
        if parsed is not None:
            truth = verbs.simulate(setup.rig, parsed, pairs, output, options, force=force, progress=progress)
        else:
            truth = verbs.simulate_scene(setup.rig, str(scene), pairs, output, options, force=force, progress=progress)
    text = f"{len(truth.names)} pairs and truth.json in {output}"
    _present(rig_json.truth_document(truth) | {"output": str(output)}, text, json)
    return FINE


def _simulate_zoom(
    pairs: int,
    output: Path,
    shown: tuple[str | None, str | None],
    look: tuple[float, float, int],
    force: bool,
    json: bool,
) -> int:
    """A pair with zoom lenses at several settings."""
    from binocal import app as verbs
    from binocal.cli.progress import progress_on_terminal
    from binocal.output import check_output_folder

    board, scene = shown
    if board is None or scene is not None:
        raise typer.BadParameter(f"--rig {ZOOM} shows a board: give --board SPEC, and no --scene.")
    parsed = _parse_board(board)
    if not parsed.is_metric:
        raise typer.BadParameter("a simulated board needs its size: give the length a unit, such as 20mm.")
    check_output_folder(output, force=force)
    with progress_on_terminal() as progress:
        options = verbs.SimulateOptions(*look)
        settings = verbs.simulate_zoom(parsed, pairs, output, options, force=force, progress=progress)
    text = f"{pairs} pairs at each of {len(settings)} zoom settings and settings.csv in {output}"
    _present({"settings": list(settings), "pairs": pairs, "output": str(output)}, text, json)
    return FINE


def _simulate_turning(
    pairs: int, output: Path, shown: tuple[str | None, str | None], seed: int, force: bool, json: bool
) -> int:
    """Cameras that turn before a rectangle."""
    from binocal import app as verbs
    from binocal.formats import rig_json
    from binocal.output import check_output_folder

    if shown != (None, None):
        raise typer.BadParameter(f"--rig {TURNING} shows a rectangle; leave out --board and --scene.")
    check_output_folder(output, force=force)
    truth = verbs.simulate_turning_cameras(pairs, output, seed=seed, force=force)
    text = (
        f"corners.npz of {len(truth.names)} pairs, rig.json from before the cameras turned, and truth.json in {output}"
    )
    _present(rig_json.truth_document(truth) | {"output": str(output)}, text, json)
    return FINE


@app.command()
def evaluate(
    rig: Annotated[
        Path,
        typer.Argument(help="The calibration to evaluate: rig.json, or OpenCV's file with --left.", metavar="RIG.JSON"),
    ],
    truth: Annotated[
        Path | None, typer.Option("--truth", help="truth.json of the simulation.", metavar="TRUTH.JSON")
    ] = None,
    left: Annotated[str | None, typer.Option("--left", help="Held-out left images.", metavar="GLOB")] = None,
    right: Annotated[str | None, typer.Option("--right", help="Held-out right images.", metavar="GLOB")] = None,
    board: Annotated[str | None, typer.Option("--board", help=BOARD_HELP, metavar="SPEC")] = None,
    require: Needs = None,
    threads: Threads = None,
    json: Json = False,
) -> int:
    """Evaluate a rig by the paper's criteria, against the truth or on images that it has not seen."""
    from binocal import app as verbs
    from binocal.cli import documents, tables
    from binocal.cli.progress import progress_on_terminal
    from binocal.formats import rig_json
    from binocal.formats.rig_file import load_rig

    on_images = (left, right, board)
    if (truth is None) == (on_images == (None, None, None)) or (truth is None and None in on_images):
        raise typer.BadParameter("give either --truth, or --left, --right and --board together.")
    needs = _parse_needs(require, is_metric=None)
    if truth is not None:
        calibration, known = rig_json.read_calibration(rig), rig_json.read_truth(truth)
        against_truth = verbs.evaluate_truth(calibration, known)
        document, text, is_good = (
            documents.truth_evaluation_document(against_truth),
            tables.truth_text(against_truth),
            True,
        )
        if needs:
            from binocal.app.needs import judge_against_truth
            from binocal.cli.needs import needs_document, needs_text

            report = judge_against_truth(calibration, known.rig, needs)
            document, is_good = document | needs_document(report), report.is_met
            text = "\n".join([*needs_text(report, calibration.rig.printed_unit), "", text])
        _present(document, text, json)
        return FINE if is_good else BELOW_QUALITY
    parsed = _parse_board(str(board))
    calibration = rig_json.read_calibration(rig) if rig_json.holds_calibration(rig) else None
    read = load_rig(rig) if calibration is None else calibration.rig
    with progress_on_terminal() as progress:
        seen = verbs.evaluate_images(read, str(left), str(right), parsed, calibration=calibration, progress=progress)
    tables.list_left_out(seen.ignored, seen.rejected, seen.notes)
    document, text = documents.images_document(seen), tables.images_text(seen, read.is_metric)
    is_good = not seen.findings
    if needs:
        from binocal.app.needs import judge_on_images
        from binocal.cli.needs import needs_document, needs_text

        assert seen.detections is not None
        report = judge_on_images(read, calibration, needs, (seen.detections, seen.pixel_error), seen.agreement, parsed)
        document, is_good = document | needs_document(report), is_good and report.is_met
        text = "\n".join([*needs_text(report, read.printed_unit), "", text])
    _present(document, text, json)
    return FINE if is_good else BELOW_QUALITY


@app.command()
def uncertainty(
    rig: Annotated[Path, typer.Argument(help="The calibration: rig.json.", metavar="RIG.JSON")],
    ranges: Annotated[
        str,
        typer.Option("--range", help="From where to where depth is measured: 0.5-5m, or one range.", metavar="RANGE"),
    ],
    matching: Annotated[
        str,
        typer.Option("--matching", help="Standard deviation of a match's disparity, in pixels: 0.25px.", metavar="PX"),
    ] = "0.25px",
    json: Json = False,
) -> int:
    """Tell how far depth, rows and projection can be trusted, by range and place in the image."""
    from binocal.app.uncertainty import tell_uncertainty
    from binocal.cli import uncertainty as texts
    from binocal.formats import rig_json

    nearest, farthest, is_metric = parse_range(ranges)
    matching_px = _parse_pixels("--matching", matching)
    calibration = rig_json.read_calibration(rig)
    if calibration.rig.is_metric != is_metric:
        unit = (
            "metres: give --range a unit, such as 0.5-5m"
            if not is_metric
            else "board pitches: give --range without a unit"
        )
        raise DataError(f"{rig}: the rig is in {unit}.")
    run = tell_uncertainty(calibration, nearest, farthest, matching_px=matching_px)
    _present(texts.uncertainty_document(run), texts.uncertainty_text(run), json)
    return FINE


Dataset = Annotated[
    str | None,
    typer.Option(
        "--dataset",
        help="Pairs and cameras of a data set as it is unpacked, in place of --left and --right: kitti:PATH, cityscapes:PATH, "
        "euroc:PATH, middlebury:PATH.",
        metavar="KIND:PATH",
    ),
]
SomeLeft = Annotated[
    str | None, typer.Option("--left", help="Left images: a glob in quotes, or a folder.", metavar="GLOB")
]
SomeRight = Annotated[
    str | None, typer.Option("--right", help="Right images, paired with the left by name.", metavar="GLOB")
]
OldRig = Annotated[
    Path | None,
    typer.Option(
        "--rig", help="The rig whose cameras took the images: rig.json, or OpenCV's file.", metavar="RIG.JSON"
    ),
]
MaxPairs = Annotated[
    int | None,
    typer.Option(
        "--max-pairs",
        help="Use the N most telling pairs of twice as many looked at; 8 unless given.",
        metavar="N",
        min=1,
    ),
]


class Starts(enum.StrEnum):
    """Whether the old rig's pose is known."""

    rig = "rig"
    none = "none"


@app.command()
def recalibrate(
    left: SomeLeft = None,
    right: SomeRight = None,
    dataset: Dataset = None,
    rig: OldRig = None,
    output: Annotated[Path, typer.Option("--output", help="Where the rig goes.", metavar="RIG.JSON")] = Path(
        "new.json"
    ),
    start: Annotated[
        Starts,
        typer.Option("--start", help="rig: its pose is nearly right; none: only its cameras are.", metavar="rig|none"),
    ] = Starts.rig,
    baseline: Annotated[
        str | None,
        typer.Option(
            "--baseline", help="Distance of the cameras, such as 120mm; default: the old rig's.", metavar="LENGTH"
        ),
    ] = None,
    calibrator: Annotated[
        str,
        typer.Option(
            "--calibrator",
            help="From the old rig: drl (agent and schedules), portfolio (schedules), lm (one schedule), or weights.",
            metavar="NAME",
        ),
    ] = "drl",
    reference: Annotated[
        bool,
        typer.Option("--reference", help="Write the rig as given, with this result as what `check` compares with."),
    ] = False,
    max_pairs: MaxPairs = None,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Find rotation and direction of translation anew from images without a board, intrinsics held."""
    from binocal.app import natural
    from binocal.cli import natural as texts
    from binocal.cli.progress import progress_on_terminal
    from binocal.formats import rig_json
    from binocal.output import check_output

    length_m = _parse_length(baseline)
    _check_natural_calibrator(calibrator)
    check_output(output, force=force)
    given, source = _natural_source(left, right, dataset, rig)
    if reference and given is None:
        raise typer.BadParameter("--reference keeps the rig as given: give --rig with a rig.json.")
    with progress_on_terminal() as progress:
        options = natural.NaturalOptions(
            start is Starts.rig, length_m, max_pairs or natural.MAX_PAIRS, seed, progress, calibrator=calibrator
        )
        run = natural.recalibrate(source, options)
    written = natural.with_reference(given, run) if reference and given is not None else run.calibration
    rig_json.write_calibration(output, written, force=force)
    kept = ", the rig as given with this result as its reference" if reference else ""
    _present(texts.run_document(run, output=str(output)), texts.recalibrate_text(run, output, kept), json)
    return FINE


@app.command()
def check(
    left: SomeLeft = None,
    right: SomeRight = None,
    dataset: Dataset = None,
    rig: OldRig = None,
    stream: Annotated[
        bool,
        typer.Option(
            "--stream", help="Watch the rig over all pairs, in their order: drift per hour, and jumps by pair."
        ),
    ] = False,
    every: Annotated[
        int | None,
        typer.Option("--every", help="With --stream: N pairs in a row are one measurement.", metavar="N", min=1),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            "--fps",
            help="With --stream: pairs per second, in place of the times that the images have.",
            metavar="F",
            callback=_finite,
        ),
    ] = None,
    max_pairs: MaxPairs = None,
    seed: Seed = 0,
    threads: Threads = None,
    json: Json = False,
) -> int:
    """Say from images without a board whether a rig is still calibrated; exit code 4 if it has drifted."""
    from binocal.app import natural
    from binocal.cli import natural as texts
    from binocal.cli.progress import progress_on_terminal

    if not stream and (every is not None or fps is not None):
        raise typer.BadParameter("--every and --fps belong to --stream.")
    if stream and max_pairs is not None:
        raise typer.BadParameter("--stream takes every pair; leave out --max-pairs.")
    if fps is not None and fps <= 0:
        raise typer.BadParameter(f"--fps is {fps:g}; give pairs per second, such as 10.")
    _, source = _natural_source(left, right, dataset, rig)
    if stream:
        return _check_stream(source, every or 1, fps, seed, json)
    with progress_on_terminal() as progress:
        run = natural.recalibrate(
            source, natural.NaturalOptions(max_pairs=max_pairs or natural.MAX_PAIRS, seed=seed, progress=progress)
        )
    _present(texts.check_document(run), texts.check_text(run), json)
    return BELOW_QUALITY if run.has_drifted else FINE


class Sides(enum.StrEnum):
    """Which camera of a rig."""

    left = "left"
    right = "right"


@app.command("vanishing-points")
def vanishing_points(
    images: Annotated[
        str, typer.Option("--images", help="Images of one camera: a glob in quotes, a folder, a file.", metavar="GLOB")
    ],
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig",
            help="A rig whose camera took them: its lens is taken out, its values are checked.",
            metavar="RIG.JSON",
        ),
    ] = None,
    side: Annotated[
        Sides, typer.Option("--side", help="Which camera of the rig took the images.", metavar="left|right")
    ] = Sides.left,
    right_angles: Annotated[
        bool,
        typer.Option(
            "--right-angles",
            help="Two families of one image are known to be at right angles: a third or a turned view need not check it.",
        ),
    ] = False,
    max_images: Annotated[
        int, typer.Option("--max-images", help="Use at most N images, evenly chosen.", metavar="N", min=1)
    ] = 20,
    seed: Seed = 0,
    threads: Threads = None,
    json: Json = False,
) -> int:
    """Find focal length and principal point from straight lines of streets and rooms, or check a rig's; exit code 4 if they contradict it."""
    from binocal.app import scene_lines
    from binocal.app.natural import load_given_rig
    from binocal.cli import scene_lines as texts
    from binocal.cli.progress import progress_on_terminal
    from binocal.cli.tables import list_left_out

    given = None if rig is None else load_given_rig(rig)
    with progress_on_terminal() as progress:
        options = scene_lines.SceneOptions(right_angles, max_images, seed, progress)
        run = scene_lines.calibrate_scene(images, options, rig=given, side=side.value)
    list_left_out([(str(path), reason) for path, reason in run.ignored], (), ())
    _present(texts.scene_document(run), texts.scene_text(run), json)
    return FINE if run.check is None or run.check.agrees else BELOW_QUALITY


def _check_stream(source: Any, every: int, fps: float | None, seed: int, json: bool) -> int:
    from binocal.app.stream import StreamOptions, check_stream
    from binocal.cli import stream as texts
    from binocal.cli.progress import progress_on_terminal

    with progress_on_terminal() as progress:
        run = check_stream(source, StreamOptions(every, fps, seed, progress))
    _present(texts.stream_document(run), texts.stream_text(run), json)
    return BELOW_QUALITY if run.has_drifted else FINE


@app.command()
def train(
    output: Annotated[
        Path, typer.Option("--output", help="Folder for checkpoints, weights, card.", metavar="DIR")
    ] = Path("binocal-agent"),
    agent: Annotated[
        str,
        typer.Option(
            "--agent",
            help="drl steers the solver, drl-increments changes R, T itself, drl-streets steers `recalibrate`.",
            metavar="NAME",
        ),
    ] = "drl",
    targets: Annotated[
        str,
        typer.Option("--targets", help="How target networks follow: soft (Polyak) or hard (copies).", metavar="MODE"),
    ] = "soft",
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            help="Steps of single rigs (default: as the shipped agent); so many give the same weights.",
            metavar="N",
            min=1,
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            "--seconds",
            help="Stop training after so long; the same command goes on.",
            metavar="S",
            min=0.0,
            callback=_finite,
        ),
    ] = None,
    layers: Annotated[
        str | None, typer.Option("--layers", help="Nodes of the actor's hidden layers, such as 64,64.", metavar="N,N")
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option("--data", help="Train on real images: left* and right* in a folder.", metavar="DIR"),
    ] = None,
    board: Annotated[str | None, typer.Option("--board", help=BOARD_HELP, metavar="SPEC")] = None,
    beside: Annotated[
        list[Path] | None,
        typer.Option(
            "--beside", help="Another run's folder to draw beside this one; seeds make a band.", metavar="DIR"
        ),
    ] = None,
    rigs: Annotated[
        int,
        typer.Option("--rigs", help="Unseen rigs of each evaluation set; 0 leaves the table out.", metavar="N", min=0),
    ] = 1000,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Train an agent on simulated rigs or real images; started again in the same folder, it goes on where it was."""
    from binocal import app as verbs
    from binocal.cli import documents, tables
    from binocal.cli.progress import progress_on_terminal

    if data is None and board is not None:
        raise typer.BadParameter("--board is that of the images in --data DIR; simulated rigs have theirs.")
    options = verbs.TrainRequest(
        _one_of("--agent", agent, ("drl", "drl-increments", "drl-streets")),
        _one_of("--targets", targets, ("soft", "hard")),
        steps,
        seconds,
        _parse_layers(layers),
        rigs,
        seed,
    )
    parsed = None if board is None else _parse_board(board)
    with progress_on_terminal() as progress:
        trained = verbs.train(
            output, options, data=data, board=parsed, beside=beside or (), force=force, progress=progress
        )
    _present(documents.training_document(trained), tables.training_text(trained), json)
    return FINE


@app.command()
def bench(
    name: Annotated[str, typer.Argument(help="Which benchmark, such as solver.", metavar="NAME")],
    sets: Annotated[
        list[str] | None, typer.Argument(help="For real: folders, files of corners or names.", metavar="[SET]...")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="For real: three recordings, three splits.")] = False,
    seed: Seed = 0,
    threads: Threads = None,
    json: Json = False,
) -> int:
    """Measure binocal against the peers that are installed on this machine."""
    from binocal.benchmark import run

    if name != "real" and (sets or quick):
        raise typer.BadParameter(f"recordings and --quick belong to `bench real`, not to `bench {name}`.")
    try:
        table = run(name, seed=seed, **({"sets": sets or (), "quick": quick} if name == "real" else {}))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    _present({key: value for key, value in table.items() if key != "text"}, table["text"], json)
    return FINE


def _check_distinct(outputs: dict[str, list[Path]]) -> None:
    """Two options that name one file would write one result over the other."""
    option_of: dict[str, str] = {}
    for option, paths in outputs.items():
        for path in paths:
            other = option_of.setdefault(os.path.normcase(os.path.realpath(path)), option)
            if other != option:
                raise typer.BadParameter(f"{option} and {other} name the same file.")


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
        raise refusal


def _calibrate_zoom(
    zoom: Path, board: Board, request: CalibrationRequest, at: float | None, preprocess: bool
) -> CalibrationRun:
    from binocal import app as verbs

    try:
        return verbs.calibrate_zoom_images(zoom, board, request, setting=at, preprocess=preprocess)
    except ValueError as error:
        raise typer.BadParameter(f"--at: {error}.") from None


def _parse_source(
    images: tuple[str | None, str | None], board: str | None, corners: Path | None, zoom: Path | None
) -> Board | None:
    """The board of the images; None where the corners are in a file."""
    left, right = images
    if zoom is not None:
        if (left, right, corners) != (None, None, None) or board is None:
            raise typer.BadParameter("--zoom SETTINGS.CSV goes with --board alone: the file names the images.")
        return _parse_board(board)
    if corners is None:
        for name, given in (("--left", left), ("--right", right), ("--board", board)):
            if given is None:
                raise typer.BadParameter(
                    f"missing option {name!r}: give --left, --right and --board, or --corners FILE."
                )
        return _parse_board(str(board))
    if (left, right, board) != (None, None, None):
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


def _parse_length(text: str | None) -> float | None:
    """Metres of a length with its unit."""
    if text is None:
        return None
    from binocal.app.natural import LEAST_BASELINE_M, MOST_BASELINE_M
    from binocal.boards.board import parse_length

    try:
        length_m, is_metric = parse_length(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    if not is_metric:
        raise typer.BadParameter(f"--baseline {text} needs a unit: mm, cm, m or in.")
    if not LEAST_BASELINE_M <= length_m <= MOST_BASELINE_M:
        raise typer.BadParameter(f"--baseline {text}: the cameras of a rig stand 1 mm to 100 m apart.")
    return length_m


def _parse_needs(texts: list[str] | None, *, is_metric: bool | None) -> Any:
    """The requirements of ``--require``; none where it is not given, and then nothing is loaded for it."""
    if not texts:
        return ()
    from binocal.cli.needs import parse_needs

    return parse_needs(texts, is_metric=is_metric)


def _parse_pixels(option: str, text: str) -> float:
    """Pixels with or without their unit."""
    try:
        value = float(text.strip().removesuffix("px"))
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise typer.BadParameter(f"{option} {text!r} is not a number of pixels such as 0.25px.")
    return value


def _natural_source(left: str | None, right: str | None, dataset: str | None, rig: Path | None) -> Any:
    """The calibration of ``--rig``, if there is one, and the pairs with their rig."""
    from binocal.app import natural

    if (dataset is None) == (left is None and right is None) or (left is None) != (right is None):
        raise typer.BadParameter("give either --dataset, or --left and --right together.")
    given = None if rig is None else natural.load_given_rig(rig)
    if dataset is not None:
        return given, natural.source_of_dataset(dataset, given)
    if given is None:
        raise typer.BadParameter("images alone do not say what cameras took them: give --rig.")
    return given, natural.source_of_images(str(left), str(right), given)


def _parse_board(spec: str) -> Any:
    from binocal.boards import load_board

    try:
        return load_board(spec)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


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


def _check_calibrator(name: str) -> None:
    from binocal.calibrators import CALIBRATORS

    if name in CALIBRATORS:
        return
    from binocal.calibrators import load_calibrator

    try:
        load_calibrator(name)  # weights are read before any image is
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def _check_natural_calibrator(name: str) -> None:
    from binocal.calibrators.natural_solves import NATURAL_CALIBRATORS, solves_of

    if name in NATURAL_CALIBRATORS:
        return
    try:
        solves_of(name)  # weights are read before any image is
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def _one_of(option: str, value: str, known: tuple[str, ...]) -> str:
    if value not in known:
        raise typer.BadParameter(f"{option} is {value!r}; known: {', '.join(known)}")
    return value


def _parse_layers(text: str | None) -> tuple[int, ...] | None:
    if text is None:
        return None
    try:
        widths = tuple(int(part) for part in text.split(","))
    except ValueError:
        widths = ()
    if not widths or min(widths) < 1:
        raise typer.BadParameter(f"--layers is {text!r}; give whole numbers with commas, such as 64,64")
    return widths
