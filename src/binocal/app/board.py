"""``binocal board``: a board on paper, for a cutter, or as an image, true to scale."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path

from binocal.boards import Board, format_board, parse_board
from binocal.boards.target_file import format_kalibr_target
from binocal.cameras import Camera, StereoRig
from binocal.formats.rig_file import load_rig
from binocal.output import Content, check_output, write_together
from binocal.printing.board_shapes import PrintStyle
from binocal.printing.drawing import Page
from binocal.printing.dxf import dxf_text
from binocal.printing.paper import PAPERS, has_room_for, smallest_paper, turned_to_fit
from binocal.printing.pdf import pdf_content
from binocal.printing.png import png_content
from binocal.printing.recommendation import camera_of_field
from binocal.printing.screen import Screen, ScreenBoard, fit_board, screen_page
from binocal.printing.sheet import SheetOptions, distances_mm, lay_out_sheet, sheet_size_mm
from binocal.printing.svg import svg_text
from binocal.printing.tiles import split_over_pages

SUFFIXES = (".pdf", ".svg", ".dxf", ".png")


@dataclass(frozen=True, slots=True)
class PrintRequest:
    """On what a board is printed; ``page_mm`` None is the smallest ISO page that it fits, for a cutter the sheet itself."""

    page_mm: tuple[float, float] | None = None
    is_landscape: bool = False
    is_tiled: bool = False
    dpi: float = 300.0
    sheet: SheetOptions = field(default_factory=SheetOptions)


@dataclass(frozen=True, slots=True)
class PrintedBoard:
    """What was written: the files, the pages' size, and the two distances that a ruler should find."""

    paths: tuple[Path, ...]
    n_pages: int
    page_mm: tuple[float, float]
    distances_mm: tuple[float, float]


def print_board(
    board: Board,
    path: str | Path,
    request: PrintRequest | None = None,
    *,
    kalibr: str | Path | None = None,
    force: bool = False,
) -> PrintedBoard:
    """Write a board to a PDF, SVG, DXF or PNG file, by its suffix, and to ``kalibr`` as Kalibr's target file.

    Raises:
        ValueError: The suffix is another one, the board fits no such page, or it cannot be drawn; the text says what would do.
        DataError: The file cannot be written, or exists and ``force`` is False.
    """
    request = request or PrintRequest()
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(
            f"{path.name} ends in none of {', '.join(SUFFIXES)}, which say what is written; .html goes with --screen"
        )
    pages = lay_out_pages(board, request, is_for_cutter=suffix == ".dxf")
    contents = _contents(path, pages, request.dpi, format_board(board))
    if kalibr is not None:
        contents[Path(kalibr)] = format_kalibr_target(board)
    for output in contents:
        check_output(output, force=force)
    write_together({**contents}, force=force)
    first = pages[0]
    return PrintedBoard(tuple(contents), len(pages), (first.width, first.height), distances_mm(board))


def write_screen_board(
    board: Board,
    path: str | Path,
    screen: Screen,
    style: PrintStyle | None = None,
    *,
    kalibr: str | Path | None = None,
    force: bool = False,
) -> ScreenBoard:
    """Write a board as a page for a browser, in whole pixels of a screen, and to ``kalibr`` as shown there.

    Raises:
        ValueError: The suffix is not .html, the screen has too few pixels, or Kalibr has no such boards.
        DataError: The file cannot be written, or exists and ``force`` is False.
    """
    path = Path(path)
    if path.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{path.name} does not end in .html, as pages for a screen do")
    shown = fit_board(board, screen, style)
    contents: dict[str | Path, Content] = {path: screen_page(shown, screen, style)}
    if kalibr is not None:
        contents[kalibr] = format_kalibr_target(parse_board(shown.spec))
    write_together(contents, force=force)
    return shown


def load_viewer(text: str) -> StereoRig | Camera:
    """The cameras that a board is for: a rig's file, or a horizontal field of view and an image size, ``60deg@1280x960``.

    Raises:
        ValueError: A field of view or a size that is none, or a rig without a scale.
        FormatError: The file holds no rig.
    """
    found = re.fullmatch(r"\s*([0-9.]+)(?:deg|°)?@([1-9][0-9]{0,5})x([1-9][0-9]{0,5})\s*", text)
    if found is None and re.fullmatch(r"\s*[0-9.]+\s*(deg|°)?\s*(@.*)?", text):
        raise ValueError(f"{text!r} lacks the image's size: write the horizontal field of view so: 60deg@1280x960")
    if found is None:
        rig = load_rig(text)
        if not rig.is_metric:
            raise ValueError(f"{text} is a rig without a scale; give the field of view instead, such as 60deg@1280x960")
        return rig
    try:
        field_deg = float(found[1])
    except ValueError:
        raise ValueError(f"{found[1]!r} is not an angle in degrees, such as 60deg@1280x960") from None
    return camera_of_field(field_deg, (int(found[2]), int(found[3])))


def lay_out_pages(board: Board, request: PrintRequest, *, is_for_cutter: bool = False) -> tuple[Page, ...]:
    """The pages of a board: one, or several where ``is_tiled`` asks for it and one is not enough.

    Raises:
        ValueError: It fits no such page, or cannot be drawn.
    """
    if not board.is_metric:
        raise ValueError("a printed board needs its size: give the length a unit, such as 20mm")
    need = sheet_size_mm(board, request.sheet)
    page_mm = request.page_mm
    if page_mm is None and is_for_cutter:
        page_mm = need
    if page_mm is None:
        name = smallest_paper(*need)
        page_mm = PAPERS[name or ("A4" if request.is_tiled else "A0")]
    page_mm = _turned(page_mm, need, request.is_landscape)
    if has_room_for(page_mm, need):
        return (lay_out_sheet(board, page_mm, request.sheet),)
    if not request.is_tiled or is_for_cutter:
        raise ValueError(_misfit(board, page_mm, need, request))
    sheet = replace(request.sheet, margin_mm=0.0)
    whole = lay_out_sheet(board, sheet_size_mm(board, sheet), sheet)
    return split_over_pages(whole, page_mm, request.sheet.margin_mm)


def _turned(page_mm: tuple[float, float], need: tuple[float, float], is_landscape: bool) -> tuple[float, float]:
    if is_landscape:
        return max(page_mm), min(page_mm)
    return turned_to_fit(page_mm, need)


def _misfit(board: Board, page_mm: tuple[float, float], need: tuple[float, float], request: PrintRequest) -> str:
    """What is too small, and what would do."""
    name = smallest_paper(*need)
    width, height = (math.ceil(side - 1e-3) for side in need)
    fitting = f"--page {name}" if name else f"--page {width}x{height}mm"
    bare = replace(request.sheet, has_notes=False)
    needs_bare = sheet_size_mm(board, bare)
    without = "" if not has_room_for(_turned(page_mm, needs_bare, request.is_landscape), needs_bare) else ", --no-notes"
    return (
        f"the board needs {width} x {height} mm with its border and notes, and the page has "
        f"{page_mm[0]:g} x {page_mm[1]:g} mm; take {fitting}{without}, or --tiles to split it over pages"
    )


def _contents(path: Path, pages: tuple[Page, ...], dpi: float, title: str) -> dict[Path, Content]:
    """What each file holds; of formats of one page a file for each, numbered."""
    suffix = path.suffix.lower()
    if suffix == ".pdf":
        return {path: pdf_content(pages, title)}
    paths = [path] if len(pages) == 1 else [path.with_stem(f"{path.stem}-{i}") for i in range(1, len(pages) + 1)]
    if suffix == ".svg":
        return {name: svg_text(page, title) for name, page in zip(paths, pages, strict=True)}
    if suffix == ".dxf":
        return {path: dxf_text(pages[0])}
    return {name: png_content(page, dpi) for name, page in zip(paths, pages, strict=True)}
