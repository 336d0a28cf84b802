"""One camera from board views alone: radial profile, vanishing points, poses, and the chosen model's distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.cameras import camera_model
from binocal.errors import TooFewViewsError
from binocal.geometry.homography import HomographyFit, PlaneFrame, fit_homographies
from binocal.initialization.distortion import estimate_lifting, fit_brown, fit_kannala_brandt, fit_lifted
from binocal.initialization.poses import BoardPoses, poses_from_rays, select_poses, unproject_all
from binocal.initialization.vanishing_points import VanishingEstimate, estimate_pinhole
from binocal.shapes import Bool, Float

_ASPECT_TOLERANCE = 0.02  # beyond it the radial profile is found again on squared-up pixels
_MAX_ROUNDS = 4
_STRONG_G = 0.85  # a corner moved by 15 % of its distance from the centre
MAX_VIEWS = 40  # evenly chosen, for everything but poses; the joint solver sees every view
_CENTRE_PRIOR = 0.12  # half diagonals: principal points of real cameras, wide


@dataclass(frozen=True, slots=True, eq=False)
class InitialCamera:
    """A camera to start the joint solver from.

    ``parameters``: fx, fy, cx, cy, skew, then the model's distortion. ``poses`` are ``T_camera_board`` by view (NaN
    where not usable), ``homographies`` what the views looked like before any of this, ``weights`` how far each corner
    is trusted, ``vanishing`` how well the views determine the pinhole (coordinates: half diagonals around
    ``lifting.centre_px``; ``columns`` and ``covariance`` are its input, at most 40 views). ``rms_px`` is the RMS
    distance of the corners that the robust weights trust, pixels, under the full model, over at most 40 views.
    """

    model: str
    size_wh: tuple[int, int]
    parameters: Float[ndarray, "p"]
    poses: BoardPoses
    rms_px: float
    homographies: HomographyFit
    vanishing: VanishingEstimate
    columns: Float[ndarray, "some 3 2"]
    covariance: Float[ndarray, "some 6 6"]
    weights: Float[ndarray, "views n"]
    unit_px: float
    notes: tuple[str, ...] = ()

    @property
    def is_usable(self) -> Bool[ndarray, "views"]:
        """Views with a pose."""
        return self.poses.is_usable


def estimate_intrinsics(
    object_points: Float[ndarray, "n d"],
    pixels: Float[ndarray, "views n 2"],
    size_wh: tuple[int, int],
    model: str,
    *,
    has_skew: bool = False,
    homographies: HomographyFit | None = None,
    focal_px: tuple[float, float] | None = None,
) -> InitialCamera:
    """Camera and board poses from corners alone, no nominal focal length; NaN = not seen, object points in z = 0.

    The radial profile comes first, from straightness (homographies) alone; vanishing points of the lifted views then
    give the pinhole; the profile is rewritten in the model's own coefficients, and those are refitted to the poses,
    linearly (Zhang 2000, eq. 13), where that lowers the residual. Lands within a few pixels, for the joint solver to
    finish.

    Raises:
        TooFewViewsError: No view has a homography.
        ValueError: Unknown model.
    """
    camera_model(model)
    pixels = np.asarray(pixels, dtype=float)
    fits = fit_homographies(object_points, pixels) if homographies is None else homographies
    usable = fits.is_valid
    if not usable.any():
        raise TooFewViewsError(0, 3)
    frame = PlaneFrame.of(object_points)
    is_seen = np.isfinite(pixels[..., 0]) & usable[:, None]
    weights = fits.weights
    u = np.where(is_seen, pixels[..., 0], 0.0)
    v = np.where(is_seen, pixels[..., 1], 0.0)

    some = np.flatnonzero(usable)
    if len(some) > MAX_VIEWS:
        some = some[np.linspace(0, len(some) - 1, MAX_VIEWS).round().astype(int)]
    u_some, v_some, w_some, seen_some = u[some], v[some], weights[some], is_seen[some]
    aspect, is_renewed, n_rounds = 1.0, False, 0
    while True:
        lifting = estimate_lifting(frame, u_some, v_some, w_some, size_wh, aspect)
        columns, covariance, distance = fit_lifted(lifting, frame, u_some, v_some, w_some)
        sigma = _view_sigma(distance, w_some)
        covariance = covariance * np.square(sigma / lifting.unit_px)[:, None, None]
        vanishing = estimate_pinhole(
            columns, covariance, sigma_centre=np.minimum(3 * lifting.sigma_centre + 0.005, _CENTRE_PRIOR),
            has_skew=has_skew,
            log_focal=None if focal_px is None else (np.log(focal_px[0] / lifting.unit_px), focal_px[1] / focal_px[0]),
        )  # fmt: skip
        K = vanishing.K
        is_square = abs(K[0, 0] / K[1, 1] - 1) < _ASPECT_TOLERANCE
        renewed = _renewed(distance, sigma, seen_some)
        is_same = np.count_nonzero(renewed > 0.5) < np.count_nonzero(w_some > 0.5) + 0.01 * np.count_nonzero(seen_some)
        if is_square and is_same:
            break
        aspect = aspect if is_square else aspect * K[0, 0] / K[1, 1]
        if not is_same:
            w_some, is_renewed = renewed, True
        n_rounds += 1
        if n_rounds == _MAX_ROUNDS:
            break
    if is_renewed:
        _, _, distance = fit_lifted(lifting, frame, u[usable], v[usable], weights[usable])
        weights = weights.copy()
        weights[usable] = _renewed(distance, _view_sigma(distance, weights[usable]), is_seen[usable])
    lifting = replace(lifting, centre_px=lifting.centre_px + lifting.unit_px * K[:2, 2] / np.array([1, lifting.aspect]))
    fx, fy = K[0, 0] * lifting.unit_px, K[1, 1] * lifting.unit_px / lifting.aspect

    dx, dy, g = lifting.lift(u, v)
    x = dx / K[0, 0] - K[0, 1] / (K[0, 0] * K[1, 1]) * dy
    poses = poses_from_rays(frame, (x, dy / K[1, 1], g), pixels, weights)
    r_max = float(np.sqrt(np.max(np.where(weights > 0.05, dx * dx + dy * dy, 0.0))))
    if model == "fisheye4":
        distortion = fit_kannala_brandt(lifting, fx, r_max)
    else:
        distortion = fit_brown(lifting, fx, r_max, camera_model(model).n_parameters - 5)
    parameters = np.r_[fx, fy, lifting.centre_px, K[0, 1] * lifting.unit_px / lifting.aspect, distortion]
    some = some[poses.is_usable[some]]
    xy = np.asarray(object_points, dtype=float)[:, :2]
    parameters, rms_px = _refit_distortion(
        model, parameters, select_poses(poses, some), xy, u[some], v[some], weights[some]
    )
    if np.min(np.where(weights > 0.05, g, 1.0)) < _STRONG_G:
        # The model's own coefficients bend a strong lens otherwise than the profile did: poses again, through the model
        rays = unproject_all(model, parameters, np.where(is_seen[..., None], pixels, np.nan))
        again = poses_from_rays(frame, rays, pixels, weights)
        if again.is_usable[some].all():
            refitted, rms_again = _refit_distortion(
                model, parameters, select_poses(again, some), xy, u[some], v[some], weights[some]
            )
            if rms_again < rms_px:
                parameters, rms_px, poses = refitted, rms_again, again
    return InitialCamera(
        model,
        size_wh,
        parameters,
        poses,
        rms_px,
        fits,
        vanishing,
        columns,
        covariance,
        weights,
        lifting.unit_px,
        vanishing.notes,
    )


def _renewed(distance: ndarray, sigma: Float[ndarray, "views"], is_seen: ndarray) -> Float[ndarray, "views n"]:
    """Weights from the lifted fits: what looked like outliers of a plain homography may have been honest distortion."""
    with np.errstate(all="ignore"):
        weights = 1 / np.square(1 + np.square(distance / (4 * sigma[:, None])))
    return np.where(is_seen & np.isfinite(weights), weights, 0.0)


def _view_sigma(distance: Float[ndarray, "views n"], weights: Float[ndarray, "views n"]) -> Float[ndarray, "views"]:
    """Weighted standard deviation of one coordinate by view, at least half the median view's."""
    with np.errstate(all="ignore"):
        total = np.sum(weights * np.square(distance), axis=-1)
    sigma = np.sqrt(total / np.maximum(2 * weights.sum(axis=-1) - 8, 1.0))
    sigma = np.where(np.isfinite(sigma), sigma, np.inf)
    finite = sigma[np.isfinite(sigma)]
    typical = float(np.median(finite)) if finite.size else 1.0
    return np.clip(sigma, max(typical / 2, 1e-9), 1e6)


def _refit_distortion(
    model: str,
    parameters: ndarray,
    poses: BoardPoses,
    xy: Float[ndarray, "n 2"],
    u: ndarray,
    v: ndarray,
    weights: ndarray,
) -> tuple[Float[ndarray, "p"], float]:
    """Radial coefficients refitted linearly to fixed poses, if better; and the weighted RMS distance in pixels."""
    functions = camera_model(model)
    X, Y, Z = (poses.R[:, i, :2] @ xy.T + poses.t[:, i, None] for i in range(3))
    if not functions.sees_behind:
        weights = np.where(Z > 0, weights, 0.0)
        Z = np.where(Z > 0, Z, 1.0)
    total = max(float(weights.sum()), 1e-9)

    def rms(candidate: ndarray) -> tuple[float, ndarray, ndarray]:
        with np.errstate(all="ignore"):
            u_fit, v_fit = functions.project(candidate, X, Y, Z)
            e_u, e_v = u - u_fit, v - v_fit
            cost = float(np.sum(weights * (e_u * e_u + e_v * e_v)))
        return np.sqrt(cost / total) if np.isfinite(cost) else np.inf, e_u, e_v

    before, e_u, e_v = rms(parameters)
    slots = np.array([5, 6]) if np.count_nonzero(parameters[5:]) <= 2 else 5 + np.flatnonzero(parameters[5:])
    fx, fy = parameters[:2]
    if model == "fisheye4":
        r = np.hypot(X, Y)
        base = np.arctan2(r, Z)
        unit_x, unit_y = X / np.maximum(r, 1e-12), Y / np.maximum(r, 1e-12)
        powers = [3, 5, 7, 9]
    else:
        base = np.hypot(X, Y) / Z
        unit_x, unit_y = X / Z / np.maximum(base, 1e-12), Y / Z / np.maximum(base, 1e-12)
        powers = [3, 5, 0, 0, 7]
    if not np.isfinite(before):
        return parameters, before
    A = np.stack([base ** powers[slot - 5] for slot in slots])
    AA = (A * (weights * (np.square(fx * unit_x) + np.square(fy * unit_y)))).reshape(len(slots), -1) @ A.reshape(
        len(slots), -1
    ).T
    b = A.reshape(len(slots), -1) @ (weights * (fx * unit_x * e_u + fy * unit_y * e_v)).ravel()
    scale = 1 / np.sqrt(np.maximum(np.diag(AA), 1e-300))
    step = scale * np.linalg.lstsq(AA * scale * scale[:, None], b * scale, rcond=1e-8)[0]
    candidate = parameters.copy()
    candidate[slots] += step
    after = rms(candidate)[0]
    reach = np.linspace(0, float(np.max(np.where(weights > 0.05, base, 0.0))), 50)
    slope = 1 + sum(powers[slot - 5] * candidate[slot] * reach ** (powers[slot - 5] - 1) for slot in slots)
    if after < before and np.all(slope > 0.02):  # a profile that folds back over its own corners helps nobody
        return candidate, after
    return parameters, before
