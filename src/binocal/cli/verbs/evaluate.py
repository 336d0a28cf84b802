"""The verbs ``evaluate`` and ``uncertainty``: what a rig is worth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from binocal.cli.arguments import parse_boards, parse_measured, parse_needs, parse_pixels
from binocal.cli.exits import BELOW_QUALITY, FINE
from binocal.cli.options import Boards, Json, Measured, Needs, Threads, app, parse_range, present
from binocal.errors import DataError


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
    board: Boards = None,
    measured: Measured = None,
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

    on_images = (left, right, board or None)
    if (truth is None) == (on_images == (None, None, None)) or (truth is None and None in on_images):
        raise typer.BadParameter("give either --truth, or --left, --right and --board together.")
    if measured is not None and truth is not None:
        raise typer.BadParameter("--measured is of a board in images; leave it out, or --truth.")
    needs = parse_needs(require, is_metric=None)
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
        present(document, text, json)
        return FINE if is_good else BELOW_QUALITY
    parsed, measured_m = parse_measured(measured, parse_boards(board or []))
    calibration = rig_json.read_calibration(rig) if rig_json.holds_calibration(rig) else None
    read = load_rig(rig) if calibration is None else calibration.rig
    with progress_on_terminal() as progress:
        seen = verbs.evaluate_images(
            read, str(left), str(right), parsed, calibration=calibration, measured_m=measured_m, progress=progress
        )
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
    present(document, text, json)
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
    matching_px = parse_pixels("--matching", matching)
    rig_json.require_calibration(rig, "an uncertainty")
    calibration = rig_json.read_calibration(rig)
    if calibration.rig.is_metric != is_metric:
        unit = (
            "metres: give --range a unit, such as 0.5-5m"
            if not is_metric
            else "board pitches: give --range without a unit"
        )
        raise DataError(f"{rig}: the rig is in {unit}.")
    run = tell_uncertainty(calibration, nearest, farthest, matching_px=matching_px)
    present(texts.uncertainty_document(run), texts.uncertainty_text(run), json)
    return FINE
