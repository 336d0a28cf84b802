"""Images that show several boards: every board a view of its own, and one pair of images calibrates a rig."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from binocal import app, detect_boards, read_detections, write_detections
from binocal.app.report_images import report_images
from binocal.boards import BoardSet
from binocal.calibrators.base import CalibrationRequest
from binocal.cameras import Camera, StereoRig
from binocal.cli import main
from binocal.errors import DataError, DetectionError
from binocal.geometry import SE3, so3
from binocal.simulation import RenderOptions, draw_room, render_room

BOARDS = BoardSet.from_specs(["chessboard:6x4:90mm", "chessboard:7x5:70mm"])
SPECS = [option for board in ("chessboard:6x4:90mm", "chessboard:7x5:70mm") for option in ("--board", board)]


@pytest.fixture(scope="module")
def room():
    left = Camera("brown4", (900, 720), np.array([640.0, 639, 446, 362, 0, -0.2, 0.05, 4e-4, -3e-4]))
    right = Camera("brown4", (900, 720), np.array([636.0, 637, 455, 357, 0, -0.2, 0.05, -3e-4, 2e-4]))
    T_right_left = SE3(so3.exp(np.radians([0.5, 1.0, -0.4])), np.array([-0.2, 0.003, -0.006]))
    return draw_room(StereoRig(left, right, T_right_left), BOARDS, np.random.default_rng(3), columns=3, rows=3)


@pytest.fixture(scope="module")
def folder(room, tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    images = render_room(room, RenderOptions(noise_dn=2.0), np.random.default_rng(3))
    for side, image in zip(("left", "right"), images, strict=True):
        cv2.imwrite(str(folder / f"{side}0.png"), image)
    return folder


@pytest.fixture(scope="module")
def run(folder):
    sides = (str(folder / "left*"), str(folder / "right*"))
    return app.calibrate_images(*sides, BOARDS, CalibrationRequest("brown4"))


def test_every_board_of_an_image_is_found_of_its_own_spec_and_nothing_else(room, folder):
    found = detect_boards(cv2.imread(str(folder / "left0.png")), BOARDS)
    for kind, (of_spec, board) in enumerate(zip(found, BOARDS.boards, strict=True)):
        truth = [k for k, of_board in enumerate(room.kind) if of_board == kind]
        assert len(of_spec) == len(truth)
        for k in truth:
            px = room.rig.left.project(SE3(room.T_left_board.R[k], room.T_left_board.t[k]).apply(board.object_points_m))
            assert min(np.abs(one.points_px - px).max() for one in of_spec) < 0.3  # 0.07 px at the worst corner


def test_one_pair_of_images_calibrates_the_rig_within_its_sigmas(room, run):
    calibration, rig = run.calibration, room.rig
    assert len(calibration.views) == len(room.kind) and not calibration.rejected
    assert calibration.views[0].name == "0 board 1" and calibration.evidence.detections.shots == (0,) * len(room.kind)
    assert calibration.board_shape is None  # of different boards
    sigma = calibration.covariance.sigma
    for name, error in (
        ("left.fx", calibration.rig.left.K[0, 0] - rig.left.K[0, 0]),
        ("right.cy", calibration.rig.right.K[1, 2] - rig.right.K[1, 2]),
        ("translation.x", calibration.rig.T_right_left.t[0] - rig.T_right_left.t[0]),
    ):
        assert abs(error) < 4 * sigma[name]
    assert sigma["translation.x"] < 1e-3 and calibration.rms.all_px < 0.05


def test_corners_of_several_boards_are_written_and_read(run, tmp_path):
    path = tmp_path / "corners.npz"
    write_detections(path, run.detections)
    again = read_detections(path)
    assert again.shots == run.detections.shots and again.board_spec == "chessboard:6x4:90mm + chessboard:7x5:70mm"
    from_corners = app.calibrate_corners(path, CalibrationRequest("brown4")).calibration
    assert from_corners.rig.baseline_m == run.calibration.rig.baseline_m
    assert again.select(np.array([1, 0])).shots == (0, 0)


def test_a_report_shows_the_pair_rectified_and_says_that_views_share_their_images(folder, run):
    sides = (str(folder / "left*"), str(folder / "right*"))
    views, rectified, notes = report_images(run.calibration, *sides)
    assert not views and rectified is not None and rectified.name == "0" and "several views" in notes[0]


def test_the_command_line_takes_several_boards_and_evaluates_on_them(folder, tmp_path, capsys):
    sides = ["--left", str(folder / "left*"), "--right", str(folder / "right*")]
    output = str(tmp_path / "rig.json")
    assert main(["calibrate", *sides, *SPECS, "--model", "brown4", "--no-checks", "--output", output, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["provenance"]["board"] == BOARDS.spec
    assert main(["evaluate", output, *sides, *SPECS, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["pixel_error_px"]["all"] < 0.05


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ([*SPECS, "--board", "chessboard:5x7:30mm"], "cannot be told apart"),
        ([*SPECS, "--measured", "500mm,400mm"], "--measured is about one board"),
    ],
)
def test_boards_that_do_not_go_together_are_refused_before_images_are_read(options, told, capsys):
    assert main(["calibrate", "--left", "l*", "--right", "r*", *options]) == 2
    assert told in capsys.readouterr().err


def test_different_boards_have_no_shape_in_common(run, tmp_path):
    path = tmp_path / "corners.npz"
    write_detections(path, run.detections)
    with pytest.raises(DataError, match="no shape in common"):
        app.calibrate_corners(path, CalibrationRequest("brown4", board_shape="free"))


def test_images_without_any_of_the_boards_are_refused(tmp_path):
    for side in ("left", "right"):
        cv2.imwrite(
            str(tmp_path / f"{side}0.png"), np.tile(np.arange(len(side), len(side) + 64, dtype=np.uint8), (48, 1))
        )
    with pytest.raises(DetectionError, match="no board of 6x4, 7x5"):
        app.calibrate_images(str(tmp_path / "left*"), str(tmp_path / "right*"), BOARDS)


def test_marker_boards_with_other_ids_in_one_image_are_each_found():
    boards = BoardSet.from_specs(
        [
            "charuco:5x4:40mm:30mm:DICT_4X4_50",
            "charuco:5x4:40mm:30mm:DICT_4X4_50:10",
            "aprilgrid:2x2:60mm:0.3",
            "chessboard:6x4:30mm",
        ]
    )
    camera = Camera("brown4", (1000, 760), np.array([800.0, 800, 500, 380, 0, 0, 0, 0, 0]))
    places = [(-0.23, -0.16), (0.05, -0.16), (-0.2, 0.05), (0.07, 0.05)]
    poses = [SE3(so3.exp(np.array([0.2, -0.2, 0.05 * k])), np.array([x, y, 0.6])) for k, (x, y) in enumerate(places)]
    from binocal.simulation.imaging import read_out
    from binocal.simulation.renderer import render_lights

    rng = np.random.default_rng(0)
    light = render_lights(camera, list(zip(boards.boards, poses, strict=True)), RenderOptions(clutter_dn=10), rng)
    image = read_out(light, rng, noise_dn=2.0, gamma=1.0, bit_depth=8)
    for board, T, of_spec in zip(boards.boards, poses, detect_boards(image, boards), strict=True):
        assert len(of_spec) == 1
        off = np.linalg.norm(of_spec[0].points_px - camera.project(T.apply(board.object_points_m)), axis=1)
        assert np.nanmax(off) < 0.3 and np.isfinite(off).mean() > 0.9
