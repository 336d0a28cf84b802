"""What a controller may observe of a solve: scale-free numbers of residuals, equations and the last iteration."""

from __future__ import annotations

from numpy import ndarray

from binocal.kernels import LastIteration, observe
from binocal.shapes import Float
from binocal.solvers.board_views import BundleProblem, BundleState

OBSERVED = (
    "log10 length of the Gauss-Newton step, sigmas",
    "rotation's share of the rig's decrement",
    "the rig's share of the whole decrement",
    "log10 least pivot of the equilibrated shared equations",
    "log10 rotation step of the rig, rad",
    "log10 translation step of the rig over the baseline",
    "log10 RMS rotation step of the boards, rad",
    "log10 RMS translation step of the boards over their distance",
    "log2 lower quartile of the residual lengths over the MAD noise",
    "log2 median of the same",
    "log2 upper quartile of the same",
    "log2 ninth decile of the same",
    "share of corners beyond 3.5 MAD noise",
    "share of corners beyond 7",
    "log2 residual, right over left",
    "spread of the views' log2 residuals, left",
    "spread of the views' log2 residuals, right",
    "log10 number of corners, over 1000",
    "log10 kernel scale over the MAD noise",
    "log10 MAD noise over that before the last iteration",
    "log10 Gauss-Newton step over that before the last iteration",
    "gain ratio of the last iteration",
    "last candidate kept",
    "cosine of this and the last rig step",
)
"""What :func:`observe_state` returns, in order."""


def observe_state(problem: BundleProblem, state: BundleState) -> Float[ndarray, "*batch f"]:
    """Scale-free numbers of the state, all of them at hand: residuals, the solver's own equations, the last iteration."""
    seen = state.seen
    last = LastIteration(state.scale_px, seen.gain, state.is_kept, seen.previous_mad_px, seen.previous_newton)
    return observe(
        tuple(e.r2_px2 for e in state.equations.cameras),
        tuple(camera.is_seen for camera in problem.cameras),
        state.mad_px,
        seen.newton,
        state.estimate.T_right_left.t,
        state.estimate.T_left_board.t,
        last,
    )
