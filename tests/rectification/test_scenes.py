"""Natural scenes of a real rig: rows after rectification beside the authors' own calibration, and depth that is the scene's."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import yaml

from binocal.cameras import Camera, StereoRig
from binocal.cli import main
from binocal.datasets.folder import list_pairs
from binocal.formats.rig_json import read_rig
from binocal.geometry import SE3
from binocal.images.reading import read_grey_image
from binocal.matching.pairs import match_pair
from binocal.metrics.rows import row_figures


def authors_rig(path) -> StereoRig:
    """BoofCV's stereo.yaml: rightToLeft takes right to left, millimetres."""
    document = yaml.safe_load(path.read_text())

    def camera(side):
        linear, lens = side["pinhole"], side["radial_tangential"]
        values = [*(linear[name] for name in ("fx", "fy", "cx", "cy")), 0.0, *lens["radial"], lens["t1"], lens["t2"]]
        return Camera("brown4", (linear["width"], linear["height"]), np.array(values))

    move = document["rightToLeft"]
    T_left_right = SE3(np.array(move["rotation"]).reshape(3, 3), np.array([move[axis] for axis in "xyz"]) / 1e3)
    return StereoRig(camera(document["left"]), camera(document["right"]), T_left_right.inverse())


@pytest.mark.data
@pytest.mark.slow
def test_rows_of_scenes_match_better_than_by_the_authors_calibration(data_dir, tmp_path):
    boards, scenes = data_dir / "boof_bumblebee2_chess", data_dir / "boof_bumblebee2_scenes"
    sources = ["--left", str(boards / "left*.jpg"), "--right", str(boards / "right*.jpg")]
    rig_path = tmp_path / "rig.json"
    assert main(["calibrate", *sources, "--board", "chessboard:6x4:30mm", "--output", str(rig_path), "--json"]) == 0
    ours, theirs = read_rig(rig_path), authors_rig(boards / "stereo.yaml")
    pairs = list_pairs(str(scenes / "*_left.jpg"), str(scenes / "*_right.jpg")).pairs
    medians = []
    for pair in pairs:
        images = read_grey_image(pair.left_path), read_grey_image(pair.right_path)
        matches = match_pair(*images, pair.name).matches
        medians.append([row_figures(rig, matches).median_px for rig in (ours, theirs)])
    ours_px, theirs_px = np.array(medians).T  # measured: 0.08 to 0.14 px, and 0.15 to 0.64 px
    assert len(pairs) == 8 and np.median(ours_px) < 0.5 * np.median(theirs_px)
    assert np.all(ours_px < theirs_px) and np.all(ours_px < 0.2)

    chair = [str(scenes / f"chair01_{side}.jpg") for side in ("left", "right")]
    out = tmp_path / "depth"
    assert (
        main(
            [
                "depth",
                str(rig_path),
                "--left",
                chair[0],
                "--right",
                chair[1],
                "--range",
                "0.5-20m",
                "--output",
                str(out),
            ]
        )
        == 0
    )
    (path,) = out.glob("depth_*.tiff")
    metres = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    seat, floor_near, floor_far = (
        np.nanmedian(metres[area])
        for area in (np.s_[200:225, 360:500], np.s_[430:450, 200:500], np.s_[260:300, 250:310])
    )
    assert (
        np.isfinite(metres).mean() > 0.6 and floor_near < seat < floor_far
    )  # the seat stands on a carpet that runs away
