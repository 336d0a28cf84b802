"""Are spots that lie on a grid the images of equal circles of its plane? Squares, and what clutter has, are not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.detection.finding.blobs import Blobs
from binocal.detection.measuring.ellipses import MeasuredSpots
from binocal.kernels.image_lens import LensFitOptions, fit_image_lens
from binocal.shapes import Float

MAX_SPREAD = 0.1  # of nine in ten radii about their median, relative: measured 0.005 of rendered boards at most
MAX_SPREAD_PX = 0.3  # which small spots may have
MAX_ELONGATION = 1.5  # of the median spot as laid on the board; measured 1.22 at most, sheared by a place 2.6
MAX_SHAPE_RESIDUAL = (
    0.12  # of the contrast, at the median spot: 0.012 of rendered discs at most, 0.2 of real squares at least
)
N_WITHOUT_SHAPE = 20  # spots, from which on a grid of spots too small for an ellipse is no chance
_STEP = 0.1  # pitches


@dataclass(frozen=True, slots=True, eq=False)
class GridSpots:
    """Spots of a grid: their places on the board in pitches, what they should be as wide as, and what was measured of them."""

    board_xy: Float[ndarray, "n 2"]
    relative_radii: Float[ndarray, "n"]
    measured: MeasuredSpots
    blobs: Blobs


def are_equal_circles(spots: GridSpots, size_wh: tuple[int, int], options: LensFitOptions) -> bool:
    """Whether the spots have the sizes and shapes that circles of the board have in the image, by the image's own lens.

    True where no lens fits, and of a large grid whose spots are too small to have a shape: then nothing speaks against it.
    Spots that are NaN have no say.
    """
    seen = np.isfinite(spots.measured.centres_px[:, 0])
    xy, measured, blobs = spots.board_xy[seen], spots.measured, spots.blobs.select(seen)
    around = xy[:, None] + _STEP * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    lens = fit_image_lens(xy, measured.centres_px[seen], size_wh, options, places_xy=around.reshape(-1, 2))
    if lens is None:
        return True
    right, left, below, above = np.moveaxis(lens.images_px.reshape(around.shape), 1, 0)
    J = np.stack([right - left, below - above], axis=-1) / (2 * _STEP)
    radii_px = np.sqrt(measured.areas_px2[seen] / np.pi)
    on_board = radii_px / np.sqrt(np.abs(np.linalg.det(J))) / spots.relative_radii[seen]
    off = np.abs(np.log(on_board / np.nanmedian(on_board))) - MAX_SPREAD_PX / radii_px
    cosine, sine = np.cos(blobs.angles_rad), np.sin(blobs.angles_rad)
    turn = np.stack([cosine, -sine, sine, cosine], axis=-1).reshape(-1, 2, 2)
    known = np.isfinite(J).all(axis=(1, 2))
    axes = np.linalg.svd(np.linalg.solve(J[known], (turn * blobs.axes_px[:, None])[known]), compute_uv=False)
    residuals = measured.shape_residuals[seen]
    residuals = residuals[np.isfinite(residuals)]
    if 2 * len(residuals) < len(xy):
        has_shape = len(xy) >= N_WITHOUT_SHAPE
    else:
        has_shape = float(np.median(residuals)) < MAX_SHAPE_RESIDUAL
    is_round = np.median(axes[:, 0] / axes[:, 1]) < MAX_ELONGATION
    return bool(has_shape and is_round and np.nanquantile(off, 0.9) < MAX_SPREAD)
