from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.datasets import ImagePair, list_pairs
from binocal.detection import detect_pairs
from binocal.errors import CancelledError, DataError, DetectionError
from binocal.images.preprocessing import Preparation

BOARD = parse_board("chessboard:7x6:30mm")
TURNS = [(0.25, -0.3, 0.1), (-0.3, 0.2, 0.2), (0.3, 0.3, -0.2), (0.1, -0.4, 0.0)]


@pytest.fixture(scope="session")
def images(shoot):
    """Left and right images of four views, and the true corners of the left ones."""
    lefts = [shoot("chessboard:7x6:30mm", turn, seed=i) for i, turn in enumerate(TURNS)]
    rights = [shoot("chessboard:7x6:30mm", turn, shift=(-0.1, 0), seed=9 + i) for i, turn in enumerate(TURNS)]
    return lefts, rights


@pytest.fixture
def folder(tmp_path, images):
    for side, shots in zip(("left", "right"), images, strict=True):
        for i, shot in enumerate(shots):
            cv2.imwrite(str(tmp_path / f"{side}{i}.png"), shot.image)
    return tmp_path


def pairs_in(folder):
    return list_pairs(str(folder / "left*"), str(folder / "right*"))


def test_all_views_in_order_with_progress(folder, images):
    calls = []
    found = detect_pairs(pairs_in(folder), BOARD, progress=lambda done, total: calls.append((done, total)), n_threads=2)
    assert found.detections.names == ("0", "1", "2", "3") and not found.rejected and not found.notes
    assert found.detections.left_size_wh == (640, 480) and found.detections.is_metric
    truth = np.stack([shot.corners_px for shot in images[0]])
    assert np.abs(found.detections.left_px - truth).max() < 0.15
    covariances = found.detections.left_covariance_px2, found.detections.right_covariance_px2
    assert covariances[0].shape == (4, 42, 2, 2) and (covariances[1][..., 0, 0] > 0).all()
    assert calls == [(i, 8) for i in range(1, 9)]


def test_results_do_not_depend_on_threads(folder):
    one, three = (detect_pairs(pairs_in(folder), BOARD, n_threads=n) for n in (1, 3))
    assert np.array_equal(one.detections.left_px, three.detections.left_px)


def test_unreadable_images_reject_their_view_by_name(folder):
    content = (folder / "left1.png").read_bytes()
    (folder / "left1.png").write_bytes(content[: len(content) // 2])
    (folder / "right2.png").write_text("this is no image")
    found = detect_pairs(pairs_in(folder), BOARD)
    reasons = {view.name: view.reason for view in found.rejected}
    assert found.detections.names == ("0", "3")
    assert "left1.png is a truncated PNG" in reasons["1"] and "right2.png is not an image but text" in reasons["2"]


def test_a_view_of_one_camera_is_kept_with_a_note_and_of_none_is_rejected(folder):
    for level, name in ((100, "left1"), (110, "left2"), (120, "right2")):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((480, 640), level, np.uint8))
    found = detect_pairs(pairs_in(folder), BOARD)
    assert found.detections.names == ("0", "1", "3")
    assert np.isnan(found.detections.left_px[1]).all() and np.isfinite(found.detections.right_px[1]).all()
    assert found.notes[0].startswith("view 1: used for the right camera only; left: the image is blank")
    assert found.rejected[0].name == "2" and found.rejected[0].reason.startswith("left and right: the image is blank")


def test_one_image_of_another_size_is_rejected_and_half_of_them_are_refused(folder):
    small = cv2.resize(cv2.imread(str(folder / "left1.png"), 0), (320, 240))
    cv2.imwrite(str(folder / "left1.png"), small)
    found = detect_pairs(pairs_in(folder), BOARD)
    assert "left1.png is 320x240, the other left images are 640x480" in found.rejected[0].reason
    cv2.imwrite(str(folder / "left2.png"), small)
    with pytest.raises(DataError, match=r"differ in size.*640x480.*320x240|differ in size.*320x240.*640x480"):
        detect_pairs(pairs_in(folder), BOARD)


def test_left_and_right_may_differ_in_size(folder):
    for i in range(4):
        path = str(folder / f"right{i}.png")
        cv2.imwrite(path, cv2.resize(cv2.imread(path, 0), (960, 720)))
    found = detect_pairs(pairs_in(folder), BOARD)
    assert found.detections.right_size_wh == (960, 720) and "640x480, right ones 960x720" in found.notes[-1]


@pytest.mark.parametrize(
    "spec", ["chessboard:6x5:30mm", "chessboard:8x6:30mm", pytest.param("chessboard:9x7:30mm", marks=pytest.mark.slow)]
)
def test_a_wrong_size_ends_with_the_right_one(folder, spec):
    with pytest.raises(DetectionError, match=r"found in 0 of 8 images; .*did you mean chessboard:7x6\?") as caught:
        detect_pairs(pairs_in(folder), parse_board(spec))
    assert set(caught.value.reasons) == {f"{side}{i}.png" for side in ("left", "right") for i in range(4)}
    assert "\n" not in str(caught.value)


def test_another_kind_of_board_is_recognised(folder):
    with pytest.raises(DetectionError, match=r"a chessboard of 7x6 .*did you mean chessboard:7x6\?"):
        detect_pairs(pairs_in(folder), parse_board("circles:7x6:30mm"))


def test_marker_boards_agree_on_one_layout_and_other_families_are_named(tmp_path, shoot):
    spec = "charuco:7x6:30mm:22mm:DICT_5X5_50"
    for i, turn in enumerate(TURNS[:2]):
        shot = shoot(spec, turn, distance=1.9, size_wh=(800, 600), is_legacy_charuco=True)
        cv2.imwrite(str(tmp_path / f"left{i}.png"), shot.image)
        cv2.imwrite(str(tmp_path / f"right{i}.png"), shot.image[:, ::1] // 2 + 40)
    near = shoot(spec, distance=0.8, size_wh=(800, 600), is_legacy_charuco=True)
    cv2.imwrite(str(tmp_path / "left2.png"), near.image)
    cv2.imwrite(str(tmp_path / "right2.png"), near.image // 2 + 40)
    found = detect_pairs(pairs_in(tmp_path), parse_board(spec))
    assert found.detections.names == ("0", "1", "2") and not any("layout" in note for note in found.notes)
    seen = found.detections.left_is_seen[2]
    assert np.abs(found.detections.left_px[2] - near.corners_px)[seen].max() < 0.3  # read alone it is off by a column
    with pytest.raises(DetectionError, match=r"markers of the family DICT_5X5"):
        detect_pairs(pairs_in(tmp_path), parse_board("charuco:7x6:30mm:22mm:DICT_6X6_50"))
    with pytest.raises(DetectionError, match=r"did you mean charuco:7x6:30mm:22mm:DICT_5X5_50\?"):
        detect_pairs(pairs_in(tmp_path), parse_board("charuco:6x7:30mm:22mm:DICT_5X5_50"))


def test_a_part_without_marks_leaves_its_camera_out_and_a_plain_board_is_told(tmp_path, shoot):
    board = parse_board("chessboard:8x6:30mm:marked")
    for i in range(3):
        whole = shoot("chessboard:8x6:30mm:marked", TURNS[i], distance=2.0)
        cv2.imwrite(str(tmp_path / f"left{i}.png"), whole.image)
        image = shoot("chessboard:8x6:30mm:marked", distance=0.6, shift=(0.4, 0.0)).image if i == 2 else whole.image
        cv2.imwrite(str(tmp_path / f"right{i}.png"), image // 2 + 40)
    found = detect_pairs(pairs_in(tmp_path), board)
    assert found.detections.right_is_seen.all(axis=1).tolist() == [True, True, False]
    assert not found.detections.right_is_seen[2].any() and found.detections.left_is_seen.all()
    (note,) = found.notes
    assert note.startswith("view 2: used for the left camera only; right: a chessboard of")
    for i in range(3):
        for side in ("left", "right"):
            plain = shoot("chessboard:8x6:30mm", TURNS[i], distance=2.0).image
            cv2.imwrite(str(tmp_path / f"{side}{i}.png"), plain // (2 if side == "left" else 1))
    with pytest.raises(DetectionError, match=r"but not the board's marked squares"):
        detect_pairs(pairs_in(tmp_path), board)


def test_equal_notes_are_one_with_the_side_and_the_views(folder, images):
    for i in range(4):
        covered = images[1][i].image.copy()
        x, y = images[1][i].corners_px[20].astype(int)
        cv2.circle(covered, (int(x), int(y)), 14, 120, -1)
        cv2.imwrite(str(folder / f"right{i}.png"), covered)
    found = detect_pairs(pairs_in(folder), BOARD)
    assert found.notes == ("4 views (0, 1, 2, 3): right: 41 of 42 corners seen",)


def test_a_camera_that_never_sees_the_board_is_named(folder, images):
    for i in range(4):
        cv2.imwrite(str(folder / f"right{i}.png"), images[1][i].image[:, :200])
    with pytest.raises(
        DetectionError, match="in 4 of 4 left images and in none of the 4 right ones: no chessboard"
    ) as caught:
        detect_pairs(pairs_in(folder), BOARD)
    assert caught.value.findings[0].code == "board-in-one-camera-only" and set(caught.value.reasons) == {
        f"right{i}.png" for i in range(4)
    }
    for i in range(4):
        cv2.imwrite(str(folder / f"right{i}.png"), images[1][i].image)
        cv2.imwrite(str(folder / f"left{i}.png"), np.full((480, 640), 90 + i, np.uint8))
    with pytest.raises(DetectionError, match="in none of the 4 left ones: the image is blank"):
        detect_pairs(pairs_in(folder), BOARD)


def test_too_few_pairs_are_counted_by_camera_before_anything_is_solved(folder):
    for name in ("left0", "right1"):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((480, 640), 100, np.uint8))
    assert detect_pairs(pairs_in(folder), BOARD).detections.n_views == 4
    with pytest.raises(DetectionError, match="3 of 4 left and 3 of 4 right images, in both of only 2 pairs") as caught:
        detect_pairs(pairs_in(folder), BOARD, least_pairs=3)
    assert caught.value.findings[0].code == "board-in-too-few-pairs" and len(caught.value.reasons) == 2


def test_images_of_one_name_in_two_folders_keep_their_reasons(tmp_path):
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for i in range(3):
            cv2.imwrite(str(tmp_path / side / f"{i}.png"), np.full((480, 640), 100 + i + 9 * len(side), np.uint8))
    with pytest.raises(DetectionError) as caught:
        detect_pairs(list_pairs(str(tmp_path / "left"), str(tmp_path / "right")), BOARD)
    assert set(caught.value.reasons) == {f"{side} {i}.png" for side in ("left", "right") for i in range(3)}


def test_a_charuco_board_given_as_a_chessboard_is_named_even_if_some_images_pass(tmp_path, shoot, images):
    for i, turn in enumerate(TURNS[:3]):
        shot = shoot("charuco:8x7:30mm:15mm:DICT_4X4_50", turn, distance=1.9, size_wh=(960, 720))
        cv2.imwrite(str(tmp_path / f"left{i}.png"), shot.image)
        cv2.imwrite(str(tmp_path / f"right{i}.png"), shot.image // 2 + 40)
    cv2.imwrite(str(tmp_path / "right2.png"), cv2.resize(images[1][0].image, (960, 720)))
    with pytest.raises(DetectionError, match=r"1 of 6 images; 2 of 2 looked at again show a ChArUco") as caught:
        detect_pairs(pairs_in(tmp_path), BOARD)
    proposed = "did you mean charuco:8x7:30mm:MARKER:DICT_4X4_50 (the markers' side is about 0.49 of"  # 0.5 in truth
    assert proposed in str(caught.value)


def test_the_caller_can_stop(folder):
    with pytest.raises(CancelledError, match=r"of 8 images"):
        detect_pairs(pairs_in(folder), BOARD, should_stop=lambda: True, n_threads=1)


def test_preprocessing_is_passed_on(folder):
    plain, prepared = (
        detect_pairs(pairs_in(folder), BOARD, preparation=Preparation(strengthens=flag)) for flag in (False, True)
    )
    difference = plain.detections.left_px - prepared.detections.left_px
    assert 0 < np.abs(difference).max() < 0.2


def test_opencvs_threads_come_back(folder):
    before = cv2.getNumThreads()
    detect_pairs(pairs_in(folder), BOARD)
    assert cv2.getNumThreads() == before


def test_nothing_to_read(tmp_path):
    with pytest.raises(DataError, match=r"no pair"):
        detect_pairs((), BOARD)
    pair = ImagePair("0", tmp_path / "left.png", tmp_path / "right.png")
    with pytest.raises(DataError, match=r"none of the 2 images can be used; left.png .*no such file"):
        detect_pairs((pair,), BOARD)


def test_files_with_several_images_are_named(tmp_path):
    """Only the first image of a stack is read: with too few pairs that is what is wrong, else it is said."""
    pages = [np.full((48, 64), value, np.uint8) for value in (10, 20, 30)]
    pairs = []
    for index in range(3):
        paths = [tmp_path / f"{side}{index}.tif" for side in ("left", "right")]
        for path in paths:
            cv2.imwritemulti(str(path), pages)
        pairs.append(ImagePair(str(index), *paths))
    with pytest.raises(DataError, match=r"1 pair of images: 1 of 1 left files.*left0\.tif 3 of them.*export them"):
        detect_pairs(pairs[:1], BOARD)
