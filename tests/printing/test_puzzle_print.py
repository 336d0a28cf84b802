"""PuzzleBoards as they come out of the printer, the cutter and the screen."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import binocal
from binocal.app.board import PrintRequest, lay_out_pages, print_board
from binocal.boards import parse_board
from binocal.printing.pdf import pdf_content
from binocal.printing.png import png_content
from binocal.printing.screen import Screen, fit_board
from binocal.printing.sheet import SheetOptions
from binocal.simulation.layout import cell_print, printed_extent_m

TRUE_TO_MM = 0.01
INCH = 25.4
SPEC = "puzzleboard:9x6:7mm:start=20,31"


def test_a_print_is_true_to_scale_and_detected():
    board = parse_board(SPEC)
    (page,) = lay_out_pages(board, PrintRequest((3 * INCH, 2.5 * INCH), sheet=SheetOptions(4.0, False)))
    wanted = 1e3 * (board.object_points_m[:, :2] - printed_extent_m(board)[:2]) + page.groups[0].shift
    images = {"png": cv2.imdecode(np.frombuffer(png_content(page, 300.0), np.uint8), cv2.IMREAD_GRAYSCALE)}
    pdfium = pytest.importorskip("pypdfium2", reason="pypdfium2 rasterises PDF files; it is in the extra test")
    document = pdfium.PdfDocument(pdf_content([page], SPEC))
    images["pdf"] = document[0].render(scale=300 / 72, grayscale=True).to_numpy().squeeze()
    for name, image in images.items():
        found = binocal.detect(cv2.GaussianBlur(image, (0, 0), 1.0), board)
        assert found.is_seen.all(), (name, found.reason)
        scale = np.array([page.width, page.height]) / image.shape[::-1]
        assert np.abs((found.points_px + 0.5) * scale - wanted).max() < TRUE_TO_MM, name


def _area_mm2(dxf: str) -> float:
    """Within the board's closed polylines, half circles and all (a bulge of 1 turns to the right of the way, y up)."""
    area, vertices, place = 0.0, [], {}
    lines = dxf.splitlines()
    for code, value in zip(map(int, lines[::2]), lines[1::2], strict=True):
        if code != 0:
            place[code] = value
            continue
        if place.get(0) == "VERTEX" and place[8] == "BOARD":
            vertices.append((float(place[10]), float(place[20]), float(place.get(42, 0))))
        if value == "SEQEND" and vertices:
            xy, bulge = np.array(vertices)[:, :2], np.array(vertices)[:, 2]
            following = np.roll(xy, -1, axis=0)
            # Clockwise where y runs up, so that the ink is on the right: there a half circle takes from it.
            area -= 0.5 * np.sum(xy[:, 0] * following[:, 1] - xy[:, 1] * following[:, 0])
            area -= np.sum(bulge * np.pi / 8 * np.sum((following - xy) ** 2, axis=1))
            vertices = []
        place = {0: value}
    return area


def test_a_dxf_has_dots_as_arcs_of_the_squares_outlines(tmp_path):
    board = parse_board(SPEC)
    print_board(board, tmp_path / "b.dxf")
    text = (tmp_path / "b.dxf").read_text()
    cells = cell_print(board)
    assert text.count("\n42\n") == len(cells.discs) == 8 * 6 + 9 * 5 and "CIRCLE" not in text
    squares = (cells.ink * np.outer(np.diff(cells.y_edges), np.diff(cells.x_edges))).sum()
    dots = 0.5 * np.pi / 36 * (2 * cells.discs[:, 3] - 1).sum()
    assert _area_mm2(text) == pytest.approx(49 * (squares + dots), rel=1e-5)


def test_on_a_screen_edges_lie_between_pixels():
    shown = fit_board(parse_board("puzzleboard:13x9:20mm:start=7,8"), Screen((1920, 1080), 0.3e-3))
    assert shown.pitch_px % 2 == 0 and shown.size_px == (13 * shown.pitch_px, 9 * shown.pitch_px)
    assert shown.template == f"puzzleboard:13x9:{{{shown.pitch_px}}}:start=7,8"
    assert parse_board(shown.spec).start == (7, 8)
    rings = fit_board(parse_board("circles:10x8:20mm:rings"), Screen((1920, 1080), 0.3e-3))
    assert rings.template.endswith(":rings")
