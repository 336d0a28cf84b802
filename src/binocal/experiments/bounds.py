"""The Cramér-Rao bound of what a finder measured."""

from __future__ import annotations

from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.errors import DegenerateGeometryError
from binocal.evidence import Detections
from binocal.geometry import SE3
from binocal.result import Covariance
from binocal.shapes import Float
from binocal.solvers.covariance import cramer_rao_bound
from binocal.solvers.whitening import corner_weights


def bound_of_corners(
    rig: StereoRig, corners: Detections, T_left_board: SE3, points_information: Float[ndarray, "m m"] | None = None
) -> Covariance | None:
    """The bound of corners with the covariances that they state, at the true rig, poses and points; None where the rig is undetermined.

    With ``points_information`` the points are known no better than that (see :func:`binocal.solvers.covariance.cramer_rao_bound`).
    """
    weights = corner_weights(corners)
    try:
        return cramer_rao_bound(
            *(rig, corners.object_points_m, T_left_board, weights.unit_px),
            left_is_seen=corners.left_is_seen,
            right_is_seen=corners.right_is_seen,
            weights=weights,
            points_information=points_information,
        )
    except DegenerateGeometryError:
        return None
