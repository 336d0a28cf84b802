"""The paper's steps 6 to 8: the pose between the cameras from uncalibrated guesses, by the agents and without one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocal.boards import parse_board
from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.from_guess import GuessSolve, hold_cameras, lead, solve_from_guess
from binocal.cameras import StereoRig
from binocal.experiments.case import Case, Made, Sample
from binocal.experiments.row import Measured
from binocal.geometry import SE3, so3
from binocal.rl.policy import Policy
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

TABLE = "steps"
N_GUESSES = 20
N_VIEWS = 20
NOISE_PX = 0.05
GUESSES = {"parallel": (0.0, 0.0), "up to 20 deg, 30 % off": (20.0, 0.3), "up to 70 deg, 100 % off": (70.0, 1.0)}
"""How far a guess is off at most: in rotation, and in translation as a share of the baseline. ``parallel`` is the data sheet's rig."""
SAME_DEG, SAME_SHARE = 0.01, 0.001  # of the baseline: within it, two solves ended in the same minimum
AGENTS = {"drl": "drl", "drl-increments": "drl-increments", "lm": "lm"}


@dataclass(frozen=True, slots=True)
class AsPrinted:
    """The paper's algorithm to its own end: cameras by vanishing points, the pose by the agent from the data sheet, nothing after."""

    agent: str = "drl"
    label: str = "drl from the guess, cameras held"

    def __call__(self, sample: Sample) -> tuple[Made, ...]:
        """See :class:`binocal.experiments.case.Method`."""
        assert sample.prior is not None  # the cases of boards have one
        request = CalibrationRequest(
            options={"agent": self.agent, "baseline_m": sample.prior.baseline_m}, **sample.choices
        )
        return (Made(solve_from_guess(sample.evidence, request).rig),)


@dataclass(frozen=True, slots=True)
class CornersForGuesses:
    """Simulated corners of the paper's rig; the sample's board says nothing, its prior is the data sheet."""

    prior: StereoRig

    def __call__(self, seed: int) -> Sample:
        """See :class:`binocal.experiments.case.Case`."""
        rng, rig, board = np.random.default_rng([seed, 5]), table2_rig(), parse_board("chessboard:11x8:20mm")
        scene = StereoScene(rig, board, sample_board_poses(rig, board, N_VIEWS, rng))
        corners = simulate_detections(scene, rng, noise_px=NOISE_PX)
        return Sample((corners, seed), rig, board, choices={"model": "brown4"}, prior=self.prior)


@dataclass(frozen=True, slots=True)
class Leads:
    """An agent from many guesses; its figures are means over them."""

    label: str
    agent: str
    farthest: tuple[float, float]

    def __call__(self, sample: Sample) -> tuple[Made, ...]:
        """See :class:`binocal.experiments.case.Method`."""
        return (led_from_guesses(sample, self.agent, self.farthest),)


def led_from_guesses(sample: Sample, agent: str | Policy, farthest: tuple[float, float]) -> Made:
    """What an agent makes of guesses up to so far off, and its figures: means over them."""
    corners, seed = sample.evidence
    assert sample.prior is not None  # given by the case
    held = hold_cameras(corners, CalibrationRequest(**sample.choices))
    right = lead(held, sample.truth.T_right_left, "lm")
    guesses = draw_guesses(sample.prior.T_right_left, *farthest, np.random.default_rng([seed, 6]))
    solves = [lead(held, guess, agent) for guess in guesses]
    is_same = np.array([_is_same(solve, right) for solve in solves])
    led = np.array([solve.n_led for solve in solves], dtype=float)
    total = np.array([int(solve.minimum.n_iterations) for solve in solves], dtype=float)
    said = {
        "iterations, all": (float(total.mean()), ""),
        "steps chosen by the agent": (float(led.mean()), ""),
        "classical steps after them": (float((total - led).mean()), ""),
        "guards took over": (100 * float(np.mean([bool(solve.guard) for solve in solves])), "%"),
        "ended in the right minimum": (100 * float(is_same.mean()), "%"),
    }
    remaining = [solve.controlled.remaining_sigma for solve in solves if solve.controlled and not solve.guard]
    if remaining:
        said["left by the agent where no guard did"] = (float(np.median(remaining)), "sigmas")
    return Made(right.rig, said=said)


def draw_guesses(middle: SE3, turn_deg: float, share: float, rng: np.random.Generator) -> list[SE3]:
    """Guesses about a pose: turned by up to so much about any axis, shifted by up to a share of the baseline; one where both are 0."""
    if not turn_deg and not share:
        return [middle]
    guesses = []
    for _ in range(N_GUESSES):
        axis, shift = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
        turn = so3.exp(np.radians(turn_deg * rng.random()) * axis)
        guesses.append(SE3(turn @ middle.R, middle.t + share * rng.random() * float(np.linalg.norm(middle.t)) * shift))
    return guesses


def _is_same(a: GuessSolve, b: GuessSolve) -> bool:
    T, other = a.rig.T_right_left, b.rig.T_right_left
    apart = float(np.linalg.norm(T.t - other.t)) / float(np.linalg.norm(other.t))
    return (
        bool(a.minimum.is_converged)
        and apart < SAME_SHARE
        and float(np.degrees(so3.angle_rad(T.R @ other.R.T))) < SAME_DEG
    )


def as_said(made: Made, sample: Sample) -> list[Measured]:
    """What the method says of itself."""
    return [Measured(name, unit, value) for name, (value, unit) in made.said.items()]


def guess_cases(prior: StereoRig) -> list[Case]:
    """A case for each distance of the guesses."""
    return [
        Case(
            name,
            CornersForGuesses(prior),
            as_said,
            tuple(Leads(label, agent, farthest) for label, agent in AGENTS.items()),
            table=TABLE,
        )
        for name, farthest in GUESSES.items()
    ]
