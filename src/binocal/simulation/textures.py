"""Textures of rendered scenes: periodic, procedural, and without details finer than what an image of them can show.

A texture is a smooth function: bicubic interpolation of a bitmap that holds nothing above half its sampling frequency, so that it can be
sampled on the fine grid on which the lens's blur acts. Where a texel would be smaller than half a pixel, coarser versions take over
(Williams 1983, "Pyramidal parametrics", halved by averaging, blended between levels).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Float32

TEXEL_SAMPLES = 2.0  # of the fine grid, at least, that a texel covers
_ROW = 1024  # samples are handed over in rows of so many: cv2.remap takes images, not lists


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A periodic texture of mean 0: square bitmaps, each half the size of the one before, and the size of the first one's texels."""

    levels: tuple[Float32[ndarray, "_ _"], ...]
    texel_m: float

    @staticmethod
    def of_bitmap(bitmap: Float[ndarray, "n n"], period_m: float) -> Texture:
        """The texture of a periodic bitmap, smoothed and centred; ``n`` is a power of 2."""
        n = len(bitmap)
        frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(n), np.fft.rfftfreq(n), indexing="ij"))
        smooth = np.fft.irfft2(np.fft.rfft2(bitmap) * np.exp(-2 * (np.pi * frequency * 1.2) ** 2), s=bitmap.shape)
        levels = [(smooth - smooth.mean()).astype(np.float32)]
        while len(levels[-1]) > 1:
            half = len(levels[-1]) // 2
            levels.append(levels[-1].reshape(half, 2, half, 2).mean(axis=(1, 3)))
        return Texture(tuple(levels), period_m / n)

    def sample(
        self, u_m: Float32[ndarray, "k"], v_m: Float32[ndarray, "k"], spacing_m: Float32[ndarray, "k"]
    ) -> Float32[ndarray, "k"]:
        """Values at places whose neighbours on the fine grid are ``spacing_m`` away."""
        wanted = np.log2(np.maximum(TEXEL_SAMPLES * spacing_m / self.texel_m, 1.0))
        wanted = np.minimum(wanted, len(self.levels) - 1.0)
        out = np.zeros(len(u_m), dtype=np.float32)
        lower = np.floor(wanted).astype(int)
        for level in range(int(lower.min(initial=0)), int(np.ceil(wanted.max(initial=0))) + 1):
            share = 1 - np.abs(wanted - level)
            some = np.flatnonzero(share > 0)
            if some.size:
                texel_m = self.texel_m * 2.0**level
                values = _interpolated(self.levels[level], u_m[some] / texel_m - 0.5, v_m[some] / texel_m - 0.5)
                out[some] += share[some].astype(np.float32) * values
        return out


def _interpolated(
    bitmap: Float32[ndarray, "n n"], x: Float32[ndarray, "k"], y: Float32[ndarray, "k"]
) -> Float32[ndarray, "k"]:
    import cv2

    n, k = len(bitmap), len(x)
    rows = -(-k // _ROW)
    maps = [np.zeros(rows * _ROW, dtype=np.float32) for _ in range(2)]
    for place, values in zip(maps, (x, y), strict=True):
        place[:k] = np.mod(values, n)
    map_x, map_y = (place.reshape(rows, _ROW) for place in maps)
    out = np.empty((rows, _ROW), dtype=np.float32)
    for first in range(0, rows, 16384):  # images have less than 32768 rows
        part = np.s_[first : first + 16384]
        out[part] = cv2.remap(bitmap, map_x[part], map_y[part], cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)
    return out.ravel()[:k]


def grain(rng: np.random.Generator, period_m: float, n: int = 1024) -> Texture:
    """Blotches of all sizes, as natural surfaces have: amplitude falls with frequency; standard deviation 1."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(n), np.fft.rfftfreq(n), indexing="ij"))
    amplitude = 1 / np.maximum(frequency, 4 / n)
    values = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((n, n))) * amplitude, s=(n, n))
    return Texture.of_bitmap(values / values.std(), period_m)


def windows(period_m: float, n: int = 256) -> Texture:
    """A facade: one dark window with a cross and a bright sill in each period; all alike."""
    y, x = (np.mgrid[:n, :n] + 0.5) / n
    out = np.zeros((n, n))
    is_pane = (np.abs(x - 0.5) < 0.22) & (np.abs(y - 0.45) < 0.3)
    is_cross = (np.abs(x - 0.5) < 0.02) | (np.abs(y - 0.35) < 0.02)
    out[is_pane & ~is_cross] = -1.0
    out[(np.abs(x - 0.5) < 0.27) & (np.abs(y - 0.79) < 0.03)] = 0.6
    return Texture.of_bitmap(out, period_m)


def slats(period_m: float, n: int = 64) -> Texture:
    """A fence: one bright slat in each period along u, one rail."""
    y, x = (np.mgrid[:n, :n] + 0.5) / n
    out = np.where(np.abs(x - 0.5) < 0.3, 0.6, -0.6)
    out[np.abs(y - 0.5) < 0.06] = 0.9
    return Texture.of_bitmap(out, period_m)


def tiles(period_m: float, n: int = 128) -> Texture:
    """Paving, tiles: dark joints around each period."""
    y, x = (np.mgrid[:n, :n] + 0.5) / n
    return Texture.of_bitmap(np.where((np.abs(x - 0.5) > 0.47) | (np.abs(y - 0.5) > 0.47), -1.0, 0.1), period_m)


def shelves(period_m: float, n: int = 256) -> Texture:
    """Shelves along a wall: two boards and an upright in each period, books of several heights between them."""
    y, x = (np.mgrid[:n, :n] + 0.5) / n
    height = np.array([0.30, 0.36, 0.26, 0.38, 0.33])[(5 * x).astype(int)]
    out = np.where((y % 0.5) > 0.5 - height, -0.7 + 0.5 * ((5 * x).astype(int) % 2), 0.1)
    out[(y % 0.5 < 0.05) | (np.abs(x - 0.5) > 0.47)] = 1.0
    return Texture.of_bitmap(out, period_m)
