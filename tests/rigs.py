"""Rigs that several tests share, and hypothesis strategies for them."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from binocal import boards
from binocal.cameras import Camera, StereoRig
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.result import (
    Covariance,
    Evidence,
    OutlierCorner,
    RejectedView,
    ResidualSummary,
    StereoCalibration,
    ViewResult,
)

DISTORTION = {
    "brown4": [-0.12, 0.05, 4e-4, -3e-4],
    "brown5": [-0.12, 0.05, 4e-4, -3e-4, 0.01],
    "brown8": [-0.1, 0.04, 4e-4, -3e-4, 0.01, 0.02, 0.01, 0.003],
    "fisheye4": [0.02, -0.01, 0.003, -0.001],
}


def make_rig(
    model: str = "brown4", *, rotation_rad=(0.01, -0.05, 0.008), t=(-0.06, 0.001, 0.002), is_metric=True, skew=0.0
) -> StereoRig:
    focal = 600.0 if model == "fisheye4" else 1600.0
    left = Camera(model, (1280, 960), np.r_[focal, focal + 3, 643.5, 471.25, skew, DISTORTION[model]])
    right = Camera(model, (1280, 960), np.r_[focal + 7, focal + 9, 630.1, 484.7, skew, DISTORTION[model]])
    return StereoRig(left, right, SE3(so3.exp(np.array(rotation_rad)), np.array(t)), is_metric)


def make_poses(n_views: int, rng: np.random.Generator) -> SE3:
    """T_left_board of a board of 11x8 corners, 10 mm apart, that stays inside both images of the default rig."""
    angles = rng.uniform(-0.5, 0.5, (n_views, 3)) * [1, 1, 0.3]
    t = np.stack(
        [rng.uniform(-0.03, -0.01, n_views), rng.uniform(-0.05, -0.02, n_views), rng.uniform(0.28, 0.36, n_views)],
        axis=-1,
    )
    return SE3(so3.exp(angles), t)


def make_detections(rig: StereoRig, T_left_board: SE3, *, noise_px: float = 0.0, rng=None) -> Detections:
    points = boards.parse_board("chessboard:11x8:10mm").object_points_m
    in_left = T_left_board.apply(points)
    left, right = rig.left.project(in_left), rig.right.project(rig.T_right_left.apply(in_left))
    if noise_px:
        left, right = (
            left + noise_px * rng.standard_normal(left.shape),
            right + noise_px * rng.standard_normal(right.shape),
        )
    return Detections.from_arrays(points, left, right, rig.left.size_wh)


def make_calibration(rig: StereoRig | None = None) -> StereoCalibration:
    rig = rig or make_rig()
    poses = make_poses(1, np.random.default_rng(0))
    corners = make_detections(make_rig(), poses)
    left_px = corners.left_px.copy()
    left_px[0, 5] = np.nan
    detections = Detections(
        corners.object_points_m, left_px, corners.right_px, rig.left.size_wh, rig.right.size_wh, ("01",), rig.is_metric
    )
    names = ("left.fx", "rotation.x", "translation.x")
    return StereoCalibration(
        rig=rig,
        covariance=Covariance(names, np.diag([0.25, 1e-8, float("nan")])),
        rms=ResidualSummary(0.1, 0.2, 0.15),
        noise_px=0.08,
        views=(ViewResult("01", 0.1, 0.1, float("nan"), 88, (OutlierCorner("left", 4, 7.5),), "turned by 180 deg"),),
        evidence=Evidence(detections, poses),
        rejected=(RejectedView("02", "no board found in the left image"),),
        warnings=("left and right look exchanged",),
        n_iterations=7,
        provenance={"seed": 0, "cost": float("inf"), "version": "x", "shape": (1, 2), "n": np.int64(3)},
    )


finite = st.floats(-1.0, 1.0, allow_nan=False, allow_subnormal=False)


@st.composite
def rigs(draw, models=tuple(DISTORTION)) -> StereoRig:
    model = draw(st.sampled_from(models))
    size = (draw(st.integers(100, 5000)), draw(st.integers(100, 5000)))

    def camera() -> Camera:
        n = len(DISTORTION[model])
        linear = [
            draw(st.floats(0.5, 2)) * size[0],
            draw(st.floats(0.5, 2)) * size[0],
            (0.5 + draw(finite) / 3) * size[0],
            (0.5 + draw(finite) / 3) * size[1],
        ]
        return Camera(model, size, np.r_[linear, 0.0, [draw(finite) * 0.1 for _ in range(n)]])

    rotation = np.array([draw(finite) for _ in range(3)]) * 0.2
    t = np.array([-draw(st.floats(0.02, 2)), draw(finite) * 0.005, draw(finite) * 0.005])
    return StereoRig(camera(), camera(), SE3(so3.exp(rotation), t), draw(st.booleans()))


def assert_same_rig(one: StereoRig, other: StereoRig, tolerance: float = 0.0) -> None:
    for a, b in ((one.left, other.left), (one.right, other.right)):
        assert (a.model, a.size_wh) == (b.model, b.size_wh)
        np.testing.assert_allclose(a.parameters, b.parameters, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(one.T_right_left.R, other.T_right_left.R, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(one.T_right_left.t, other.T_right_left.t, rtol=tolerance, atol=tolerance)
    assert one.is_metric == other.is_metric
