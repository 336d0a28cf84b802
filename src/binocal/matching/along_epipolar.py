"""Where a point of the left image lies in the right one, sought along its epipolar line only."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.kernels.template_match import match_templates
from binocal.shapes import Bool, Float
from binocal.values import ArrayValue

NEAREST_BASELINES = 2.0  # nearer things are in the middle of no pair
N_FIRST = 200  # places looked at to see how far apart they are
HALVES = (9, 6, 4)  # of windows: a smaller one where a larger one shows things at several depths
MARGIN_PX = 4  # beyond a window, for its samples' neighbours
MIN_SEARCH_LIKENESS = 0.7
MIN_LIKENESS = 0.85
ALIKE = 0.05  # a second place whose likeness is less than this below the best one's may be the right one
SEPARATE_PX = 5.0
MOST_REFINED_PX = 3.0  # of a place found in steps of a pixel
MOST_OFF_LINE_PX = 2.0
LEAST_SIGMA_PX = 0.05  # of a matched window, as single matches of natural images scatter


class NotMatchedError(ValueError):
    """A point has no clear partner; the text says why, and what may help."""


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarMatch(ArrayValue):
    """The partner of a left point: its place, that place's covariance, and how it moves with the left point on the same surface."""

    right_px: Float[ndarray, "2"]
    covariance_px2: Float[ndarray, "2 2"]
    warp: Float[ndarray, "2 2"]
    likeness: float


def match_along_epipolar(left: ndarray, right: ndarray, rig: StereoRig, left_px: Float[ndarray, "2"]) -> EpipolarMatch:
    """The partner of a point of a left grey image (h, w) in the right one.

    Places along the line, a pixel apart, are compared by normalised cross-correlation, the window warped as a surface that faces
    the camera at that depth would look; the best one is fitted by least squares.

    Raises:
        NotMatchedError: The point is at the border, nothing on the line looks like it, or two places do.
    """
    shown, other = (np.ascontiguousarray(image, dtype=np.float32) for image in (left, right))
    problems = []
    for half in HALVES:
        try:
            return _match(shown, other, rig, np.asarray(left_px, dtype=float), half)
        except NotMatchedError as error:
            problems.append(error)
    raise problems[0]


def _match(left: ndarray, right: ndarray, rig: StereoRig, left_px: Float[ndarray, "2"], half: int) -> EpipolarMatch:
    reach = half + MARGIN_PX
    if not _is_inside(left_px[None], left.shape, 0)[0]:
        raise NotMatchedError(f"it lies outside of the left image of {left.shape[1]}x{left.shape[0]} pixels")
    if not _is_inside(left_px[None], left.shape, reach)[0]:
        raise NotMatchedError(f"it lies less than {reach} pixels from the border of the left image")
    places, warps = _places(rig, left_px, right.shape, reach)
    if not len(places):
        raise NotMatchedError("the right camera does not see it at any depth")
    likeness = _likeness(left, right, left_px, places, warps, half)
    best = int(np.argmax(likeness))
    if likeness[best] < MIN_SEARCH_LIKENESS:
        raise NotMatchedError(
            f"nothing on its epipolar line in the right image looks like it (correlation {likeness[best]:.2f} at best)"
        )
    far = np.linalg.norm(places - places[best], axis=1) > SEPARATE_PX
    rival = int(np.argmax(np.where(far, likeness, -1.0)))
    if far.any() and likeness[rival] > likeness[best] - ALIKE:
        (x, y), (x2, y2) = places[best], places[rival]
        raise NotMatchedError(
            f"two places in the right image look like it, ({x:.0f}, {y:.0f}) and ({x2:.0f}, {y2:.0f})"
        )
    found = match_templates(left, right, left_px[None], places[[best]], warps[[best]], half=half, max_iterations=30)
    if not (found.is_converged[0] and found.likeness[0] > MIN_LIKENESS):
        raise NotMatchedError("its surroundings do not look alike in both images")
    place = found.points_px[0]
    off_line = np.linalg.norm(places - place, axis=1).min()
    if np.linalg.norm(place - places[best]) > MOST_REFINED_PX or off_line > MOST_OFF_LINE_PX:
        raise NotMatchedError(f"its partner lies {off_line:.1f} pixels off its epipolar line")
    xx, xy, yy = found.covariance_px2[0]
    covariance = np.array([[xx, xy], [xy, yy]]) + LEAST_SIGMA_PX**2 * np.eye(2)
    return EpipolarMatch(place, covariance, found.warp[0], float(found.likeness[0]))


def _places(
    rig: StereoRig, left_px: Float[ndarray, "2"], shape: tuple[int, ...], reach: float
) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2 2"]]:
    """Places in the right image where the point may lie, a pixel apart or less, and the windows' warps there."""
    rays = rig.left.unproject(left_px + np.array([[0.0, 0], [0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
    rays = rays / np.linalg.norm(rays[0])
    nearness = np.linspace(0, 1 / (NEAREST_BASELINES * rig.baseline_m), N_FIRST)
    seen = _seen(rig, rays, nearness)
    steps = np.linalg.norm(np.diff(seen[:, 0], axis=0), axis=1)
    longest = np.where(_is_inside(seen[1:, 0], shape, 0), np.nan_to_num(steps, nan=0.0), 0.0).max(initial=0.0)
    if longest > 1:
        seen = _seen(rig, rays, np.linspace(0, nearness[-1], 1 + int(np.ceil(N_FIRST * min(longest, 100.0)))))
    is_inside = _is_inside(seen[:, 0], shape, reach) & np.isfinite(seen).all(axis=(1, 2))
    seen = seen[is_inside]
    return seen[:, 0], np.stack([seen[:, 1] - seen[:, 2], seen[:, 3] - seen[:, 4]], axis=-1)


def _seen(rig: StereoRig, rays: Float[ndarray, "k 3"], nearness: Float[ndarray, "n"]) -> Float[ndarray, "n k 2"]:
    """Where the right camera sees points on the left one's rays at distances 1 / nearness."""
    T = rig.T_right_left
    with np.errstate(all="ignore"):
        return rig.right.project((rays @ T.R.T)[None] + nearness[:, None, None] * T.t)


def _is_inside(px: Float[ndarray, "n 2"], shape: tuple[int, ...], reach: float) -> Bool[ndarray, "n"]:
    with np.errstate(invalid="ignore"):
        return np.all((px >= reach) & (px <= np.array([shape[1], shape[0]]) - 1 - reach), axis=-1, keepdims=False)


def _likeness(
    left: ndarray,
    right: ndarray,
    left_px: Float[ndarray, "2"],
    places: Float[ndarray, "n 2"],
    warps: Float[ndarray, "n 2 2"],
    half: int,
) -> Float[ndarray, "n"]:
    """Normalised cross-correlation of the window around the left point with the warped ones at the places."""
    offsets = np.stack(np.meshgrid(np.arange(-half, half + 1.0), np.arange(-half, half + 1.0)), axis=-1).reshape(-1, 2)
    shown = _sampled(left, (left_px + offsets)[None])
    found = _sampled(right, places[:, None] + np.einsum("nij,kj->nki", warps, offsets))
    shown, found = (values - values.mean(axis=1, keepdims=True) for values in (shown, found))
    size = np.sqrt((shown**2).sum() * (found**2).sum(axis=1))
    return (found @ shown[0]) / np.maximum(size, 1e-6)


def _sampled(image: ndarray, places: Float[ndarray, "n k 2"]) -> Float[ndarray, "n k"]:
    """Values between pixels; places in parts, since cv2.remap takes at most 32767 rows."""
    x, y = (np.ascontiguousarray(places[..., i], dtype=np.float32) for i in range(2))
    parts = [np.s_[first : first + 16384] for first in range(0, len(x), 16384)]
    values = [cv2.remap(image, x[p], y[p], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for p in parts]
    return np.concatenate(values).astype(float)
