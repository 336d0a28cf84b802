"""Boards as they come out of the printer: every kind measured back and detected, by binocal and by OpenCV."""

from __future__ import annotations

import re
import zlib

import cv2
import numpy as np
import pytest

import binocal
from binocal.app.board import PrintRequest, lay_out_pages, print_board
from binocal.boards import Board, load_board, parse_board
from binocal.boards.measured import measured_box_m
from binocal.printing.board_shapes import PrintStyle, board_size_mm
from binocal.printing.drawing import Disc, Page
from binocal.printing.dxf import dxf_text
from binocal.printing.paper import PAPERS, parse_paper, smallest_paper
from binocal.printing.pdf import pdf_content
from binocal.printing.png import png_content
from binocal.printing.sheet import SheetOptions, sheet_size_mm
from binocal.printing.svg import svg_text
from binocal.simulation.layout import printed_extent_m

TRUE_TO_MM = 0.01  # measured: at most .0013
INCH = 25.4
KINDS = [
    ("chessboard:7x5:6mm", False),
    ("charuco:7x6:7mm:5mm:DICT_4X4_50", False),
    ("charuco:7x6:7mm:5mm:DICT_4X4_50", True),
    ("aprilgrid:4x3:10mm:0.3", False),
    ("circles:7x5:6mm", False),
    ("acircles:4x9:4mm", False),
    ("squares:5x4:5mm:4mm", False),
]


def small_page(spec: str, is_legacy: bool = False) -> tuple[Board, Page]:
    """A board on a page of 3 x 2.5 inches without notes."""
    board = parse_board(spec)
    request = PrintRequest((3 * INCH, 2.5 * INCH), sheet=SheetOptions(4.0, False, PrintStyle(is_legacy)))
    (page,) = lay_out_pages(board, request)
    return board, page


def points_mm(board: Board, page: Page) -> np.ndarray:
    """Where the board's points lie on the page."""
    return 1e3 * (board.object_points_m[:, :2] - printed_extent_m(board)[:2]) + page.groups[0].shift


def as_photographed(content: bytes) -> np.ndarray:
    return cv2.GaussianBlur(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE), (0, 0), 1.0)


@pytest.mark.parametrize(("spec", "is_legacy"), KINDS)
def test_a_png_is_true_to_scale_and_detected(spec, is_legacy):
    board, page = small_page(spec, is_legacy)
    image = as_photographed(png_content(page, 300.0))
    found = binocal.detect(image, board)
    assert found.is_found, found.reason
    away = (found.points_px + 0.5) * INCH / 300 - points_mm(board, page)
    assert np.abs(away).max() < TRUE_TO_MM
    theirs = (detect_with_opencv(image, board, is_legacy) + 0.5) * INCH / 300
    assert np.nanmax(np.abs(theirs - points_mm(board, page))) < (0.5 if board.kind == "aprilgrid" else 0.1)


@pytest.mark.parametrize("spec", ["chessboard:7x5:6mm", "charuco:6x5:9mm:7mm:DICT_4X4_50", "aprilgrid:4x3:10mm:0.3"])
def test_a_png_is_detected_as_it_is(spec):
    """No camera has blurred it: a third of the corners beside markers was lost, and the others off by 0.01 mm."""
    board, page = small_page(spec)
    image = cv2.imdecode(np.frombuffer(png_content(page, 300.0), np.uint8), cv2.IMREAD_GRAYSCALE)
    found = binocal.detect(image, board)
    assert found.is_seen.all() and not found.note
    # measured 0.0022
    assert np.abs((found.points_px + 0.5) * INCH / 300 - points_mm(board, page)).max() < 0.004
    (same,) = binocal.detect_boards(image, binocal.BoardSet((board,)))[0]
    assert np.allclose(same.points_px, found.points_px, atol=1e-6)


@pytest.mark.parametrize(("spec", "is_legacy"), KINDS[:2])
def test_at_1200_dpi_too(spec, is_legacy):
    board, page = small_page(spec, is_legacy)
    found = binocal.detect(as_photographed(png_content(page, 1200.0)), board)
    assert np.abs((found.points_px + 0.5) * INCH / 1200 - points_mm(board, page)).max() < TRUE_TO_MM


@pytest.mark.parametrize(("spec", "is_legacy"), KINDS)
def test_a_pdf_is_true_to_scale_and_detected(spec, is_legacy):
    pdfium = pytest.importorskip("pypdfium2", reason="pypdfium2 rasterises PDF files; it is in the extra test")
    board, page = small_page(spec, is_legacy)
    for dpi in (300, 1200) if board.kind == "chessboard" else (300,):
        document = pdfium.PdfDocument(pdf_content([page], spec))
        # a page of 901 x 750 pixels: pdfium rounds up, and stretches what it shows
        image = document[0].render(scale=dpi / 72, grayscale=True).to_numpy().squeeze()
        scale = np.array([page.width, page.height]) / image.shape[::-1]
        assert image.shape[::-1] == pytest.approx(np.array([page.width, page.height]) * dpi / INCH, abs=1.01)
        found = binocal.detect(cv2.GaussianBlur(image, (0, 0), 1.0), board)
        assert np.abs((found.points_px + 0.5) * scale - points_mm(board, page)).max() < TRUE_TO_MM


def test_tags_with_one_bit_of_border_are_found_as_apriltags_own_detector_looks_for_them():
    board = parse_board("aprilgrid:4x3:10mm:0.3")
    sheet = SheetOptions(4.0, False, PrintStyle(border_bits=1))
    (page,) = lay_out_pages(board, PrintRequest((3 * INCH, 2.5 * INCH), sheet=sheet))
    image = as_photographed(png_content(page, 300.0))
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(image)  # one bit is its default
    assert sorted(ids.ravel()) == list(range(12))
    found = binocal.detect(image, board)
    assert np.abs((found.points_px + 0.5) * INCH / 300 - points_mm(board, page)).max() < TRUE_TO_MM


@pytest.mark.parametrize("spec", [*(spec for spec, is_legacy in KINDS if not is_legacy), "circles:7x5:6mm:hollow"])
def test_an_inverted_board_is_true_to_scale_and_detected(spec):
    board = parse_board(spec)
    sheet = SheetOptions(4.0, False, PrintStyle(is_inverted=True))
    (page,) = lay_out_pages(board, PrintRequest((3 * INCH, 2.6 * INCH), sheet=sheet))
    image = cv2.imdecode(np.frombuffer(png_content(page, 300.0), np.uint8), cv2.IMREAD_GRAYSCALE)
    upright = PrintRequest((3 * INCH, 2.6 * INCH), sheet=SheetOptions(4.0, False))
    plain = cv2.imdecode(np.frombuffer(png_content(lay_out_pages(board, upright)[0], 300.0), np.uint8), 0)
    corners = np.array([(0.0, 0.0), board_size_mm(board)]) + page.groups[0].shift
    (left, top), (right, bottom) = np.rint(corners * 300 / INCH).astype(int) + [[2, 2], [-2, -2]]
    of_print = image[top:bottom, left:right], plain[top:bottom, left:right]
    assert np.abs(of_print[0].astype(int) - (255 - of_print[1].astype(int))).max() <= 1
    assert (
        image[2, 2] == 255 and (image[top:bottom, left - 8] == 0).all()
    )  # the page's margin is white, the border black
    found = binocal.detect(cv2.GaussianBlur(image, (0, 0), 1.0), board)
    assert found.is_found, found.reason
    assert np.abs((found.points_px + 0.5) * INCH / 300 - points_mm(board, page)).max() < TRUE_TO_MM


@pytest.mark.parametrize("spec", ["chessboard:7x5:6mm:marked", "circles:7x5:6mm:hollow"])
def test_inverted_pdf_svg_and_dxf_hold_the_same_shapes(spec):
    board = parse_board(spec)
    sheet = SheetOptions(4.0, False, PrintStyle(is_inverted=True))
    (page,) = lay_out_pages(board, PrintRequest((3 * INCH, 2.6 * INCH), sheet=sheet))
    pdfium = pytest.importorskip("pypdfium2", reason="pypdfium2 rasterises PDF files; it is in the extra test")
    drawn = pdfium.PdfDocument(pdf_content([page], spec))[0].render(scale=300 / 72, grayscale=True).to_numpy().squeeze()
    image = cv2.imdecode(np.frombuffer(png_content(page, 300.0), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert np.abs(cv2.resize(drawn, image.shape[::-1]).astype(float) - image).mean() < 2
    text = dxf_text(page)
    plain = dxf_text(small_page(spec)[1])
    assert len(outlines_of(text, "BOARD")) == len(outlines_of(plain, "BOARD")) + 1  # the ground's
    assert text.count("CIRCLE") == plain.count("CIRCLE") > 0
    svg = svg_text(page, spec)
    assert svg.count("<circle") == text.count("CIRCLE") and 'fill="#fff"' in svg.split("<circle", 1)[1]


def detect_with_opencv(image: np.ndarray, board: Board, is_legacy: bool) -> np.ndarray:
    """The board's points in its own order, by OpenCV's detectors as its users would call them; NaN where one is not found."""
    size = (board.columns, board.rows)
    if board.kind == "chessboard":
        ok, points = cv2.findChessboardCornersSB(image, size)
        assert ok
        points = points.reshape(-1, 2)
        return points if points[0, 0] < points[-1, 0] else points[::-1]
    if board.kind in ("circles", "acircles"):
        flag = cv2.CALIB_CB_ASYMMETRIC_GRID if board.kind == "acircles" else cv2.CALIB_CB_SYMMETRIC_GRID
        parameters = cv2.SimpleBlobDetector_Params()
        parameters.maxArea = 1e5
        ok, points = cv2.findCirclesGrid(
            image, size, flags=flag, blobDetector=cv2.SimpleBlobDetector_create(parameters)
        )
        assert ok
        points = points.reshape(-1, 2)
        return points if points[0].sum() < points[-1].sum() else points[::-1]
    if board.kind == "squares":  # OpenCV has no detector of square grids: outlines, as its tutorials do
        outlines, _ = cv2.findContours((image < 128).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        quads = [cv2.approxPolyDP(outline, 0.04 * cv2.arcLength(outline, True), True) for outline in outlines]
        points = np.concatenate([quad for quad in quads if len(quad) == 4]).astype(np.float32)
        assert len(points) == board.n_points
        points = cv2.cornerSubPix(image, points, (5, 5), (-1, -1), (3, 50, 1e-3)).reshape(-1, 2)
        return points[np.lexsort((points[:, 0], np.rint(points[:, 1] / 10)))]
    points = np.full((board.n_points, 2), np.nan)
    if board.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        charuco = cv2.aruco.CharucoBoard(size, board.pitch_m, board.marker_m, dictionary)
        charuco.setLegacyPattern(is_legacy)
        corners, ids, _, marker_ids = cv2.aruco.CharucoDetector(charuco).detectBoard(image)
        assert sorted(marker_ids.ravel()) == list(range(board.columns * board.rows // 2))
        assert len(ids) == board.n_points
        points[ids.ravel()] = corners.reshape(-1, 2)
        return points
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    assert sorted(ids.ravel()) == list(range(board.columns * board.rows))
    order = {int(tag): index for index, tag in enumerate(board.tag_ids)}
    for tag, quad in zip(ids.ravel(), corners, strict=True):
        # OpenCV holds the family turned by 180 degrees
        points[4 * order[int(tag)] + np.arange(4)] = np.roll(quad.reshape(4, 2), 2, axis=0)
    return points


def outlines_of(dxf: str, layer: str) -> list[np.ndarray]:
    """The closed polylines of a layer, as a reader of DXF sees them: pairs of a code and a value."""
    lines = dxf.splitlines()
    found, points, place = [], None, {}
    for code, value in zip(map(int, lines[::2]), lines[1::2], strict=True):
        if code == 0:
            if points is not None and place.get(0) == "VERTEX":
                points.append((place[10], place[20]))
            if value == "POLYLINE":
                points = []
            elif value == "SEQEND":
                if place.get(8) == layer:
                    found.append(np.array(points, dtype=float))
                points = None
            place = {0: value}
        else:
            place[code] = value
    return found


def test_a_dxf_holds_every_square_as_a_closed_polyline(tmp_path):
    printed = print_board(parse_board("chessboard:4x3:20mm"), tmp_path / "b.dxf")
    text = (tmp_path / "b.dxf").read_text()
    squares = outlines_of(text, "BOARD")
    assert len(squares) == 10 and "$INSUNITS\n70\n4\n" in text and text.count("POLYLINE\n8\nBOARD\n66\n1") == 10
    for square in squares:
        assert np.ptp(square, axis=0) == pytest.approx([20, 20])
    every = np.concatenate(squares)
    assert np.ptp(every, axis=0) == pytest.approx([100, 80]) and printed.distances_mm == pytest.approx((100, 80))
    top_left = squares[np.argmin([s[:, 0].min() - s[:, 1].max() for s in squares])]
    assert top_left[:, 0].min() == pytest.approx(every[:, 0].min())  # y runs up: black at the top left
    (sheet,) = outlines_of(text, "SHEET")
    assert np.ptp(sheet, axis=0) == pytest.approx(printed.page_mm, abs=1e-5)


def test_opencv_finds_the_marks_of_a_printed_chessboard():
    _, page = small_page("chessboard:8x5:6mm:marked")
    image = as_photographed(png_content(page, 300.0))
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(image, (8, 5), cv2.CALIB_CB_MARKER)
    assert found and np.count_nonzero(meta > 2) == 3
    grid = corners.reshape(*meta.shape, 2)
    for value, is_black in ((3, False), (4, True)):  # of squares with a white disc, and with a black one
        centres = np.array([grid[r : r + 2, c : c + 2].mean(axis=(0, 1)) for r, c in np.argwhere(meta == value)])
        theirs = (centres + 0.5) * INCH / 300 - page.groups[0].shift
        discs = [shape for shape in page.groups[0].shapes if isinstance(shape, Disc) and shape.is_black == is_black]
        away = theirs[:, None] - np.array([[disc.x, disc.y] for disc in discs])
        assert np.linalg.norm(away, axis=-1).min(axis=1).max() < 0.02 and len(theirs) == len(discs)


def test_white_discs_are_white_in_every_kind_of_file(tmp_path):
    board = parse_board("chessboard:8x5:20mm:marked")
    print_board(board, tmp_path / "b.svg")
    assert (tmp_path / "b.svg").read_text().count(' r="3.4" fill="#fff"/>') == 2
    print_board(board, tmp_path / "b.dxf")
    assert (tmp_path / "b.dxf").read_text().count("CIRCLE") == 3
    _, page = small_page("chessboard:8x5:6mm:marked")
    stream = pdf_content([page], "").split(b"stream\n")[1].removesuffix(b"\nend")
    assert zlib.decompress(stream).count(b"1 g ") == 2


def test_a_dxf_of_circles_has_circles(tmp_path):
    print_board(parse_board("circles:4x3:20mm"), tmp_path / "b.dxf")
    circles = re.findall(r"CIRCLE\n8\nBOARD\n10\n(.*)\n20\n(.*)\n30\n.*\n40\n(.*)\n", (tmp_path / "b.dxf").read_text())
    assert len(circles) == 12 and {float(radius) for _, _, radius in circles} == {5.0}


def test_an_svg_is_in_millimetres_and_has_the_same_outlines(tmp_path):
    board = parse_board("charuco:5x4:20mm:15mm:DICT_4X4_50")
    print_board(board, tmp_path / "b.svg")
    text = (tmp_path / "b.svg").read_text()
    assert re.search(r'width="297mm" height="210mm" viewBox="0 0 297 210"', text)
    path = re.search(r'<g id="board0".*?<path fill-rule="evenodd" d="([^"]*)"', text, re.DOTALL)
    points = np.array([tuple(map(float, pair.split())) for pair in re.findall(r"[\d.]+ [\d.]+", path[1])])
    assert np.ptp(points, axis=0) == pytest.approx([100, 80])


def test_the_qr_code_says_the_spec(tmp_path):
    for spec in ("chessboard:9x6:20mm", "charuco:5x4:30mm:22.5mm:DICT_5X5_50"):
        print_board(parse_board(spec), tmp_path / "b.png", force=True)
        image = cv2.imread(str(tmp_path / "b.png"), cv2.IMREAD_GRAYSCALE)
        assert cv2.QRCodeDetector().detectAndDecode(image[-450:, :450])[0] == spec


def test_the_bars_are_a_hundred_millimetres_long():
    (page,) = lay_out_pages(parse_board("chessboard:9x6:20mm"), PrintRequest())
    boxes = [np.ptp(o, axis=0) for shape in page.groups[1].shapes if hasattr(shape, "outlines") for o in shape.outlines]
    lengths = [tuple(np.round(box, 6)) for box in boxes]
    assert (100.0, 0.2) in lengths and (0.2, 100.0) in lengths


@pytest.mark.parametrize(
    ("spec", "across", "along"),
    [
        ("chessboard:9x6:20mm", 200, 140),
        ("charuco:5x4:30mm:22mm:DICT_5X5_50", 150, 120),
        ("aprilgrid:3x2:50mm:0.3", 180, 115),
        ("circles:7x5:25mm", 150, 100),
        ("acircles:4x11:12mm", 84, 120),
        ("squares:4x3:30mm:20mm", 180, 130),
    ],
)
def test_the_distances_to_measure_are_the_lines_that_are_printed(spec, across, along):
    board = parse_board(spec)
    x0, y0, x1, y1 = 1e3 * np.array(measured_box_m(board))
    assert (x1 - x0, y1 - y0) == pytest.approx((across, along))
    (page,) = lay_out_pages(board, PrintRequest())
    shift = np.array(page.groups[0].shift) - 1e3 * np.array(printed_extent_m(board)[:2])
    marks = np.array([outline.mean(axis=0) for outline in page.groups[1].shapes[0].outlines])
    assert marks[[0, 2], 0] == pytest.approx([x0 + shift[0], x1 + shift[0]])
    assert marks[[5, 3], 1] == pytest.approx([y0 + shift[1], y1 + shift[1]])


def test_the_smallest_page_is_taken_and_turned(tmp_path):
    printed = print_board(parse_board("chessboard:9x6:20mm"), tmp_path / "a.pdf")
    assert printed.page_mm == (297.0, 210.0) and printed.n_pages == 1
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF-1.6")
    assert lay_out_pages(parse_board("charuco:11x8:30mm:22mm:DICT_5X5_50"), PrintRequest())[0].width == 420.0
    assert lay_out_pages(parse_board("chessboard:9x6:5mm"), PrintRequest(PAPERS["A4"], True))[0].height == 210.0


def test_a_board_that_fits_no_page_is_refused_with_what_would_do():
    board = parse_board("chessboard:9x6:25mm")
    with pytest.raises(ValueError, match=r"needs 290 x 229 mm .* take --page A3, --no-notes, or --tiles"):
        lay_out_pages(board, PrintRequest(PAPERS["A4"]))
    with pytest.raises(ValueError, match=r"take --page 1071x985mm, or --tiles"):
        lay_out_pages(parse_board("chessboard:9x8:100mm"), PrintRequest())
    with pytest.raises(ValueError, match="needs its size"):
        lay_out_pages(parse_board("chessboard:9x6"), PrintRequest())


def test_the_parts_of_a_split_board_lie_on_one_another(tmp_path):
    board = parse_board("chessboard:9x6:40mm")
    dots = 2.0  # in a millimetre
    sheet = SheetOptions(0.0)
    whole = lay_out_pages(board, PrintRequest(sheet_size_mm(board, sheet), sheet=sheet))[0]
    printed = print_board(
        board, tmp_path / "b.png", PrintRequest(PAPERS["A3"], is_tiled=True, dpi=dots * INCH), force=True
    )
    assert [path.name for path in printed.paths] == ["b-1.png", "b-2.png"] and printed.page_mm == (297.0, 420.0)
    full = cv2.imdecode(np.frombuffer(png_content(whole, dots * INCH), np.uint8), cv2.IMREAD_GRAYSCALE)
    for i, path in enumerate(printed.paths):
        part = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)[20:-20, 20:-20]  # within margins of 10 mm
        start = i * int(dots * (277 - 10))  # pages overlap by 10 mm
        same = full[: part.shape[0], start : start + part.shape[1]]
        assert np.abs(part[: same.shape[0], : same.shape[1]].astype(int) - same).mean() < 1.0
    first, second = (cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in printed.paths)
    mark = int(dots * (10 + 277 - 5))  # in the middle of the overlap
    assert first[10, mark - 1 : mark + 1].max() < 210 and second[10, 2 * 15 - 1 : 2 * 15 + 1].max() < 210


def test_a_file_for_cutters_is_not_split(tmp_path):
    with pytest.raises(ValueError, match="the board needs"):
        print_board(parse_board("chessboard:9x6:40mm"), tmp_path / "b.dxf", PrintRequest(PAPERS["A4"], is_tiled=True))


@pytest.mark.parametrize(
    "spec", ["chessboard:9x6:20mm", "aprilgrid:3x2:50mm:0.25", "circles:7x5:25mm", "acircles:4x11:12mm"]
)
def test_kalibrs_target_beside_it_is_the_same_board(tmp_path, spec):
    board = parse_board(spec)
    print_board(board, tmp_path / "b.svg", kalibr=tmp_path / "target.yaml")
    assert load_board(str(tmp_path / "target.yaml")) == board


def test_a_board_that_kalibr_lacks_writes_nothing(tmp_path):
    with pytest.raises(ValueError, match="no ChArUco"):
        print_board(
            parse_board("charuco:5x4:30mm:22mm:DICT_5X5_50"), tmp_path / "b.svg", kalibr=tmp_path / "target.yaml"
        )
    assert not list(tmp_path.iterdir())


def test_papers():
    assert parse_paper("a3") == (297.0, 420.0) and parse_paper("500x400mm") == (500.0, 400.0)
    assert parse_paper("8.5x11in") == pytest.approx(PAPERS["letter"]) and smallest_paper(290, 200) == "A4"
    assert smallest_paper(1200, 100) is None
    for text in ("A9", "5x5mm", "10x10", "9000x100mm", "x"):
        with pytest.raises(ValueError, match="page"):
            parse_paper(text)


def test_rings_are_printed_with_their_holes():
    pdfium = pytest.importorskip("pypdfium2", reason="pypdfium2 rasterises PDF files; it is in the extra test")
    board, page = small_page("circles:7x5:6mm:hollow")
    png = cv2.imdecode(np.frombuffer(png_content(page, 300.0), np.uint8), cv2.IMREAD_GRAYSCALE)
    pdf = (
        pdfium.PdfDocument(pdf_content([page], "rings"))[0].render(scale=300 / 72, grayscale=True).to_numpy().squeeze()
    )
    for image in (png, pdf):
        found = binocal.detect(cv2.GaussianBlur(image, (0, 0), 1.0), board)
        assert (
            found.is_seen.all() and np.abs((found.points_px + 0.5) * INCH / 300 - points_mm(board, page)).max() < 0.1
        )  # pdfium stretches a page to whole pixels
        grey = image[tuple(np.rint(found.points_px).astype(int).T[::-1])]
        assert np.flatnonzero(grey > 128).tolist() == sorted(board.marked_points)
    assert svg_text(page, "rings").count('fill="none" stroke="#000"') == 3
    assert dxf_text(page).count("CIRCLE") == 35 + 3
