"""Standard deviation of one camera's projection: of where a thing of the world is seen, and so of the direction of a pixel.

Intrinsics alone do not say it: a shift of the principal point by a pixel is nearly a turn of the camera, which the board poses of the
same solve have taken up. What a pixel means is its direction against the boards that were seen. So a point is fixed to the boards: it
goes, through each view's board, from the true poses to the estimated ones, the mean of these is projected by the estimated camera,
and the shift of its pixel is the error. Source: Kogan, mrcal documentation, "Projection uncertainty", the mean over frames
(``mean-pcam``), here to first order: the mean over the views of exp(xi) p is p plus the mean motion's effect. At infinity only the
rotation counts.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig, camera_model
from binocal.geometry import so3
from binocal.shapes import Float
from binocal.uncertainty.covariance import Covariance, MeanBoardPose
from binocal.uncertainty.derivatives import camera_derivatives

Side = Literal["left", "right"]


def projection_covariance_px2(
    rig: StereoRig,
    covariance: Covariance,
    mean_pose: MeanBoardPose,
    side: Side,
    px: Float[ndarray, "*n 2"],
    range_m: Float[ndarray, "*n"] | float = np.inf,
) -> Float[ndarray, "*n 2 2"]:
    """Covariance of the pixel at which a camera is thought to see what it sees at ``px``, ``range_m`` away; NaN without a ray."""
    px = np.asarray(px, dtype=float)
    range_m = np.broadcast_to(np.asarray(range_m, dtype=float), px.shape[:-1]).reshape(-1)
    G = projection_gradients(rig, covariance.names, side, px.reshape(-1, 2), range_m)
    matrix = mean_pose.joint(covariance).matrix
    out = np.einsum("nip,pq,njq->nij", G, matrix, G, optimize=True)
    return out.reshape(*px.shape, 2)


def projection_sigma_px(
    rig: StereoRig,
    covariance: Covariance,
    mean_pose: MeanBoardPose,
    side: Side,
    px: Float[ndarray, "*n 2"],
    range_m: Float[ndarray, "*n"] | float = np.inf,
) -> Float[ndarray, "*n"]:
    """Standard deviation, pixels, of a camera's projection in its worst direction, see :func:`projection_covariance_px2`."""
    C = projection_covariance_px2(rig, covariance, mean_pose, side, px, range_m)
    half = 0.5 * (C[..., 0, 0] + C[..., 1, 1])
    apart = np.hypot(0.5 * (C[..., 0, 0] - C[..., 1, 1]), C[..., 0, 1])
    return np.sqrt(np.maximum(half + apart, 0.0))


def projection_gradients(
    rig: StereoRig,
    names: tuple[str, ...],
    side: Side,
    px: Float[ndarray, "n 2"],
    range_m: Float[ndarray, "*n"] | float = np.inf,
) -> Float[ndarray, "n 2 q"]:
    """Derivatives of the pixel by the rig's named parameters and, behind them, the mean board pose's six.

    A motion xi = (w, v) of the boards in the left frame, and one of the rig, (r, d): R -> exp(r) R, t -> t + d, move a point X of the
    right frame by a motion of rotation r + R w and translation d + t x r + R v + t x R w.
    """
    camera = getattr(rig, side)
    own_names = [f"{side}.{name}" for name in _parameter_names(camera.model)]
    rays = camera.unproject(px)
    known = np.isfinite(rays).all(axis=-1)
    distance = np.broadcast_to(np.asarray(range_m, dtype=float), known.shape)[known]
    out = np.full((len(px), 2, len(names) + 6), np.nan)
    rays = rays[known]
    _, by_point, own = camera_derivatives(camera, rays)
    turn = -by_point @ so3.hat(rays)
    shift = by_point / distance[:, None, None]
    G = np.zeros((len(rays), 2, len(names) + 6))
    index = {name: i for i, name in enumerate(names)}
    for i, name in enumerate(own_names):
        if name in index:
            G[:, :, index[name]] = own[:, :, i]
    if side == "left":
        G[:, :, -6:-3], G[:, :, -3:] = turn, shift
    else:
        R, hat = rig.T_right_left.R, so3.hat(rig.T_right_left.t)
        by_turn = turn + shift @ hat  # a turn about the left camera's centre, seen from the right one
        G[:, :, -6:-3], G[:, :, -3:] = by_turn @ R, shift @ R
        for i, axis in enumerate("xyz"):
            if f"rotation.{axis}" in index:
                G[:, :, index[f"rotation.{axis}"]] = by_turn[:, :, i]
            if f"translation.{axis}" in index:
                G[:, :, index[f"translation.{axis}"]] = shift[:, :, i]
    out[known] = G
    return out


def _parameter_names(model: str) -> tuple[str, ...]:
    return camera_model(model).parameter_names
