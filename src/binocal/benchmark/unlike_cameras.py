"""Rigs whose cameras converge, see wide, differ, or are held upside down: what rectification must cope with."""

from __future__ import annotations

import numpy as np

from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3, so3

NARROW = Camera("brown4", (640, 480), np.array([800.0, 799, 322.7, 237.4, 0, -0.1, 0.12, 4e-4, -3e-4]))
STANDING = Camera("brown4", (480, 640), np.array([800.0, 799, 240.0, 321, 0, -0.1, 0.12, 0, 0]))
SMALL = Camera("brown4", (320, 240), np.array([300.0, 300.2, 155.1, 122.5, 0, -0.1, 0.12, 4e-4, -3e-4]))
LARGE = Camera("brown4", (1280, 960), np.array([1600.0, 1599, 642.7, 477.4, 0, -0.1, 0.12, 4e-4, -3e-4]))
FISHEYE_120 = Camera("fisheye4", (640, 480), np.array([300.0, 301, 321, 236, 0, 0.02, -0.01, 0.003, -0.001]))
FISHEYE_200 = Camera("fisheye4", (640, 480), np.array([184.0, 184, 320, 240, 0, 0.01, -0.004, 0.001, 0]))


def converging(degrees: float, camera: Camera = NARROW, baseline_m: float = 0.5) -> StereoRig:
    """Two cameras side by side, each turned inwards by half of the angle."""
    half = np.radians(degrees) / 2
    R_left, R_right = so3.exp(np.array([0.0, -half, 0.0])), so3.exp(np.array([0.0, half, 0.0]))
    return StereoRig(camera, camera, SE3(R_right @ R_left.T, -R_right @ np.array([baseline_m, 0, 0])))


def beside(left: Camera, right: Camera, turn_deg: float = 0.0) -> StereoRig:
    """The right camera 6 cm to the right, turned about its axis."""
    R = so3.exp(np.array([0.0, 0.0, np.radians(turn_deg)])) @ so3.exp(np.array([0.005, -0.01, 0.004]))
    return StereoRig(left, right, SE3(R, R @ np.array([-0.06, 0.0003, 0.001])))


def below(left: Camera, right: Camera) -> StereoRig:
    """The camera called right 5 cm below."""
    return StereoRig(left, right, SE3(so3.exp(np.array([0.01, -0.02, 0.008])), np.array([0.002, -0.05, 0.003])))


UNLIKE_RIGS = {
    "parallel": beside(NARROW, NARROW),
    "converging by 60°": converging(60),
    "converging by 100°": converging(100),
    "converging by 150°": converging(150),
    "fisheyes of 120°": beside(FISHEYE_120, FISHEYE_120),
    "fisheyes of 200°": beside(FISHEYE_200, FISHEYE_200),
    "fisheyes of 200° converging by 90°": converging(90, FISHEYE_200),
    "1280 px, f 1600, beside 320 px, f 300": beside(LARGE, SMALL),
    "320 px, f 300, beside 1280 px, f 1600": beside(SMALL, LARGE),
    "right upside down": beside(NARROW, NARROW, 180),
    "right on its side": beside(NARROW, STANDING, 90),
    "one above the other": below(NARROW, NARROW),
    "fisheyes of 200°, one above the other": below(FISHEYE_200, FISHEYE_200),
}
