"""The verb ``report``: a calibration as one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from binocal.cli.arguments import parse_board, parse_needs
from binocal.cli.exits import BELOW_QUALITY, FINE, one_line
from binocal.cli.options import BOARD_HELP, Force, Json, Needs, Threads, app, present


@app.command()
def report(
    rig: Annotated[Path, typer.Argument(help="The calibration: rig.json.", metavar="RIG.JSON")],
    output: Annotated[Path, typer.Option("--output", help="Where the page goes.", metavar="REPORT.HTML")] = Path(
        "report.html"
    ),
    evidence: Annotated[
        Path | None,
        typer.Option(
            "--evidence",
            help="The corners that calibrate --evidence kept (default: those of the rig in a file beside it).",
            metavar="CORNERS.NPZ",
        ),
    ] = None,
    left: Annotated[
        str | None, typer.Option("--left", help="Left images of the calibration, to be shown.", metavar="GLOB")
    ] = None,
    right: Annotated[
        str | None, typer.Option("--right", help="Right images of the calibration.", metavar="GLOB")
    ] = None,
    board: Annotated[
        str | None, typer.Option("--board", help=f"{BOARD_HELP} By default the one that the rig names.", metavar="SPEC")
    ] = None,
    require: Needs = None,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Also print it to a PDF beside the page, by Chromium, Chrome or Edge.")
    ] = False,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Write a rig's report: one HTML file that says whether its depth will be right, why, and what to do."""
    from binocal.app.report import ReportRequest, write_report
    from binocal.cli.needs import needs_document, needs_text
    from binocal.cli.progress import progress_on_terminal
    from binocal.formats import rig_json

    if (left is None) != (right is None):
        raise typer.BadParameter("give both --left and --right, or neither.")
    needs = parse_needs(require, is_metric=None)
    parsed = None if board is None else parse_board(board)
    printed = output.with_suffix(".pdf") if pdf else None
    if printed == output:
        raise typer.BadParameter(f"--output {output} is the page, HTML; --pdf prints it beside: name it report.html.")
    request = ReportRequest(evidence, left, right, parsed, needs)
    with progress_on_terminal() as progress:
        run = write_report(rig, output, request, pdf=printed, force=force, progress=progress)
    document = {
        "output": str(output),
        "pdf": None if printed is None else str(printed),
        "level": run.headline.level,
        "verdict": run.headline.sentence,
        "points": run.headline.points,
        "notes": run.notes,
        **needs_document(run.needs),
    }
    lines = [f"Verdict  {one_line(run.headline.sentence)}"]
    lines += [f"         {one_line(point)}" for point in run.headline.points]
    if needs:
        lines += needs_text(run.needs, rig_json.read_rig(rig).printed_unit)
    lines += [f"note: {one_line(note)}" for note in run.notes]
    present(document, "\n".join([*lines, f"Wrote    {output}{f' and {printed}' if printed else ''}"]), json)
    return FINE if run.needs.is_met else BELOW_QUALITY
