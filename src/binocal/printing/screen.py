"""A board for a screen, pixel by pixel: every edge of a square lies between two pixels of the screen."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from html import escape

import numpy as np

from binocal.boards import Board, format_board
from binocal.printing.board_shapes import PrintStyle, board_shapes, board_size_mm
from binocal.printing.drawing import Group, Page
from binocal.printing.png import encode_png
from binocal.printing.raster import raster_bands
from binocal.simulation.layout import cell_print

NOTE_PX = 40  # kept free below the board, for what is written there
PX_M = 1e-3  # a pixel in the drawing, whose unit is the millimetre
APRIL_DATA_CELLS = 6  # of a tag's side, besides its border
MOST_DIAGONAL_M = 5.0
LEAST_PITCH_PX = {
    "chessboard": 4,
    "charuco": 8,
    "aprilgrid": 10,
    "circles": 8,
    "acircles": 6,
    "squares": 6,
    "puzzleboard": 12,
}


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """A screen of square pixels: how many, and how large one is, metres; None where its diagonal is not known."""

    resolution_wh: tuple[int, int]
    pixel_m: float | None

    @staticmethod
    def of_diagonal(resolution_wh: tuple[int, int], diagonal_m: float | None) -> Screen:
        """The screen with this diagonal of its visible area.

        Raises:
            ValueError: No screen is so large.
        """
        if diagonal_m is None:
            return Screen(resolution_wh, None)
        if not 0 < diagonal_m <= MOST_DIAGONAL_M:
            raise ValueError(
                f"a diagonal of {diagonal_m:g} m is not plausible: screens have at most {MOST_DIAGONAL_M:g} m"
            )
        return Screen(resolution_wh, diagonal_m / math.hypot(*resolution_wh))


@dataclass(frozen=True, slots=True, eq=False)
class ScreenBoard:
    """A board in whole pixels, and what it is to be called."""

    board: Board
    """In units of ``PX_M`` for each pixel."""
    pitch_px: int
    size_px: tuple[int, int]
    spec: str
    """With its unit where the screen's diagonal is known."""
    template: str
    """The SPEC with each length as its number of pixels in braces."""


def fit_board(board: Board, screen: Screen, style: PrintStyle | None = None) -> ScreenBoard:
    """The board in whole pixels: of the SPEC's own pitch, to a pixel, where that is known and fits, else as large as fits.

    The lengths of markers and gaps become whole pixels too, and with them their ratio to the pitch.

    Raises:
        ValueError: The screen has too few pixels for the board.
    """
    style = style or PrintStyle()
    width, height = screen.resolution_wh
    sizes: Iterable[int] = range(max(width, height) // 2, LEAST_PITCH_PX[board.kind] - 1, -1)
    if board.is_metric and screen.pixel_m is not None:
        wanted = round(board.pitch_m / screen.pixel_m)
        sizes = [wanted, *(size for size in sizes if size < wanted)]
    for pitch_px in sizes:
        in_pixels = _in_pixels(board, pitch_px, style)
        if in_pixels is None:
            continue
        print_px = board_size_mm(in_pixels)
        quiet = -(-round(in_pixels.pitch_m / PX_M) // 3)
        if print_px[0] + 2 * quiet <= width and print_px[1] + 2 * quiet <= height - NOTE_PX:
            return _named(in_pixels, screen, (math.ceil(print_px[0] - 1e-6), math.ceil(print_px[1] - 1e-6)))
    raise ValueError(f"{width} x {height} pixels are too few for a board of {board.columns}x{board.rows}")


def _in_pixels(board: Board, pitch_px: int, style: PrintStyle) -> Board | None:
    """The board with all edges on whole pixels, its pitch at most so many; None where its cells would be smaller than a pixel."""
    if pitch_px < LEAST_PITCH_PX[board.kind]:
        return None
    if board.kind == "charuco":
        one = replace(board, columns=3, rows=3, pitch_m=1.0, is_metric=False, marker_m=board.marker_m / board.pitch_m)
        n_cells = len(cell_print(one).x_edges) // 3 - 2  # of a marker's side
        cell = round(pitch_px * board.marker_m / board.pitch_m / n_cells)
        pitch_px -= (pitch_px - n_cells * cell) % 2  # the same margin on both sides
        if cell < 1 or n_cells * cell >= pitch_px:
            return None
        return replace(board, pitch_m=PX_M * pitch_px, is_metric=True, marker_m=PX_M * n_cells * cell)
    if board.kind == "aprilgrid":
        n_cells = APRIL_DATA_CELLS + 2 * style.april_border_bits
        side = pitch_px // n_cells * n_cells
        gap = max(1, round(board.tag_gap_ratio * side))
        return replace(board, pitch_m=PX_M * side, is_metric=True, tag_gap_ratio=gap / side)
    if board.kind == "puzzleboard":
        pitch_px -= pitch_px % 2  # its outer squares are cut in half
    if board.kind == "squares":
        gap = max(1, round(board.gap_m / board.pitch_m * pitch_px))
        return replace(board, pitch_m=PX_M * pitch_px, is_metric=True, gap_m=PX_M * gap)
    return replace(board, pitch_m=PX_M * pitch_px, is_metric=True)


def _named(board: Board, screen: Screen, size_px: tuple[int, int]) -> ScreenBoard:
    pitch_px = round(board.pitch_m / PX_M)
    second = {"charuco": "marker_m", "squares": "gap_m"}.get(board.kind, "")  # the other length of its SPEC
    second_px = round(getattr(board, second) / PX_M) if second else 0
    if screen.pixel_m is None:
        named = replace(board, pitch_m=1.0, is_metric=False, **({second: second_px / pitch_px} if second else {}))
    else:
        pitch_m, second_m = (1e-3 * float(f"{1e3 * screen.pixel_m * px:.6g}") for px in (pitch_px, second_px))
        named = replace(board, pitch_m=pitch_m, **({second: second_m} if second else {}))
    unit = replace(board, pitch_m=1.0, is_metric=False, **({second: 0.5} if second else {}))
    fields = format_board(unit).split(":")
    lengths = [f"{{{pitch_px}}}", *([f"{{{second_px}}}"] if second else [])]
    n_written = (
        len(lengths) if board.kind in ("charuco", "aprilgrid", "squares") else 0
    )  # other SPECs of a pitch of 1 have none
    fields[2:] = [*lengths, *fields[2 + n_written :]]
    return ScreenBoard(board, pitch_px, size_px, format_board(named), ":".join(fields))


def screen_page(shown: ScreenBoard, screen: Screen, style: PrintStyle | None = None) -> str:
    """A page of HTML that holds everything: the board, which it shows pixel by pixel, its SPEC, and what to press."""
    shapes = board_shapes(shown.board, style)
    width, height = shown.size_px
    page = Page(float(width), float(height), (Group("board", shapes),))
    png = encode_png(raster_bands(page, 1.0), shown.size_px, _dpi(screen))
    values = {
        "size": shown.size_px,
        "screen": screen.resolution_wh,
        "template": shown.template,
        "pixelMm": None if screen.pixel_m is None else 1e3 * screen.pixel_m,
        "pitchPx": shown.pitch_px,
        "notePx": NOTE_PX,
    }
    data = json.dumps(values).replace("<", "\\u003c")
    image = base64.b64encode(png).decode("ascii")
    ground, ink = ("#000", "#fff") if style is not None and style.is_inverted else ("#fff", "#000")
    filled = {"@TITLE@": escape(shown.spec), "@GROUND@": ground, "@INK@": ink, "@IMAGE@": image, "@VALUES@": data}
    page_text = _PAGE
    for mark, text in filled.items():
        page_text = page_text.replace(mark, text)
    return page_text


def _dpi(screen: Screen) -> float:
    return 96.0 if screen.pixel_m is None else float(np.clip(0.0254 / screen.pixel_m, 1.0, 10_000.0))


_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>@TITLE@</title>
<style>
html, body { margin: 0; height: 100%; background: @GROUND@; overflow: hidden; }
#board { position: absolute; image-rendering: pixelated; }
#note { position: absolute; left: 8px; bottom: 4px; font: 12px monospace; color: @INK@; }
#warning { color: #c33; }
:fullscreen { cursor: none; }
</style>
</head>
<body>
<img id="board" alt="@TITLE@" src="data:image/png;base64,@IMAGE@">
<div id="note"><span id="spec"></span> <span id="ask">Diagonal, inches: <input id="diagonal" size="5"></span>
<span id="warning"></span></div>
<script>
"use strict";
const values = @VALUES@;
const board = document.getElementById("board");
let pixelMm = values.pixelMm;
document.getElementById("ask").hidden = pixelMm !== null;
document.getElementById("diagonal").addEventListener("input", event => {
  const diagonal = Number(event.target.value);
  pixelMm = diagonal > 0 ? 25.4 * diagonal / Math.hypot(...values.screen) : null;
  show();
});
function show() {
  const ratio = window.devicePixelRatio;
  const [width, height] = values.size;
  const room = [Math.round(window.innerWidth * ratio), Math.round(window.innerHeight * ratio)];
  board.style.width = width / ratio + "px";
  board.style.height = height / ratio + "px";
  board.style.left = Math.max(0, Math.floor((room[0] - width) / 2)) / ratio + "px";
  board.style.top = Math.max(0, Math.floor((room[1] - values.notePx - height) / 2)) / ratio + "px";
  const length = px => Number((px * pixelMm).toPrecision(6)) + "mm";
  const named = values.template.replace(/\\{(\\d+)\\}/g, (_, px) => pixelMm === null ? px + "px" : length(Number(px)));
  document.getElementById("spec").textContent =
    (pixelMm === null ? named + ", pitch in pixels." : "--board " + named + ".") + " F: full screen.";
  const real = [Math.round(screen.width * ratio), Math.round(screen.height * ratio)];
  const isOther = Math.abs(real[0] - values.screen[0]) > 1 || Math.abs(real[1] - values.screen[1]) > 1;
  let warning = "";
  if (isOther) {
    warning = "This screen shows " + real.join(" x ") + " pixels, not " + values.screen.join(" x ") +
      ": set the zoom to 100 %, or write the page anew with --resolution " + real.join("x") + ".";
  } else if (width > room[0] || height > room[1] - values.notePx) {
    warning = "The window is too small: press F.";
  }
  document.getElementById("warning").textContent = warning;
}
document.addEventListener("keydown", event => {
  if (event.key === "f" || event.key === "F") {
    document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen();
  }
});
window.addEventListener("resize", show);
show();
</script>
</body>
</html>
"""
