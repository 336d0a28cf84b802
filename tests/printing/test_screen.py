"""Boards in whole pixels of a screen."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess

import cv2
import numpy as np
import pytest

import binocal
from binocal.app.board import write_screen_board
from binocal.boards import Board, load_board, parse_board
from binocal.printing.board_shapes import PrintStyle
from binocal.printing.screen import NOTE_PX, Screen, ScreenBoard, fit_board, screen_page
from binocal.report.printing import NAMES

KINDS = [
    "chessboard:9x6:20mm",
    "charuco:11x8:30mm:22mm:DICT_5X5_50",
    "aprilgrid:4x3:40mm:0.3",
    "circles:10x8:20mm",
    "acircles:4x11:20mm",
    "squares:5x4:30mm:20mm",
    "aprilgrid:4x3:40mm:0.3:tag25h9:5",
]


def image_of(page: str) -> np.ndarray:
    data = base64.b64decode(re.search(r"base64,([^\"]*)\"", page)[1])
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)


def farthest_px(image: np.ndarray, board: Board, shown: ScreenBoard) -> float:
    """The farthest point from where whole pixels of pitch put it."""
    found = binocal.detect(cv2.GaussianBlur(image, (0, 0), 1.0), board)
    assert found.is_found, found.reason
    away = found.points_px - board.object_points_m[:, :2] / board.pitch_m * shown.pitch_px
    return float(np.abs(away - away.mean(axis=0)).max())


@pytest.mark.parametrize("spec", KINDS)
def test_edges_lie_between_pixels_and_the_pitch_is_right(spec):
    screen = Screen.of_diagonal((1920, 1080), 0.6)
    shown = fit_board(parse_board(spec), screen)
    image = image_of(screen_page(shown, screen))
    assert image.shape[::-1] == shown.size_px and image.shape[0] <= 1080 - NOTE_PX
    board = parse_board(shown.spec)
    assert board.pitch_m == pytest.approx(shown.pitch_px * 0.6 / np.hypot(1920, 1080), rel=1e-5)
    if board.kind not in ("circles", "acircles"):
        assert set(np.unique(image)) == {0, 255}
    most = (
        2e-3 if board.kind == "squares" else 1e-3
    )  # 0.0014: grey levels are whole, and the gap in the SPEC is rounded
    assert farthest_px(np.pad(image, 50, constant_values=255), board, shown) < most


@pytest.mark.parametrize("spec", ["charuco:11x8:30mm:22mm:DICT_5X5_50", "circles:10x8:20mm"])
def test_an_inverted_board_is_on_a_black_page(spec):
    screen, style = Screen.of_diagonal((1920, 1080), 0.6), PrintStyle(is_inverted=True)
    shown = fit_board(parse_board(spec), screen, style)
    page = screen_page(shown, screen, style)
    assert "background: #000" in page and "@" not in re.sub(r"base64,[^\"]*", "", page).replace("@media", "")
    image = image_of(page)
    assert np.array_equal(image, 255 - image_of(screen_page(shown, screen)))
    assert farthest_px(np.pad(image, 50, constant_values=0), parse_board(shown.spec), shown) < 1e-3


def test_the_pitch_is_the_specs_where_it_fits_else_the_largest():
    screen = Screen.of_diagonal((2560, 1440), 27 * 0.0254)
    assert fit_board(parse_board("chessboard:9x6:20mm"), screen).pitch_px == round(0.02 / screen.pixel_m)
    large = fit_board(parse_board("chessboard:9x6:200mm"), screen)
    assert large.size_px[1] + 2 * large.pitch_px / 3 <= 1440 - NOTE_PX < large.size_px[1] + 2 * large.pitch_px
    assert fit_board(parse_board("chessboard:9x6"), Screen((2560, 1440), None)).pitch_px == large.pitch_px


def test_without_a_diagonal_the_scale_is_unknown():
    shown = fit_board(parse_board("charuco:5x4:1:0.75:DICT_4X4_50"), Screen((640, 480), None))
    assert not parse_board(shown.spec).is_metric and shown.template.startswith(f"charuco:5x4:{{{shown.pitch_px}}}:{{")


def test_a_square_grids_gap_is_whole_pixels_too():
    shown = fit_board(parse_board("squares:5x4:30mm:20mm"), Screen((640, 480), None))
    side, gap = shown.pitch_px, round(shown.board.gap_m / shown.board.pitch_m * shown.pitch_px)
    assert shown.template == f"squares:5x4:{{{side}}}:{{{gap}}}" and abs(gap / side - 2 / 3) < 1 / side


def test_a_screens_board_keeps_its_marks():
    shown = fit_board(parse_board("chessboard:9x6:marked"), Screen((640, 480), None))
    assert shown.spec == "chessboard:9x6:marked"
    assert shown.template == f"chessboard:9x6:{{{shown.pitch_px}}}:marked"


def test_a_screen_of_too_few_pixels_is_refused():
    with pytest.raises(ValueError, match="99 x 88 pixels are too few"):
        fit_board(parse_board("chessboard:90x60"), Screen((99, 88), None))
    with pytest.raises(ValueError, match="not plausible"):
        Screen.of_diagonal((1920, 1080), 27.0)


def test_kalibrs_target_is_of_the_board_as_shown(tmp_path):
    shown = write_screen_board(
        parse_board("aprilgrid:6x6:88mm:0.3"),
        tmp_path / "b.html",
        Screen.of_diagonal((1920, 1080), 0.6),
        kalibr=tmp_path / "t.yaml",
    )
    assert load_board(str(tmp_path / "t.yaml")) == parse_board(shown.spec)
    with pytest.raises(ValueError, match=r"does not end in .html"):
        write_screen_board(parse_board("chessboard:9x6"), tmp_path / "b.pdf", Screen((640, 480), None))


def test_a_browser_shows_it_pixel_by_pixel(tmp_path, ratio=2):
    browser = next((path for name in NAMES if (path := shutil.which(name))), None)
    if browser is None:
        pytest.skip(f"no browser to show the page in: {', '.join(NAMES)}")
    shown = write_screen_board(
        parse_board("charuco:7x5:30mm:22mm:DICT_4X4_50"),
        tmp_path / "b.html",
        Screen.of_diagonal((1200, 800), 0.4),
    )
    arguments = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={tmp_path}/user"]
    arguments += [f"--window-size={1200 // ratio},{800 // ratio}", f"--force-device-scale-factor={ratio}"]
    arguments += [f"--screenshot={tmp_path}/s.png", (tmp_path / "b.html").as_uri()]
    subprocess.run([browser, *arguments], capture_output=True, timeout=60, check=True)
    image = cv2.imread(str(tmp_path / "s.png"), cv2.IMREAD_GRAYSCALE)
    assert image.shape == (800, 1200) and set(np.unique(image[: 800 - 3 * NOTE_PX])) == {0, 255}
    assert farthest_px(image, parse_board(shown.spec), shown) < 1e-3
