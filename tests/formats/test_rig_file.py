"""One function reads every file that holds a rig."""

import numpy as np
import pytest

from binocal.errors import FormatError
from binocal.formats import opencv_yaml, rig_json
from binocal.formats.detections_npz import write_detections
from binocal.formats.rig_file import load_rig
from rigs import assert_same_rig, make_calibration, make_detections, make_poses, make_rig


def test_one_function_reads_both_formats(tmp_path):
    calibration = make_calibration()
    rig_json.write_calibration(tmp_path / "rig.json", calibration)
    assert_same_rig(load_rig(tmp_path / "rig.json"), calibration.rig)
    rig = make_rig()
    opencv_yaml.write_opencv(tmp_path / "rig.yml", rig)
    back = load_rig(tmp_path / "rig.yml")
    assert np.abs(back.T_right_left.R - rig.T_right_left.R).max() < 1e-12
    assert back.left.size_wh == rig.left.size_wh


def test_a_file_that_holds_no_rig_is_named(tmp_path):
    write_detections(tmp_path / "corners.npz", make_detections(make_rig(), make_poses(1, np.random.default_rng(0))))
    with pytest.raises(FormatError, match="holds corners, not a rig"):
        load_rig(tmp_path / "corners.npz")
    (tmp_path / "rig.json").write_text("{}")
    with pytest.raises(FormatError, match=r"rig\.json"):
        load_rig(tmp_path / "rig.json")
    with pytest.raises(FormatError, match=r"none\.yml"):
        load_rig(tmp_path / "none.yml")
