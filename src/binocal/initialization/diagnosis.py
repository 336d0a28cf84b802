"""What is wrong with the views, by name: repaired where that is certain, else rejected, or the whole set refused.

Order of the checks: each camera's corners (inside the image, on a grid, spread), the resolution of left against
right, each camera's geometry (degenerate sets), then the two cameras against each other (corner order, shifts,
pairing), and last the rig as a whole. Thresholds compare with what the data itself shows (robust medians,
covariances), never with one kind of rig.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.errors import TooFewViewsError
from binocal.evidence import Detections
from binocal.findings import Finding, finding, refusal
from binocal.geometry import SE3
from binocal.geometry.homography import (
    COINCIDENT,
    COLLINEAR,
    GOOD,
    MIN_POINTS,
    UNFIT,
    HomographyFit,
    fit_homographies,
)
from binocal.initialization.intrinsics import InitialCamera, estimate_intrinsics
from binocal.initialization.poses import BoardPoses, select_poses
from binocal.initialization.relative_pose import Consensus, estimate_relative_pose, transfer_px
from binocal.initialization.symmetries import BoardSymmetries, board_symmetries, no_symmetry, transposed_order
from binocal.initialization.vanishing_points import check_orientations
from binocal.result import RejectedView
from binocal.shapes import Bool, Float

MIN_VIEWS = 3  # two leave the principal point to chance
_OFF_GRID = (
    0.5  # robust sigma of a homography over the corner spacing; 200° fisheyes reach 0.3, a wrong order 1 and more
)
_MOST = 0.6  # share of views that makes a fault the set's, not the view's
_OUTSIDE_PX = 2.0
_MAX_SHIFT = 3
_MAX_SIGMA_LOG_FOCAL = 0.5  # six views tilted by 12° reach 0.37, twenty tilted by 1° start at 0.65
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
    left: InitialCamera
    right: InitialCamera
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
    reasons: dict[int, Finding] = {}
    pixels = [detections.left_px, detections.right_px]
    sizes = [detections.left_size_wh, detections.right_size_wh]
    points = detections.object_points_m
    fits = []
    for camera, px, size in zip(("left", "right"), pixels, sizes, strict=True):
        fit = fit_homographies(points, px)
        _check_inside(camera, px, size, fit, detections.names)
        _check_grid(camera, points, px, fit, detections.names, reasons)
        fits.append(fit)
    if not np.any(fits[0].is_valid | fits[1].is_valid):
        _require(0, detections, reasons)
    _check_resolution(pixels, sizes, fits)

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
        _check_degeneracy(camera, cameras[k], points)
    cameras = _share_focal(cameras, fits, points, pixels, sizes, model, has_skew)
    sizes_found = [_check_size(camera, cameras[k], pixels[k]) for k, camera in enumerate(("left", "right"))]
    _require(int(np.sum(cameras[0].is_usable & cameras[1].is_usable)), detections, reasons)

    consensus, symmetries = _find_consensus(cameras, detections)
    notes = [""] * detections.n_views
    orders: tuple[dict[int, ndarray], dict[int, ndarray]] = ({}, {})
    weights = [camera.weights.copy() for camera in cameras]
    R, t = consensus.R_left_board.copy(), consensus.t_left_board.copy()
    for view in np.flatnonzero(consensus.symmetry >= 0):
        if not consensus.agrees[view]:
            reasons[int(view)] = _explain(int(view), consensus, cameras, points)
        elif consensus.symmetry[view] > 0:
            k = int(consensus.symmetry[view])
            side = _side_to_reorder(int(view), k, consensus, cameras)
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


def _require(found: int, detections: Detections, reasons: dict[int, Finding]) -> None:
    if found < MIN_VIEWS:
        raise TooFewViewsError(found, MIN_VIEWS, {detections.names[i]: reasons[i].text for i in sorted(reasons)})


def _without(fit: HomographyFit, dropped: Bool[ndarray, "views"]) -> HomographyFit:
    """The fits with some views marked as not usable."""
    if not dropped.any():
        return fit
    return replace(
        fit, status=np.where(dropped, UNFIT, fit.status), weights=np.where(dropped[:, None], 0.0, fit.weights),
        H=np.where(dropped[:, None, None], np.nan, fit.H),
    )  # fmt: skip


# --- one camera -------------------------------------------------------------------------------------------------------


def _check_inside(camera: str, px: ndarray, size: tuple[int, int], fit: HomographyFit, names: tuple[str, ...]) -> None:
    """Corners that fit their board, yet lie outside the image, show a wrong image size (outliers do not fit)."""
    width, height = size
    slack = np.maximum(_OUTSIDE_PX, 3 * np.nan_to_num(fit.sigma_px))[:, None]
    trusted = fit.weights > 0.5
    with np.errstate(invalid="ignore"):
        beyond = np.maximum(
            np.maximum(-0.5 - px[..., 0], px[..., 0] - (width - 0.5)),
            np.maximum(-0.5 - px[..., 1], px[..., 1] - (height - 0.5)),
        )
        outside = trusted & (beyond > slack)
    if not outside.any():
        return
    view, corner = np.unravel_index(int(np.argmax(np.where(outside, beyond, -np.inf))), outside.shape)
    x, y = px[view, corner]
    inside = px[trusted & (np.min(px, axis=-1, where=np.isfinite(px), initial=np.inf) > -0.5 - _OUTSIDE_PX)]
    hint = None
    if len(inside) == trusted.sum() and np.all(inside <= np.array([height, width]) + _OUTSIDE_PX):
        hint = f"the image size looks swapped: give {height}x{width}"
    found = finding(
        "corners-outside-image",
        remedy=hint,
        camera=camera,
        view=names[view],
        corner=int(corner),
        x_px=float(x),
        y_px=float(y),
        width_px=width,
        height_px=height,
        n_corners=int(outside.sum()),
        n_views=int(outside.any(axis=1).sum()),
    )
    raise refusal(found)


def _spacing_px(points: ndarray, fit: HomographyFit) -> Float[ndarray, "views"]:
    """Rough distance between neighbouring corners in each view, pixels."""
    xy = points[:, :2]
    sample = xy[:: max(1, len(xy) // 40)]
    distance2 = np.square(sample[:, None, 0] - xy[:, 0]) + np.square(sample[:, None, 1] - xy[:, 1])
    distance2[distance2 < 1e-24] = np.inf
    return float(np.median(np.sqrt(distance2.min(axis=1)))) * fit.px_per_unit


def _check_grid(
    camera: str, points: ndarray, px: ndarray, fit: HomographyFit, names: tuple[str, ...], reasons: dict[int, Finding]
) -> None:
    """Views whose corners are no image of the board; refuses the set where nearly all are, and tries to say why."""
    n_seen = np.isfinite(px[..., 0]).sum(axis=1)
    with np.errstate(all="ignore"):
        off_grid = (fit.status == UNFIT) | (
            (fit.status == GOOD) & (fit.sigma_px > _OFF_GRID * _spacing_px(points, fit))
        )
    examined = np.isin(fit.status, (GOOD, UNFIT))
    if off_grid.sum() > _MOST * max(examined.sum(), 1) and off_grid.sum() >= min(3, examined.sum()):
        order = transposed_order(points)
        if order is not None:
            other = fit_homographies(points[order], px)
            with np.errstate(all="ignore"):
                fits_now = (other.status == GOOD) & (other.sigma_px < 0.5 * _OFF_GRID * _spacing_px(points, fit))
            if fits_now.sum() > _MOST * examined.sum():
                n_fitting, n_views = int(fits_now.sum()), int(examined.sum())
                raise refusal(
                    finding("columns-and-rows-exchanged", camera=camera, n_fitting=n_fitting, n_views=n_views)
                )
        view = int(np.flatnonzero(off_grid)[0])
        n_off, n_views = int(off_grid.sum()), int(examined.sum())
        raise refusal(finding("corners-off-grid", camera=camera, n_off=n_off, n_views=n_views, view=names[view]))
    for view in np.flatnonzero(n_seen > 0):
        i = int(view)
        if off_grid[i]:
            reasons.setdefault(i, finding("view-off-grid", camera=camera))
        elif fit.status[i] == COINCIDENT:
            x, y = np.nanmean(px[i], axis=0).tolist()
            reasons.setdefault(i, finding("view-at-one-point", camera=camera, x_px=x, y_px=y))
        elif fit.status[i] == COLLINEAR and n_seen[i] >= MIN_POINTS:
            reasons.setdefault(i, finding("view-on-a-line", camera=camera))


def _check_degeneracy(camera: str, initial: InitialCamera, points: ndarray) -> None:
    """Sets of views from which no focal length follows; repeated poses count once."""
    usable = np.flatnonzero(initial.homographies.is_valid)
    H = initial.homographies.H[usable]
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    ends = np.array([[low[0], low[1], 1], [high[0], low[1], 1], [low[0], high[1], 1], [high[0], high[1], 1]])
    mapped = H @ ends.T
    with np.errstate(all="ignore"):
        ends_px = (mapped[:, :2] / mapped[:, 2:]).reshape(len(usable), -1)
    tolerance = max(1.0, 4 * float(np.median(initial.homographies.sigma_px[usable])) if initial.rms_px > 0 else 1.0)
    tolerance = min(tolerance, 5.0)
    fresh = np.ones(len(usable), dtype=bool)
    n_distinct = 0
    while fresh.any() and n_distinct < MIN_VIEWS:
        n_distinct += 1
        first = ends_px[np.argmax(fresh)]
        fresh &= np.sqrt(np.mean(np.square(ends_px - first), axis=1)) > tolerance
    if n_distinct < MIN_VIEWS:
        plural = "" if n_distinct == 1 else "s"
        raise refusal(finding("too-few-poses", camera=camera, n_poses=n_distinct, plural=plural, n_views=len(usable)))
    check_orientations(initial.vanishing.K, initial.columns, initial.covariance, camera)
    if initial.vanishing.sigma_log_focal > _MAX_SIGMA_LOG_FOCAL:
        percent = 100 * float(initial.vanishing.sigma_log_focal)
        raise refusal(finding("tilts-too-small", camera=camera, sigma_percent=percent))


def _check_size(camera: str, initial: InitialCamera, px: ndarray) -> Finding | None:
    """A finding, or None, on too large an image size: principal point off the middle, no corner beyond twice that."""
    width, height = initial.size_wh
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    principal = initial.parameters[2:4]
    sigma = np.maximum(initial.vanishing.sigma_centre * initial.unit_px, 1.0)
    far = np.array([np.max(px[..., k], where=initial.weights > 0.5, initial=0.0) for k in range(2)])
    offset = centre - principal
    implied = 2 * principal + 1
    if not np.all(far < 1.12 * implied):  # lenses sit a few percent off the middle of their own image too
        return None
    figures = {
        "camera": camera,
        "x_px": float(principal[0]),
        "y_px": float(principal[1]),
        "width_px": width,
        "height_px": height,
        "far_x_px": float(far[0]),
        "far_y_px": float(far[1]),
        "implied_width_px": float(implied[0]),
        "implied_height_px": float(implied[1]),
    }
    if np.all(offset > 0.15 * np.array([width, height])) and np.all(offset > 6 * sigma):
        raise refusal(finding("image-size-wrong", **figures))
    if np.any((offset > 0.1 * np.array([width, height])) & (offset > 6 * sigma)):
        return finding("image-size-suspect", **figures)
    return None


# --- left against right -----------------------------------------------------------------------------------------------


def _check_resolution(pixels: list[ndarray], sizes: list[tuple[int, int]], fits: list[HomographyFit]) -> None:
    """One camera's corners at a fraction of its image: they keep to its first part, and boards look smaller."""
    both = fits[0].is_valid & fits[1].is_valid
    if both.sum() < MIN_VIEWS:
        return
    far = [
        np.array([np.max(px[..., k], where=fit.weights > 0.5, initial=0.0) for k in range(2)]) / size
        for px, size, fit in zip(pixels, sizes, fits, strict=True)
    ]
    scale = [fit.px_per_unit[both] / size[0] for fit, size in zip(fits, sizes, strict=True)]
    ratio = float(np.median(scale[1] / scale[0]))
    for side, (name, other) in enumerate((("right", "left"), ("left", "right"))):
        k = 1 - side
        share = ratio if k == 1 else 1 / ratio
        if share < 0.62 and np.all(far[k] < share * 1.15) and np.any(far[1 - k] > 0.62):
            width, height = sizes[k]
            found = finding(
                "resolution-mismatch",
                camera=name,
                other=other,
                far_x_px=float(far[k][0] * width),
                far_y_px=float(far[k][1] * height),
                width_px=width,
                height_px=height,
                share=share,
            )
            raise refusal(found)


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
    size = [f[k] / cameras[k].poses.t[both, 2] for k in range(2)]
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


def _own_rms(cameras: list[InitialCamera]) -> float:
    """What both cameras' poses leave without any common rig: median over views, pixels."""
    both = cameras[0].is_usable & cameras[1].is_usable
    squared = (np.square(cameras[0].poses.rms_px[both]) + np.square(cameras[1].poses.rms_px[both])) / 2
    return float(np.sqrt(np.median(squared)))


def _quality(consensus: Consensus) -> tuple[float, float]:
    """Share of views that agree, and the median miss of those, pixels."""
    examined = consensus.symmetry >= 0
    return float(consensus.agrees.sum() / examined.sum()), float(np.median(consensus.miss_px[consensus.agrees]))


def _find_consensus(cameras: list[InitialCamera], detections: Detections) -> tuple[Consensus, BoardSymmetries]:
    """The rig on which most views agree; and the board's symmetries where some views may need one, else the identity.

    Raises:
        InconsistentViewsError: There is none; the pairing is tested for being off by a few views first.
    """
    left, right = cameras[0].poses, cameras[1].poses
    diagonal = float(np.hypot(*detections.left_size_wh))
    own = _own_rms(cameras)
    trusted_px = max(
        4 * own, 1.0
    )  # where intrinsics are sound, a true consensus adds next to nothing to the views' own residuals
    start_px = max(camera.rms_px for camera in cameras)
    consensus = estimate_relative_pose(left, right, start_rms_px=start_px)
    share, typical = _quality(consensus)
    if share == 1.0 and typical < trusted_px:
        return consensus, no_symmetry(len(detections.object_points_m))
    symmetries = board_symmetries(detections.object_points_m)
    if len(symmetries.names) > 1:
        other = estimate_relative_pose(left, right, symmetries.motions, max_proposals=32, start_rms_px=start_px)
        other_share, other_typical = _quality(other)
        n_more = int(other.agrees.sum()) - int(consensus.agrees.sum())
        if (other_typical < 3 * max(typical, own) and n_more > 0) or other_typical < typical / 3:
            consensus, share, typical = other, other_share, other_typical
    is_sound = share > 0.5 and typical < trusted_px
    if not is_sound:
        for shift in sorted((s for s in range(-_MAX_SHIFT, _MAX_SHIFT + 1) if s), key=abs):
            moved = _shifted(right, shift)
            if np.sum(left.is_usable & moved.is_usable) < MIN_VIEWS:
                continue
            other = estimate_relative_pose(left, moved, symmetries.motions, start_rms_px=start_px)
            other_share, other_typical = _quality(other)
            if other_share > 0.7 and other_typical < max(trusted_px, 2.0) and other_typical < (typical + own) / 3:
                k = int(np.flatnonzero(other.agrees)[0])
                found = finding(
                    "pairs-shifted",
                    shift="one" if abs(shift) == 1 else abs(shift),
                    left_view=detections.names[k],
                    right_view=detections.names[k + shift],
                    n_agreeing=int(other.agrees.sum()),
                    n_views=int(np.sum(other.symmetry >= 0)),
                )
                raise refusal(found)
        if not share >= 0.5 or typical > max(0.02 * diagonal, trusted_px):
            found = finding(
                "left-and-right-contradict",
                n_agreeing=int(consensus.agrees.sum()),
                n_views=int(np.sum(consensus.symmetry >= 0)),
                limit_px=max(0.02 * diagonal, trusted_px),
                miss_px=typical,
            )
            raise refusal(found)
    return consensus, symmetries


def _shifted(poses: BoardPoses, shift: int) -> BoardPoses:
    """Poses whose view k is the given view k + shift."""
    n = len(poses.is_usable)
    index = np.arange(n) + shift
    inside = (index >= 0) & (index < n)
    moved = select_poses(poses, np.clip(index, 0, n - 1))
    return replace(moved, is_usable=moved.is_usable & inside)


def _explain(view: int, consensus: Consensus, cameras: list[InitialCamera], points: ndarray) -> Finding:
    """Why one view disagrees: corners shifted by a row or column, or another board pose altogether."""
    miss = float(consensus.miss_px[view])
    xy = points[:, :2]
    columns, rows = (np.unique(np.round(xy[:, axis], 9)) for axis in range(2))
    steps = [float(np.median(np.diff(values))) if len(values) > 1 else 0.0 for values in (columns, rows)]
    poses = [select_poses(camera.poses, np.array([view])) for camera in cameras]
    found: list[tuple[float, str, int]] = []
    for axis, name in ((0, "column"), (1, "row")):
        for count in (-2, -1, 1, 2):
            offset = np.zeros(3)
            offset[axis] = count * steps[axis]
            px = float(transfer_px(consensus.T_right_left, poses[0], poses[1], SE3(np.eye(3), offset))[0])
            found.append((px, name, abs(count)))
    px, name, count = min(found)
    if (
        px < 0.25 * float(transfer_px(consensus.T_right_left, poses[0], poses[1], SE3.identity())[0])
        and px < 3 * consensus.limit_px
    ):
        stray = [float(np.mean(c.weights[view][np.isfinite(c.homographies.residuals_px[view])] < 0.1)) for c in cameras]
        side = "left" if stray[0] > stray[1] + 0.03 else "right" if stray[1] > stray[0] + 0.03 else "left or right"
        how_many = f"one {name}" if count == 1 else f"two {name}s"
        return finding("view-shifted", camera=side, shift=how_many)
    typical_px = float(np.median(consensus.miss_px[consensus.agrees]))
    return finding("view-mismatched", miss_px=miss, typical_px=typical_px)


def _side_to_reorder(view: int, symmetry: int, consensus: Consensus, cameras: list[InitialCamera]) -> int:
    """0 or 1: the camera whose board stands otherwise than in its other views; if most do, the inverted one."""
    agreeing = consensus.agrees & (consensus.symmetry >= 0)
    mostly = np.mean(consensus.symmetry[agreeing] == symmetry) > 0.5
    score = []
    for camera in cameras:
        typical = np.mean(camera.poses.R[agreeing & (consensus.symmetry == (symmetry if mostly else 0))], axis=0)
        # Board axes against the image's own, or against those of the other views
        score.append(float(np.sum(typical * (np.eye(3) if mostly else camera.poses.R[view]))))
    return 0 if score[0] < score[1] else 1


def _rig_findings(consensus: Consensus, cameras: list[InitialCamera], notes: list[str]) -> list[Finding]:
    """What there is to say about the rig as a whole."""
    t = consensus.T_right_left.t
    found = []
    if abs(t[0]) >= abs(t[1]) and t[0] > 0:
        found.append(finding("cameras-exchanged"))
    n_repaired = sum(bool(note) for note in notes)
    if n_repaired > _MOST * consensus.agrees.sum() and n_repaired > 1:
        found.append(finding("corner-orders-repaired", n_views=n_repaired))
    for name, camera in zip(("left", "right"), cameras, strict=True):
        found.extend(finding("start-simplified", camera=name, note=note) for note in camera.notes)
    return found
