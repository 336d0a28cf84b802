"""Standard deviation of the row error that is left after rectification."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.cameras.epipolar_projection import EpipolarProjection
from binocal.rectification import row_rectification
from binocal.shapes import Float
from binocal.uncertainty.covariance import Covariance
from binocal.uncertainty.derivatives import pair_derivatives, variance_of


def row_sigma_px(
    rig: StereoRig,
    covariance: Covariance,
    left_px: Float[ndarray, "*n 2"],
    range_m: Float[ndarray, "*n"] | float = np.inf,
) -> Float[ndarray, "*n"]:
    """Standard deviation, rectified pixels, of the row error (column error, if vertical) that the calibration leaves at left pixels.

    ``range_m`` is the distance of what is seen there; at infinity the baseline's direction does not count. NaN where a point is not
    seen by both cameras or lies outside the rectified half-space.

    Raises:
        DegenerateGeometryError: The rig cannot be rectified.
    """
    left_px = np.asarray(left_px, dtype=float)
    range_m = np.broadcast_to(np.asarray(range_m, dtype=float), left_px.shape[:-1]).reshape(-1)
    G = row_gradients(rig, covariance.names, left_px.reshape(-1, 2), range_m)
    return np.sqrt(variance_of(G, covariance.matrix)).reshape(left_px.shape[:-1])


def row_gradients(
    rig: StereoRig, names: Sequence[str], left_px: Float[ndarray, "n 2"], range_m: Float[ndarray, "*n"] | float = np.inf
) -> Float[ndarray, "n p"]:
    """Derivatives of the rectified row difference, left less right, by the named parameters, the pixels held.

    The difference depends on the two pixels through the epipolar constraint alone: moving the rig by d changes it as moving both
    pixels by minus what the point's image moves by. So it is the rectified rows' gradient by the pixels times those motions.
    """
    rectified = row_rectification(rig)
    axis = 0 if rectified.is_vertical else 1
    rays = rig.left.unproject(left_px)
    s = 1 / np.broadcast_to(np.asarray(range_m, dtype=float), rays.shape[:-1])
    known = np.isfinite(rays).all(axis=-1)
    G = np.full((len(rays), len(names)), np.nan)
    rays, s = rays[known], s[known]
    d = pair_derivatives(rig, names, rays, s)
    in_right = rays @ rig.T_right_left.R.T + s[:, None] * rig.T_right_left.t
    left = _row_by_pixel(rays, d.left_by_point, rectified.R_rect_left, axis, rectified.left)
    right = _row_by_pixel(in_right, d.right_by_point, rectified.R_rect_right, axis, rectified.right)
    G[known] = np.einsum("ni,nip->np", right, d.right) - np.einsum("ni,nip->np", left, d.left)
    return G


def _row_by_pixel(
    points: Float[ndarray, "n 3"],
    by_point: Float[ndarray, "n 2 3"],
    R: Float[ndarray, "3 3"],
    axis: int,
    shown: EpipolarProjection,
) -> Float[ndarray, "n 2"]:
    """Gradient of the rectified row by the camera's own pixel.

    Row = focal (R x)_axis / (R x)_z, or focal times its angle, is a function of the ray, as the pixel is: the gradients by x of both
    lie in the plane across it.
    """
    turned = points @ R.T
    a, z = turned[:, axis, None], turned[:, 2, None]
    if shown.kind == "pinhole":
        divisor = np.where(z > 1e-9, z**2, np.nan)
    else:
        divisor = a**2 + z**2
    h = shown.focal_px[axis] * (z * R[axis] - a * R[2]) / divisor
    out = np.full((len(points), 2), np.nan)
    known = np.isfinite(h).all(axis=-1) & np.isfinite(by_point).all(axis=(1, 2))
    B = by_point[known]
    out[known] = np.linalg.solve(B @ B.swapaxes(1, 2), B @ h[known][..., None])[..., 0]
    return out
