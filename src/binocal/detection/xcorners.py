"""X-corners: points where four sectors meet, dark and bright in turn, and the directions of the edges between them.

Candidates are peaks of the saddle response (minus the Hessian's determinant, Bowers et al. and many since); each is
then read on a ring around it, where an X-corner shows exactly four transitions, opposite ones alike (the idea of
Bennett & Lasenby 2014, ChESS).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy import ndarray

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32

N_RING = 32  # samples on a ring: 11 degrees apart, fine enough for sectors of 30 degrees
MIN_CONTRAST_DN = 6.0  # of 255; ring contrast below it is noise in every camera tried
_ANGLES = 2 * np.pi * np.arange(N_RING) / N_RING
_RING = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class XCorners:
    """Candidate X-corners of one picture.

    ``rays_rad`` are the four edge directions in rising angle (x towards y, so clockwise on the screen); the first has
    its bright sector after it (at larger angles), the second before it, and so on in turn. ``contrast_dn`` is bright
    minus dark.
    """

    points_px: Float32[ndarray, "n 2"]
    rays_rad: Float[ndarray, "n 4"]
    contrast_dn: Float[ndarray, "n"]

    def __len__(self) -> int:
        return len(self.points_px)


def saddle_response(smooth: Float32[ndarray, "h w"]) -> Float32[ndarray, "h w"]:
    """Minus the determinant of the Hessian: positive at saddles, zero along edges."""
    xx = cv2.Sobel(smooth, cv2.CV_32F, 2, 0, ksize=3)
    yy = cv2.Sobel(smooth, cv2.CV_32F, 0, 2, ksize=3)
    xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=3)
    xx *= 0.25  # ksize-3 kernels sum their smoothing to 4 (second derivatives) and 4 (mixed: 2 x 2)
    yy *= 0.25
    xy *= 0.25
    return xy * xy - xx * yy


def find_x_corners(smooth: Float32[ndarray, "h w"], radius_px: float, *, most: int = 1200) -> XCorners:
    """X-corners of a smoothed grey picture (0..255), read on a ring of ``radius_px``.

    The ``most`` strongest saddles are tried.
    """
    response = saddle_response(smooth)
    size = 2 * max(1, round(0.6 * radius_px)) + 1
    peaks = response == cv2.dilate(response, np.ones((size, size), np.uint8))
    # A saddle of contrast c blurred by about s px has a response of about (c / 2 / s^2 / 3)^2.
    peaks &= response > (MIN_CONTRAST_DN / (3 * radius_px)) ** 2
    margin = int(np.ceil(radius_px)) + 1
    peaks[:margin], peaks[-margin:], peaks[:, :margin], peaks[:, -margin:] = False, False, False, False
    rows, columns = np.nonzero(peaks)
    if len(rows) > most:
        strongest = np.argpartition(response[rows, columns], -most)[-most:]
        rows, columns = rows[strongest], columns[strongest]
    points = _interpolate_peaks(response, rows, columns)
    is_corner, rays, contrast = read_rings(smooth, points, radius_px)
    return XCorners(points[is_corner], rays[is_corner], contrast[is_corner])


def _interpolate_peaks(response: ndarray, rows: ndarray, columns: ndarray) -> Float32[ndarray, "n 2"]:
    """Peaks to a fraction of a pixel, by parabolas through the neighbours in x and in y."""

    def offset(before: ndarray, at: ndarray, after: ndarray) -> ndarray:
        bend = before - 2 * at + after
        return np.clip(np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1), 0), -0.5, 0.5)

    at = response[rows, columns]
    x = columns + offset(response[rows, columns - 1], at, response[rows, columns + 1])
    y = rows + offset(response[rows - 1, columns], at, response[rows + 1, columns])
    return np.stack([x, y], axis=-1).astype(np.float32)


def sample(image: Float32[ndarray, "h w"], points_px: Float[ndarray, "*n 2"]) -> Float32[ndarray, "*n"]:
    """Bilinear values at points; the border's value beyond the border."""
    flat = np.ascontiguousarray(points_px, dtype=np.float32).reshape(-1, 1, 2)
    if not len(flat):
        return np.zeros(points_px.shape[:-1], np.float32)
    values = [
        cv2.remap(image, part, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in np.array_split(flat, len(flat) // 30_000 + 1)
    ]  # remap is limited to 32767 rows
    return np.concatenate(values).reshape(points_px.shape[:-1])


def read_rings(
    smooth: Float32[ndarray, "h w"],
    points_px: Float[ndarray, "n 2"],
    radius_px: float,
    *,
    min_contrast_dn: float = MIN_CONTRAST_DN,
) -> tuple[Bool[ndarray, "n"], Float[ndarray, "n 4"], Float[ndarray, "n"]]:
    """Which points are X-corners, their edge directions, and their contrast; see :class:`XCorners`."""
    n = len(points_px)
    rays = np.zeros((n, 4))
    if n == 0:
        return np.zeros(0, bool), rays, np.zeros(0)
    values = sample(smooth, points_px[:, None] + radius_px * _RING).astype(float)
    top, bottom = values.max(axis=1), values.min(axis=1)
    contrast = top - bottom
    level = values - 0.5 * (top + bottom)[:, None]
    following = np.roll(level, -1, axis=1)
    is_crossing = (level > 0) != (following > 0)
    opposite = np.roll(level, N_RING // 2, axis=1)
    # Opposite samples agree; 0.35 of the contrast admits shading across the ring and a centre that is off by a fifth of
    # the radius.
    is_symmetric = np.mean(np.abs(level - opposite), axis=1) < 0.35 * contrast
    is_corner = (is_crossing.sum(axis=1) == 4) & is_symmetric & (contrast > min_contrast_dn)
    index = np.nonzero(is_corner)[0]
    at = np.nonzero(is_crossing[index])[1].reshape(-1, 4)
    before, after = np.take_along_axis(level[index], at, 1), np.take_along_axis(following[index], at, 1)
    angles = (at + before / (before - after)) * (2 * np.pi / N_RING)
    starts_dark = before[:, 0] < 0
    angles = np.where(starts_dark[:, None], angles, np.roll(angles, -1, axis=1))
    rays[index] = angles
    # Each edge runs straight through: 40 degrees admit strong lens distortion, thin sectors and noise.
    bend = np.abs(_wrap(angles[:, :2] + np.pi - angles[:, 2:]))
    sectors = np.mod(np.roll(angles, -1, axis=1) - angles, 2 * np.pi)
    is_straight = (bend < np.radians(40)).all(axis=1) & (sectors > np.radians(18)).all(axis=1)
    is_corner[index[~is_straight]] = False
    return is_corner, rays, contrast


def _wrap(angle: ndarray) -> ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi
