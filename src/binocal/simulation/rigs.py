"""Rigs with known numbers: the paper's, and random ones within the tolerances of real lenses and mounts."""

from __future__ import annotations

import numpy as np

from binocal.cameras import Camera, StereoRig, camera_model
from binocal.errors import SceneError
from binocal.geometry import SE3, so3

_SIZES_WH = ((640, 480), (752, 480), (1280, 720), (1280, 960), (1280, 1024))
_MAX_TRIES = 200  # a draw whose distortion folds back inside the image is drawn again


def table2_rig() -> StereoRig:
    """The rig of the paper's table 2: 1280 x 960, 6 mm lenses on 3.75 µm pixels (f = 1600 px), baseline 60 mm.

    The paper states nominal values; the tolerances (focal lengths within 0.3 %, principal points within 15 px, 1.2°
    of toe-in, Brown-Conrady distortion with 4 coefficients of an ordinary 6 mm lens) are ours.
    """
    left = Camera("brown4", (1280, 960), np.array([1603.2, 1602.1, 646.8, 473.4, 0.0, -0.112, 0.148, 4.1e-4, -3.2e-4]))
    right = Camera("brown4", (1280, 960), np.array([1597.6, 1598.9, 631.2, 486.1, 0.0, -0.105, 0.131, -2.7e-4, 3.8e-4]))
    R_right_left = so3.exp(np.radians([0.31, 1.17, -0.24]))
    centre = np.array([1.0, 0.006, -0.011])
    return _rig(left, right, R_right_left, 0.060 * centre / np.linalg.norm(centre))


def random_rig(
    rng: np.random.Generator,
    model: str = "brown4",
    *,
    size_wh: tuple[int, int] | None = None,
    baseline_m: float | None = None,
    field_deg: float | None = None,
    has_skew: bool = False,
) -> StereoRig:
    """A rig with two cameras of one make: equal image size, nominal focal length and lens type, individual tolerances.

    Horizontal field ``field_deg``: 35-75° (Brown-Conrady) or 100-150° (fisheye4) unless given; baseline 50-150 mm;
    rotation 1.5° (one sigma) about each axis; focal lengths within 1 %, principal points 1.5 % of the width (one
    sigma) off centre. Distortion moves the corner of the image by up to 12 % of its radius and never folds back
    inside the image.

    Raises:
        ValueError: Unknown model, or a field outside 10-100° (Brown-Conrady) or 60-200° (fisheye4).
        SceneError: No distortion without a fold was found (cannot happen within the limits on the field).
    """
    is_fisheye = camera_model(model).sees_behind
    low, high = (60, 200) if is_fisheye else (10, 100)
    field = field_deg if field_deg is not None else rng.uniform(*((100, 150) if is_fisheye else (35, 75)))
    if not low <= field <= high:
        raise ValueError(f"field_deg of a {model} camera must be within {low}-{high}; got {field}")
    size = size_wh if size_wh is not None else _SIZES_WH[rng.integers(len(_SIZES_WH))]
    left, right = (_random_camera(rng, model, size, np.radians(field), has_skew) for _ in range(2))
    baseline = baseline_m if baseline_m is not None else rng.uniform(0.05, 0.15)
    centre = np.array([1.0, rng.normal(0, 0.02), rng.normal(0, 0.02)])
    return _rig(
        left, right, so3.exp(np.radians(1.5) * rng.standard_normal(3)), baseline * centre / np.linalg.norm(centre)
    )


def _rig(left: Camera, right: Camera, R_right_left: np.ndarray, centre_right_m: np.ndarray) -> StereoRig:
    """Rig of two cameras, their rotation and the right camera's centre in the left frame."""
    return StereoRig(left, right, SE3(R_right_left, -(R_right_left @ centre_right_m)))


def _random_camera(
    rng: np.random.Generator, model: str, size_wh: tuple[int, int], field_rad: float, has_skew: bool
) -> Camera:
    width, height = size_wh
    half_angle = field_rad / 2
    nominal_px = width / 2 / (half_angle if model == "fisheye4" else np.tan(half_angle))
    for _ in range(_MAX_TRIES):
        fx = nominal_px * (1 + np.clip(rng.normal(0, 0.003), -0.01, 0.01))
        fy = fx * (1 + np.clip(rng.normal(0, 0.002), -0.01, 0.01))
        cx = (width - 1) / 2 + 0.015 * width * np.clip(rng.standard_normal(), -2.5, 2.5)
        cy = (height - 1) / 2 + 0.015 * width * np.clip(rng.standard_normal(), -2.5, 2.5)
        skew = rng.normal(0, 5e-4) * fx if has_skew else 0.0
        radius = np.hypot(max(cx, width - 1 - cx) / fx, max(cy, height - 1 - cy) / fy)
        distortion = _random_distortion(rng, model, radius)
        camera = Camera(model, size_wh, np.r_[fx, fy, cx, cy, skew, distortion])
        if _covers_image(camera):
            return camera
    raise SceneError(
        f"{model} with a field of {np.degrees(field_rad):.0f} deg always folds back inside the image", 0, 1
    )


def _random_distortion(rng: np.random.Generator, model: str, radius: float) -> np.ndarray:
    """Coefficients scaled by ``radius``, the normalised radius (fisheye: angle) of the image's farthest corner."""
    if model == "fisheye4":
        shares = np.array(
            [rng.uniform(-0.06, 0.04), rng.uniform(-0.03, 0.03), rng.normal(0, 0.01), rng.normal(0, 0.005)]
        )
        return shares / radius ** np.array([2, 4, 6, 8])
    k1 = rng.uniform(-0.12, 0.04)
    k2 = -0.3 * k1 + rng.normal(0, 0.01)  # lenses are corrected: the second term takes back part of the first
    p1, p2 = rng.normal(0, 4e-4, 2)
    if model == "brown4":
        return np.array([k1 / radius**2, k2 / radius**4, p1, p2])
    k3 = rng.normal(0, 0.01)
    if model == "brown5":
        return np.array([k1 / radius**2, k2 / radius**4, p1, p2, k3 / radius**6])
    k4, k5, k6 = rng.uniform(0.1, 0.5), rng.normal(0, 0.03), rng.normal(0, 0.01)
    # numerator and denominator nearly cancel, as fitted rational models do
    shares = np.array([k1 + k4, k2 + k5 + k1 * k4, k3 + k6, k4, k5, k6])
    k1, k2, k3, k4, k5, k6 = shares / radius ** np.array([2, 4, 6, 2, 4, 6])
    return np.array([k1, k2, p1, p2, k3, k4, k5, k6])


def _covers_image(camera: Camera) -> bool:
    """True where every pixel of the border, and a rim of 2 % around it, has a ray."""
    width, height = camera.size_wh
    t = np.linspace(-0.02, 1.02, 27)
    border = np.concatenate([np.stack([t, np.full_like(t, e)], -1) for e in (-0.02, 1.02)])
    border = np.concatenate([border, border[:, ::-1]]) * [width - 1, height - 1]
    return bool(np.isfinite(camera.unproject(border)).all())
