"""``alternating``: the cameras adjusted in turn, each with the other as reference, then all parameters together.

With the left camera as reference its intrinsics are held while those of the right one, ``T_right_left`` and the boards' poses are
adjusted to all corners; then the right camera is the reference; and so on until a round changes nothing worth another. All
parameters together end it, so the rig is that of ``lm``: what the alternation costs are iterations.

Source: the paper's related work [7] as its text describes it (PAPER: "alternating adjustment ... left and right camera coordinates as
reference coordinates"); block coordinate descent. Deviations: the same robust kernel, guards, corner weights and final checks as
``lm``; both blocks adjust all corners, not one camera's alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.joint import calibrate_jointly
from binocal.evidence import Detections
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem
from binocal.solvers.minimization import LoopOptions, minimize

MAX_ROUNDS = 30  # ordinary sets need 2 to 6, long lenses 20 and more
SETTLED_SHARE = 1e-3  # of the cost: a round that saves less is the last


def calibrate_alternating(evidence: Detections, request: CalibrationRequest) -> StereoCalibration:
    """Alternation, then the joint solve (see :class:`binocal.calibrators.base.Calibrator`)."""
    minimizer = _Alternation(request)
    calibration = calibrate_jointly(evidence, request, minimizer=minimizer)
    return replace(calibration, provenance={**calibration.provenance, "alternation": minimizer.report()})


@dataclass(frozen=True, slots=True)
class _Solve:
    """Cost after each half round, squares of the noise, and the iterations of the halves and of the joint end."""

    costs: tuple[float, ...]
    half_iterations: int
    joint_iterations: int


@dataclass(slots=True)
class _Alternation:
    """A minimiser that remembers what it did; one for each calibration."""

    request: CalibrationRequest
    solves: list[_Solve] = field(default_factory=list)

    def __call__(
        self,
        problem: BundleProblem,
        start: BundleEstimate,
        options: LoopOptions | None = None,
        *,
        scale_px: Float[ndarray, "*batch"] | None = None,
    ) -> BundleMinimum:
        options = options or LoopOptions()
        estimate, costs, n_halves, noise_px = start, [], 0, scale_px
        for turn in range(2 * MAX_ROUNDS):
            self.request.check_stop()
            half = minimize(_with_reference(problem, turn % 2), estimate, options, scale_px=noise_px)
            estimate, noise_px = half.estimate, half.scale_px
            n_halves += int(half.n_iterations)
            costs.append(float(half.equations.cost_px2 / half.scale_px**2))
            if len(costs) > 2 and costs[-3] - costs[-1] < SETTLED_SHARE * costs[-1]:
                break
        end = minimize(problem, estimate, options, scale_px=noise_px)
        self.solves.append(_Solve(tuple(costs), n_halves, int(end.n_iterations)))
        return replace(end, n_iterations=end.n_iterations + n_halves)

    def report(self) -> dict[str, Any]:
        """What each solve took; the first one starts from the closed forms."""
        return {
            "solves": [
                {"half_rounds": len(s.costs), "iterations": s.half_iterations, "joint_iterations": s.joint_iterations}
                for s in self.solves
            ],
        }


def _with_reference(problem: BundleProblem, side: int) -> BundleProblem:
    """The problem with one camera's intrinsics held."""
    cameras = list(problem.cameras)
    cameras[side] = replace(cameras[side], is_free=np.zeros_like(cameras[side].is_free))
    return replace(problem, cameras=tuple(cameras))
