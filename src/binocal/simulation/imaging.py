"""What every rendered image goes through, whatever it shows: the rays of its pixels, the lens's edge, the sensor."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.shapes import Float, UInt


def rays_of_pixels(camera: Camera, apron: int) -> Float[ndarray, "3 h w"]:
    """Unit ray of every pixel and of ``apron`` + 1 pixels around the image; NaN where there is none. Those of two cameras are kept."""
    return _cached_rays(camera.model, camera.size_wh, camera.parameters.tobytes(), apron)


@lru_cache(maxsize=2)  # a stereo pair; 30 MB each at 1280 x 960
def _cached_rays(model: str, size_wh: tuple[int, int], parameters: bytes, apron: int) -> Float[ndarray, "3 h w"]:
    camera = Camera(model, size_wh, np.frombuffer(parameters))
    width, height = size_wh
    rim = apron + 1
    u = np.arange(-rim, width + rim, dtype=float)
    rays = np.empty((3, height + 2 * rim, width + 2 * rim))
    for first in range(0, height + 2 * rim, 16):  # blocks that stay in the processor's cache
        v = np.arange(first, min(first + 16, height + 2 * rim), dtype=float) - rim
        block = camera.unproject(np.stack(np.broadcast_arrays(u, v[:, None]), axis=-1))
        rays[:, first : first + 16] = np.moveaxis(block, -1, 0)
    return rays


def through_lens(
    light: Float[ndarray, "h w"], camera: Camera, ray_z: Float[ndarray, "h w"], vignetting: float
) -> Float[ndarray, "h w"]:
    """Light after vignetting; black where the lens shows nothing."""
    if vignetting > 0:
        width, height = camera.size_wh
        _, _, cx, cy = camera.parameters[:4]
        u, v = np.arange(width) - cx, np.arange(height) - cy
        corner = np.hypot(width, height) / 2
        light = light * (1 - vignetting * ((u / corner) ** 2 + (v[:, None] / corner) ** 2)).clip(0).astype(np.float32)
    has_ray = np.isfinite(ray_z)
    return light if has_ray.all() else np.where(has_ray, light, np.float32(0))


def read_out(
    light: Float[ndarray, "h w"], rng: np.random.Generator, *, noise_dn: float, gamma: float = 1.0, bit_depth: int = 8
) -> UInt[ndarray, "h w"]:
    """The sensor's numbers: gamma, Gaussian noise, rounding. 16-bit images hold 257 times the grey levels of 8-bit ones."""
    if gamma != 1:
        light = 255 * (light / 255) ** (1 / gamma)
    if noise_dn > 0:
        light = light + np.float32(noise_dn) * rng.standard_normal(light.shape, dtype=np.float32)
    scale, dtype = (257, np.uint16) if bit_depth == 16 else (1, np.uint8)
    return np.rint(np.clip(light * scale, 0, 255 * scale)).astype(dtype)
