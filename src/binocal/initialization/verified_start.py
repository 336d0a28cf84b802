"""A start for sets of views in which nothing is wrong, at a tenth of the cost of finding out what is.

Plain homographies of all images at once, a focal length for each camera with the principal point held in the middle,
poses, and the mean of the views' relative poses: rough, and not robust against anything. Whoever uses it must verify the
joint solve from it (:mod:`binocal.calibrators.joint` does, by :mod:`binocal.acceptance.proof`), and diagnose the views
(:mod:`binocal.initialization.diagnosis`) where that fails.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import camera_model
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.geometry.homography import PlaneFrame, fit_plane
from binocal.initialization.poses import decompose
from binocal.initialization.solid_targets import is_solid
from binocal.shapes import Float

MIN_CORNERS = 12  # of every image; fewer leave a homography too free to prove anything
_OUTSIDE_PX = 2.0
_FOCAL_RANGE = (0.3, 100.0)  # half diagonals: 150 to 1 deg of view
_MAX_LENS_RESIDUAL = (
    0.01  # of a half diagonal; a lens that bends straight lines by more needs the profile that the diagnosis fits
)
_MAX_TURN = (
    0.7  # of a view's rotation between the cameras from the mean's: rough poses stay below, reversed corners reach 2
)


@dataclass(frozen=True, slots=True, eq=False)
class VerifiedStart:
    """Rough cameras, rig and boards.

    ``parameters``: left and right, fx, fy, cx, cy, then zeros. ``homography_px`` is the RMS residual of one coordinate
    of all corners under free homographies, which no rig can beat by more than their eight parameters and the lens allow.
    """

    parameters: tuple[Float[ndarray, "p"], Float[ndarray, "p"]]
    R_right_left: Float[ndarray, "3 3"]
    t_right_left: Float[ndarray, "3"]
    R_left_board: Float[ndarray, "views 3 3"]
    t_left_board: Float[ndarray, "views 3"]
    homography_px: float


def estimate_verified_start(detections: Detections, model: str) -> VerifiedStart | None:
    """A rough start from closed forms alone, or None where the views do not look clean at first sight.

    Every image must show twelve corners or more of a plane, inside the image, and no lens that bends the board visibly.
    """
    pixels = np.concatenate([detections.left_px, detections.right_px])
    n_views = detections.n_views
    is_seen = np.isfinite(pixels[..., 0])
    if is_seen.sum(axis=-1).min(initial=len(is_seen[0])) < MIN_CORNERS:
        return None
    if is_solid(detections.object_points_m):
        return None
    is_full = bool(is_seen.all())
    size = np.array([detections.left_size_wh, detections.right_size_wh], dtype=float).repeat(n_views, axis=0)
    centre = (size - 1) / 2
    unit_px = np.hypot(size[:, 0], size[:, 1]) / 2
    u = (pixels[..., 0] - centre[:, :1]) / unit_px[:, None]
    v = (pixels[..., 1] - centre[:, 1:]) / unit_px[:, None]
    if not is_full:
        u[~is_seen], v[~is_seen] = 0.0, 0.0
    limit = (centre + 0.5 + _OUTSIDE_PX) / unit_px[:, None]
    if (np.abs(u) > limit[:, :1]).any() or (np.abs(v) > limit[:, 1:]).any():
        return None
    frame = PlaneFrame.of(detections.object_points_m)
    weights = is_seen.astype(float)
    with np.errstate(all="ignore"):
        fit, du, dv = fit_plane(frame, u, v, weights, n_passes=1)
        squares = weights * (du * du + dv * dv)
    n_corners = is_seen.sum()
    rms = np.sqrt(squares.sum() / (2 * n_corners))
    if not rms < _MAX_LENS_RESIDUAL:  # NaN too
        return None
    focal = _focal_lengths(fit.rows.reshape(2, n_views, 3, 3))
    if focal is None:
        return None
    rays = fit.rows / np.repeat(focal, n_views)[:, None, None] ** [[1], [1], [0]]
    with np.errstate(all="ignore"):
        R, t_centre, _ = decompose(rays, frame.scale)
        t = t_centre - R[..., :2] @ frame.centre
    if not (np.abs(R).max() < 2 and np.isfinite(t).all()):  # no rotation: an image whose corners lie on a line
        return None
    R_left, t_left, R_right, t_right = R[:n_views], t[:n_views], R[n_views:], t[n_views:]
    relative = R_right @ R_left.swapaxes(-1, -2)
    R_right_left = so3.project_to_rotation(relative.mean(axis=0))
    if np.abs(relative - R_right_left).max() > _MAX_TURN:
        return None
    t_right_left = np.mean(t_right - t_left @ R_right_left.T, axis=0)
    parameters = []
    for side in range(2):
        start = np.zeros(camera_model(model).n_parameters)
        start[:2] = focal[side] * unit_px[side * n_views]
        start[2:4] = centre[side * n_views]
        parameters.append(start)
    homography_px = float(np.sqrt((squares.sum(axis=-1) * unit_px**2).sum() / (2 * n_corners - 8 * len(pixels))))
    return VerifiedStart((parameters[0], parameters[1]), R_right_left, t_right_left, R_left, t_left, homography_px)


def _focal_lengths(rows: Float[ndarray, "cameras views 3 3"]) -> Float[ndarray, "cameras"] | None:
    """Focal length of each camera, principal point at the origin, square pixels: one linear unknown, 1 / f².

    Source: Zhang 2000, eqs 3 and 4. None where one comes out implausible.
    """
    h1, h2 = rows[..., 0], rows[..., 1]
    size = np.vecdot(h1, h1) + np.vecdot(h2, h2)
    orthogonal, equal = h1 * h2 / size[..., None], (h1 + h2) * (h1 - h2) / (2 * size[..., None])
    squares = products = 0.0
    for each in (orthogonal, equal):
        across = each[..., 0] + each[..., 1]
        squares = squares + np.vecdot(across, across)
        products = products + np.vecdot(across, each[..., 2])
    with np.errstate(all="ignore"):
        focal = np.sqrt(-squares / products)
    return focal if np.all((focal > _FOCAL_RANGE[0]) & (focal < _FOCAL_RANGE[1])) else None
