"""The motion of predicted corners along a step against differences of the projections themselves."""

from dataclasses import replace

import numpy as np
import pytest
from test_step import make_problem

from binocal.cameras import CAMERA_MODELS


def predicted_px(problem, estimate):
    """Corners as the estimate predicts them, (views, 2, n) for each camera."""
    out = []
    for camera, parameters, T in zip(problem.cameras, estimate.parameters, problem.camera_poses(estimate), strict=True):
        X = T.R @ problem.object_points + T.t[..., None]
        u, v = camera.model.project(parameters, X[:, 0], X[:, 1], X[:, 2])
        out.append(np.stack([u, v], axis=1))
    return out


@pytest.mark.parametrize("model", CAMERA_MODELS)
@pytest.mark.parametrize("bend", [0.0, 0.6, 1.0])
def test_the_motion_is_the_second_order_series_of_the_projection(model, bend):
    # steps of some degrees; differences with h = 1e-3 leave 1e-5 px of rounding and fourth order
    problem, estimate = make_problem(model)
    step = problem.solve_step(estimate, problem.linearize(estimate, np.asarray(0.5), "squared"), np.zeros(()))
    rng = np.random.default_rng(1)
    shared = step.shared.copy()
    shared[-6:-3] = 0.1 * rng.standard_normal(3)
    shared[-3:] = 0.02 * rng.standard_normal(3)
    views = np.concatenate([0.05 * rng.standard_normal((5, 3)), 0.01 * rng.standard_normal((5, 3))], axis=1)
    step = replace(step, shared=shared, views=views)
    h = 1e-3

    def at(share):
        return predicted_px(
            problem, problem.retract(estimate, replace(step, shared=share * shared, views=share * views))
        )

    now, ahead, behind = predicted_px(problem, estimate), at(h), at(-h)
    straight = problem.straightened(estimate, step, np.asarray(bend))
    for camera, old, p0, p1, p2 in zip(straight.cameras, problem.cameras, now, ahead, behind, strict=True):
        motion = (p1 - p2) / (2 * h) + bend * 0.5 * (p1 + p2 - 2 * p0) / h**2
        assert np.abs(old.pixels - camera.pixels - motion).max() < 2e-3  # of motions up to 300 px
        assert np.abs(motion).max() > 10


def test_a_step_of_nothing_moves_nothing():
    problem, estimate = make_problem("brown4")
    step = problem.solve_step(estimate, problem.linearize(estimate, np.asarray(0.5), "squared"), np.zeros(()))
    still = replace(step, shared=0 * step.shared, views=0 * step.views)
    for camera, old in zip(problem.straightened(estimate, still, np.ones(())).cameras, problem.cameras, strict=True):
        assert np.array_equal(camera.pixels, old.pixels)
