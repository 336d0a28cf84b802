"""How differently the views show the board: whether they are one pose, and what a weak set lacks.

A refusal that asks for what the set already has helps nobody. The advice is taken from the views themselves: their tilts, the part
of the image that the board fills, the places where it was.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.acceptance.figures import board_normals, focal_sigma_share
from binocal.evidence import Detections
from binocal.findings import Finding, finding
from binocal.geometry.so3 import angle_rad
from binocal.result import StereoCalibration
from binocal.shapes import Float

ONE_POSE_DEG, ONE_POSE_SHARE = 12.0, 0.12
"""Views turned and moved (share of the board's extent) by less are variations of one pose: a board held before the cameras."""
SAME_DEG, SAME_SHARE = 3.0, 0.03  # by less, they are the same pose: a hand that trembles
WEAK_FOCAL_SHARE = 0.01  # standard deviation of a focal length over it: below it even one pose would have told enough
TILTED_DEG = 12.0  # from here on a tilt says something of the focal length
N_TILTED = 3  # such views, the directions of whose tilts span two axes
ACROSS_SHARE = 0.3  # least over largest axis of the tilts' directions: below, they are all about one axis
SMALL_SHARE = (
    0.3  # of the image's diagonal: a board that looks smaller in most views is seen nearly without perspective
)
COVERED_SHARE = 0.6  # of the image's width and height that all corners together should span


def find_one_pose(calibration: StereoCalibration, *, is_converged: bool) -> Finding | None:
    """The refusal of a weak set whose views are all variations of one pose; None where it is another, or strong."""
    if calibration.evidence is None or calibration.evidence.detections.n_views < 2:
        return None
    is_weak = not is_converged or max(focal_sigma_share(calibration, s) for s in ("left", "right")) > WEAK_FOCAL_SHARE
    if not is_weak:
        return None
    detections = calibration.evidence.detections
    turned_deg, moved = _turns_deg(calibration), _moves(detections)
    # The pose is that of the view which the others are nearest to.
    middle = int(np.argmin(np.median(turned_deg / ONE_POSE_DEG + moved / ONE_POSE_SHARE, axis=1)))
    if not (turned_deg[middle].max() < ONE_POSE_DEG and moved[middle].max() < ONE_POSE_SHARE):
        return None
    n_same = int(np.sum((turned_deg[middle] < SAME_DEG) & (moved[middle] < SAME_SHARE)))
    return finding(
        "views-of-one-pose",
        n_views=detections.n_views,
        view=detections.names[middle],
        turned_deg=float(turned_deg[middle].max()),
        moved_percent=100 * float(moved[middle].max()),
        n_same=n_same,
    )


def advise(calibration: StereoCalibration) -> str | None:
    """What would make the views of a weak set determine more, without what they have; None where tilts are what they lack."""
    if calibration.evidence is None or not has_tilts(board_normals(calibration)):
        return None
    detections = calibration.evidence.detections
    share, covered = _share_filled(detections), _share_covered(detections)
    ways = []
    if share < SMALL_SHARE:
        ways.append(
            f"bring the board nearer or use a larger one (it fills {100 * share:.0f} % of the image's diagonal in the median view)"
        )
    if covered < COVERED_SHARE:
        ways.append(f"move it over the whole image (all corners together span {100 * covered:.0f} % of it)")
    if not ways:
        return "the tilts are there: add more such views, or hold what you know (--prior with --hold left,right), or choose a plainer --model"
    return " and ".join(ways) + "; the tilts are there"


def has_tilts(normals: Float[ndarray, "views 3"]) -> bool:
    """Whether at least three views are tilted, and about more than one axis."""
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.where(unit[:, 2:] < 0, -unit, unit)
    tilted = unit[np.degrees(np.arccos(np.clip(unit[:, 2], -1, 1))) > TILTED_DEG]
    if len(tilted) < N_TILTED:
        return False
    spread = np.linalg.svd(tilted[:, :2], compute_uv=False)
    return bool(spread[1] > ACROSS_SHARE * spread[0])


def _turns_deg(calibration: StereoCalibration) -> Float[ndarray, "views views"]:
    """Angle between the board's poses in every two views."""
    assert calibration.evidence is not None
    R = calibration.evidence.T_left_board.R
    return np.degrees(angle_rad(np.swapaxes(R[:, None], -1, -2) @ R[None]))


def _moves(detections: Detections) -> Float[ndarray, "views views"]:
    """RMS motion of the corners that two views share, over the board's extent in the image: the larger of both cameras.

    Infinite where two views share none.
    """
    moves = np.zeros((detections.n_views, detections.n_views))
    n_shared = np.zeros_like(moves)
    for px in (detections.left_px, detections.right_px):
        extent = _extents_px(px)
        for a in range(len(px)):
            shared = np.isfinite(px[a, :, 0]) & np.isfinite(px[:, :, 0])
            apart2 = np.where(shared, np.square(np.nan_to_num(px - px[a])).sum(axis=-1), 0.0).sum(axis=1)
            count = shared.sum(axis=1)
            rms = np.sqrt(apart2 / np.maximum(count, 1)) / max(float(extent[a]), 1e-9)
            moves[a] = np.where(count > 0, np.maximum(moves[a], rms), moves[a])
            n_shared[a] += count
    return np.where(n_shared > 0, moves, np.inf)


def _share_filled(detections: Detections) -> float:
    """The board's extent over the image's diagonal in the median view, in the camera where it is smaller."""
    shares = []
    for px, size_wh in (
        (detections.left_px, detections.left_size_wh),
        (detections.right_px, detections.right_size_wh),
    ):
        extent = _extents_px(px)
        if (extent > 0).any():
            shares.append(float(np.median(extent[extent > 0])) / float(np.hypot(*size_wh)))
    return min(shares, default=0.0)


def _share_covered(detections: Detections) -> float:
    """What all corners together span of the image's width or height, whichever is less, in the camera where it is less."""
    shares = []
    for px, size_wh in (
        (detections.left_px, detections.left_size_wh),
        (detections.right_px, detections.right_size_wh),
    ):
        seen = px[np.isfinite(px[..., 0])]
        if len(seen):
            shares.append(float(np.min(np.ptp(seen, axis=0) / np.array(size_wh))))
    return min(shares, default=0.0)


def _extents_px(px: Float[ndarray, "views n 2"]) -> Float[ndarray, "views"]:
    """Diagonal of the box about each view's corners, 0 where none is seen."""
    unseen = np.isnan(px)
    low = np.min(np.where(unseen, np.inf, px), axis=1)
    high = np.max(np.where(unseen, -np.inf, px), axis=1)
    return np.linalg.norm(np.maximum(high - low, 0.0), axis=1)
