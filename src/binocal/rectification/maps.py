"""Rectified points, maps and images: what a :class:`~binocal.cameras.rectified_pair.Rectification` does to pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig, camera_model
from binocal.cameras.epipolar_projection import EpipolarProjection
from binocal.cameras.rectified_pair import Projection, Rectification
from binocal.errors import DegenerateGeometryError
from binocal.geometry import SE3
from binocal.kernels.rectified_maps import rectified_map
from binocal.shapes import Bool, Float, Float32

OUTSIDE = -16.0  # for cv2.remap, which reads NaN as pixel 0 on some processors


def rectify_points(
    camera: Camera, R_rect_camera: Float[ndarray, "3 3"], P: Projection, pixels: Float[ndarray, "*batch 2"]
) -> Float[ndarray, "*batch 2"]:
    """Rectified pixels of a camera's pixels; NaN where there is no ray or the projection does not show it."""
    return _projection(P).project(camera.unproject(pixels) @ R_rect_camera.T)


def rectification_map(
    camera: Camera, R_rect_camera: Float[ndarray, "3 3"], P: Projection, size_wh: tuple[int, int]
) -> tuple[Float32[ndarray, "h w 2"], Bool[ndarray, "h w"]]:
    """For every rectified pixel, the pixel (x, y) of the camera's image to read, and where there is one.

    What lies outside the image is NaN. The two coordinates are planes of their own in memory: ``source[..., 0]`` and ``[..., 1]`` are
    what ``cv2.remap`` takes, without a copy.
    """
    is_inside = np.empty((size_wh[1], size_wh[0]), bool)
    planes = _map_planes(camera, R_rect_camera, _projection(P), size_wh, np.nan, is_inside)
    return np.moveaxis(planes, 0, -1), is_inside


@dataclass(frozen=True, slots=True, eq=False)
class RectificationMaps:
    """The maps of a rectified pair, made once for all its images: ``left`` and ``right`` are (2, h, w), x then y."""

    left: Float32[ndarray, "2 h w"]
    right: Float32[ndarray, "2 h w"]

    @staticmethod
    def of(rig: StereoRig, rectification: Rectification) -> RectificationMaps:
        """Those of a rig and its rectification; what lies outside an image is below -1."""
        r = rectification
        left, right = (
            _map_planes(camera, R, projection, r.size_wh, OUTSIDE, None)
            for camera, R, projection in ((rig.left, r.R_rect_left, r.left), (rig.right, r.R_rect_right, r.right))
        )
        return RectificationMaps(left, right)

    def rectify(self, left_image: ndarray, right_image: ndarray) -> tuple[ndarray, ndarray]:
        """Both images rectified, bilinear, black where the camera saw nothing; (h, w) or (h, w, 3), uint8, uint16 or float32."""
        import cv2

        return (
            cv2.remap(left_image, self.left[0], self.left[1], cv2.INTER_LINEAR),
            cv2.remap(right_image, self.right[0], self.right[1], cv2.INTER_LINEAR),
        )


def rectified_rig(rig: StereoRig, rectification: Rectification) -> StereoRig:
    """The ideal rig that pinhole images come from: no distortion, no rotation, baseline along an axis.

    Raises:
        DegenerateGeometryError: The projection is no pinhole.
    """
    r = rectification
    if r.projection != "pinhole":
        raise DegenerateGeometryError(f"a {r.projection} image comes from no camera without distortion.")
    left, right = (
        Camera("brown4", r.size_wh, np.r_[shown.focal_px, shown.centre_px, np.zeros(5)]) for shown in (r.left, r.right)
    )
    t = np.zeros(3)
    t[r.left.along] = r.offset_m
    return StereoRig(left, right, SE3(np.eye(3), t), rig.is_metric)


def _projection(P: Projection) -> EpipolarProjection:
    return P if isinstance(P, EpipolarProjection) else EpipolarProjection.of_matrix(P)


def _map_planes(
    camera: Camera,
    R_rect_camera: Float[ndarray, "3 3"],
    projection: EpipolarProjection,
    size_wh: tuple[int, int],
    outside: float,
    is_inside: Bool[ndarray, "h w"] | None,
) -> Float32[ndarray, "2 h w"]:
    rows, columns = (part @ R_rect_camera for part in projection.pixel_rays(size_wh))
    model = camera_model(camera.model)
    if model.is_compiled and model.farthest_angle is not None:
        least = float(np.cos(model.farthest_angle(camera.parameters)))
        return rectified_map(
            camera.model, camera.parameters, rows, columns, camera.size_wh,
            least_cosine=least if model.sees_behind else max(least, 0.0), outside=outside, is_inside=is_inside,
        )  # fmt: skip
    rays = (rows[:, None] + columns).reshape(-1, 3)
    is_seen = camera.sees(np.where(np.isfinite(rays), rays, 0.0))
    planes = np.where(is_seen[:, None], camera.project(rays), outside).T.astype(np.float32)
    if is_inside is not None:
        is_inside[:] = is_seen.reshape(is_inside.shape)
    return planes.reshape(2, len(rows), len(columns))
