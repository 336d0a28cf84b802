"""Images of a report: views with their corners, a rectified pair, and images that are not of the calibration."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="Matplotlib is an extra: pip install binocal[report]")

from binocal.app.report_images import report_images
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.errors import DataError
from binocal.images.encoding import encode_jpeg, shrunk
from binocal.images.png import encode_png
from binocal.report.contents import ReportContents
from binocal.report.image_sections import rectified_section, view_section
from binocal.result import RejectedView
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

RIG, BOARD = table2_rig(), parse_board("chessboard:6x5:30mm")


@pytest.fixture(scope="module")
def calibration():
    rng = np.random.default_rng(3)
    scene = StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, 6, rng))
    found = calibrate(
        simulate_detections(scene, rng, noise_px=0.05), model="brown4", calibrator="lm", board_shape="flat"
    )
    return replace(found, rejected=(RejectedView("odd", "the board was not found"),))


def write_images(folder, names, size_wh, odd_size_wh=(64, 48)):
    for side in ("left", "right"):
        for name in names:
            width, height = odd_size_wh if name == "odd" else size_wh
            image = (np.add.outer(np.arange(height), np.arange(width)) + 9 * (side == "right")).astype(np.uint8)
            (folder / f"{side}_{name}.png").write_bytes(encode_png(image))
    return str(folder / "left_*"), str(folder / "right_*")


def test_views_are_shown_with_corners_rejected_ones_first(calibration, tmp_path):
    name = calibration.views[0].name
    sources = write_images(tmp_path, [name, "odd"], RIG.left.size_wh)
    images, rectified, notes = report_images(calibration, *sources)
    assert [shown.name for shown in images] == ["odd", name] and notes == ()
    assert images[0].sizes_wh[0] == (64, 48) and images[1].left_jpeg.startswith(b"\xff\xd8")
    contents = ReportContents(
        "rig.json", calibration, detections=calibration.corners.detections, images=images, rectified=rectified
    )
    odd, used = view_section(contents).cards
    assert not odd.is_used and odd.text == "not used: the board was not found" and odd.sides[0][3] == ""
    first = calibration.corners.detections.left_px[0, 0]
    assert used.is_used and used.sides[0][3].startswith(f"M{first[0]:.0f} {first[1]:.0f}h0")
    assert len(re.findall("M", used.sides[0][3])) == BOARD.n_points
    shown = rectified_section(contents)
    assert len(shown.photos) == 3 and all(
        photo.alt and photo.source.startswith("data:image/jpeg") for photo in shown.photos
    )
    assert "share rows" in shown.photos[1].caption


def test_outliers_are_marked(calibration, tmp_path):
    from binocal.result import OutlierCorner

    views = (replace(calibration.views[0], outliers=(OutlierCorner("right", 2, 4.0),)), *calibration.views[1:])
    marked = replace(calibration, views=views)
    images, _, _ = report_images(marked, *write_images(tmp_path, [views[0].name], RIG.left.size_wh))
    left, right = view_section(ReportContents("rig.json", marked, images=images)).cards[0].sides
    px = calibration.corners.detections.right_px[0, 2]
    assert left[4] == () and right[4] == ((round(px[0]), round(px[1])),)


def test_images_of_another_size_or_of_other_views_are_refused(calibration, tmp_path):
    sources = write_images(tmp_path, [calibration.views[0].name], (320, 240))
    with pytest.raises(
        DataError, match=r"left_.*is 320 x 240, the rig's left camera .*give the images that were calibrated"
    ):
        report_images(calibration, *sources)
    (tmp_path / "others").mkdir()
    with pytest.raises(DataError, match="none of the images is of a view of this calibration"):
        report_images(calibration, *write_images(tmp_path / "others", ["x17", "x18"], RIG.left.size_wh))


def test_a_small_jpeg_for_the_eye():
    image = np.full((300, 400, 3), 40000, np.uint16)
    assert shrunk(image, 100).shape == (75, 100, 3) and shrunk(image, 500) is image
    assert len(encode_jpeg(shrunk(image, 100))) < 2000


def test_images_in_which_the_corners_lie_elsewhere_are_refused(calibration, tmp_path, monkeypatch):
    from types import SimpleNamespace

    from binocal.app import report_images as module
    from binocal.images.preprocessing import Preparation

    sources = write_images(tmp_path, [calibration.views[0].name], RIG.left.size_wh)
    corners = calibration.evidence.detections.select(np.array([0]))

    def compare(shift_px):
        found = replace(corners, left_px=corners.left_px[:, ::-1] + shift_px)  # found from the board's other end
        monkeypatch.setattr(module, "detect_pairs", lambda *_, **__: SimpleNamespace(detections=found))
        module.require_same_images(calibration, *sources, BOARD, Preparation())

    compare(0.2)
    with pytest.raises(DataError, match=r"left_.*the corners of view \S+ lie [0-9.]+ px off the board in its images"):
        compare(8.0)


def test_images_without_the_board_are_refused_where_the_corners_were_found_in_images(calibration, tmp_path):
    from binocal.app.report_images import require_same_images
    from binocal.images.preprocessing import Preparation

    sources = write_images(tmp_path, [view.name for view in calibration.views], RIG.left.size_wh)
    require_same_images(calibration, *sources, BOARD, Preparation())  # corners that others found
    found = replace(calibration, provenance=calibration.provenance | {"input_sha256": {"left": "1", "right": "2"}})
    with pytest.raises(DataError, match=r"left_.*not found in the images of its best views .*that it was made from"):
        require_same_images(found, *sources, BOARD, Preparation())
