"""What is wrong with the views, by name: repaired where that is certain, else rejected, or the whole set refused.

Order of the checks: each camera's corners (inside the image, on a grid, spread), the resolution of left against
right, each camera's geometry (degenerate sets), then the two cameras against each other (corner order, shifts,
pairing), and last the rig as a whole. Thresholds compare with what the data itself shows (robust medians,
covariances), never with one kind of rig.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.cameras.rig import are_exchanged
from binocal.errors import TooFewViewsError
from binocal.evidence import Detections
from binocal.findings import Finding, finding
from binocal.geometry import SE3
from binocal.geometry.homography import (
    MIN_POINTS,
    UNFIT,
    HomographyFit,
    fit_homographies,
)
from binocal.initialization.consensus import explain_view, find_consensus, side_to_reorder
from binocal.initialization.input_checks import (
    MIN_VIEWS,
    MOST,
    check_degeneracy,
    check_grid,
    check_inside,
    check_resolution,
    check_size,
)
from binocal.initialization.intrinsics import InitialCamera, estimate_intrinsics
from binocal.initialization.relative_pose import Consensus
from binocal.initialization.solid_diagnosis import findings_of_solid, rejected_views, start_of_solid
from binocal.initialization.solid_targets import SolidCamera, is_solid
from binocal.result import RejectedView
from binocal.shapes import Bool, Float

_SHARED_FOCAL = 0.03  # sigma of log f beyond which the other camera's focal length is consulted


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """The views as they can be used, and a start for the joint solver.

    ``detections`` are the input with repaired corner orders (rejected views still in place); ``is_used`` marks the
    views to calibrate from, ``rejected`` says why for the others, ``notes`` has a sentence for each repaired view (""
    for the rest) and ``findings`` those for the user. ``left`` and ``right`` are the initial cameras; their poses and
    weights belong to the corners as they were given, ``R_left_board`` and ``t_left_board`` (NaN where unused) to the
    repaired ones. ``left_weights`` and ``right_weights`` in [0, 1] say how far the start trusts each repaired
    corner.
    """

    detections: Detections
    is_used: Bool[ndarray, "views"]
    rejected: tuple[RejectedView, ...]
    notes: tuple[str, ...]
    findings: tuple[Finding, ...]
    left: InitialCamera | SolidCamera
    right: InitialCamera | SolidCamera
    T_right_left: SE3
    R_left_board: Float[ndarray, "views 3 3"]
    t_left_board: Float[ndarray, "views 3"]
    left_weights: Float[ndarray, "views n"]
    right_weights: Float[ndarray, "views n"]
    rms_px: float
    """Median over views of the RMS distance at the start, both cameras."""


def diagnose_views(detections: Detections, model: str = "brown4", *, has_skew: bool = False) -> Diagnosis:
    """Check the views, repair or reject the bad ones, and start cameras, T_right_left and board poses in closed form.

    Raises:
        DataError: Corners lie outside the image, or at another resolution than it.
        InconsistentViewsError: Corner order, board size or pairing are wrong in most views.
        DegenerateGeometryError: The views leave the intrinsics undetermined.
        TooFewViewsError: Fewer than 3 pairs remain; ``rejected`` says why.
    """
    if is_solid(detections.object_points_m):
        return _diagnose_solid(detections, model)
    reasons: dict[int, Finding] = {}
    pixels = [detections.left_px, detections.right_px]
    sizes = [detections.left_size_wh, detections.right_size_wh]
    points = detections.object_points_m
    fits = []
    for camera, px, size in zip(("left", "right"), pixels, sizes, strict=True):
        fit = fit_homographies(points, px)
        check_inside(camera, px, size, fit, detections.names)
        check_grid(camera, points, px, fit, detections.names, reasons)
        fits.append(fit)
    if not np.any(fits[0].is_valid | fits[1].is_valid):
        _require(0, detections, reasons)
    check_resolution(pixels, sizes, fits)

    keep = np.ones(detections.n_views, dtype=bool)
    keep[list(reasons)] = False
    fits = [_without(fit, ~keep) for fit in fits]
    seen = [fit.is_valid for fit in fits]
    for view in np.flatnonzero(keep & ~seen[0] & ~seen[1]):
        reasons[int(view)] = finding("view-without-corners")
    for side in range(2):
        _require(int(seen[side].sum()), detections, reasons)
    cameras = [
        estimate_intrinsics(points, pixels[k], sizes[k], model, has_skew=has_skew, homographies=fits[k])
        for k in range(2)
    ]
    for k, camera in enumerate(("left", "right")):
        check_degeneracy(camera, cameras[k], points)
    cameras = _share_focal(cameras, fits, points, pixels, sizes, model, has_skew)
    sizes_found = [check_size(camera, cameras[k], pixels[k]) for k, camera in enumerate(("left", "right"))]
    _require(int(np.sum(cameras[0].is_usable & cameras[1].is_usable)), detections, reasons)

    consensus, symmetries = find_consensus(cameras, detections)
    notes = [""] * detections.n_views
    orders: tuple[dict[int, ndarray], dict[int, ndarray]] = ({}, {})
    weights = [camera.weights.copy() for camera in cameras]
    R, t = consensus.R_left_board.copy(), consensus.t_left_board.copy()
    for view in np.flatnonzero(consensus.symmetry >= 0):
        if not consensus.agrees[view]:
            reasons[int(view)] = explain_view(int(view), consensus, cameras, detections, symmetries)
        elif consensus.symmetry[view] > 0:
            k = int(consensus.symmetry[view])
            side = side_to_reorder(int(view), k, consensus, cameras)
            applied = k if side == 1 else symmetries.inverse_of(k)
            orders[side][int(view)] = symmetries.order[applied]
            weights[side][view] = weights[side][view][symmetries.order[applied]]
            if side == 0:
                motion = symmetries.motions[applied]
                t[view] = R[view] @ motion.t + t[view]
                R[view] = R[view] @ motion.R
            camera = ("left", "right")[side]
            notes[view] = finding("view-reordered", camera=camera, symmetry=symmetries.names[k]).text
    is_used = (cameras[0].is_usable | cameras[1].is_usable) & np.array(
        [i not in reasons for i in range(detections.n_views)]
    )
    n_pairs = int(np.sum(is_used & cameras[0].is_usable & cameras[1].is_usable))
    _require(n_pairs, detections, reasons)
    R[~is_used], t[~is_used] = np.nan, np.nan
    return Diagnosis(
        detections.reorder("left", orders[0]).reorder("right", orders[1]),
        is_used,
        tuple(RejectedView(detections.names[i], reasons[i].text, reasons[i].code) for i in sorted(reasons)),
        tuple(notes),
        tuple([found for found in sizes_found if found] + _rig_findings(consensus, cameras, notes)),
        cameras[0],
        cameras[1],
        consensus.T_right_left,
        R,
        t,
        weights[0],
        weights[1],
        float(np.median(consensus.miss_px[consensus.agrees])),
    )


def _diagnose_solid(detections: Detections, model: str) -> Diagnosis:
    """As :func:`diagnose_views`, of a target that is no plane: nothing to reorder, and one view determines a camera."""
    reasons: dict[int, Finding] = {}
    (left, right), T_right_left, T_left_board, is_used, miss_px = start_of_solid(detections, model, reasons)
    _require(int(np.sum(is_used & left.is_usable & right.is_usable)), detections, reasons)
    R, t = T_left_board.R.copy(), T_left_board.t.copy()
    R[~is_used], t[~is_used] = np.nan, np.nan
    return Diagnosis(
        detections,
        is_used,
        rejected_views(detections, reasons),
        ("",) * detections.n_views,
        findings_of_solid(T_right_left),
        left,
        right,
        T_right_left,
        R,
        t,
        left.weights,
        right.weights,
        miss_px,
    )


def _require(found: int, detections: Detections, reasons: dict[int, Finding]) -> None:
    """Raise TooFewViewsError unless enough views are left: the camera that sees no board is named, else why views were left out."""
    if found >= MIN_VIEWS:
        return
    rejected = {detections.names[i]: reasons[i].text for i in sorted(reasons)}
    is_seen = [seen.sum(axis=1) >= MIN_POINTS for seen in (detections.left_is_seen, detections.right_is_seen)]
    n_left, n_right, n_both = (int(s.sum()) for s in (*is_seen, is_seen[0] & is_seen[1]))
    why, remedy = "", ""
    if n_both < MIN_VIEWS <= detections.n_views:
        why = f"the left camera sees the board in {n_left} of {detections.n_views} views, the right one in {n_right}, both in {n_both}"
        remedy = "add views in which both cameras see the board"
    elif rejected:
        code, n_same = Counter(found.code for found in reasons.values()).most_common(1)[0]
        view, first = next((i, found) for i, found in sorted(reasons.items()) if found.code == code)
        why = (
            f"{len(rejected)} of {detections.n_views} views were left out, {n_same} of them as view {detections.names[view]}: "
            f"{first.text.partition('; ')[0]}"
        )
        remedy = "mend these views, or add others"
    raise TooFewViewsError(found, MIN_VIEWS, rejected, why=why, remedy=remedy)


def _without(fit: HomographyFit, dropped: Bool[ndarray, "views"]) -> HomographyFit:
    """The fits with some views marked as not usable."""
    if not dropped.any():
        return fit
    return replace(
        fit, status=np.where(dropped, UNFIT, fit.status), weights=np.where(dropped[:, None], 0.0, fit.weights),
        H=np.where(dropped[:, None, None], np.nan, fit.H),
    )  # fmt: skip


def _share_focal(
    cameras: list[InitialCamera],
    fits: list[HomographyFit],
    points: ndarray,
    pixels: list[ndarray],
    sizes: list[tuple[int, int]],
    model: str,
    has_skew: bool,
) -> list[InitialCamera]:
    """In weak sets, bring both focal lengths together: far boards look larger by the ratio of the focal lengths."""
    sigma = [camera.vanishing.sigma_log_focal for camera in cameras]
    both = cameras[0].is_usable & cameras[1].is_usable
    if max(sigma) < _SHARED_FOCAL or both.sum() < MIN_VIEWS:
        return cameras
    f = [float(camera.parameters[0]) for camera in cameras]
    depths = [camera.poses.t[both, 2] for camera in cameras]
    in_front = (depths[0] > 0) & (depths[1] > 0)  # beside a lens of more than 180 degrees boards may stand behind
    if not in_front.any():
        return cameras
    size = [f[k] / depths[k][in_front] for k in range(2)]
    ratio = float(np.median(np.log(size[1] / size[0])))  # log fR / fL, were the depths equal
    precision = [1 / s**2 for s in sigma]
    # left's log f from both cameras; the depths differ by a few percent in usual rigs
    tied = 1 / (sigma[1] ** 2 + _SHARED_FOCAL**2)
    log_left = (precision[0] * np.log(f[0]) + tied * (np.log(f[1]) - ratio)) / (precision[0] + tied)
    values = [float(np.exp(log_left)), float(np.exp(log_left + ratio))]
    return [
        estimate_intrinsics(
            points, pixels[k], sizes[k], model, has_skew=has_skew, homographies=fits[k],
            focal_px=(values[k], values[k] * _SHARED_FOCAL),
        )
        for k in range(2)
    ]  # fmt: skip


def _rig_findings(consensus: Consensus, cameras: list[InitialCamera], notes: list[str]) -> list[Finding]:
    """What there is to say about the rig as a whole."""
    found = []
    if are_exchanged(consensus.T_right_left):
        found.append(finding("cameras-exchanged"))
    n_repaired = sum(bool(note) for note in notes)
    if n_repaired > MOST * consensus.agrees.sum() and n_repaired > 1:
        found.append(finding("corner-orders-repaired", n_views=n_repaired))
    for name, camera in zip(("left", "right"), cameras, strict=True):
        found.extend(finding("start-simplified", camera=name, note=note) for note in camera.notes)
    return found
