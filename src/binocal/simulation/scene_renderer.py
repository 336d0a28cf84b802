"""Images of textured scenes, with the same optics as those of boards.

Light is computed on a grid of 4 x 4 points per pixel; then come the lens's blur, integration over pixels, and the sensor. The ray of
every pixel goes through the full camera model; those of its 16 points are interpolated between neighbouring pixels, which is off by less
than 1e-3 px. Edges of things are as sharp as the fine grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.geometry import SE3
from binocal.shapes import Float, Float32, UInt
from binocal.simulation.imaging import rays_of_pixels, read_out, through_lens
from binocal.simulation.optics import blur_image, blur_kernel
from binocal.simulation.textured_scenes import TexturedPatch, TexturedScene
from binocal.simulation.textures import Texture

_FINE = 4  # points per pixel and axis, as for boards
_LEAST_BLUR_PX = 0.14
_TILE_PX = 48  # worked on at a time: few patches show in a tile, and it fits the processor's cache
_COARSE = 2  # every so many pixels are looked at to see which patches a tile shows
_SKY_DN = 215.0
_NEAREST_M = 1e-3


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """Lens and sensor: Gaussian blur (sigma, pixels, at least 0.14), noise (grey levels), time between the exposures of a pair."""

    blur_px: float = 0.8
    noise_dn: float = 2.0
    gap_s: float = 0.0
    """The right camera exposes so much later; only what moves of itself moves, the rig does not."""

    def __post_init__(self) -> None:
        if not (self.blur_px >= 0 and self.noise_dn >= 0 and np.isfinite(self.gap_s)):
            raise ValueError(f"blur_px and noise_dn must be >= 0, gap_s finite; got {self}")


def render_scene_image(
    scene: TexturedScene,
    pair: int,
    camera: Camera,
    T_camera_world: SE3,
    options: SceneOptions,
    rng: np.random.Generator,
    elapsed_s: float = 0.0,
) -> UInt[ndarray, "h w"]:
    """What a camera shows of a pair's moment, ``elapsed_s`` after the left exposure."""
    light = render_scene_light(camera, T_camera_world, scene.patches_at(pair, elapsed_s), scene.grain, options.blur_px)
    return read_out(light, rng, noise_dn=options.noise_dn)


def render_scene_light(
    camera: Camera, T_camera_world: SE3, patches: Sequence[TexturedPatch], grain: Texture, blur_px: float
) -> Float[ndarray, "h w"]:
    """What the pixels receive, in grey levels, before noise and rounding (float32)."""
    import cv2

    kernel = blur_kernel(blur_px, "gaussian", (0.0, 0.0), least_px=_LEAST_BLUR_PX)
    apron = 8 * (kernel.reach_px // 8 + 1)
    rays = rays_of_pixels(camera, apron)
    planes = _Planes.seen_by(T_camera_world, patches)
    height, width = rays.shape[1] - 2, rays.shape[2] - 2
    fine = np.empty((height * _FINE, width * _FINE), dtype=np.float32)
    spacing = float(1 / (_FINE * camera.parameters[0]))
    for row in range(0, height, _TILE_PX):
        for column in range(0, width, _TILE_PX):
            part = rays[:, row : row + _TILE_PX + 2, column : column + _TILE_PX + 2]
            tile = np.nan_to_num(np.moveaxis(part, 0, -1).astype(np.float32))
            lit = _lit(tile, planes, patches, grain, spacing)
            first, left = row * _FINE, column * _FINE
            fine[first : first + lit.shape[0], left : left + lit.shape[1]] = lit
    # the mean of four points is narrower than a pixel: the blur makes up for it
    fine = blur_image(fine, kernel.without(-1 / (12 * _FINE**2)), scale=_FINE)
    light = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)[apron:-apron, apron:-apron]
    return through_lens(light, camera, rays[2, apron + 1 : -apron - 1, apron + 1 : -apron - 1], 0.0)


def _lit(
    rays: Float32[ndarray, "h w 3"], planes: _Planes, patches: Sequence[TexturedPatch], grain: Texture, spacing: float
) -> Float32[ndarray, "4*(h-2) 4*(w-2)"]:
    """Light on the fine grid of a tile, from the rays of its pixels and of one more all around; a ray of 0 meets nothing."""
    import cv2

    coarse = rays[::_COARSE, ::_COARSE].reshape(-1, 3)
    shown = np.unique(planes.nearest(coarse, range(len(patches)))[0])
    shown = shown[shown >= 0]
    size = (rays.shape[1] * _FINE, rays.shape[0] * _FINE)
    points = cv2.resize(rays, size, interpolation=cv2.INTER_LINEAR)[_FINE:-_FINE, _FINE:-_FINE]
    index, u, v, reach = planes.nearest(points.reshape(-1, 3), [int(k) for k in shown])
    light = np.full(len(index), _SKY_DN, dtype=np.float32)
    for k in shown:
        some = np.flatnonzero(index == k)
        if some.size:
            light[some] = _light_of(patches[k], grain, u[some], v[some], spacing * reach[some])
    return light.reshape(points.shape[:2])


@dataclass(frozen=True, slots=True, eq=False)
class _Planes:
    """The patches in the camera's frame: normals and both axes as rows, centres, half sides."""

    frames: Float32[ndarray, "k 3 3"]
    offsets: Float32[ndarray, "k 3"]
    """Of the centres, along the normal and both axes."""
    half_m: Float32[ndarray, "k 2"]

    @staticmethod
    def seen_by(T_camera_world: SE3, patches: Sequence[TexturedPatch]) -> _Planes:
        axes = np.stack([patch.axes for patch in patches])
        frames = np.concatenate([np.cross(axes[:, 0], axes[:, 1])[:, None], axes], axis=1) @ T_camera_world.R.T
        centres = T_camera_world.apply(np.stack([patch.centre_m for patch in patches]))
        offsets = np.einsum("kij,kj->ki", frames, centres)
        half = np.array([patch.half_m for patch in patches])
        return _Planes(*(values.astype(np.float32) for values in (frames, offsets, half)))

    def nearest(
        self, rays: Float32[ndarray, "n 3"], candidates: Sequence[int]
    ) -> tuple[ndarray, Float32[ndarray, "n"], Float32[ndarray, "n"], Float32[ndarray, "n"]]:
        """The patch that each ray meets first (-1: none), where on it, and the distance over the cosine of incidence."""
        n = len(rays)
        index = np.full(n, -1)
        nearest = np.full(n, np.inf, dtype=np.float32)
        u, v, reach = (np.zeros(n, dtype=np.float32) for _ in range(3))
        for k in candidates:
            toward = rays @ self.frames[k].T
            with np.errstate(all="ignore"):
                distance = self.offsets[k, 0] / toward[:, 0]
                on_u, on_v = (distance * toward[:, i] - self.offsets[k, i] for i in (1, 2))
                is_hit = (distance > _NEAREST_M) & (distance < nearest)
                is_hit &= (np.abs(on_u) <= self.half_m[k, 0]) & (np.abs(on_v) <= self.half_m[k, 1])
            hit = np.flatnonzero(is_hit)
            index[hit], nearest[hit], u[hit], v[hit] = k, distance[hit], on_u[hit], on_v[hit]
            reach[hit] = distance[hit] / np.abs(toward[hit, 0])
        return index, u, v, reach


def _light_of(
    patch: TexturedPatch,
    grain: Texture,
    u: Float32[ndarray, "n"],
    v: Float32[ndarray, "n"],
    spacing_m: Float32[ndarray, "n"],
) -> Float32[ndarray, "n"]:
    """Level, grain of two sizes that never repeat together, and the pattern."""
    at_u, at_v = u + np.float32(patch.grain_offset_m[0]), v + np.float32(patch.grain_offset_m[1])
    fine = grain.sample(at_u, at_v, spacing_m)
    wide = np.float32(0.29)  # 1 / 3.4: the larger blotches
    coarse = grain.sample(wide * (0.8 * at_u + 0.6 * at_v), wide * (0.8 * at_v - 0.6 * at_u), wide * spacing_m)
    light = np.float32(patch.level_dn) + np.float32(patch.grain_dn) * (
        np.float32(0.7) * fine + np.float32(0.7) * coarse
    )
    if patch.pattern is not None:
        light = light + np.float32(patch.pattern_dn) * patch.pattern.sample(u, v, spacing_m)
    return np.clip(light, 2.0, 253.0)
