"""Images that a rig explains only otherwise than they were given: sides exchanged, mirrored, upside down, lists shifted."""

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

CLEAR_FACTOR = 5.0  # right images fit better by 20 and more
LEAST_VIEWS = 2  # a shift of the lists leaves fewer; one view alone may agree by chance
MOST_SHIFT = 3  # images by which lists are off; more are another recording


def find_mixup(rig: StereoRig, detections: Detections, given: OrderedViews) -> Finding | None:
    """How the images would fit the rig, where as ``given`` they do not and one change to all of them mends it; else None.

    The changes: left and right exchanged, one side or both mirrored or upside down, one list shifted by up to three images.
    """
    given_px = _misfit_px(given)
    if not given_px > SUSPECT_PX:
        return None
    # covariances would have to turn with their corners; medians do not need them
    bare = replace(detections, left_covariance_px2=None, right_covariance_px2=None)
    bare = replace(bare, left_cross_covariance_px2=None, right_cross_covariance_px2=None)
    fits = [(_misfit_px(order_corners(rig, changed)), how, cure) for changed, how, cure in _changes(bare)]
    best_px, how, cure = min(fits, key=lambda fit: fit[0], default=(np.inf, "", ""))
    if not best_px < given_px / CLEAR_FACTOR:
        return None
    return finding("images-mixed-up", how=how, given_px=given_px, mended_px=best_px, cure=cure)


def _misfit_px(ordered: OrderedViews) -> float:
    """Median over the views of their typical residual; infinite where too few views have one."""
    known = ordered.residual_px[np.isfinite(ordered.residual_px)]
    return float(np.median(known)) if len(known) >= LEAST_VIEWS else float("inf")


def _changes(detections: Detections) -> Iterator[tuple[Detections, str, str]]:
    """The images otherwise: the corners as they would be then, what is wrong, and what to do."""
    if detections.left_size_wh == detections.right_size_wh:
        exchanged = replace(detections, left_px=detections.right_px, right_px=detections.left_px)
        yield exchanged, "left and right are exchanged", "exchange --left and --right"
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
