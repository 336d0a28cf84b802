"""The loop solves any problem with the protocol's methods: here a rigid motion in the plane, fitted to points with outliers."""

from dataclasses import dataclass

import numpy as np
import pytest

from binocal.solvers import robust
from binocal.solvers.controllers import Marquardt
from binocal.solvers.loop import begin, run
from binocal.solvers.minimization import Arrival, LoopOptions, minimize
from binocal.solvers.problem import Problem
from binocal.solvers.rules import FAR, NEAR


@dataclass(frozen=True)
class Motion:
    """Angle and translation: (*batch, 3)."""

    values: np.ndarray

    @property
    def batch(self):
        return self.values.shape[:-1]


@dataclass(frozen=True)
class Linearized:
    r2: np.ndarray
    cost_px2: np.ndarray
    information: np.ndarray
    gradient: np.ndarray

    @property
    def r2_px2(self):
        return (self.r2,)

    def cost_under(self, scale_px, kernel):
        return robust.costs(self.r2, np.asarray(scale_px)[..., None], kernel).sum(axis=-1)


@dataclass(frozen=True)
class PlaneStep:
    values: np.ndarray
    predicted_px2: np.ndarray


@dataclass(frozen=True)
class MotionProblem:
    """Points (n, 2) seen moved, (*batch, n, 2)."""

    points: np.ndarray
    moved: np.ndarray

    def _residuals(self, estimate):
        angle, t = estimate.values[..., 0, None], estimate.values[..., None, 1:]
        x, y = self.points.T
        turned = np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y], axis=-1)
        return turned + t - self.moved, turned

    def residual_lengths2(self, estimate):
        return (np.square(self._residuals(estimate)[0]).sum(axis=-1),)

    def noise_estimate_px(self, r2_px2):
        return robust.scale_of_median(np.median(r2_px2[0], axis=-1))

    def linearize(self, estimate, scale_px, kernel):
        residuals, turned = self._residuals(estimate)
        r2 = np.square(residuals).sum(axis=-1)
        scale = np.asarray(scale_px)[..., None]
        weights = robust.weights(r2, scale, kernel)
        J = np.zeros((*r2.shape, 2, 3))
        J[..., 0, 0], J[..., 1, 0] = -turned[..., 1], turned[..., 0]
        J[..., 0, 1] = J[..., 1, 2] = 1.0
        information = np.einsum("...n,...nic,...nid->...cd", weights, J, J)
        gradient = -np.einsum("...n,...nic,...ni->...c", weights, J, residuals)
        return Linearized(r2, robust.costs(r2, scale, kernel).sum(axis=-1), information, gradient)

    def solve_step(self, estimate, equations, damping):
        A = equations.information + np.asarray(damping)[..., None, None] * np.eye(3) * equations.information
        x = np.linalg.solve(A, equations.gradient[..., None])[..., 0]
        return PlaneStep(x, 0.5 * (x * equations.gradient).sum(axis=-1))

    def retract(self, estimate, step):
        return Motion(estimate.values + step.values)

    def shared_information(self, estimate, equations):
        return equations.information


TRUTH = np.array([[0.4, 3.0, -1.0], [-0.2, 0.5, 2.0]])


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    points = rng.uniform(-50, 50, (40, 2))
    moved = MotionProblem(points, np.zeros((2, 40, 2)))._residuals(Motion(TRUTH))[0]
    moved = moved + 0.1 * rng.standard_normal(moved.shape)
    moved[:, :6] += 30.0  # outliers
    return MotionProblem(points, moved)


def test_the_classical_solve_finds_the_motion_despite_outliers(problem):
    assert isinstance(problem, Problem)
    minimum = minimize(problem, Motion(np.zeros((2, 3))))
    assert minimum.is_converged.all()
    information = problem.shared_information(minimum.estimate, minimum.equations)
    sigma = minimum.scale_px[:, None] * np.sqrt(np.linalg.inv(information).diagonal(axis1=-2, axis2=-1))
    assert (np.abs(minimum.estimate.values - TRUTH) < 4 * sigma).all()
    assert minimum.scale_px == pytest.approx([0.1, 0.1], rel=0.4)


def test_every_rig_of_a_batch_is_solved_as_alone(problem):
    together = minimize(problem, Motion(np.zeros((2, 3))))
    for i in range(2):
        alone = minimize(MotionProblem(problem.points, problem.moved[i]), Motion(np.zeros(3)))
        np.testing.assert_allclose(alone.estimate.values, together.estimate.values[i], atol=1e-4)


def test_another_controller_reaches_the_same_minimum(problem):
    state = begin(problem, Motion(np.zeros((2, 3))), "hampel", rules=NEAR)
    arrival = Arrival(state, LoopOptions())
    end = run(problem, state, Marquardt(damping=1.0), "hampel", NEAR, arrival)
    expected = minimize(problem, Motion(np.zeros((2, 3))))
    np.testing.assert_allclose(end.estimate.values, expected.estimate.values, atol=1e-3)


def test_steps_that_cannot_be_altered_are_refused_by_name(problem):
    state = begin(problem, Motion(np.zeros((2, 3))), "hampel", rules=FAR)
    action, _ = Marquardt().choose(problem, state, Marquardt().start((2,)))
    with pytest.raises(TypeError, match="MotionProblem has no steps"):
        FAR.propose(problem, state, action, "hampel")


def test_a_controller_that_observes_needs_rules_that_do(problem):
    state = begin(problem, Motion(np.zeros((2, 3))), "hampel", rules=NEAR)
    with pytest.raises(ValueError, match="rules leave out"):
        state.seen  # noqa: B018
