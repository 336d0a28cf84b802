"""The verb ``board``: a board for the printer or the cutter, true to scale."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from binocal.cli.arguments import parse_board
from binocal.cli.exits import FINE
from binocal.cli.options import Force, Json, app, finite, present

if TYPE_CHECKING:
    from binocal.app.board import PrintedBoard, PrintRequest
    from binocal.boards import Board

LARGEST_MARGIN_M = 0.5


@app.command()
def board(
    spec: Annotated[
        str,
        typer.Argument(
            metavar="SPEC",
            help="The board, as for --board of the other verbs: chessboard:9x6:20mm (inner corners), "
            "charuco:11x8:30mm:22mm:DICT_5X5_50 (squares), aprilgrid:6x6:88mm:0.3, circles:10x10:30mm, acircles:4x11:20mm.",
            show_default=False,
        ),
    ],
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="What is written: a .pdf, .svg, .png, or a .dxf to cut or etch.", show_default=False
        ),
    ],
    page: Annotated[
        str | None,
        typer.Option(
            "--page",
            help="A4 to A0, letter, or a size such as 500x400mm (default: the smallest of A4 to A0 that it fits; of a .dxf the "
            "sheet itself).",
            metavar="PAGE",
        ),
    ] = None,
    landscape: Annotated[
        bool, typer.Option("--landscape", help="Turn the page, which otherwise lies as the board fits.")
    ] = False,
    margin: Annotated[str, typer.Option("--margin", help="What the printer leaves white.", metavar="LENGTH")] = "10mm",
    dpi: Annotated[
        float,
        typer.Option("--dpi", help="Of a .png: dots per inch.", metavar="N", min=20.0, max=4800.0, callback=finite),
    ] = 300.0,
    tiles: Annotated[
        bool,
        typer.Option(
            "--tiles",
            help="Split a board that is larger than the page over several, which overlap and bear marks to cut at.",
        ),
    ] = False,
    legacy: Annotated[
        bool, typer.Option("--legacy", help="ChArUco as OpenCV before 4.6 printed it; differs where the rows are even.")
    ] = False,
    notes: Annotated[
        bool,
        typer.Option(
            "--notes/--no-notes", help="Scale bars, the SPEC as text and QR code, and the lines to measure along."
        ),
    ] = True,
    kalibr: Annotated[
        Path | None,
        typer.Option(
            "--kalibr", help="Also write Kalibr's target file, which --board takes too.", metavar="TARGET.YAML"
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Write a board to print, cut or etch: true to scale, with scale bars, its SPEC, and two distances to measure."""
    from binocal.app.board import PrintRequest, print_board
    from binocal.printing.paper import parse_paper
    from binocal.printing.sheet import SheetOptions

    parsed = parse_board(spec)
    if legacy and parsed.kind != "charuco":
        raise typer.BadParameter("--legacy is a layout of ChArUco boards alone.")
    if kalibr is not None and kalibr.suffix.lower() not in (".yaml", ".yml"):
        raise typer.BadParameter(f"--kalibr {kalibr} does not end in .yaml, as board files do.")
    try:
        page_mm = None if page is None else parse_paper(page)
        request = PrintRequest(
            page_mm, landscape, tiles, dpi, SheetOptions(_margin_mm(margin), notes, is_legacy_charuco=legacy)
        )
        printed = print_board(parsed, file, request, kalibr=kalibr, force=force)
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None
    present(_document(spec, printed), _text(parsed, printed, request), json)
    return FINE


def _margin_mm(text: str) -> float:
    from binocal.boards.board import parse_length

    if text.strip() in ("0", "0mm"):
        return 0.0
    length_m, has_unit = parse_length(text)
    if not has_unit or length_m > LARGEST_MARGIN_M:
        raise ValueError(f"--margin {text} is not a length with its unit such as 10mm, of at most half a metre")
    return 1e3 * length_m


def _document(spec: str, printed: PrintedBoard) -> dict[str, Any]:
    across, along = printed.distances_mm
    return {
        "board": spec,
        "files": [str(path) for path in printed.paths],
        "pages": printed.n_pages,
        "page_mm": list(printed.page_mm),
        "distances_mm": {"A-B": across, "A-C": along},
    }


def _text(parsed: Board, printed: PrintedBoard, request: PrintRequest) -> str:
    from binocal.boards.measured import measured_ends

    width, height = printed.page_mm
    many = "" if printed.n_pages == 1 else f"{printed.n_pages} pages of "
    names = str(printed.paths[0]) + ("" if len(printed.paths) == 1 else f" to {printed.paths[-1].name}")
    across, along = printed.distances_mm
    lines = [f"{names}: {many}{width:.4g} x {height:.4g} mm; print it at 100 %"]
    if request.sheet.has_notes:
        lines.append(f"then measure A-B ({across:.6g} mm) and A-C ({along:.6g} mm), {measured_ends(parsed)}")
    return "\n".join(lines)
