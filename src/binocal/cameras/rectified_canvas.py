"""The canvas of rectified images: scale, size, and what lies at their middles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.cameras.camera import MOST_SIDE_PX, Camera
from binocal.cameras.common_field import Window
from binocal.cameras.epipolar_projection import EpipolarProjection, ProjectionKind
from binocal.errors import DegenerateGeometryError
from binocal.shapes import Float

SAME_MIDDLE = 0.25  # of the window's width: cameras whose fields lie farther apart get a principal point each
SAME_ASPECT = 1.25  # of window over image: beyond it the canvas takes the window's shape
MOST_ZOOM = 1.25  # over the finer camera's own scale: more shows nothing new
ZOOM_RANGE = 64.0  # between the canvas that just shows the common field and one that any camera covers
FIRST_STEP, N_STEPS = 0.08, 5  # of the canvas's side, halved: the middle of the covered canvas, to 0.5 %


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """Pixels per coordinate, size, and the coordinates at both images' middles: across, and along for left and right."""

    focal_px: float
    size_wh: tuple[int, int]
    middle: Float[ndarray, "3"]
    along: int

    @property
    def has_one_middle(self) -> bool:
        """Both images show the same coordinates along the baseline."""
        return bool(self.middle[1] == self.middle[2])

    def projections(self, kind: ProjectionKind) -> tuple[EpipolarProjection, EpipolarProjection]:
        """Those of the left and of the right image."""
        both = []
        for own in self.middle[1:]:
            place = np.empty(2)
            place[self.along], place[1 - self.along] = own, self.middle[0]
            centre = (np.array(self.size_wh) - 1) / 2 - self.focal_px * place
            both.append(EpipolarProjection(kind, np.full(2, self.focal_px), centre, self.along == 1))
        return both[0], both[1]


def fit_canvas(
    window: Window, along: int, cameras: tuple[Camera, Camera], size_wh: tuple[int, int] | None = None
) -> Canvas:
    """The canvas that a window fills: of the left image's size if its shape allows, at most of the finer camera's scale."""
    middle = np.r_[window.across.mean(), window.along.mean(axis=1)]
    width = window.width
    if abs(middle[1] - middle[2]) <= SAME_MIDDLE * width:
        middle[1:] = middle[1:].mean()
    extent = np.array([width, window.height] if along == 0 else [window.height, width])
    finest = MOST_ZOOM * max(float(camera.parameters[:2].max()) for camera in cameras)
    if size_wh is not None:
        focal_px = min(float((np.array(size_wh) / extent).min()), finest)
        return Canvas(focal_px, (int(size_wh[0]), int(size_wh[1])), middle, along)
    size = np.array(cameras[0].size_wh, dtype=float)
    shape = (extent[0] / extent[1]) / (size[0] / size[1])
    if not 1 / SAME_ASPECT <= shape <= SAME_ASPECT:
        size = np.sqrt(size.prod() / extent.prod()) * extent
    focal_px = float((size / extent).min())
    if focal_px > finest:
        focal_px, size = finest, finest * extent
    width_px, height_px = (int(side) for side in np.clip(np.round(size), 1, MOST_SIDE_PX))
    return Canvas(focal_px, (width_px, height_px), middle, along)


def covered_canvas(canvas: Canvas, is_covered: Callable[[Canvas], bool]) -> Canvas:
    """The canvas of the smallest scale about, near the given one's middle, of which ``is_covered`` holds; same size.

    ``is_covered`` holds of every larger scale as well. The middle is moved step by step to where the scale can be smallest.

    Raises:
        DegenerateGeometryError: It holds of none.
    """
    groups = [[0], [1, 2]] if canvas.has_one_middle else [[0], [1], [2]]

    def smallest(middle: Float[ndarray, "3"]) -> Canvas | None:
        least, most = canvas.focal_px / ZOOM_RANGE, canvas.focal_px * ZOOM_RANGE
        if not is_covered(replace(canvas, focal_px=most, middle=middle)):
            return None
        while most > 1.001 * least:
            half = float(np.sqrt(least * most))
            least, most = (least, half) if is_covered(replace(canvas, focal_px=half, middle=middle)) else (half, most)
        return replace(canvas, focal_px=most, middle=middle)

    best = smallest(canvas.middle)
    if best is None:
        raise DegenerateGeometryError(
            "no part of the rectified images is covered by both cameras; leave out alpha, or choose a larger one."
        )
    step = FIRST_STEP
    for _ in range(N_STEPS):
        for group in groups:
            side = best.size_wh[canvas.along if group != [0] else 1 - canvas.along]
            for sign in (-1, 1):
                middle = best.middle.copy()
                middle[group] += sign * step * side / best.focal_px
                if not is_covered(replace(best, middle=middle, focal_px=best.focal_px / 1.001)):
                    continue
                best = smallest(middle) or best
        step /= 2
    return best


def between(valid: Canvas, whole: Canvas, alpha: float) -> Canvas:
    """From ``valid`` (alpha 0) to ``whole`` (alpha 1): the middle in equal steps, the scale in equal factors."""
    middle = (1 - alpha) * valid.middle + alpha * whole.middle
    if valid.has_one_middle:
        middle[1:] = middle[1:].mean()
    focal_px = float(valid.focal_px ** (1 - alpha) * whole.focal_px**alpha)
    return replace(valid, focal_px=focal_px, middle=middle)
