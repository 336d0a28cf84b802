"""Rigs that several tests share, and hypothesis strategies for them."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from hypothesis import strategies as st

from binocal import boards
from binocal.cameras import Camera, StereoRig
from binocal.evidence import Detections
from binocal.findings import Finding, Severity, finding
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
    return StereoRig(
        left, right, SE3(so3.exp(np.array(rotation_rad, dtype=float)), np.array(t, dtype=float)), is_metric
    )


def street_rig(model: str = "brown4") -> StereoRig:
    """A car's cameras, 0.54 m apart."""
    if model == "fisheye4":
        parameters = [[400.0, 401, 615 + i, 180, 0, -0.02, 0.003, 0, 0] for i in range(2)]
    else:
        parameters = [[720.0, 721, 615 + 3 * i, 180, 0, -0.2, 0.05, 1e-3, -5e-4] for i in range(2)]
    left, right = (Camera(model, (1242, 375), np.array(values)) for values in parameters)
    T_right_left = SE3(so3.exp(np.radians([0.3, -0.8, 0.2])), np.array([-0.54, 0.004, -0.006]))
    return StereoRig(left, right, T_right_left)


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


def make_calibration(rig: StereoRig | None = None, n_views: int = 1) -> StereoCalibration:
    rig = rig or make_rig()
    poses = make_poses(n_views, np.random.default_rng(0))
    corners = make_detections(make_rig(), poses)
    left_px = corners.left_px.copy()
    left_px[0, 5] = np.nan
    view_names = tuple(f"{i + 1:02d}" for i in range(n_views))
    detections = Detections(
        corners.object_points_m,
        left_px,
        corners.right_px,
        rig.left.size_wh,
        rig.right.size_wh,
        view_names,
        rig.is_metric,
    )
    names = ("left.fx", "rotation.x", "translation.x")
    return StereoCalibration(
        rig=rig,
        covariance=Covariance(names, np.diag([0.25, 1e-8, float("nan")])),
        rms=ResidualSummary(0.1, 0.2, 0.15),
        noise_px=0.08,
        views=tuple(
            ViewResult(name, 0.1, 0.1, float("nan"), 88, (OutlierCorner("left", 4, 7.5),), "turned by 180 deg")
            for name in view_names
        ),
        evidence=Evidence(detections, poses),
        rejected=(RejectedView("02", "no board found in the left image"),),
        findings=(finding("cameras-exchanged"),),
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


@st.composite
def detections(draw) -> Detections:
    """Any detections: unseen corners, cameras that saw nothing, covariances known of some corners, any names."""
    n_views, n = draw(st.integers(0, 4)), draw(st.integers(0, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sides = {}
    for side in ("left", "right"):
        px = rng.standard_normal((n_views, n, 2)) * 10.0 ** rng.integers(-300, 300, (n_views, n, 2))
        px[rng.random((n_views, n)) < draw(st.floats(0, 1))] = np.nan
        sides[f"{side}_px"] = px
        if draw(st.booleans()):
            root = rng.standard_normal((n_views, n, 2, 2))
            covariance = root @ root.swapaxes(-1, -2)
            covariance[rng.random((n_views, n)) < draw(st.floats(0, 1))] = np.nan
            sides[f"{side}_covariance_px2"] = covariance
    size = st.tuples(st.integers(1, 100_000), st.integers(1, 100_000))
    return Detections(
        rng.standard_normal((n, 3)),
        left_size_wh=draw(size),
        right_size_wh=draw(size),
        names=tuple(draw(st.lists(st.text(max_size=8), min_size=n_views, max_size=n_views))),
        is_metric=draw(st.booleans()),
        board_spec=draw(st.none() | st.text(max_size=20)),
        **sides,
    )


any_text = st.text(st.characters(), max_size=8)  # lone surrogates too: names of files may hold bytes that are no UTF-8


@st.composite
def findings(draw):
    figures = st.dictionaries(any_text, st.one_of(any_text, st.integers(-9, 9), st.floats(-1e3, 1e3)), max_size=3)
    return Finding(draw(any_text), draw(st.sampled_from(Severity)), draw(any_text), draw(any_text), draw(figures))


any_number = st.floats(allow_infinity=False) | st.floats(1e-9, 1e3)


@st.composite
def calibrations(draw) -> StereoCalibration:
    """Any calibration that a file can hold: unknown numbers, any names, with and without board poses."""
    rig, n = draw(rigs()), draw(st.integers(0, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    order = tuple(rng.permutation(4).tolist())
    views = tuple(
        ViewResult(
            draw(any_text),
            *(draw(any_number) for _ in range(3)),
            draw(st.integers(0, 200)),
            tuple(
                OutlierCorner("left", int(corner), draw(any_number)) for corner in rng.integers(0, 88, rng.integers(3))
            ),
            draw(any_text),
            left_order=order if draw(st.booleans()) else (),
            right_order=order if draw(st.booleans()) else (),
        )
        for _ in range(n)
    )
    names = tuple(draw(st.lists(any_text, max_size=4, unique=True)))
    root = rng.standard_normal((len(names), len(names))) * 10.0 ** rng.integers(-8, 3, (len(names), 1))
    covariance = root @ root.T
    covariance[rng.random(len(names)) < 0.2] = np.nan
    has_poses = n > 0 and draw(st.booleans())
    json_value = st.recursive(
        st.none() | st.booleans() | st.integers(-(2**60), 2**60) | any_number.filter(np.isfinite) | any_text,
        lambda inner: st.lists(inner, max_size=2) | st.dictionaries(any_text, inner, max_size=2),
        max_leaves=5,
    )
    return StereoCalibration(
        rig=rig,
        covariance=Covariance(names, covariance),
        rms=ResidualSummary(draw(any_number), draw(any_number), draw(any_number)),
        noise_px=draw(any_number),
        views=views,
        rejected=tuple(RejectedView(draw(any_text), draw(any_text)) for _ in range(draw(st.integers(0, 2)))),
        findings=tuple(draw(st.lists(findings(), max_size=2))),
        n_iterations=draw(st.integers(0, 1000)),
        provenance=draw(st.dictionaries(any_text, json_value, max_size=3)),
        T_left_board=SE3(so3.exp(rng.standard_normal((n, 3))), rng.standard_normal((n, 3))) if has_poses else None,
        misfit_px=draw(st.none() | any_number),
        extra=draw(st.dictionaries(any_text.map(lambda key: "x-" + key), json_value, max_size=2)),
    )


def assert_same_detections(one: Detections, other: Detections) -> None:
    for field in fields(Detections):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert b is not None and a.tobytes() == b.tobytes() and a.shape == b.shape, field.name
        else:
            assert a == b and type(a) is type(b), field.name


def assert_same_rig(one: StereoRig, other: StereoRig, tolerance: float = 0.0) -> None:
    for a, b in ((one.left, other.left), (one.right, other.right)):
        assert (a.model, a.size_wh) == (b.model, b.size_wh)
        np.testing.assert_allclose(a.parameters, b.parameters, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(one.T_right_left.R, other.T_right_left.R, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(one.T_right_left.t, other.T_right_left.t, rtol=tolerance, atol=tolerance)
    assert one.is_metric == other.is_metric
