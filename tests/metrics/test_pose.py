from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.cameras import Camera
from binocal.geometry import SE3, so3
from binocal.metrics import pose
from binocal.result import Covariance
from rigs import make_rig


def test_the_true_rig_has_no_error_and_all_parameters_correct():
    comparison = pose.compare_with_truth(make_rig(), make_rig())
    assert (
        comparison.rotation_error_deg == 0
        and comparison.translation_error_mm == 0
        and comparison.baseline_error_mm == 0
    )
    assert (
        len(comparison.parameters) == 22 and comparison.parameter_accuracy_percent == 100 and not comparison.has_bound
    )
    assert all(np.isnan(p.error_per_bound) for p in comparison.parameters)


def test_errors_carry_the_units_they_say():
    truth = make_rig()
    T = truth.T_right_left
    turned = replace(truth, T_right_left=SE3(so3.exp(np.array([0, np.radians(0.2), 0])) @ T.R, T.t + [0, 0.003, 0]))
    comparison = pose.compare_with_truth(turned, truth)
    assert comparison.rotation_error_deg == pytest.approx(0.2, rel=1e-9)
    assert comparison.translation_error_mm == pytest.approx(3.0, rel=1e-9)
    wrong = {p.name for p in comparison.parameters if not p.is_correct}
    assert wrong == {"rotation.y", "translation.y"} and comparison.n_correct == 20


def test_the_bound_divides_the_error_and_limits_it():
    truth = make_rig()
    values = truth.left.parameters.copy()
    values[0] += 2.0
    rig = replace(truth, left=Camera("brown4", truth.left.size_wh, values))
    names = ("left.fx", "rotation.x", "rotation.y", "translation.x")
    bound = Covariance(names, np.diag([0.25, 1e-8, 1e-8, 1e-10]))
    comparison = pose.compare_with_truth(rig, truth, bound=bound, sigma={"left.fx": 0.6})
    fx = comparison.parameters[0]
    assert fx.name == "left.fx" and fx.error_per_bound == pytest.approx(4.0) and fx.sigma == 0.6
    assert not fx.is_correct and comparison.n_correct == 21  # 2 px is within 1 %, but 4 sigma of the bound
    assert comparison.rotation_bound_deg == pytest.approx(np.degrees(np.sqrt(2) * 1e-4))
    assert comparison.translation_bound_mm == pytest.approx(0.01) and comparison.focal_error_px == pytest.approx(2.0)


def test_models_are_compared_by_coefficient_or_not_at_all():
    truth = make_rig("brown4")
    larger = pose.compare_with_truth(make_rig("brown5"), truth)
    k3 = next(p for p in larger.parameters if p.name == "left.k3")
    assert k3.truth == 0 and k3.value == 0.01 and not k3.is_correct
    fisheye = pose.compare_with_truth(make_rig("fisheye4"), truth)
    assert not [p for p in fisheye.parameters if ".k" in p.name] and len(fisheye.parameters) == 14


def test_skew_counts_when_estimated():
    truth = make_rig()
    assert "left.skew" not in {p.name for p in pose.compare_with_truth(make_rig(), truth).parameters}
    assert "left.skew" in {p.name for p in pose.compare_with_truth(make_rig(), truth, has_skew=True).parameters}
    assert "left.skew" in {p.name for p in pose.compare_with_truth(make_rig(skew=0.3), truth).parameters}


def test_a_lens_in_a_larger_model():
    camera = make_rig("brown4").left
    larger = pose.in_model(camera, "brown8")
    points = np.random.default_rng(0).uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 1], (9, 3))
    np.testing.assert_allclose(larger.project(points), camera.project(points), atol=1e-12)
    assert pose.in_model(larger, "brown4") is None and pose.in_model(camera, "fisheye4") is None


def test_scaling_makes_a_rig_metric():
    rig = pose.scaled(make_rig(t=(-3.0, 0.0, 0.0), is_metric=False), 0.02)
    assert rig.is_metric and rig.baseline_m == pytest.approx(0.06)
