"""Whether the lens model suffices: would a free radial profile predict the rows of views that it was not fitted to?

What residuals point outwards or inwards by is fitted, camera by camera, as a free function of the distance from the principal point (a
cubic spline) to all views but a block, and taken from the block's corners. If rectified rows of the blocks fall by more than chance,
the lens bends light in a way that its model cannot follow.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.calibrators.left_out_views import blocks_of
from binocal.calibrators.model_selection import Advantage, advantage
from binocal.errors import DegenerateGeometryError
from binocal.metrics.image import row_differences
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.validation.residuals import corner_residuals, solved_detections

N_BASIS = 7  # functions of the radius: bends of a lens within a sixth of the image's half diagonal
RIDGE = 1e-6  # of the normal equations' trace: a part of the radius without corners stays as it is
N_RADII = 40
MIN_VIEWS = 6


@dataclass(frozen=True, slots=True, eq=False)
class LensAdequacy:
    """What a free radial profile would change.

    ``gain`` says by how much squared rows of views left out would be smaller. ``radius_px`` and ``profile_px`` (left, right) are the
    profile from all views: how far outwards of the model's prediction corners lie, NaN where there are none; ``largest_px`` its
    largest absolute value.
    """

    gain: Advantage
    radius_px: Float[ndarray, "2 m"]
    profile_px: Float[ndarray, "2 m"]

    @property
    def largest_px(self) -> float:
        """Of both cameras."""
        return float(np.nanmax(np.abs(self.profile_px), initial=0.0))


def measure_lens_adequacy(calibration: StereoCalibration) -> LensAdequacy | None:
    """The gain of a free radial profile; None with fewer than six views, or where the rig cannot be rectified.

    Raises:
        DataError: The calibration holds no corners.
    """
    detections, rig = solved_detections(calibration), calibration.rig
    if detections.n_views < MIN_VIEWS:
        return None
    block = blocks_of(detections.n_views)
    corrected, radii, profiles = [], [], []
    for camera, px, residual in zip(
        (rig.left, rig.right), (detections.left_px, detections.right_px), corner_residuals(calibration), strict=True
    ):
        away = px - camera.parameters[2:4]
        radius = np.linalg.norm(away, axis=-1)
        outward = away / np.maximum(radius, 1e-9)[..., None]
        known = np.isfinite(residual[..., 0]) & np.isfinite(radius)
        end = float(radius[known].max(initial=1.0))
        basis = np.where(known[..., None], spline_basis(np.where(known, radius, 0.0) / end), 0.0)
        target = np.where(known, np.sum(np.nan_to_num(residual) * np.nan_to_num(outward), axis=-1), 0.0)
        own = np.where(np.isfinite(radius), np.minimum(radius / end, 1.0), 0.0)
        shift = np.zeros(px.shape[:-1])
        for k in range(block[-1] + 1):
            c = _fit(basis[block != k], target[block != k])
            shift[block == k] = spline_basis(own[block == k]) @ c
        corrected.append(px - shift[..., None] * outward)
        grid = np.linspace(0, 1, N_RADII)
        counts, _ = np.histogram(
            radius[known] / end, bins=np.linspace(-0.5, N_RADII - 0.5, N_RADII + 1) / (N_RADII - 1)
        )
        profile = spline_basis(grid) @ _fit(basis, target)
        radii.append(grid * end)
        profiles.append(np.where(counts > 0, profile, np.nan))
    try:
        before = row_differences(rig, detections)
        after = row_differences(rig, replace(detections, left_px=corrected[0], right_px=corrected[1]))
    except DegenerateGeometryError:
        return None
    lengths = [np.isfinite(r[..., 0]) for r in corner_residuals(calibration)]
    counted = lengths[0] & lengths[1]
    before, after = np.where(counted, before, np.nan), np.where(counted, after, np.nan)
    if not np.isfinite(before).any():
        return None
    return LensAdequacy(advantage(before, after), np.array(radii), np.array(profiles))


def spline_basis(x: Float[ndarray, "*n"]) -> Float[ndarray, "*n k"]:
    """Uniform cubic B-splines on [0, 1]: :data:`N_BASIS` functions that add up to 1. Source: de Boor 1978."""
    n_cells = N_BASIS - 3
    s = np.clip(np.asarray(x) * n_cells, 0, n_cells * (1 - 1e-12))
    cell = np.floor(s).astype(int)
    t = s - cell
    parts = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=-1) / 6
    out = np.zeros((*np.shape(x), N_BASIS))
    for k in range(4):
        np.put_along_axis(out, (cell + k)[..., None], parts[..., [k]], axis=-1)
    return out


def _fit(basis: Float[ndarray, "views n k"], target: Float[ndarray, "views n"]) -> Float[ndarray, "k"]:
    B = basis.reshape(-1, N_BASIS)
    A = B.T @ B
    return np.linalg.solve(A + RIDGE * max(float(np.trace(A)), 1e-9) * np.eye(N_BASIS), B.T @ target.ravel())
