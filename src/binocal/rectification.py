"""Stereo rectification: rotations that make matching points share a row, new projections, and the depth matrix Q.

Frames ``rect_left`` and ``rect_right`` have the same axes; the baseline lies along x (or along y, for a rig whose
cameras stand one above the other: matching points then share a column, and disparity runs down the columns).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig
from binocal.errors import DegenerateGeometryError
from binocal.geometry import SE3, so3
from binocal.shapes import Bool, Float

MAX_AXIS_ANGLE_DEG = (
    60.0  # beyond it the cameras stand behind each other rather than side by side: no common image is left
)


@dataclass(frozen=True, slots=True, eq=False)
class Rectification:
    """How both images are brought to common rows.

    ``R_rect_left`` and ``R_rect_right`` (OpenCV's R1, R2) rotate camera coordinates into the rectified frames;
    ``P_left`` and ``P_right`` (P1, P2), 3x4, project points of the frame ``rect_left`` to rectified pixels of either
    image. Both images share focal length and principal point (OpenCV's ``CALIB_ZERO_DISPARITY``), so that disparity
    is zero at infinity.
    """

    R_rect_left: Float[ndarray, "3 3"]
    R_rect_right: Float[ndarray, "3 3"]
    P_left: Float[ndarray, "3 4"]
    P_right: Float[ndarray, "3 4"]
    size_wh: tuple[int, int]
    is_vertical: bool
    """The cameras stand one above the other: matching points share a column, not a row."""
    is_swapped: bool
    """The camera called right stands on the other's left (above it, if vertical); disparity is negative."""

    @property
    def Q(self) -> Float[ndarray, "4 4"]:
        """Depth matrix: ``Q @ (x, y, disparity, 1)`` is the homogeneous point in ``rect_left``.

        Disparity is left minus right, along x (along y if vertical); it is negative where ``is_swapped``, and so is the
        baseline entry, so that depth stays positive.
        """
        axis = 1 if self.is_vertical else 0
        focal_px = self.P_left[0, 0]
        Q = np.zeros((4, 4))
        Q[0, 0] = Q[1, 1] = 1.0
        Q[:2, 3] = -self.P_left[:2, 2]
        Q[2, 3] = focal_px
        Q[3, 2] = -focal_px / self.P_right[axis, 3]
        return Q


def rectify(rig: StereoRig) -> Rectification:
    """Rectification of a rig, for every camera model.

    Each camera is turned by half of the rotation between them, then both by the smallest rotation that lays the
    baseline on an axis (Bouguet's method, the one that OpenCV uses). The common focal length is the smaller of the
    vertical ones (the horizontal ones if vertical), the common principal point centres both images. Deviation from
    OpenCV: focal length and centre come from the middle of the image alone, so that they exist for lenses that see
    90° aside and beyond.

    Raises:
        DegenerateGeometryError: The baseline is zero, or within 30° of the viewing direction; or a camera looks away
            from it.
    """
    T = rig.T_right_left
    if not rig.baseline_m > 0:
        raise DegenerateGeometryError("the rig has no baseline (T = 0): its images cannot be rectified.")
    half_rad = so3.log(T.R) / 2
    t_mid = so3.exp(-half_rad) @ T.t
    axis = 0 if abs(t_mid[0]) >= abs(t_mid[1]) else 1
    along = np.zeros(3)
    along[axis] = 1.0 if t_mid[axis] > 0 else -1.0
    turn = np.cross(t_mid, along)
    sine, cosine = np.linalg.norm(turn), t_mid @ along
    angle_rad = np.arctan2(sine, cosine)
    if angle_rad > np.radians(MAX_AXIS_ANGLE_DEG):
        raise DegenerateGeometryError(
            f"the baseline is {np.degrees(angle_rad):.0f} deg from the nearer image axis (at most "
            f"{MAX_AXIS_ANGLE_DEG:.0f}): the cameras stand one behind the other and their images cannot be rectified."
        )
    W = so3.exp(turn * (angle_rad / sine)) if sine > 0 else np.eye(3)
    R_rect_left, R_rect_right = W @ so3.exp(half_rad), W @ so3.exp(-half_rad)

    focal_px = min(camera.parameters[1 - axis] for camera in (rig.left, rig.right))
    width, height = rig.left.size_wh
    middle = [
        _project_direction(R @ camera.unproject((np.array(camera.size_wh) - 1) / 2)) * focal_px
        for camera, R in ((rig.left, R_rect_left), (rig.right, R_rect_right))
    ]
    if not np.all(np.isfinite(middle)):
        raise DegenerateGeometryError(
            "a camera looks 90 deg or more away from the rectified direction, or its model has no ray at the image's "
            "centre: the images cannot be rectified."
        )
    centre = (np.array([width, height]) - 1) / 2 - np.mean(middle, axis=0)
    P = np.array([[focal_px, 0, centre[0], 0], [0, focal_px, centre[1], 0], [0, 0, 1, 0]])
    P_right = P.copy()
    P_right[axis, 3] = focal_px * (R_rect_right @ T.t)[axis]
    return Rectification(R_rect_left, R_rect_right, P, P_right, (width, height), axis == 1, bool(along[axis] > 0))


def rectify_points(
    camera: Camera, R_rect_camera: Float[ndarray, "3 3"], P: Float[ndarray, "3 4"], pixels: Float[ndarray, "*batch 2"]
) -> Float[ndarray, "*batch 2"]:
    """Rectified pixels of a camera's pixels; NaN where there is no ray or it leaves the rectified half-space."""
    rays = camera.unproject(pixels) @ R_rect_camera.T
    return _project_direction(rays) * [P[0, 0], P[1, 1]] + P[:2, 2]


def rectification_map(
    camera: Camera, R_rect_camera: Float[ndarray, "3 3"], P: Float[ndarray, "3 4"], size_wh: tuple[int, int]
) -> tuple[Float[ndarray, "h w 2"], Bool[ndarray, "h w"]]:
    """For every rectified pixel, the pixel (x, y) of the camera's image to read, and where there is one.

    What lies outside the image is NaN. Split and cast to float32 for ``cv2.remap``.
    """
    width, height = size_wh
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    rays = np.stack([(x - P[0, 2]) / P[0, 0], (y - P[1, 2]) / P[1, 1], np.ones_like(x)], axis=-1)
    source = camera.project((rays @ R_rect_camera).reshape(-1, 3)).reshape(height, width, 2)
    with np.errstate(invalid="ignore"):
        is_inside = np.all((source >= -0.5) & (source <= np.array(camera.size_wh) - 0.5), axis=-1)
    # A strong lens model folds back far outside its image: such a pixel returns to another ray than it came from.
    back = camera.unproject(np.where(is_inside[..., None], source, np.nan)) @ R_rect_camera.T
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    is_inside &= np.linalg.norm(np.where(np.isnan(back), np.inf, back) - unit, axis=-1) < 1e-6
    source[~is_inside] = np.nan
    return source, is_inside


def _project_direction(rays: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 2"]:
    with np.errstate(all="ignore"):
        return np.where(rays[..., 2:] > 1e-9, rays[..., :2] / rays[..., 2:], np.nan)


def rectified_rig(rig: StereoRig, rectification: Rectification) -> StereoRig:
    """The ideal rig that the rectified images come from: no distortion, no rotation, baseline along an axis."""
    P = rectification.P_left
    camera = Camera("brown4", rectification.size_wh, np.r_[P[0, 0], P[1, 1], P[0, 2], P[1, 2], np.zeros(5)])
    T_right_left = SE3(np.eye(3), rectification.P_right[:, 3] / P[0, 0])
    return StereoRig(camera, camera, T_right_left, rig.is_metric)
