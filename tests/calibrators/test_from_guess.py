"""The paper's algorithm from an uncalibrated guess: the agent's own steps, its guards, and where the joint solve ends after it."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.from_guess import solve_from_guess
from binocal.geometry import so3
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.solvers.loop import listening

FAR = [12.0, -9.0, 13.0, -0.042, 0.0, 0.01]  # 20 deg and 30 % of the baseline off
AGENTS = ("drl", "drl-increments", "lm")


@pytest.fixture(scope="module")
def corners():
    rng, rig, board = np.random.default_rng(0), table2_rig(), parse_board("chessboard:11x8:20mm")
    scene = StereoScene(rig, board, sample_board_poses(rig, board, 20, rng))
    return simulate_detections(scene, rng, noise_px=0.05)


@pytest.fixture(scope="module")
def joint(corners):
    return calibrate(corners, calibrator="lm", model="brown4")


@pytest.mark.parametrize(
    ("agent", "guess"),
    [*((agent, {"guess_deg_m": FAR}) for agent in AGENTS), ("drl", {"baseline_m": 0.06}), ("drl", {})],
    ids=(*AGENTS, "data sheet", "nothing known"),
)
def test_it_ends_where_the_joint_solve_does(corners, joint, agent, guess):
    made = calibrate(corners, calibrator="from-guess", model="brown4", options={"agent": agent} | guess)
    T, expected = made.rig.T_right_left, joint.rig.T_right_left
    sigma = joint.covariance.sigma
    assert np.abs(T.t - expected.t).max() < 0.01 * sigma["translation.x"]
    assert so3.angle_rad(T.R @ expected.R.T) < 0.01 * sigma["rotation.x"]
    said = made.provenance["from_guess"]
    assert said["is_converged"] and (said["agent_iterations"] > 0) == (agent != "lm")


def test_the_joint_solve_goes_on_from_where_the_agent_ended(corners):
    fits = []  # RMS residual at every start and after every iteration

    def listen(problem, state, n_done):
        fits.append((n_done, np.sqrt(np.mean(np.concatenate(problem.residual_lengths2(state.estimate))))))

    with listening(listen):
        calibrate(corners, calibrator="from-guess", model="brown4", options={"baseline_m": 0.06})
    starts = [i for i, (n_done, _) in enumerate(fits) if n_done == 0]
    after = next(i for i in starts if i and fits[i - 1][1] < 0.2)  # 0.09 px with the cameras of the vanishing points
    assert fits[0][1] > 10 and fits[after][1] == pytest.approx(fits[after - 1][1], rel=0.01)


def test_the_agent_itself_brings_the_rig_to_its_minimum(corners):
    request = CalibrationRequest("brown4", options={"guess_deg_m": FAR})
    solve = solve_from_guess(corners, request)
    assert solve.controlled is not None and not solve.guard and 2 <= solve.n_led <= 6
    assert solve.controlled.remaining_sigma < 1.0  # 0.1 to 0.5 measured
    start_deg = np.degrees(so3.angle_rad(solve.guess.R @ table2_rig().T_right_left.R.T))
    end_deg = np.degrees(so3.angle_rad(solve.rig.T_right_left.R @ table2_rig().T_right_left.R.T))
    assert start_deg > 15 and end_deg < 0.1  # what the cameras of the vanishing points leave


def test_an_agent_that_is_no_number_is_a_guard_and_the_result_stands(corners, joint, monkeypatch):
    class Broken:
        def start(self, batch):
            return {}

        def choose(self, problem, state, memory):
            from binocal.solvers.loop_state import Action

            return Action(np.full((), np.nan), 1.0), memory

    monkeypatch.setattr("binocal.calibrators.from_guess._controller", lambda name: Broken())
    made = calibrate(corners, calibrator="from-guess", model="brown4", options={"guess_deg_m": FAR})
    assert "not finite" in made.provenance["from_guess"]["guard"]
    assert np.abs(made.rig.T_right_left.t - joint.rig.T_right_left.t).max() < 1e-7


@pytest.mark.parametrize(
    ("options", "text"),
    (
        ({"agent": "magic"}, "'magic'; it can be drl, drl-increments, lm"),
        ({"baseline_m": -1.0}, "baseline_m must be above 0"),
        ({"guess_deg_m": [1, 2]}, "six numbers"),
        ({"speed": 1}, "no option 'speed'"),
    ),
)
def test_odd_options_are_refused(corners, options, text):
    with pytest.raises(ValueError, match=text):
        calibrate(corners, calibrator="from-guess", model="brown4", options=options)
