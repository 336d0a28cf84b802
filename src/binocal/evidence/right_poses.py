"""Whether the rig's pose is the one that the right poses of its views deviate from, where the exposures were apart.

Each view then has a right pose of its own, which fits its corners whatever the rig's R and T are: residuals say nothing of a change of
these. But a calibration ends where the views' deviations balance. A deviation is a turn w about the board's centre and a shift d of
it, both with normal priors, so that moving the rig by a turn and a shift no longer helps: the sums over the views of d and of
``w / var(w) + centre x d / var(d)`` vanish.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.geometry import SE3, so3
from binocal.shapes import Float

MOST_OFF_BALANCE = 1.0  # standard errors; calibrations leave at most 0.26, an edit by 0.05 deg of webcams' R 2.9 to 12


def imbalance_of_deviations(
    T_right_left: SE3, T_left_board: SE3, T_right_board: SE3, centre_m: Float[ndarray, "3"]
) -> float:
    """The largest of the six means over the views that should vanish, in standard errors by the views' scatter.

    ``centre_m`` is the board's centre. 0 where fewer than three views leave nothing to compare with.
    """
    if len(T_left_board.t) < 3:
        return 0.0
    centres = T_right_left.apply(T_left_board.apply(centre_m[None])[:, 0])
    shift = T_right_board.apply(centre_m[None])[:, 0] - centres
    predicted = T_right_left.R @ T_left_board.R
    turn = np.stack([so3.log(R) for R in T_right_board.R @ predicted.swapaxes(1, 2)])
    turn2, shift2 = np.mean(turn**2), np.mean(shift**2)
    if not (turn2 > 0 and shift2 > 0):
        return 0.0
    scores = np.concatenate([turn / turn2 + np.cross(centres, shift) / shift2, shift], axis=1)
    error = scores.std(axis=0, ddof=1) / np.sqrt(len(scores))
    return float(np.max(np.abs(scores.mean(axis=0)) / np.maximum(error, 1e-300)))
