"""What the covariance of a calibration leaves uncertain of the distances that a rectified pair measures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig, camera_model
from binocal.cameras.rectified_pair import Rectification
from binocal.geometry import SE3, so3
from binocal.metrics.image import triangulate
from binocal.result import Covariance
from binocal.shapes import Float, Float32

COLUMNS, ROWS, LEVELS = 9, 7, 6  # of the lattice: the image, and the logarithm of distance
STEP_SIGMAS = 0.1  # of a parameter, for its central difference: small against what is linear, large against rounding


@dataclass(frozen=True, slots=True, eq=False)
class DepthSigma:
    """Standard deviation over distance on a lattice of the rectified left image, of points at ``distances`` (rising, even factors)."""

    distances: Float[ndarray, "levels"]
    share: Float[ndarray, "levels rows columns"]

    def at(self, distance: Float32[ndarray, "h w"]) -> Float32[ndarray, "h w"]:
        """Standard deviation of every pixel's distance, by linear interpolation; NaN where there is no distance.

        Beyond the lattice's distances the share is that of its end.
        """
        height, width = distance.shape
        across, along = _weights(height, ROWS), _weights(width, COLUMNS)
        first, last = np.log(self.distances[[0, -1]])
        with np.errstate(all="ignore"):
            level = np.clip((np.log(distance) - first) / (last - first) * (LEVELS - 1), 0, LEVELS - 1)
        share = np.zeros_like(distance)
        for k in range(LEVELS):
            weight = np.maximum(1 - np.abs(level - k), 0)
            plane = (across @ _filled(self.share[k]) @ along.T).astype(np.float32)
            share += np.where(weight == 0, np.float32(0), weight * plane)
        return share * distance


def depth_sigma(
    rig: StereoRig, covariance: Covariance, rectification: Rectification, near: float, far: float
) -> DepthSigma:
    """How uncertain the calibration leaves distances between near and far (both finite), as seen in the rectified left image.

    First-order propagation: each place is a point, seen by both raw images at fixed pixels, and each parameter is moved by a
    tenth of its standard deviation to see by how much the point's distance moves along the left camera's axes. ``share`` is NaN
    where the covariance is unknown or a camera has no such pixel.
    """
    width, height = rectification.size_wh
    u, v = np.linspace(0, width - 1, COLUMNS), np.linspace(0, height - 1, ROWS)
    rays = rectification.left.unproject(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    is_pinhole = rectification.projection == "pinhole"
    rays = rays / (rays[:, 2:] if is_pinhole else np.linalg.norm(rays, axis=1, keepdims=True))
    distances = np.geomspace(near, far, LEVELS)
    points = (distances[:, None, None] * rays).reshape(-1, 3) @ rectification.R_rect_left
    points = np.where(np.isfinite(points), points, 0.0)
    left_px, right_px = rig.left.project(points), rig.right.project(rig.T_right_left.apply(points))
    normal = rectification.R_rect_left[2] if is_pinhole else None

    def distance(moved: StereoRig) -> Float[ndarray, "n"]:
        found, _ = triangulate(moved, left_px, right_px)
        return found @ normal if normal is not None else np.linalg.norm(found, axis=1)

    sigma = np.sqrt(np.diag(covariance.matrix))
    slopes = []
    for name, step in zip(covariance.names, STEP_SIGMAS * sigma, strict=True):
        if not np.isfinite(step):
            slopes.append(np.full(len(points), np.nan))
            continue
        step = step if step > 0 else 1e-9
        slopes.append((distance(_moved(rig, name, step)) - distance(_moved(rig, name, -step))) / (2 * step))
    J = np.array(slopes).reshape(len(covariance.names), len(points))
    variance = np.einsum("pn,pq,qn->n", J, covariance.matrix, J) if len(J) else np.full(len(points), np.nan)
    with np.errstate(invalid="ignore"):
        share = np.sqrt(np.maximum(variance, 0)) / np.repeat(distances, ROWS * COLUMNS)
    return DepthSigma(distances, share.reshape(LEVELS, ROWS, COLUMNS))


def _moved(rig: StereoRig, name: str, step: float) -> StereoRig:
    """The rig with one parameter of its covariance moved; unknown names move nothing."""
    group, _, item = name.partition(".")
    if group in ("left", "right"):
        camera: Camera = getattr(rig, group)
        names = camera_model(camera.model).parameter_names
        parameters = camera.parameters.copy()
        parameters[names.index(item)] += step
        return replace(rig, **{group: replace(camera, parameters=parameters)})
    T, way = rig.T_right_left, np.eye(3)["xyz".index(item)] * step
    moved = SE3(so3.exp(way) @ T.R, T.t) if group == "rotation" else SE3(T.R, T.t + way)
    return replace(rig, T_right_left=moved)


def _filled(share: Float[ndarray, "rows columns"]) -> Float[ndarray, "rows columns"]:
    """Places of a lattice that a camera does not see get the mean of their neighbours that both see; all NaN stays NaN.

    Pixels between such a place and one that both see would else have no standard deviation.
    """
    filled = share.copy()
    while np.isnan(filled).any() and np.isfinite(filled).any():
        padded = np.pad(filled, 1, constant_values=np.nan)
        around = np.stack([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
        known = np.isfinite(around).sum(axis=0)
        mean = np.nansum(around, axis=0) / np.maximum(known, 1)
        filled = np.where(np.isnan(filled) & (known > 0), mean, filled)
    return filled


def _weights(n: int, n_nodes: int) -> Float[ndarray, "n nodes"]:
    """Linear interpolation from nodes at the ends and evenly between to n pixels."""
    place = np.linspace(0, n_nodes - 1, n)
    return np.maximum(1 - np.abs(place[:, None] - np.arange(n_nodes)), 0)
