"""Real recordings are found, described and read, or it is said what was looked for."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from binocal.benchmark import real_sets
from binocal.benchmark.real_sets import find_sets, load_set, read_corners, read_description, same_points
from binocal.benchmark.scenes import render_scene_pairs
from binocal.boards import parse_board
from binocal.errors import DataError, FormatError
from binocal.evidence import Detections
from binocal.formats.detections_npz import write_detections
from binocal.images.reading import read_image


@pytest.fixture(autouse=True)
def empty_data_folder(tmp_path, monkeypatch):
    folder = tmp_path / "data"
    folder.mkdir()
    monkeypatch.setenv("BINOCAL_DATA", str(folder))
    return folder


def describe(folder, **described):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "set.json").write_text(json.dumps(described))
    return folder


def grid_detections(n_views=3, columns=4, rows=3):
    points = parse_board(f"chessboard:{columns}x{rows}:30mm").object_points_m
    rng = np.random.default_rng(0)
    left, right = (40 + 1e3 * points[:, :2] + 5 * rng.standard_normal((n_views, 1, 2)) for _ in range(2))
    return Detections.from_arrays(points, left, right, (320, 240))


def test_nothing_there_is_said_with_what_was_looked_for(empty_data_folder):
    with pytest.raises(DataError, match=r"BINOCAL_DATA.*set\.json nor one of opencv_bouguet") as caught:
        find_sets()
    assert str(empty_data_folder) in str(caught.value)
    with pytest.raises(DataError, match=r"elsewhere: neither an \.npz"):
        find_sets(["elsewhere"])


def test_a_missing_data_folder_is_said_too(monkeypatch, tmp_path):
    monkeypatch.setenv("BINOCAL_DATA", str(tmp_path / "gone"))
    with pytest.raises(DataError, match="gone"):
        find_sets()


def test_without_the_variable_the_folder_beside_the_checkout_is_meant(monkeypatch):
    monkeypatch.delenv("BINOCAL_DATA")
    assert real_sets.data_folder().parts[-2:] == ("shared", "data")


def test_known_and_described_recordings_of_the_data_folder_are_found(empty_data_folder):
    (empty_data_folder / "stereopi_fisheye").mkdir()
    describe(empty_data_folder / "mine", board="chessboard:8x5:30mm", left="cam0/*.png", right="cam1/*.png")
    (empty_data_folder / "no set").mkdir()
    known, mine = find_sets()
    assert (known.name, known.board, known.model) == ("stereopi_fisheye", "chessboard:9x6:25mm", "fisheye4")
    assert (mine.name, mine.left, mine.right, mine.model) == ("mine", "cam0/*.png", "cam1/*.png", "brown5")
    assert [source.name for source in find_sets(["mine"])] == ["mine"]
    assert find_sets([str(empty_data_folder / "stereopi_fisheye")])[0].model == "fisheye4"


@pytest.mark.parametrize(
    ("described", "message"),
    [
        ({"left": "l*"}, "does not say the board"),
        ({"board": "chessboard:8x5", "lefts": "l*"}, "has no use for lefts; it may hold board, left"),
        ({"board": "chessboard:8x5", "model": "brown9"}, "names the model brown9; the models are brown4"),
        ({"board": 8}, "not an object of texts"),
    ],
)
def test_a_wrong_description_is_named(tmp_path, described, message):
    with pytest.raises(FormatError, match=message):
        read_description(describe(tmp_path / "mine", **described))


def test_a_description_that_is_no_json_is_named(tmp_path):
    folder = describe(tmp_path / "mine")
    (folder / "set.json").write_text("{")
    with pytest.raises(FormatError, match="cannot be read as JSON"):
        read_description(folder)


def test_an_unknown_board_and_an_empty_folder_are_named(tmp_path):
    with pytest.raises(DataError, match="mine"):
        load_set(read_description(describe(tmp_path / "mine", board="checkers:8x5")))
    with pytest.raises(DataError, match="holds no pair"):
        load_set(read_description(describe(tmp_path / "mine", board="chessboard:8x5", side_by_side="pair*.png")))


def test_corners_are_read_from_both_kinds_of_archive(tmp_path):
    detections = grid_detections()
    write_detections(tmp_path / "own.npz", detections)
    plain = {
        n: getattr(detections, n) for n in ("object_points_m", "left_px", "right_px", "left_size_wh", "right_size_wh")
    }
    folder = tmp_path / "garage"
    folder.mkdir()
    np.savez(folder / "corners.npz", **plain)
    own, garage = find_sets([str(tmp_path / "own.npz"), str(folder / "corners.npz")])
    assert (own.name, garage.name) == ("own", "garage")
    for source in (own, garage):
        recording = load_set(source)
        assert np.array_equal(recording.detections.right_px, detections.right_px)
        assert recording.detections.left_size_wh == (320, 240) and recording.opencv_detections is None
    np.savez(folder / "corners.npz", left_px=detections.left_px)
    with pytest.raises(FormatError, match="object_points_m"):
        read_corners(folder / "corners.npz")


def test_side_by_side_images_give_the_corners_of_their_halves(tmp_path):
    folder = tmp_path / "recording"
    folder.mkdir()
    render_scene_pairs(folder, 2, "chessboard:7x5:30mm", (400, 300), 3)
    for i in range(2):
        both = [read_image(folder / f"{side}_{i:03d}.png") for side in ("left", "right")]
        cv2.imwrite(str(folder / f"pair{i}.png"), np.hstack(both))
    describe(folder, board="chessboard:7x5:30mm")
    apart = load_set(read_description(folder))
    describe(folder, board="chessboard:7x5:30mm", side_by_side="pair*.png")
    together = load_set(read_description(folder))
    assert together.detections.names == ("pair0", "pair1") and together.detections.left_size_wh == (400, 300)
    for side in ("left_px", "right_px"):
        assert np.array_equal(getattr(together.detections, side), getattr(apart.detections, side))
    own = same_points(apart.opencv_detections, apart.detections)
    distance = np.linalg.norm(own.left_px - apart.detections.left_px, axis=-1)
    assert np.isfinite(distance).any() and np.nanmax(distance) < 0.5


def test_a_peers_corners_take_our_order_or_none():
    detections = grid_detections()
    near = detections.left_px + 0.2
    near[1] = near[1][::-1]  # numbered from the other end
    near[2, 3] += 20.0  # another place: the view's left image does not count
    own = Detections.from_arrays(detections.object_points_m, near, detections.right_px[:, ::-1], (320, 240))
    matched = same_points(own, detections.select(np.array([2, 1])))
    assert np.isnan(matched.left_px[0]).all()
    assert matched.left_px[1] == pytest.approx(detections.left_px[1] + 0.2)
    assert matched.right_px == pytest.approx(detections.right_px[[2, 1]])
