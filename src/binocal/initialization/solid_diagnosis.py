"""Views of a target that is no plane: those that cannot be used by name, the others with a start for the joint solver."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.cameras.rig import are_exchanged
from binocal.evidence import Detections
from binocal.findings import Finding, finding, refusal
from binocal.geometry import SE3, so3
from binocal.initialization.solid_targets import MIN_PLANE_POINTS, SolidCamera, estimate_solid_camera, is_solid
from binocal.result import RejectedView
from binocal.shapes import Bool, Float

OUTSIDE_PX = 2.0
MOST_OFF_SHARE = (
    0.1  # of the target's extent in the image, that a pose may leave: strong lenses reach 0.02, a wrong order 0.2
)
MOST_VIEWS_OFF = 0.6  # share of the views that makes a fault the set's, not the view's
MISS_FLOOR_PX, MISS_RATIO = 3.0, 6.0  # a pair disagrees when it misses by more than that and so many times the median


def start_of_solid(
    detections: Detections, model: str, reasons: dict[int, Finding]
) -> tuple[tuple[SolidCamera, SolidCamera], SE3, SE3, Bool[ndarray, "views"], float]:
    """Both cameras, ``T_right_left``, ``T_left_board`` of every view (the identity where unused), which are used, the median miss.

    ``reasons`` gets why a view cannot be used.

    Raises:
        DataError: Corners lie outside the image.
        InconsistentViewsError: The points are not those of the images, in most views.
        DegenerateGeometryError: No view of a camera shows points enough to determine it.
    """
    points = detections.object_points_m
    cameras = []
    for side, px, size_wh in (
        ("left", detections.left_px, detections.left_size_wh),
        ("right", detections.right_px, detections.right_size_wh),
    ):
        _check_inside(side, px, size_wh, detections.names)
        camera = estimate_solid_camera(points, px, size_wh, model)
        if camera is None:
            solid = [view for view, seen in enumerate(np.isfinite(px[..., 0])) if is_solid(points[seen])]
            if not solid:
                raise refusal(finding("solid-target-seen-flat", camera=side, n_views=detections.n_views))
            n_off, view = len(solid), detections.names[solid[0]]
            raise refusal(finding("points-off-target", camera=side, n_off=n_off, n_views=detections.n_views, view=view))
        _check_fit(side, camera, px, detections.names, reasons)
        cameras.append(camera)
    left, right = cameras
    usable = [camera.is_usable & np.array([i not in reasons for i in range(detections.n_views)]) for camera in cameras]
    both = np.flatnonzero(usable[0] & usable[1])
    T_right_left = SE3.identity()
    miss = np.full(detections.n_views, np.nan)
    if len(both):
        T_right_left = _agreed(
            SE3(right.poses.R[both], right.poses.t[both]), SE3(left.poses.R[both], left.poses.t[both])
        )
        miss[both] = _misses_px(T_right_left, left, right, detections, both)
    typical = float(np.median(miss[both])) if len(both) else np.nan
    for view in both[miss[both] > max(MISS_FLOOR_PX, MISS_RATIO * typical)].tolist():
        reasons.setdefault(view, finding("view-mismatched", miss_px=float(miss[view]), typical_px=typical))
    for view in np.flatnonzero(~usable[0] & ~usable[1]).tolist():
        reasons.setdefault(view, finding("view-without-corners"))
    is_used = np.array([i not in reasons for i in range(detections.n_views)])
    from_right = T_right_left.inverse() @ SE3(
        np.where(usable[1][:, None, None], right.poses.R, np.eye(3)), np.where(usable[1][:, None], right.poses.t, 0.0)
    )
    R = np.where(usable[0][:, None, None], left.poses.R, from_right.R)
    t = np.where(usable[0][:, None], left.poses.t, from_right.t)
    T_left_board = SE3(np.where(is_used[:, None, None], R, np.eye(3)), np.where(is_used[:, None], t, 0.0))
    return (left, right), T_right_left, T_left_board, is_used, typical


def rejected_views(detections: Detections, reasons: dict[int, Finding]) -> tuple[RejectedView, ...]:
    """The views that are not used, and why."""
    return tuple(RejectedView(detections.names[i], reasons[i].text, reasons[i].code) for i in sorted(reasons))


def findings_of_solid(T_right_left: SE3) -> tuple[Finding, ...]:
    """What there is to say of the rig as a whole."""
    return (finding("cameras-exchanged"),) if are_exchanged(T_right_left) else ()


def _check_inside(side: str, px: Float[ndarray, "views n 2"], size_wh: tuple[int, int], names: tuple[str, ...]) -> None:
    width, height = size_wh
    with np.errstate(invalid="ignore"):
        beyond = np.maximum(-0.5 - px, px - (np.array([width, height]) - 0.5)).max(axis=-1)
        outside = beyond > OUTSIDE_PX
    if not outside.any():
        return
    view, corner = np.unravel_index(int(np.argmax(np.where(outside, beyond, -np.inf))), outside.shape)
    x, y = px[view, corner]
    found = finding(
        "corners-outside-image",
        camera=side,
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


def _check_fit(
    side: str,
    camera: SolidCamera,
    px: Float[ndarray, "views n 2"],
    names: tuple[str, ...],
    reasons: dict[int, Finding],
) -> None:
    """Views whose corners are no image of the points; refuses the set where most are."""
    seen = np.isfinite(px[..., 0])
    is_given = seen.sum(axis=1) >= MIN_PLANE_POINTS
    extent = np.ones(len(px))
    for view in np.flatnonzero(is_given):
        extent[view] = max(float(np.ptp(px[view, seen[view]], axis=0).max()), 1e-9)
    with np.errstate(invalid="ignore"):
        is_off = is_given & ~(camera.poses.rms_px < MOST_OFF_SHARE * extent)
    if is_off.sum() > MOST_VIEWS_OFF * max(is_given.sum(), 1):
        view = int(np.flatnonzero(is_off)[0])
        n_off, n_given = int(is_off.sum()), int(is_given.sum())
        raise refusal(finding("points-off-target", camera=side, n_off=n_off, n_views=n_given, view=names[view]))
    for view in np.flatnonzero(is_off).tolist():
        reasons.setdefault(view, finding("view-off-target", camera=side))


def _agreed(T_right_board: SE3, T_left_board: SE3) -> SE3:
    """``T_right_left`` of the view that most others agree with, averaged over those."""
    T = T_right_board @ T_left_board.inverse()
    turned = so3.angle_rad(np.swapaxes(T.R[:, None], -1, -2) @ T.R[None])
    length = np.median(np.linalg.norm(T_left_board.t, axis=-1))
    moved = np.linalg.norm(T.t[:, None] - T.t[None], axis=-1) / length
    apart = turned + moved
    middle = int(np.argmin(np.median(apart, axis=1)))
    near = apart[middle] <= 3 * np.median(apart[middle]) + 1e-9
    return SE3(so3.mean(T.R[near]), T.t[near].mean(axis=0))


def _misses_px(
    T_right_left: SE3, left: SolidCamera, right: SolidCamera, detections: Detections, both: ndarray
) -> Float[ndarray, "k"]:
    """RMS distance of the right corners from where the left poses put them."""
    camera = Camera(right.model, right.size_wh, right.parameters)
    in_left = SE3(left.poses.R[both], left.poses.t[both]).apply(detections.object_points_m)
    off = camera.project(T_right_left.apply(in_left)) - detections.right_px[both]
    with np.errstate(invalid="ignore"):
        return np.sqrt(np.nanmean(np.square(off).sum(axis=-1), axis=1))
