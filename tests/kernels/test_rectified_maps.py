"""Maps of rectified images against the plain statement of the camera models, and against OpenCV."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import binocal
from binocal.cameras.models import CAMERA_MODELS
from binocal.kernels.rectified_maps import rectified_map
from binocal.rectification import rectification_map, rectify
from rigs import DISTORTION, make_rig


@pytest.mark.parametrize("projection", ["pinhole", "cylindrical", "equirectangular"])
@pytest.mark.parametrize("model", DISTORTION)
def test_it_is_the_camera_model(model, projection):
    rig = make_rig(model, skew=0.7)
    r = rectify(rig, projection=projection, alpha=1.0, size_wh=(301, 203))
    source, is_inside = rectification_map(rig.right, r.R_rect_right, r.P_right, r.size_wh)
    rows, columns = r.right.pixel_rays(r.size_wh)
    rays = ((rows[:, None] + columns) @ r.R_rect_right).reshape(-1, 3)
    is_seen = rig.right.sees(rays).reshape(is_inside.shape)
    assert 0.3 < is_seen.mean() < 1 and np.array_equal(is_inside, is_seen)
    expected = rig.right.project(rays).reshape(source.shape)
    np.testing.assert_allclose(source[is_seen], expected[is_seen], atol=1e-4)  # single precision at 1280 px
    assert np.isnan(source[~is_seen]).all()


@pytest.mark.parametrize("model", DISTORTION)
def test_it_is_opencvs_map(model):
    cv2 = pytest.importorskip("cv2")
    rig = make_rig(model)
    r = rectify(rig, projection="pinhole", size_wh=(640, 480))
    package = cv2.fisheye if model == "fisheye4" else cv2
    theirs = package.initUndistortRectifyMap(
        rig.left.K, rig.left.distortion, r.R_rect_left, r.P_left[:, :3], r.size_wh, cv2.CV_32FC1
    )
    source, is_inside = rectification_map(rig.left, r.R_rect_left, r.P_left, r.size_wh)
    np.testing.assert_allclose(source[is_inside], np.stack(theirs, axis=-1)[is_inside], atol=1e-3)  # measured: 6e-5


def test_the_number_of_threads_changes_nothing():
    rig = make_rig("fisheye4")
    r = rectify(rig)
    maps = []
    try:
        for n in (1, 3):
            binocal.set_threads(n)
            maps.append(rectification_map(rig.left, r.R_rect_left, r.P_left, r.size_wh)[0].tobytes())
    finally:
        binocal.set_threads(None)
    assert maps[0] == maps[1]


def test_a_model_that_is_not_compiled_is_mapped_all_the_same(monkeypatch):
    rig = make_rig("brown5")
    r = rectify(rig, size_wh=(160, 120))
    compiled = rectification_map(rig.left, r.R_rect_left, r.P_left, r.size_wh)
    monkeypatch.setitem(CAMERA_MODELS, "brown5", replace(CAMERA_MODELS["brown5"], farthest_angle=None))
    plain = rectification_map(rig.left, r.R_rect_left, r.P_left, r.size_wh)
    assert np.array_equal(plain[1], compiled[1])
    np.testing.assert_allclose(plain[0], compiled[0], atol=1e-4)


def test_wrong_shapes_are_refused():
    rows, columns, parameters = np.zeros((4, 3)), np.zeros((5, 3)), make_rig().left.parameters
    make = rectified_map.__wrapped__ if hasattr(rectified_map, "__wrapped__") else rectified_map
    for change, text in (
        ({"out": np.empty((2, 5, 4), np.float32)}, "map must be"),
        ({"outside": 3.0}, "NaN or below"),
        ({"is_inside": np.empty((2, 2), bool)}, "is_inside must be"),
    ):
        with pytest.raises(ValueError, match=text):
            make("brown4", parameters, rows, columns, (640, 480), least_cosine=0.0, **change)
    with pytest.raises(ValueError, match="wrong number of parameters"):
        make("brown5", parameters, rows, columns, (640, 480), least_cosine=0.0)
    with pytest.raises(ValueError, match="no compiled camera model"):
        make("brown9", parameters, rows, columns, (640, 480), least_cosine=0.0)
