"""The lens of one image from its own board; model and formulas: ``image_lens.hpp``.

Points are (x, y), (0, 0) the centre of the top-left pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import NOTHING, as_floats
from binocal.shapes import Float


@dataclass(frozen=True, slots=True, eq=False)
class ImageLens:
    """A lens that sees a board's points where they are in an image.

    ``bending`` are w, v and q of ``image_lens.hpp``: coefficients of the squared angle from the axis, half diagonals;
    ``centre_px`` is the image of the axis, ``log_aspect`` the logarithm of the vertical scale over the horizontal one.
    ``H`` takes the board's (X, Y, 1) to the ray's frame (f = 1 there). ``residual_px`` is each point's distance from where this lens sees
    it, infinite behind it. ``images_px`` are the places that were asked for, NaN where this lens does not see them.
    """

    bending: Float[ndarray, "3"]
    centre_px: Float[ndarray, "2"]
    log_aspect: float
    H: Float[ndarray, "3 3"]
    residual_px: Float[ndarray, "n"]
    images_px: Float[ndarray, "m 2"]
    size_wh: tuple[int, int]

    def to_board(self, pixels: Float[ndarray, "k 2"]) -> Float[ndarray, "k 2"]:
        """Where the pixels' rays meet the board's plane, in the board's unit. Pixels beyond the lens's field are not told apart."""
        unit = 0.5 * np.hypot(*self.size_wh)
        x, y = ((pixels - self.centre_px) / unit).T
        y = np.exp(self.log_aspect) * y
        r2 = x * x + y * y
        s = r2 * (self.bending[0] + r2 * (self.bending[1] + r2 * self.bending[2]))
        root = np.sqrt(np.maximum(np.abs(s), 1e-8))
        depth = np.where(s > 1e-8, root / np.tan(root), np.where(s < -1e-8, root / np.tanh(root), 1 - s / 3))
        u, v, w = np.linalg.solve(self.H, np.stack([x, y, depth]))
        return np.stack([u / w, v / w], axis=-1)


@dataclass(frozen=True, slots=True)
class LensFitOptions:
    """How a lens is fitted.

    What is off by less than ``tolerance_px`` keeps a weight. ``is_robust`` looks for wild points from every start; else they
    are given less weight only where the fit of all shows them. ``has_one_unknown`` leaves the lens w alone.
    """

    tolerance_px: float = 0.3
    is_robust: bool = False
    has_one_unknown: bool = False


def fit_image_lens(
    board_xy: Float[ndarray, "n 2"],
    points_px: Float[ndarray, "n 2"],
    size_wh: tuple[int, int],
    options: LensFitOptions | None = None,
    *,
    places_xy: Float[ndarray, "m 2"] | None = None,
) -> ImageLens | None:
    """The lens and the plane of one image of a board, by least squares with Tukey's weights.

    None where no plane fits (fewer than four points, or all on a line) or where it is seen from behind. ``places_xy`` are
    more places on the board whose images are wanted.
    """
    options = options or LensFitOptions()
    places = np.empty((0, 2)) if places_xy is None else as_floats(places_xy)
    lens, residual, images = np.empty(15), np.empty(len(points_px)), np.empty(places.shape)
    n_unknowns = 1 if options.has_one_unknown else 6
    width, height = size_wh
    if not _kernel.fit_image_lens(
        as_floats(board_xy), as_floats(points_px), float(width), float(height), float(options.tolerance_px), n_unknowns,
        options.is_robust, places if len(places) else NOTHING, lens, residual, images,
    ):  # fmt: skip
        return None
    return ImageLens(lens[:3], lens[3:5], float(lens[5]), lens[6:].reshape(3, 3), residual, images, size_wh)
