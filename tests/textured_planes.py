"""Images of a plane with a random texture, as any rig sees it: exact depth for tests of matching."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3, so3
from binocal.kernels.images import sample

PIXELS_PER_M = 600.0
SIDE_PX = 2400


def small_rig(model: str = "brown4", *, t=(-0.06, 0.0005, 0.001), turn_deg: float = 0.0) -> StereoRig:
    """320 x 240 pixels; 120° across for the fisheye."""
    distortion = {"brown4": [-0.1, 0.05, 4e-4, -3e-4], "fisheye4": [0.02, -0.01, 0.003, -0.001]}[model]
    focal = {"brown4": 260.0, "fisheye4": 150.0}[model]
    camera = Camera(model, (320, 240), np.r_[focal, focal + 1, 161.0, 118.0, 0, distortion])
    upright = so3.exp(np.array([0.0, 0.0, np.radians(turn_deg)]))
    return StereoRig(camera, camera, SE3(upright @ so3.exp(np.array([0.01, -0.02, 0.006])), upright @ np.array(t)))


def render_plane(rig: StereoRig, distance_m: float, tilt: float = 0.2, seed: int = 0) -> tuple[ndarray, ndarray]:
    """Grey images of the plane z = distance + tilt x of the left frame; black where a ray misses the texture."""
    rng = np.random.default_rng(seed)
    texture = np.zeros((SIDE_PX, SIDE_PX))
    for cell in (4, 8, 16):
        n = SIDE_PX // cell
        texture += np.kron(rng.uniform(0, 1, (n, n)), np.ones((cell, cell)))
    texture = (texture * 80).astype(np.uint8)
    images = []
    for camera, T in ((rig.left, SE3(np.eye(3), np.zeros(3))), (rig.right, rig.T_right_left.inverse())):
        width, height = camera.size_wh
        u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
        rays = camera.unproject(np.stack([u, v], axis=-1).reshape(-1, 2)) @ T.R.T
        normal = np.array([-tilt, 0.0, 1.0])
        with np.errstate(all="ignore"):
            reach = (distance_m - T.t @ normal) / (rays @ normal)
            points = T.t + reach[:, None] * rays
            places = points[:, :2] * PIXELS_PER_M + SIDE_PX / 2
        hit = (
            np.isfinite(places).all(axis=1)
            & (reach > 0)
            & (places > 1).all(axis=1)
            & (places < SIDE_PX - 2).all(axis=1)
        )
        values = np.where(hit, sample(texture, np.where(hit[:, None], places, 0.0)), 0)
        images.append(np.round(values).astype(np.uint8).reshape(height, width))
    return images[0], images[1]
