"""The two distances that a ruler finds on a printed board."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import binocal
from binocal.app import CalibrationRequest, calibrate_corners
from binocal.boards import parse_board
from binocal.boards.measured import board_as_measured, measured_box_m, parse_measured
from binocal.cli import main
from binocal.errors import DataError
from contracts import make_corners


def test_two_lengths_with_units():
    assert parse_measured("199.4mm, 13.99cm") == pytest.approx((0.1994, 0.1399))
    for text in ("199.4mm", "199.4,139.9", "199.4mm,139.9", "1mm,2mm,3mm", "x,y", "-1mm,2mm"):
        with pytest.raises(ValueError):
            parse_measured(text)


@pytest.mark.parametrize(
    "spec",
    [
        "chessboard:9x6:20mm",
        "charuco:5x4:30mm:22mm:DICT_5X5_50",
        "aprilgrid:3x2:50mm:0.3",
        "acircles:4x11:12mm",
        "squares:4x3:30mm:20mm",
    ],
)
def test_scales_are_measured_over_drawn(spec):
    board = parse_board(spec)
    x0, y0, x1, y1 = measured_box_m(board)
    same, scales = board_as_measured(board, (0.997 * (x1 - x0), 1.002 * (y1 - y0)))
    assert same == board and scales == pytest.approx((0.997, 1.002))


def test_a_board_without_a_scale_gets_one():
    board, scales = board_as_measured(parse_board("charuco:5x4:1:0.7:DICT_5X5_50"), (0.1505, 0.1198))
    assert board.is_metric and board.marker_m / board.pitch_m == pytest.approx(0.7)
    assert board.pitch_m * 5 * scales[0] == pytest.approx(0.1505)
    assert board.pitch_m * 4 * scales[1] == pytest.approx(0.1198)
    board, _ = board_as_measured(parse_board("squares:4x3:2:1"), (0.165, 0.12))
    assert board.pitch_m == pytest.approx(0.03) and board.gap_m == pytest.approx(0.015)


@pytest.mark.parametrize(
    ("measured", "text"),
    [
        ((0.18, 0.14), "A-B measures 180mm and should have 200mm, which is more than 5 % off"),
        ((0.1, 2.0), "A-B measures 100mm and should have 200mm and A-C measures 2000mm and should have 140mm"),
        ((0.2, 0.12), "A-C measures 120mm and should have 140mm"),
        ((0.14, 0.2), "are they exchanged"),
    ],
)
def test_another_distance_is_refused_by_name(measured, text):
    with pytest.raises(ValueError, match=text) as caught:
        board_as_measured(parse_board("chessboard:9x6:20mm"), measured)
    assert "over all its squares" in str(caught.value)


def corners_file(tmp_path, spec: str = "chessboard:11x8:20mm"):
    """Corners that name their board."""
    board = parse_board(spec)
    corners = make_corners()
    assert np.allclose(corners.object_points_m, board.object_points_m)
    binocal.write_detections(tmp_path / "corners.npz", replace(corners, board_spec=spec))
    return tmp_path / "corners.npz"


def test_corners_are_calibrated_on_the_measured_board(tmp_path):
    path = corners_file(tmp_path)
    request = CalibrationRequest(model="brown4", board_shape="flat")
    plain = calibrate_corners(path, request, calibrator="lm").calibration
    larger = calibrate_corners(path, request, calibrator="lm", measured_m=(0.24 * 1.02, 0.18 * 1.02)).calibration
    assert larger.rig.baseline_m == pytest.approx(1.02 * plain.rig.baseline_m, rel=1e-6)
    assert larger.provenance["measured"]["scale_x"] == pytest.approx(1.02)
    with pytest.raises(DataError, match="A-B measures 100mm and should have 240mm"):
        calibrate_corners(path, measured_m=(0.1, 0.18))


def test_the_option_reaches_the_evidence_and_the_provenance(tmp_path, capsys):
    path = corners_file(tmp_path)
    arguments = [
        "calibrate",
        "--corners",
        path,
        "--model",
        "brown4",
        "--calibrator",
        "lm",
        "--board-shape",
        "flat",
        "--no-checks",
    ]
    arguments += ["--measured", "240.6mm,179.7mm", "--output", tmp_path / "rig.json", "--evidence", tmp_path / "e.npz"]
    assert main([*map(str, arguments), "--json"]) == 0
    measured = json.loads(capsys.readouterr().out)["provenance"]["measured"]
    assert measured["A-B_m"] == 0.2406 and measured["scale_y"] == pytest.approx(179.7 / 180)
    points = binocal.read_detections(tmp_path / "e.npz").object_points_m
    assert np.ptp(points, axis=0) == pytest.approx([0.2 * 240.6 / 240, 0.14 * 179.7 / 180, 0])
    # the evidence is of the measured board already: the same ruler changes nothing
    arguments[2], arguments[-3], arguments[-1] = tmp_path / "e.npz", tmp_path / "r2.json", tmp_path / "e2.npz"
    assert main([str(a) for a in arguments]) == 0
    assert binocal.read_detections(tmp_path / "e2.npz").object_points_m == pytest.approx(points, rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--measured", "200mm,140mm", "--board-file", "rig.json"], "leave it out, or"),
        (["--measured", "200mm"], "is not two lengths"),
        (["--measured", "140mm,200mm"], "are they exchanged?"),
    ],
)
def test_wrong_options_are_refused_before_any_image_is_read(arguments, text, capsys):
    assert main(["calibrate", "--left", "l", "--right", "r", "--board", "chessboard:9x6:20mm", *arguments]) == 2
    assert text in capsys.readouterr().err
