"""Two cameras on pan-tilt heads before a rectangle: what they see pair by pair, and the exact truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig
from binocal.errors import SceneError
from binocal.evidence.rectangles import RectanglePairs
from binocal.geometry import SE3, so3
from binocal.shapes import Float
from binocal.simulation.visibility import visible_px
from binocal.solvers.turning_cameras import SIGNS, rig_at, turned

MAX_TRIES = 2000
MARGIN_PX = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TurningOptions:
    """How the cameras turn and how well things are measured.

    ``turn_deg`` are the largest yaw and pitch from the initial pose, ``attitude_sigma_deg`` the sensor's error on each angle,
    ``distance_m`` and ``size_m`` the ranges of the rectangles' distance and sides. One rectangle stands still while all pairs are taken;
    with ``is_always_another`` every pair shows another one. ``pivot_m`` is how far behind its centre each camera's axes cross, which the
    method takes for 0.
    """

    noise_px: float = 0.3
    attitude_sigma_deg: float = 1.0
    turn_deg: tuple[float, float] = (12.0, 6.0)
    distance_m: tuple[float, float] = (4.0, 8.0)
    size_m: tuple[float, float] = (0.5, 1.2)
    is_always_another: bool = False
    starts_at_rest: bool = True
    pivot_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TurningScene:
    """What was measured, and the truth: angles (left, right; yaw, pitch), the rig and the corners before the left camera, by pair."""

    pairs: RectanglePairs
    angles_rad: Float[ndarray, "pairs 2 2"]
    T_right_left: SE3
    corners_left_m: Float[ndarray, "pairs 4 3"]


def turning_rig() -> StereoRig:
    """Two 1280 x 1024 cameras of 50 degrees, 1.2 m apart, as they stand before they turn.

    The set-up of Wang, Wang & Yin 2019 is not public; this baseline is one at which 0.12 degrees move the translation by 2.5 mm.
    """
    left = Camera("brown4", (1280, 1024), np.array([1380.0, 1379.0, 642.0, 507.0, 0.0, -0.08, 0.06, 2e-4, -3e-4]))
    right = Camera("brown4", (1280, 1024), np.array([1376.0, 1377.5, 631.0, 515.0, 0.0, -0.085, 0.07, -2e-4, 2e-4]))
    return StereoRig(left, right, SE3(so3.exp(np.radians([0.2, 9.0, -0.3])), np.array([-1.185, 0.006, 0.19])))


def simulate_turning(
    rig: StereoRig, n_pairs: int, rng: np.random.Generator, options: TurningOptions | None = None
) -> TurningScene:
    """``n_pairs`` pairs of cameras that turn at random, their rectangle whole in both images.

    Raises:
        SceneError: No turn keeps a rectangle in both images.
    """
    options = options or TurningOptions()
    corners = _rectangle(rig, rng, options)
    rows, numbers = [], []
    number = 0
    for pair in range(n_pairs):
        at_rest = pair == 0 and options.starts_at_rest
        for _ in range(MAX_TRIES):
            if options.is_always_another and pair:
                corners, number = _rectangle(rig, rng, options), pair
            limit = np.radians(options.turn_deg)
            angles = np.zeros((2, 2)) if at_rest else rng.uniform(-limit, limit, (2, 2))
            seen, px = _seen(rig, angles, corners, options.pivot_m)
            if np.isfinite(px).all():
                break
            if at_rest:
                corners = _rectangle(rig, rng, options)
        else:
            raise SceneError("no turn keeps a rectangle in both images", pair, n_pairs)
        sigma = 0.0 if at_rest else np.radians(options.attitude_sigma_deg)
        rows.append((angles, seen, px + options.noise_px * rng.standard_normal(px.shape), sigma))
        numbers.append(number)
    angles, seen, px, sigma = (np.array(column) for column in zip(*rows, strict=True))
    said = angles + sigma[:, None, None] * rng.standard_normal(angles.shape)
    width = len(str(n_pairs - 1))
    pairs = RectanglePairs(
        px[:, 0],
        px[:, 1],
        said[:, 0],
        said[:, 1],
        sigma,
        np.array(numbers),
        tuple(f"{i:0{width}d}" for i in range(n_pairs)),
    )
    rigs = [_rig_at(rig, a, options.pivot_m) for a in angles]
    return TurningScene(pairs, angles, SE3(np.stack([T.R for T in rigs]), np.stack([T.t for T in rigs])), seen)


def _rectangle(rig: StereoRig, rng: np.random.Generator, options: TurningOptions) -> Float[ndarray, "4 3"]:
    """Corners of a rectangle before the initial rig, clockwise as the cameras see it."""
    size = rng.uniform(*options.size_m, 2)
    tilt = so3.exp(np.radians(rng.uniform(-30, 30, 3)) * [1, 1, 0.5])
    distance = rng.uniform(*options.distance_m)
    middle = rig.T_right_left.inverse().t / 2
    place = middle + distance * np.array([*rng.uniform(-0.1, 0.1, 2), 1.0])
    return np.c_[SIGNS * size, np.zeros(4)] @ tilt.T + place


def _mounts(rig: StereoRig, angles: Float[ndarray, "2 2"], pivot_m: float) -> tuple[SE3, SE3]:
    """``T_camera_base`` of both cameras once turned about a point behind their centres."""
    behind = np.array([0.0, 0.0, -pivot_m])
    poses = []
    for turn, mount in zip(angles, (SE3.identity(), rig.T_right_left), strict=True):
        C = turned(turn)
        poses.append(SE3(C, behind - C @ behind) @ mount)
    return poses[0], poses[1]


def _rig_at(rig: StereoRig, angles: Float[ndarray, "2 2"], pivot_m: float) -> SE3:
    if pivot_m == 0:
        return rig_at(rig, angles)
    left, right = _mounts(rig, angles, pivot_m)
    return right @ left.inverse()


def _seen(
    rig: StereoRig, angles: Float[ndarray, "2 2"], corners: Float[ndarray, "4 3"], pivot_m: float
) -> tuple[Float[ndarray, "4 3"], Float[ndarray, "2 4 2"]]:
    """Corners before the left camera, and their exact pixels, NaN outside of an image."""
    left, right = _mounts(rig, angles, pivot_m)
    px = [
        visible_px(camera, T.apply(corners), margin_px=MARGIN_PX)
        for camera, T in ((rig.left, left), (rig.right, right))
    ]
    return left.apply(corners), np.stack(px)
