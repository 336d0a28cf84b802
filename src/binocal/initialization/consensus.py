"""The rig on which most views agree, the board's symmetries that views may need, and why a view does not agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.cameras.models import camera_model
from binocal.evidence import Detections
from binocal.findings import Finding, finding, refusal
from binocal.geometry import SE3
from binocal.initialization.input_checks import MIN_VIEWS
from binocal.initialization.intrinsics import InitialCamera
from binocal.initialization.poses import BoardPoses, estimate_poses, select_poses
from binocal.initialization.relative_pose import Consensus, estimate_relative_pose, transfer_px
from binocal.initialization.symmetries import BoardSymmetries, board_symmetries, mirrored_corners, no_symmetry
from binocal.shapes import Float

_MAX_SHIFT = 3


def _own_rms(cameras: list[InitialCamera]) -> float:
    """What both cameras' poses leave without any common rig: median over views, pixels."""
    both = cameras[0].is_usable & cameras[1].is_usable
    squared = (np.square(cameras[0].poses.rms_px[both]) + np.square(cameras[1].poses.rms_px[both])) / 2
    return float(np.sqrt(np.median(squared)))


def _quality(consensus: Consensus) -> tuple[float, float]:
    """Share of views that agree, and the median miss of those, pixels."""
    examined = consensus.symmetry >= 0
    return float(consensus.agrees.sum() / examined.sum()), float(np.median(consensus.miss_px[consensus.agrees]))


def find_consensus(cameras: list[InitialCamera], detections: Detections) -> tuple[Consensus, BoardSymmetries]:
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

    def explains(share: float, px: float) -> bool:
        """Whether the views agree when they are read otherwise."""
        return share > 0.7 and px < max(trusted_px, 2.0) and px < (typical + own) / 3

    if not is_sound:
        for shift in sorted((s for s in range(-_MAX_SHIFT, _MAX_SHIFT + 1) if s), key=abs):
            moved = _shifted(right, shift)
            if np.sum(left.is_usable & moved.is_usable) < MIN_VIEWS:
                continue
            other = estimate_relative_pose(left, moved, symmetries.motions, start_rms_px=start_px)
            other_share, other_typical = _quality(other)
            if explains(other_share, other_typical):
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
        back = mirrored_back(cameras[1], detections.right_px, detections.object_points_m, symmetries)
        if back is not None and np.sum(left.is_usable & back.is_usable) >= MIN_VIEWS:
            other = estimate_relative_pose(left, back, symmetries.motions, start_rms_px=start_px)
            other_share, other_typical = _quality(other)
            if explains(other_share, other_typical):
                n_agreeing, n_views = int(other.agrees.sum()), int(np.sum(other.symmetry >= 0))
                found = finding(
                    "one-side-mirrored",
                    n_agreeing=n_agreeing,
                    n_views=n_views,
                    mended_px=other_typical,
                    miss_px=typical,
                )
                raise refusal(found)
        if not share >= 0.5 or typical > max(0.02 * diagonal, trusted_px):
            n_agreeing, n_views = int(consensus.agrees.sum()), int(np.sum(consensus.symmetry >= 0))
            found = finding(
                "left-and-right-contradict", n_agreeing=n_agreeing, n_views=n_views, miss_px=typical, own_px=own
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


def mirrored_back(
    camera: InitialCamera, px: Float[ndarray, "views n 2"], points: Float[ndarray, "n 3"], symmetries: BoardSymmetries
) -> BoardPoses | None:
    """A camera's board poses if its images were mirrored: those of the flipped images, whose boards a finder numbers the other way.

    Which axis was flipped does not matter: the other is this one and a turn of the camera. None for boards that tell their mirror image.
    """
    order = symmetries.mirror_order
    if order is None:
        return None
    width_px = camera.size_wh[0]
    values = dict(zip(camera_model(camera.model).parameter_names, camera.parameters.tolist(), strict=True))
    values["cx"] = width_px - 1 - values["cx"]
    for odd in ("skew", "p2"):  # change their sign with x
        values[odd] = -values[odd] if odd in values else 0.0
    parameters = np.array([values[name] for name in camera_model(camera.model).parameter_names])
    return estimate_poses(
        camera.model, parameters, points, mirrored_corners(px, width_px, order), camera.weights[:, order]
    )


def explain_view(
    view: int, consensus: Consensus, cameras: list[InitialCamera], detections: Detections, symmetries: BoardSymmetries
) -> Finding:
    """Why one view disagrees: corners shifted by a row or column, an image mirrored, or another board pose altogether."""
    points = detections.object_points_m
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
    if (side := _mirrored_side(view, consensus, cameras, detections, symmetries)) is not None:
        return finding("view-mirrored", camera=side, miss_px=miss, typical_px=typical_px)
    return finding("view-mismatched", miss_px=miss, typical_px=typical_px)


def side_to_reorder(view: int, symmetry: int, consensus: Consensus, cameras: list[InitialCamera]) -> int:
    """0 or 1: the camera whose board stands otherwise than in its other views; if most do, the inverted one."""
    agreeing = consensus.agrees & (consensus.symmetry >= 0)
    mostly = np.mean(consensus.symmetry[agreeing] == symmetry) > 0.5
    score = []
    for camera in cameras:
        typical = np.mean(camera.poses.R[agreeing & (consensus.symmetry == (symmetry if mostly else 0))], axis=0)
        # Board axes against the image's own, or against those of the other views
        score.append(float(np.sum(typical * (np.eye(3) if mostly else camera.poses.R[view]))))
    return 0 if score[0] < score[1] else 1


def _mirrored_side(
    view: int, consensus: Consensus, cameras: list[InitialCamera], detections: Detections, symmetries: BoardSymmetries
) -> str | None:
    """The camera whose image of a view is mirrored; None where that does not explain why the view disagrees."""
    found: list[tuple[float, str]] = []
    views = np.array([view])
    for k, side in enumerate(("left", "right")):
        camera = replace(cameras[k], weights=cameras[k].weights[views])
        back = mirrored_back(camera, getattr(detections, f"{side}_px")[views], detections.object_points_m, symmetries)
        if back is None or not back.is_usable[0]:
            continue
        pair = [select_poses(other.poses, views) for other in cameras]
        pair[k] = back
        for motion in symmetries.motions:
            found.append((float(transfer_px(consensus.T_right_left, pair[0], pair[1], motion)[0]), side))
    px, side = min(found, default=(np.inf, ""))
    # intrinsics that were estimated from mirrored views among others are off by some pixels
    return side if px < float(consensus.miss_px[view]) / 3 and px < 5 * consensus.limit_px else None
