"""Standard deviation of the distance in every pixel of a rectified image, from a lattice of places and distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.cameras.rectified_pair import Rectification
from binocal.shapes import Float, Float32
from binocal.uncertainty.covariance import Covariance
from binocal.uncertainty.depth import relative_depth_gradients
from binocal.uncertainty.derivatives import variance_of

COLUMNS, ROWS, LEVELS = 9, 7, 6  # of the lattice: the image, and the logarithm of distance


@dataclass(frozen=True, slots=True, eq=False)
class DepthSigmaLattice:
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


def depth_sigma_lattice(
    rig: StereoRig, covariance: Covariance, rectification: Rectification, near: float, far: float
) -> DepthSigmaLattice:
    """How uncertain the calibration leaves distances between near and far (both finite), as seen in the rectified left image.

    That of :func:`binocal.uncertainty.depth_sigma`, the calibration's part. ``share`` is NaN where the covariance is unknown or a
    camera has no such pixel.
    """
    width, height = rectification.size_wh
    u, v = np.linspace(0, width - 1, COLUMNS), np.linspace(0, height - 1, ROWS)
    rays = rectification.left.unproject(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    rays = rays / (
        rays[:, 2:] if rectification.projection == "pinhole" else np.linalg.norm(rays, axis=1, keepdims=True)
    )
    distances = np.geomspace(near, far, LEVELS)
    points = (distances[:, None, None] * rays).reshape(-1, 3) @ rectification.R_rect_left
    G = relative_depth_gradients(rig, covariance.names, points)
    share = np.sqrt(np.maximum(variance_of(G, covariance.matrix), 0))
    return DepthSigmaLattice(distances, share.reshape(LEVELS, ROWS, COLUMNS))


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
