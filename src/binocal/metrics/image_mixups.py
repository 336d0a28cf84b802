"""Images that a rig explains only otherwise than they were given: exchanged, mirrored, upside down, shifted, a board of another size."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.evidence import Detections
from binocal.findings import Finding, finding
from binocal.initialization.symmetries import board_symmetries, mirrored_corners
from binocal.metrics.order import SUSPECT_PX, OrderedViews, order_corners
from binocal.shapes import Float
from binocal.solvers.poses import estimate_board_poses

CLEAR_FACTOR = 5.0  # right images fit better by 20 and more
LEAST_ALONE_PX = 0.05  # corners without noise
LEAST_SCALE = 1.4  # sizes that differ by less may be a baseline that has changed; the comparison with the rig says both
LEAST_VIEWS = 2  # a shift of the lists leaves fewer; one view alone may agree by chance
MOST_SHIFT = 3  # images by which lists are off; more are another recording


def find_mixup(rig: StereoRig, detections: Detections, given: OrderedViews) -> Finding | None:
    """How the images would fit the rig, where as ``given`` they do not and one change to all of them mends it; else None.

    The changes: left and right exchanged, one side or both mirrored or upside down, one list shifted by up to three images,
    a board of another size.
    """
    given_px = _misfit_px(given)
    if not given_px > SUSPECT_PX:
        return None
    alone_px, scale = _each_camera_alone(rig, detections)
    # covariances would have to turn with their corners; medians do not need them
    bare = replace(detections, left_covariance_px2=None, right_covariance_px2=None)
    bare = replace(bare, left_cross_covariance_px2=None, right_cross_covariance_px2=None)
    fits = [(_misfit_px(order_corners(rig, changed)), how, cure) for changed, how, cure in _changes(bare, scale)]
    best_px, how, cure = min(fits, key=lambda fit: fit[0], default=(np.inf, "", ""))
    # a board said to be huge seems far away, where any pose of it nearly fits: what explains the images leaves little more than
    # each camera alone does
    if not best_px < min(given_px / CLEAR_FACTOR, CLEAR_FACTOR * max(alone_px, LEAST_ALONE_PX)):
        return None
    return finding("images-mixed-up", how=how, given_px=given_px, mended_px=best_px, cure=cure)


def _misfit_px(ordered: OrderedViews) -> float:
    """Median over the views of their typical residual; infinite where too few views have one."""
    known = ordered.residual_px[np.isfinite(ordered.residual_px)]
    return float(np.median(known)) if len(known) >= LEAST_VIEWS else float("inf")


def _each_camera_alone(rig: StereoRig, detections: Detections) -> tuple[float, float]:
    """What the views leave where each camera has poses of its own (median, pixels), and the board's size over the stated one.

    With that size the board stands where the rig has both cameras see it; NaN where no view says.
    """
    unseen = np.full_like(detections.left_px, np.nan)
    left = estimate_board_poses(rig, replace(detections, right_px=unseen))
    right = estimate_board_poses(rig, replace(detections, left_px=unseen))
    both = np.flatnonzero(left.is_found & right.is_found)
    if not len(both):
        return np.inf, np.nan
    medians = [np.nanmedian(r2[both], axis=1) for r2 in (left.left_r2_px2, right.right_r2_px2)]
    T = rig.T_right_left
    centre = detections.object_points_m.mean(axis=0)[None]
    in_left, in_right = (poses.T_left_board[both].apply(centre)[:, 0] for poses in (left, right))
    path = T.apply(in_right) - in_left @ T.R.T  # from camera to camera, as the stated size has it; the rig says T.t
    times = float(np.median(path @ T.t)) / float(T.t @ T.t)
    return float(np.median(np.sqrt(np.fmax(*medians)))), 1 / times if times > 0 else np.nan


def _changes(detections: Detections, scale: float) -> Iterator[tuple[Detections, str, str]]:
    """The images otherwise: the corners as they would be then, what is wrong, and what to do."""
    if detections.left_size_wh == detections.right_size_wh:
        exchanged = replace(detections, left_px=detections.right_px, right_px=detections.left_px)
        yield exchanged, "left and right are exchanged", "exchange --left and --right"
    if scale < 1 / LEAST_SCALE or scale > LEAST_SCALE:
        scaled = replace(detections, object_points_m=detections.object_points_m * scale)
        cure = "give the board's length as printed, with its unit; if that is right, the baseline has changed: calibrate anew"
        yield scaled, f"the board is {scale:.3g} times as large as stated", cure
    mirror = board_symmetries(detections.object_points_m).mirror_order
    for which, sides in (("left", ("left",)), ("right", ("right",)), ("left and right", ("left", "right"))):
        if mirror is not None:
            changed = _with_sides(detections, sides, functools.partial(_mirrored, order=mirror))
            yield changed, f"the {which} images are mirrored", "mirror them back: a camera sees no board from behind"
        changed = _with_sides(detections, sides, _upside_down)
        yield changed, f"the {which} images are upside down", "turn them by 180 degrees, as when the rig was calibrated"
    n = detections.n_views
    for shift in sorted((s for s in range(-MOST_SHIFT, MOST_SHIFT + 1) if s), key=abs):
        left, right = np.arange(max(0, -shift), min(n, n - shift)), np.arange(max(0, shift), min(n, n + shift))
        if len(left) < max(LEAST_VIEWS, n // 2):
            continue
        moved = replace(detections.select(left), right_px=detections.right_px[right])
        by = "one image" if abs(shift) == 1 else f"{abs(shift)} images"
        pair = f"left {detections.names[left[0]]} belongs to right {detections.names[right[0]]}"
        text = f"the lists of left and right images are off by {by} ({pair})"
        yield moved, text, "pair the images again"


def _with_sides(
    detections: Detections, sides: tuple[str, ...], change: Callable[[ndarray, tuple[int, int]], ndarray]
) -> Detections:
    """The corners of the sides changed."""
    changed = {
        f"{side}_px": change(getattr(detections, f"{side}_px"), getattr(detections, f"{side}_size_wh"))
        for side in sides
    }
    return replace(detections, **changed)


def _mirrored(px: Float[ndarray, "views n 2"], size_wh: tuple[int, int], order: ndarray) -> Float[ndarray, "views n 2"]:
    return mirrored_corners(px, size_wh[0], order)


def _upside_down(px: Float[ndarray, "views n 2"], size_wh: tuple[int, int]) -> Float[ndarray, "views n 2"]:
    return np.array(size_wh) - 1.0 - px
