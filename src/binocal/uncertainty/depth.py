"""Standard deviation of measured depth: of the calibration, of the matching, and of the board's size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig, camera_model
from binocal.shapes import Bool, Float
from binocal.uncertainty.covariance import Covariance
from binocal.uncertainty.derivatives import PairDerivatives, pair_derivatives, variance_of
from binocal.values import ArrayValue, frozen_array

MATCHING_PX = 0.25
"""Standard deviation of a disparity, pixels, where none is stated; semi-global matching reaches 0.2 to 0.3 on textured scenes."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthSigma(ArrayValue):
    """Standard deviations of the depth of points, metres (board pitches without a scale), by cause.

    ``depth_m`` is the points' depth. ``calibration_m`` follows from the rig's covariance and is one error for all images;
    ``matching_m`` from the noise of the match and is another in every pixel; ``board_m`` from the size of the board's print.
    NaN where a point is not seen by both cameras.
    """

    depth_m: Float[ndarray, "*n"]
    calibration_m: Float[ndarray, "*n"]
    matching_m: Float[ndarray, "*n"]
    board_m: Float[ndarray, "*n"]

    def __post_init__(self) -> None:
        for name in ("depth_m", "calibration_m", "matching_m", "board_m"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    @property
    def total_m(self) -> Float[ndarray, "*n"]:
        """All causes together."""
        return np.sqrt(self.calibration_m**2 + self.matching_m**2 + self.board_m**2)

    @property
    def relative(self) -> Float[ndarray, "*n"]:
        """All causes together, over the depth."""
        return self.total_m / self.depth_m


def depth_sigma(
    rig: StereoRig,
    covariance: Covariance,
    points: Float[ndarray, "*n 3"],
    *,
    matching_px: float = 0.0,
    board_scale_sigma: float = 0.0,
) -> DepthSigma:
    """Standard deviation of the depth at which the rig sees points of the left frame (metres).

    Depth is that of the least-squares intersection of both rays, its error the point's shift along the left ray: relative to the
    depth it does not depend on where the left camera's own axis is thought to lie. ``points`` give place and range;
    ``matching_px`` is the standard deviation of a match in the right image (each coordinate; that across the epipolar line does not
    count), ``board_scale_sigma`` the relative one of the board's size.
    First order; what the depth of a point with noise-free pixels would be off by in other calibrations of the same kind.
    """
    points = np.asarray(points, dtype=float)
    flat = points.reshape(-1, 3)
    derivatives = pair_derivatives(rig, covariance.names, flat)
    G, match = depth_gradients(rig, derivatives, flat)
    depth = _depths(rig, flat)
    relative = np.sqrt(variance_of(G, covariance.matrix))
    shape = points.shape[:-1]
    return DepthSigma(
        depth.reshape(shape),
        (relative * depth).reshape(shape),
        (matching_px * np.linalg.norm(match, axis=-1) * depth).reshape(shape),
        np.where(np.isfinite(relative), board_scale_sigma * depth, np.nan).reshape(shape),
    )


def depth_gradients(
    rig: StereoRig, derivatives: PairDerivatives, points: Float[ndarray, "n 3"]
) -> tuple[Float[ndarray, "n p"], Float[ndarray, "n 2"]]:
    """Derivatives of relative depth by the parameters, the pixels held, and by the right pixel, the rig held."""
    P = np.concatenate([derivatives.left_by_point, derivatives.right_by_point @ rig.T_right_left.R], axis=1)
    J = np.concatenate([derivatives.left, derivatives.right], axis=1)
    along = points / np.sum(points**2, axis=-1, keepdims=True)  # the ray's direction over the range
    G, match = np.full((len(points), J.shape[2]), np.nan), np.full((len(points), 2), np.nan)
    seen = np.isfinite(P).all(axis=(1, 2)) & np.isfinite(J).all(axis=(1, 2))
    P, J, along = P[seen], J[seen], along[seen]
    P, along, is_told = _in_baselines(rig, P, along)
    normal = P.swapaxes(1, 2) @ P
    weights = np.full_like(along, np.nan)
    weights[is_told] = np.linalg.solve(normal[is_told], along[is_told, :, None])[
        ..., 0
    ]  # along' N^-1 P' is the row wanted
    row = np.einsum("ni,nji->nj", weights, P)
    G[seen] = -np.einsum("nj,njp->np", row, J)
    match[seen] = row[:, 2:]
    return G, match


def _in_baselines(
    rig: StereoRig, P: Float[ndarray, "n 4 3"], along: Float[ndarray, "n 3"]
) -> tuple[Float[ndarray, "n 4 3"], Float[ndarray, "n 3"], Bool[ndarray, " n"]]:
    """The same with lengths along the ray stretched by range over baseline, as far points move pixels less along it by that share.

    Else the normal equations lose a digit for every factor of three in range, and are singular from 1e8 baselines. Told is what
    rounding leaves; beyond 1e12 baselines nothing.
    """
    inverse_range = np.linalg.norm(along, axis=-1)
    ray = along / inverse_range[:, None]
    stretch = 1 / (inverse_range * rig.baseline_m)
    P = P + (P @ ray[..., None]) * ((stretch - 1)[:, None] * ray)[:, None, :]
    return P, stretch[:, None] * along, stretch < 1e12


def points_at(
    rig: StereoRig, left_px: Float[ndarray, "*n 2"], depth_m: Float[ndarray, "*n"] | float
) -> Float[ndarray, "*n 3"]:
    """Points of the left frame at that depth on the rays of left pixels; NaN where a pixel has no ray.

    Depth is along the optical axis; of cameras that see aside and behind, the distance.
    """
    rays = rig.left.unproject(np.asarray(left_px, dtype=float))
    if not _measures_distance(rig):
        rays = rays / np.where(rays[..., 2:] > 1e-9, rays[..., 2:], np.nan)
    return rays * np.broadcast_to(np.asarray(depth_m, dtype=float), rays.shape[:-1])[..., None]


def is_seen_by_right(rig: StereoRig, points: Float[ndarray, "*n 3"], *, margin_px: float = 0.0) -> Bool[ndarray, "*n"]:
    """Which points of the left frame land in the right image, and come from where the right camera's model sees them."""
    in_right = rig.T_right_left.apply(points)
    pixels = rig.right.project(in_right)
    with np.errstate(invalid="ignore"):
        is_inside = np.all(
            (pixels >= margin_px - 0.5) & (pixels <= np.array(rig.right.size_wh) - 0.5 - margin_px), axis=-1
        )
    # a strong lens model folds back outside its field: such a pixel returns to another ray
    back = rig.right.unproject(np.where(is_inside[..., None], pixels, np.nan))
    direction = in_right / np.linalg.norm(in_right, axis=-1, keepdims=True)
    return is_inside & (np.linalg.norm(np.where(np.isnan(back), np.inf, back) - direction, axis=-1) < 1e-6)


def _measures_distance(rig: StereoRig) -> bool:
    return camera_model(rig.left.model).sees_behind


def _depths(rig: StereoRig, points: Float[ndarray, "n 3"]) -> Float[ndarray, "n"]:
    return np.linalg.norm(points, axis=-1) if _measures_distance(rig) else points[..., 2]


def relative_depth_gradients(
    rig: StereoRig, names: Sequence[str], points: Float[ndarray, "n 3"]
) -> Float[ndarray, "n p"]:
    """Derivatives of relative depth by the named parameters, the pixels held; NaN where not both cameras see."""
    return depth_gradients(rig, pair_derivatives(rig, names, points), points)[0]
