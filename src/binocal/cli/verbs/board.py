"""The verb ``board``: a board for the printer, the cutter or a screen, true to scale; or which one suits cameras and distances."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from binocal.cli.arguments import parse_board
from binocal.cli.exits import FINE
from binocal.cli.options import Force, Json, app, finite, parse_range, present

if TYPE_CHECKING:
    from binocal.app.board import PrintedBoard, PrintRequest
    from binocal.boards import Board
    from binocal.printing.recommendation import Recommendation
    from binocal.printing.screen import Screen, ScreenBoard

LARGEST_MARGIN_M = 0.5


@app.command()
def board(
    spec: Annotated[
        str | None,
        typer.Argument(
            metavar="SPEC",
            help="The board, as for --board of the other verbs: chessboard:9x6:20mm (inner corners), "
            "charuco:11x8:30mm:22mm:DICT_5X5_50 (squares), aprilgrid:6x6:88mm:0.3, circles:10x10:30mm, acircles:4x11:20mm, "
            "squares:4x3:30mm:30mm, puzzleboard:11x8:30mm.",
            show_default=False,
        ),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="FILE", help="What is written: a .pdf, .svg, .png, or a .dxf to cut or etch.", show_default=False
        ),
    ] = None,
    seen_by: Annotated[
        str | None,
        typer.Option(
            "--for",
            help="In place of SPEC: recommend a board for the cameras of a rig.json, or of a horizontal field of view and an image "
            "size such as 60deg@1280x960, and write it to FILE, if one is given.",
            metavar="RIG|FOV",
        ),
    ] = None,
    range_: Annotated[
        str | None,
        typer.Option("--range", help="With --for: nearest and farthest distance, such as 0.5-3m.", metavar="NEAR-FAR"),
    ] = None,
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
    tag_border: Annotated[
        int,
        typer.Option(
            "--tag-border",
            help="AprilGrid: bits of black around a tag, 2 as Kalibr's or 1 as AprilTag's own.",
            metavar="BITS",
            min=1,
            max=2,
        ),
    ] = 2,
    inverted: Annotated[
        bool,
        typer.Option(
            "--inverted",
            help="White on black, the border too, as for etched metal, back-lit film or screens; found alike.",
        ),
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
    screen: Annotated[
        bool,
        typer.Option(
            "--screen",
            help="Write a page for a browser, which shows the board pixel by pixel; FILE is board.html if left out.",
        ),
    ] = False,
    diagonal: Annotated[
        str | None,
        typer.Option(
            "--diagonal",
            help="With --screen: that of its visible area, such as 27in; the pitch follows.",
            metavar="LENGTH",
        ),
    ] = None,
    resolution: Annotated[
        str | None,
        typer.Option("--resolution", help="With --screen: its pixels (default: 1920x1080).", metavar="WxH"),
    ] = None,
    open_page: Annotated[bool, typer.Option("--open", help="With --screen: open the page in the browser.")] = False,
    force: Force = False,
    json: Json = False,
) -> int:
    """Write a board to print, cut, etch or show on a screen: true to scale, with scale bars, its SPEC, and two distances to measure."""
    from binocal.app.board import PrintRequest, print_board, write_screen_board
    from binocal.printing.board_shapes import PrintStyle
    from binocal.printing.paper import parse_paper
    from binocal.printing.sheet import SheetOptions

    if seen_by is not None and spec is not None and file is None:
        spec, file = None, Path(spec)
    if screen and file is None:
        file = Path("board.html")
    recommended = _recommend(seen_by, range_, spec)
    if recommended is None and (spec is None or file is None):
        raise typer.BadParameter("missing SPEC or FILE: give both, or --for RIG|FOV with --range NEAR-FAR.")
    parsed = parse_board(str(spec)) if recommended is None else recommended.board
    if legacy and parsed.kind != "charuco":
        raise typer.BadParameter("--legacy is a layout of ChArUco boards alone.")
    if tag_border != 2 and (parsed.kind != "aprilgrid" or kalibr is not None):
        raise typer.BadParameter("--tag-border 1 is of AprilGrids alone, and not as Kalibr looks for them.")
    if kalibr is not None and kalibr.suffix.lower() not in (".yaml", ".yml"):
        raise typer.BadParameter(f"--kalibr {kalibr} does not end in .yaml, as board files do.")
    if kalibr is not None and file is None:
        raise typer.BadParameter("--kalibr writes beside a board: name its FILE too.")
    if not screen and (diagonal is not None or resolution is not None or open_page):
        raise typer.BadParameter("--diagonal, --resolution and --open belong to --screen.")
    if screen and (page is not None or landscape or tiles):
        raise typer.BadParameter("--page, --landscape and --tiles belong to paper; leave them out, or --screen.")
    document, lines = _recommendation(recommended)
    try:
        page_text = page if page is not None or recommended is None else recommended.page
        page_mm = None if page_text is None else parse_paper(page_text)
        style = PrintStyle(legacy, tag_border, inverted)
        request = PrintRequest(page_mm, landscape, tiles, dpi, SheetOptions(_margin_mm(margin), notes, style))
        if screen and file is not None:
            shown = write_screen_board(
                parsed, file, _parse_screen(resolution, diagonal), style, kalibr=kalibr, force=force
            )
            document |= _screen_document(file, shown)
            lines += _screen_lines(file, shown)
        elif file is not None:
            printed = print_board(parsed, file, request, kalibr=kalibr, force=force)
            document |= _document(parsed, printed)
            lines += _lines(parsed, printed, request)
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None
    present(document, "\n".join(lines), json)
    if open_page and file is not None:
        import webbrowser

        webbrowser.open(file.absolute().as_uri())
    return FINE


def _parse_screen(resolution: str | None, diagonal: str | None) -> Screen:
    """The screen of ``--resolution`` and ``--diagonal``."""
    from binocal.boards.board import parse_length
    from binocal.printing.screen import Screen

    text = resolution or "1920x1080"
    found = re.fullmatch(r"([1-9][0-9]{1,4})x([1-9][0-9]{1,4})", text)
    if found is None:
        raise ValueError(f"--resolution is {text!r}; give width and height in pixels, such as 2560x1440")
    size_wh = int(found[1]), int(found[2])
    if diagonal is None:
        return Screen(size_wh, None)
    length_m, has_unit = parse_length(diagonal)
    if not has_unit:
        raise ValueError(f"--diagonal {diagonal} needs a unit: mm, cm, m or in, such as 27in")
    return Screen.of_diagonal(size_wh, length_m)


def _screen_document(file: Path, shown: ScreenBoard) -> dict[str, Any]:
    parsed = parse_board(shown.spec)
    pitch_mm = 1e3 * parsed.pitch_m if parsed.is_metric else None
    return {
        "board": shown.spec,
        "files": [str(file)],
        "pitch_px": shown.pitch_px,
        "pitch_mm": pitch_mm,
        "size_px": list(shown.size_px),
    }


def _screen_lines(file: Path, shown: ScreenBoard) -> list[str]:
    width, height = shown.size_px
    lines = [
        f"{file}: {width} x {height} pixels, {shown.pitch_px} a pitch; open it in a browser, press F for full screen",
        f"then --board {shown.spec}",
    ]
    if not parse_board(shown.spec).is_metric:
        lines.append("the scale is unknown: write the page with --diagonal, or type the diagonal there")
    return lines


def _recommend(seen_by: str | None, range_: str | None, spec: str | None) -> Recommendation | None:
    """What ``--for`` and ``--range`` ask for; None where neither is given."""
    if (seen_by is None) != (range_ is None):
        raise typer.BadParameter("--for and --range belong together: --for 60deg@1280x960 --range 0.5-3m.")
    if seen_by is None:
        return None
    if spec is not None:
        raise typer.BadParameter("--for recommends a board: leave out the SPEC.")
    from binocal.app.board import load_viewer
    from binocal.printing.recommendation import recommend_board

    near_m, far_m, has_unit = parse_range(str(range_))
    if not has_unit:
        raise typer.BadParameter(f"--range {range_} needs a unit: mm, cm, m or in.")
    try:
        return recommend_board(load_viewer(seen_by), near_m, far_m)
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None


def _recommendation(recommended: Recommendation | None) -> tuple[dict[str, Any], list[str]]:
    if recommended is None:
        return {}, []
    from binocal.boards import format_board

    spec = format_board(recommended.board)
    figures = {"square_px": recommended.square_px, "share": recommended.share}
    document = {"board": spec, "page": recommended.page, "reasons": list(recommended.reasons), **figures}
    return document, [spec, *(f"- {reason}" for reason in recommended.reasons)]


def _margin_mm(text: str) -> float:
    from binocal.boards.board import parse_length

    if text.strip() in ("0", "0mm"):
        return 0.0
    length_m, has_unit = parse_length(text)
    if not has_unit or length_m > LARGEST_MARGIN_M:
        raise ValueError(f"--margin {text} is not a length with its unit such as 10mm, of at most half a metre")
    return 1e3 * length_m


def _document(parsed: Board, printed: PrintedBoard) -> dict[str, Any]:
    from binocal.boards import format_board

    across, along = printed.distances_mm
    return {
        "board": format_board(parsed),
        "files": [str(path) for path in printed.paths],
        "pages": printed.n_pages,
        "page_mm": list(printed.page_mm),
        "distances_mm": {"A-B": across, "A-C": along},
    }


def _lines(parsed: Board, printed: PrintedBoard, request: PrintRequest) -> list[str]:
    from binocal.boards.measured import measured_ends

    width, height = printed.page_mm
    many = "" if printed.n_pages == 1 else f"{printed.n_pages} pages of "
    names = str(printed.paths[0]) + ("" if len(printed.paths) == 1 else f" to {printed.paths[-1].name}")
    across, along = printed.distances_mm
    lines = [f"{names}: {many}{width:.4g} x {height:.4g} mm; print it at 100 %"]
    if request.sheet.has_notes:
        lines.append(f"then measure A-B ({across:.6g} mm) and A-C ({along:.6g} mm), {measured_ends(parsed)}")
    return lines
