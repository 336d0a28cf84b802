"""``drl`` and ``drl-increments``: the joint solve, its steps chosen by a trained agent while it is far from the optimum.

The agent decides how the solver steps, never where it ends: see :mod:`binocal.solvers.controlled` for the guards. What it did is
report in the result's provenance.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from numpy import ndarray

from binocal.calibrators.base import CalibrationRequest, Calibrator
from binocal.calibrators.joint import calibrate_jointly
from binocal.errors import FormatError
from binocal.evidence import Detections
from binocal.result import StereoCalibration
from binocal.rl.agent_kind import AgentKind
from binocal.rl.policy import LearnedController, Policy, load_policy, shipped_policy
from binocal.shapes import Float
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem
from binocal.solvers.controlled import ControlledMinimum, minimize_controlled
from binocal.solvers.minimization import LoopOptions, minimize


def calibrate_drl(evidence: Detections, request: CalibrationRequest) -> StereoCalibration:
    """The shipped agent chooses how the solver steps (see :class:`binocal.calibrators.base.Calibrator`)."""
    return calibrate_with_policy(evidence, request, shipped_policy(AgentKind.DRL))


def calibrate_drl_increments(evidence: Detections, request: CalibrationRequest) -> StereoCalibration:
    """The shipped agent changes R, T itself, as in the paper; all other unknowns take their own steps beside."""
    return calibrate_with_policy(evidence, request, shipped_policy(AgentKind.DRL_INCREMENTS))


def calibrator_of_weights(path: str | Path) -> Calibrator:
    """The calibrator that the agent in a file of weights controls.

    Raises:
        FormatError: The file cannot be read, or fits another version.
    """
    policy = load_policy(path)
    if policy.kind == AgentKind.DRL_STREETS:
        raise FormatError(path, f"weights of {policy.kind}, which sees no board; they are for `binocal recalibrate`.")
    return partial(calibrate_with_policy, policy=policy)


def calibrate_with_policy(evidence: Detections, request: CalibrationRequest, policy: Policy) -> StereoCalibration:
    """Calibration with any policy; the answer is that of ``lm`` whatever the policy's weights are."""
    minimizer = _ControlledMinimizer(policy)
    calibration = calibrate_jointly(evidence, request, minimizer=minimizer)
    return replace(calibration, provenance={**calibration.provenance, "agent": minimizer.report()})


class _ControlledMinimizer:
    """A minimiser that remembers what the agent did; one for each calibration."""

    def __init__(self, policy: Policy) -> None:
        self.controller, self.solves = LearnedController(policy), list[ControlledMinimum]()

    def __call__(
        self,
        problem: BundleProblem,
        start: BundleEstimate,
        options: LoopOptions | None = None,
        *,
        scale_px: Float[ndarray, "*batch"] | None = None,
    ) -> BundleMinimum:
        if options is not None and options.kernel != "hampel":
            return minimize(problem, start, options, scale_px=scale_px)
        solve = minimize_controlled(problem, start, self.controller, options, scale_px=scale_px)
        self.solves.append(solve)
        return solve.minimum

    def report(self) -> dict[str, Any]:
        """What the agent did in each solve: its iterations, whether a guard took over, what was left to the classical tail."""
        return {
            "iterations": sum(len(solve.controlled) for solve in self.solves),
            "solves": [
                {
                    "iterations": [asdict(iteration) for iteration in solve.controlled],
                    "classical_iterations": int(solve.minimum.n_iterations) - len(solve.controlled),
                    "fallback_reason": solve.fallback_reason,
                    "remaining_sigma": solve.remaining_sigma,
                }
                for solve in self.solves
            ],
        }
