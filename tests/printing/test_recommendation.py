"""Which board for which cameras and distances."""

from __future__ import annotations

import numpy as np
import pytest

import binocal
from binocal.app.board import PrintRequest, lay_out_pages, load_viewer
from binocal.boards import parse_board
from binocal.cameras import StereoRig
from binocal.errors import FormatError
from binocal.geometry import SE3
from binocal.printing.board_shapes import board_size_mm
from binocal.printing.paper import parse_paper
from binocal.printing.recommendation import LEAST_SQUARE_PX, MOST_SHARE, camera_of_field, recommend_board
from binocal.simulation import RenderOptions, render_image, table2_rig


@pytest.mark.parametrize(
    ("field_deg", "size_wh", "near_m", "far_m", "kind"),
    [
        (60, (1280, 960), 0.5, 3, "chessboard"),
        (60, (1280, 960), 0.5, 1.5, "chessboard"),
        (25, (640, 480), 0.1, 0.2, "chessboard"),
        (30, (2448, 2048), 2, 20, "chessboard"),
        (90, (1280, 960), 1, 8, "charuco"),
        (150, (1280, 960), 0.3, 2, "charuco"),
    ],
)
def test_both_ends_of_the_range_are_served(field_deg, size_wh, near_m, far_m, kind):
    camera = camera_of_field(field_deg, size_wh)
    found = recommend_board(camera, near_m, far_m)
    board, focal_px = found.board, camera.parameters[0]
    assert board.kind == kind and (board.columns + board.rows) % 2 == 1
    assert focal_px * board.pitch_m / far_m == pytest.approx(found.square_px)
    assert found.square_px >= LEAST_SQUARE_PX[kind]
    shares = 1e-3 * np.array(board_size_mm(board)) * focal_px / near_m / size_wh
    assert shares.max() == pytest.approx(found.share) and 0.4 <= found.share <= MOST_SHARE[kind] + 1e-9
    (page,) = lay_out_pages(board, PrintRequest(parse_paper(found.page)))
    assert {page.width, page.height} == set(parse_paper(found.page))


def test_the_board_is_found_at_the_far_end(distance_m=3.0):
    camera = camera_of_field(60, (1280, 960))
    board = recommend_board(camera, 0.5, 3).board
    middle = board.object_points_m.mean(axis=0)
    turned = SE3.exp(np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    pose = SE3(turned.R, np.array([0.0, 0.0, distance_m]) - turned.R @ middle)
    image = render_image(camera, pose, board, RenderOptions(blur_px=0.8), np.random.default_rng(0)).image
    assert binocal.detect(image, board).is_found


def test_the_field_of_view_is_that_of_the_camera():
    for field_deg in (60, 150, 200):
        camera = camera_of_field(field_deg, (1280, 960))
        rays = camera.unproject(np.array([[-0.5, 479.5], [1279.5, 479.5]]))
        angles = np.degrees(np.arctan2(rays[:, 0], rays[:, 2]))
        assert angles == pytest.approx([-field_deg / 2, field_deg / 2], abs=1e-6)


def test_what_both_cameras_see_bounds_the_board():
    alone = recommend_board(table2_rig().left, 0.3, 1.0)
    rig = StereoRig(table2_rig().left, table2_rig().left, SE3(np.eye(3), np.array([-0.13, 0.0, 0.0])))
    together = recommend_board(rig, 0.3, 1.0)
    assert together.share < alone.share
    rig = StereoRig(rig.left, rig.left, SE3(np.eye(3), np.array([-0.21, 0.0, 0.0])))
    with pytest.raises(ValueError, match=r"see only 1. % of the image together; begin the range farther away"):
        recommend_board(rig, 0.3, 1.0)


def test_a_range_that_no_board_serves_says_how_long_one_may_be():
    with pytest.raises(ValueError, match=r"a square must have 541 mm .* at most 8.6 times the near one"):
        recommend_board(camera_of_field(60, (1280, 960)), 0.1, 30)
    assert recommend_board(camera_of_field(60, (1280, 960)), 1, 8.5).board.kind == "charuco"


def test_images_and_ranges_that_are_too_small_for_any_board_are_named():
    with pytest.raises(
        ValueError, match=r"too small for a board at any distance: .* needs 120 x 100 pixels, 58 x 43 are"
    ):
        recommend_board(camera_of_field(60, (64, 48)), 0.5, 1)
    with pytest.raises(ValueError, match=r"at 0.005 m .* no board that small to print; begin the range farther away"):
        recommend_board(camera_of_field(10, (1280, 960)), 0.005, 0.006)


def test_a_board_that_no_paper_holds_says_so():
    reasons = recommend_board(camera_of_field(60, (1280, 960)), 10, 12).reasons
    assert reasons[-1].startswith("larger than any paper: split it over pages (--tiles)")
    assert "larger" not in recommend_board(camera_of_field(60, (1280, 960)), 0.5, 3).reasons[-1]


def test_viewers(tmp_path):
    assert load_viewer("60deg@1280x960").size_wh == (1280, 960) and load_viewer("60@64x48").size_wh == (64, 48)
    for text, why in (
        ("0deg@1280x960", "is none"),
        ("1.2.3deg@1280x960", "not an angle"),
        ("60deg", "lacks the image's size"),
    ):
        with pytest.raises(ValueError, match=why):
            load_viewer(text)
    with pytest.raises(FormatError, match="missing"):
        load_viewer(str(tmp_path / "rig.json"))
    assert (
        parse_board("chessboard:7x4:43mm").pitch_m
        == recommend_board(load_viewer("60deg@1280x960"), 0.5, 3).board.pitch_m
    )
