"""``from-guess``: the paper's algorithm step by step, its rotation and translation found from an uncalibrated guess.

Internal parameters come from the vanishing points of each camera's boards (eqs 7-12). Then they are held, the boards stay where the
left camera alone sees them, and the agent moves the rig from a guess to where both cameras agree (steps 6 to 8); no closed-form pose
between the cameras has any part in it. The guess is what somebody knows who has two cameras before him: parallel, side by side.

The paper ends there. Here the joint solve of all parameters follows, from where the agent ended, and the checks of every other
calibrator; ``provenance.from_guess`` says what the agent did, and where it ended. What the guards of
:mod:`binocal.solvers.controlled` do is counted there too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.joint import calibrate_jointly
from binocal.calibrators.registry import refuse_unsuited
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.initialization.diagnosis import diagnose_views
from binocal.result import StereoCalibration
from binocal.rl.agent_kind import AgentKind
from binocal.rl.policy import LearnedController, Policy, load_policy, shipped_policy
from binocal.shapes import Float
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem, CameraObservations
from binocal.solvers.controlled import ControlledMinimum, minimize_controlled
from binocal.solvers.loop_state import Controller
from binocal.solvers.minimization import LoopOptions, minimize

CLASSICAL = "lm"
BASELINE_SHARE = 0.1  # of the boards' median distance, where nobody knows the baseline
OPTIONS = ("agent", "baseline_m", "guess_deg_m")


@dataclass(frozen=True, slots=True, eq=False)
class GuessSolve:
    """What the vanishing points and the agent made: cameras, the guess, and the solve with the cameras held.

    ``controlled`` is None where the same start was solved without an agent.
    """

    rig: StereoRig
    guess: SE3
    minimum: BundleMinimum
    controlled: ControlledMinimum | None

    @property
    def n_led(self) -> int:
        """Iterations that the agent chose."""
        return 0 if self.controlled is None else len(self.controlled.controlled)

    @property
    def guard(self) -> str:
        """Why a guard took over from the agent; empty where none did."""
        return "" if self.controlled is None else self.controlled.fallback_reason

    def document(self) -> dict[str, Any]:
        """What of it belongs in a rig file."""
        T = self.rig.T_right_left
        return {
            "guess": {"R": self.guess.R.tolist(), "T": self.guess.t.tolist()},
            "agent_iterations": self.n_led,
            "agent_steps_kept": sum(i.is_kept for i in self.controlled.controlled) if self.controlled else 0,
            "guard": self.guard,
            "classical_iterations": int(self.minimum.n_iterations) - self.n_led,
            "is_converged": bool(self.minimum.is_converged),
            "remaining_sigma": 0.0 if self.controlled is None else self.controlled.remaining_sigma,
            "with_cameras_held": {"R": T.R.tolist(), "T": T.t.tolist()},
        }


def calibrate_from_guess(evidence: Detections, request: CalibrationRequest) -> StereoCalibration:
    """See the module's text, and :class:`binocal.calibrators.base.Calibrator`.

    Options: ``agent`` is ``drl``, ``drl-increments``, a file of weights, or ``lm``, which solves the same start without an agent.
    ``baseline_m`` is that of the data sheet. ``guess_deg_m`` is another guess of ``T_right_left``: a rotation vector in degrees and
    a translation in metres, six numbers.
    """
    request.check_options(*OPTIONS)
    if not isinstance(evidence, Detections):
        raise TypeError(f"calibrator 'from-guess' works from Detections of a board; got {type(evidence).__name__}")
    refuse_unsuited("from-guess", request)
    solve = solve_from_guess(evidence, request)
    request.check_stop()
    calibration = calibrate_jointly(
        evidence, replace(request, options={}), minimizer=_ContinuesFrom(solve.minimum.estimate)
    )
    return replace(calibration, provenance={**calibration.provenance, "from_guess": solve.document()})


@dataclass(frozen=True, slots=True, eq=False)
class HeldCameras:
    """Cameras by vanishing points, the corners with those cameras held, and where the left one alone sees the boards."""

    left: Camera
    right: Camera
    problem: BundleProblem
    T_left_board: SE3
    is_metric: bool


def hold_cameras(detections: Detections, request: CalibrationRequest) -> HeldCameras:
    """The internal parameters of the views that can be used. Raises as :func:`binocal.initialization.diagnosis.diagnose_views`."""
    diagnosis = diagnose_views(detections, request.model, has_skew=request.skew)
    used = np.flatnonzero(diagnosis.is_used & diagnosis.left.is_usable)
    views, model = diagnosis.detections.select(used), camera_model(request.model)
    problem = BundleProblem(
        np.ascontiguousarray(views.object_points_m.T),
        (
            CameraObservations.from_corners(model, views.left_px, intrinsics=False),
            CameraObservations.from_corners(model, views.right_px, intrinsics=False),
        ),
    )
    left, right = (Camera(request.model, c.size_wh, c.parameters) for c in (diagnosis.left, diagnosis.right))
    boards = SE3(diagnosis.left.poses.R[used], diagnosis.left.poses.t[used])
    return HeldCameras(left, right, problem, boards, views.is_metric)


def lead(held: HeldCameras, guess: SE3, agent: str | Policy) -> GuessSolve:
    """The pose between the cameras from a guess, by an agent's own steps or without one (``lm``)."""
    start = BundleEstimate((held.left.parameters, held.right.parameters), held.T_left_board, guess)
    controller, controlled = _controller(agent), None
    if controller is None:
        minimum = minimize(held.problem, start)
    else:
        controlled = minimize_controlled(held.problem, start, controller, leads_when_near=True)
        minimum = controlled.minimum
    T = minimum.estimate.T_right_left
    rig = StereoRig(held.left, held.right, SE3(so3.project_to_rotation(T.R), T.t), held.is_metric)
    return GuessSolve(rig, guess, minimum, controlled)


def solve_from_guess(detections: Detections, request: CalibrationRequest) -> GuessSolve:
    """Cameras by vanishing points, and the pose between them by the agent from the request's guess: the paper's own end.

    Raises as :func:`hold_cameras`.
    """
    held = hold_cameras(detections, request)
    return lead(held, _guess(request.options, held.T_left_board), str(request.options.get("agent", AgentKind.DRL)))


def _controller(name: str | Policy) -> Controller | None:
    """Who leads; None: nobody."""
    if isinstance(name, Policy):
        return LearnedController(name)
    if name == CLASSICAL:
        return None
    kinds = {str(kind): kind for kind in (AgentKind.DRL, AgentKind.DRL_INCREMENTS)}
    if name in kinds:
        return LearnedController(shipped_policy(kinds[name]))
    if not name.endswith(".safetensors"):
        raise ValueError(f"option agent is {name!r}; it can be {', '.join(kinds)}, {CLASSICAL} or a .safetensors file")
    return LearnedController(load_policy(name))


def _guess(options: Mapping[str, Any], boards: SE3) -> SE3:
    """``T_right_left`` as the options say it, or of parallel cameras side by side."""
    if "guess_deg_m" in options:
        numbers = np.asarray(options["guess_deg_m"], dtype=float)
        if numbers.shape != (6,) or not np.isfinite(numbers).all():
            raise ValueError(f"option guess_deg_m takes six numbers: turns in degrees, metres; got {numbers.tolist()}")
        return SE3(so3.exp(np.radians(numbers[:3])), numbers[3:])
    baseline_m = float(options.get("baseline_m", BASELINE_SHARE * float(np.median(boards.t[:, 2]))))
    if not 0 < baseline_m < np.inf:
        raise ValueError(f"option baseline_m must be above 0; got {baseline_m}")
    return SE3(np.eye(3), np.array([-baseline_m, 0.0, 0.0]))


class _ContinuesFrom:
    """The classical minimiser, which begins its first solve at a rig that was found before, and at its boards of the same views."""

    def __init__(self, found: BundleEstimate) -> None:
        self._found: BundleEstimate | None = found

    def __call__(
        self,
        problem: BundleProblem,
        start: BundleEstimate,
        options: LoopOptions | None = None,
        *,
        scale_px: Float[ndarray, "*batch"] | None = None,
    ) -> BundleMinimum:
        if self._found is not None:
            found = self._found.T_left_board
            boards = found if found.t.shape == start.T_left_board.t.shape else start.T_left_board  # fewer: other views
            start = replace(
                start, parameters=self._found.parameters, T_left_board=boards, T_right_left=self._found.T_right_left
            )
            self._found = None
        return minimize(problem, start, options, scale_px=scale_px)
