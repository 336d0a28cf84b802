"""Which corners were put where when corner orders were repaired."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.evidence.detections import Detections
from binocal.shapes import Bool, Float, Int

Orders = dict[int, tuple[int, ...]]


def changed_orders(detected: Detections, repaired: Detections) -> tuple[Orders, Orders]:
    """For the left and the right camera: views of ``repaired`` whose corners stand in another order than as detected.

    ``order`` maps them: corner i of the view is corner ``order[i]`` as detected, as :meth:`Detections.reorder` takes it. Views are
    matched by name.

    Raises:
        ValueError: A view of ``repaired`` was not detected, or its corners are not those detected in any order.
    """
    if repaired is detected:
        return {}, {}
    place = {name: i for i, name in enumerate(detected.names)}
    unknown = [name for name in repaired.names if name not in place]
    if unknown:
        raise ValueError(f"view {unknown[0]} is not among those that were detected")
    index = np.array([place[name] for name in repaired.names], dtype=int)
    left, right = (_side_orders(side, detected, repaired, index) for side in ("left", "right"))
    return left, right


def _side_orders(side: str, detected: Detections, repaired: Detections, index: Int[ndarray, "k"]) -> Orders:
    before, after = _rows(side, detected)[index], _rows(side, repaired)
    orders: Orders = {}
    for view in np.flatnonzero(_differs(before, after)).tolist():
        order = np.empty(len(after[view]), dtype=int)
        order[_sorting(after[view])] = _sorting(before[view])
        if _differs(before[view][order][None], after[view][None])[0]:
            raise ValueError(
                f"{side} view {repaired.names[view]}: its corners are not those that were detected; a calibrator may drop "
                "views and change the order of corners, and no more"
            )
        orders[view] = tuple(order.tolist())
    return orders


def _rows(side: str, detections: Detections) -> Float[ndarray, "views n d"]:
    """All that is known of each corner of a camera."""
    px, covariance = getattr(detections, f"{side}_px"), getattr(detections, f"{side}_covariance_px2")
    return px if covariance is None else np.concatenate([px, covariance.reshape(*px.shape[:2], 4)], axis=-1)


def _differs(a: Float[ndarray, "views n d"], b: Float[ndarray, "views n d"]) -> Bool[ndarray, "views"]:
    return ((a != b) & ~(np.isnan(a) & np.isnan(b))).any(axis=(1, 2))


def _sorting(rows: Float[ndarray, "n d"]) -> Int[ndarray, "n"]:
    return np.lexsort(rows.T)
