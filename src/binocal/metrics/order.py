"""Board poses of held-out views, with the two cameras' corner orders brought into agreement.

A symmetric board looks the same when it is turned, and a finder may number its corners from either end: then left and
right corners of one view do not match although every corner is right. The rig, which is known here, decides. Mirrored
orders are not tried: no camera sees a print from behind, and what only a mirror explains has another cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.evidence import Detections
from binocal.geometry import SE3
from binocal.initialization.symmetries import board_symmetries
from binocal.shapes import Float
from binocal.solvers.poses import PosedViews, estimate_board_poses

SUSPECT_PX = 1.0  # no sane rig misses its corners by that much; looking costs time only
CLEAR_FACTOR = 5.0  # another order is believed if it fits that many times better; a wrong one is worse by 100 and more


@dataclass(frozen=True, slots=True, eq=False)
class OrderedViews:
    """Detections whose corner orders agree, a board pose per view, its typical (median) residual, and what was done.

    The corners of a view without a pose are NaN, its residual too.
    """

    detections: Detections
    T_left_board: SE3
    residual_px: Float[ndarray, "views"]
    notes: tuple[str, ...]


def order_corners(rig: StereoRig, detections: Detections) -> OrderedViews:
    """Bring the right corners of each view into the order of the left ones, as turns of the board onto itself allow.

    A view's corners are reordered only where that makes its typical (median) residual at least 5 times smaller, and the view no
    stranger than others; a note says so.
    """
    best = estimate_board_poses(rig, detections)
    residual_px = _typical_px(best)
    symmetries = board_symmetries(detections.object_points_m)
    orders, notes = {}, {}
    R, t = best.T_left_board.R.copy(), best.T_left_board.t.copy()
    is_found = best.is_found.copy()
    suspects = np.flatnonzero(residual_px > SUSPECT_PX)
    usual_px = float(np.median(residual_px[np.isfinite(residual_px)])) if np.isfinite(residual_px).any() else 0.0
    limit_px = np.minimum(residual_px / CLEAR_FACTOR, max(SUSPECT_PX, CLEAR_FACTOR * usual_px))
    turns = [k for k in range(1, len(symmetries.names)) if symmetries.motions.R[k, 2, 2] > 0]
    for k in turns if len(suspects) else ():
        views = detections.select(suspects)
        moved = views.reorder("right", {view: symmetries.order[k] for view in range(views.n_views)})
        poses = estimate_board_poses(rig, moved)
        for i in np.flatnonzero(_typical_px(poses) < limit_px[suspects]):
            view = suspects[i]
            limit_px[view] = residual_px[view] = _typical_px(poses)[i]
            orders[int(view)] = symmetries.order[k]
            R[view], t[view], is_found[view] = poses.T_left_board.R[i], poses.T_left_board.t[i], poses.is_found[i]
            notes[view] = (
                f"view {detections.names[view]}: the right corner order was {symmetries.names[k]} against the left; "
                "repaired."
            )
    has_pose = is_found[:, None, None]
    ordered = detections.reorder("right", orders)
    ordered = replace(
        ordered,
        left_px=np.where(has_pose, ordered.left_px, np.nan),
        right_px=np.where(has_pose, ordered.right_px, np.nan),
    )
    return OrderedViews(ordered, SE3(R, t), residual_px, tuple(notes[view] for view in sorted(notes)))


def _typical_px(poses: PosedViews) -> Float[ndarray, "views"]:
    """Median residual length of each view, both cameras; NaN where nothing was seen."""
    r2 = np.concatenate([poses.left_r2_px2, poses.right_r2_px2], axis=1)
    typical = np.full(len(r2), np.nan)
    seen = np.isfinite(r2).any(axis=1)
    typical[seen] = np.sqrt(np.nanmedian(r2[seen], axis=1))
    return typical
