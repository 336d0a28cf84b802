"""What a circle's image is off its centre's image by: the bias of an ellipse's centre, to be taken out."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.kernels.image_lens import ImageLens, LensFitOptions, fit_image_lens
from binocal.shapes import Float

_STEP_PX = 0.5  # of the differences: the map from pixels to the plane is smooth, and exact to 1e-15
_ROUNDS = 2  # the first round's centres are off by the shift itself, which bends the map by a tenth of it


def measure_circle_shift(
    board_xy: Float[ndarray, "n 2"],
    centres_px: Float[ndarray, "n 2"],
    areas_px2: Float[ndarray, "n"],
    size_wh: tuple[int, int],
    options: LensFitOptions,
    relative_radii: Float[ndarray, "n"],
) -> Float[ndarray, "n 2"]:
    """Centre of each circle's image minus the image of its centre, pixels, by the image's own lens and plane.

    ``areas_px2`` are the circles' areas in the image, from which their radius follows, given each one's over a plain
    circle's. Zero where no plane fits; that the places determine one is not checked.
    """
    shift = np.zeros_like(centres_px)
    for _ in range(_ROUNDS):
        lens = fit_image_lens(board_xy, centres_px - shift, size_wh, options)
        if lens is None:
            return np.zeros_like(centres_px)
        shift = circle_shift(lens, centres_px - shift, areas_px2, relative_radii)
    return shift


def circle_shift(
    lens: ImageLens,
    centres_px: Float[ndarray, "n 2"],
    areas_px2: Float[ndarray, "n"],
    relative_radii: Float[ndarray, "n"],
) -> Float[ndarray, "n 2"]:
    """Centroid of each image of a circle of radius R minus the image of its centre, pixels.

    With P the map from the plane to the image and J its derivative, R^2 / 4 (lap P / 2 + J grad ln |det J|): the mean of P over the
    disc, every place weighted by the area that it has in the image, to second order. For a homography it is the
    ellipse's centre (Heikkilä 2000). P's derivatives follow from those of its inverse Q, which is explicit:
    J = K^-1 and d2P = -J d2Q(J, J), with K the derivative of Q.
    """
    h = _STEP_PX
    steps = h * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]])
    places = lens.to_board((centres_px[:, None] + steps).reshape(-1, 2)).reshape(-1, len(steps), 2)
    o, e, w, s, n, se, nw, ne, sw = np.moveaxis(places, 1, 0)
    K = np.stack([(e - w) / (2 * h), (s - n) / (2 * h)], axis=-1)  # [place's axis, pixel's axis]
    xx, yy, xy = (e - 2 * o + w) / h**2, (s - 2 * o + n) / h**2, (se + nw - ne - sw) / (4 * h**2)
    second = np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-1)  # [place, pixel, pixel]
    J = np.linalg.inv(K)
    on_plane = np.einsum("nji,najk,nkl->nail", J, second, J)
    laplacian = -np.einsum("nka,naii->nk", J, on_plane)
    slope = -np.einsum("nlil->ni", on_plane)
    plain = float(np.median(areas_px2 / np.abs(np.linalg.det(J)) / relative_radii**2)) / np.pi
    return (plain * relative_radii**2 / 4)[:, None] * (0.5 * laplacian + np.einsum("nki,ni->nk", J, slope))
