"""A parallel pair with zoom lenses: the rig at every setting, known exactly."""

from __future__ import annotations

import numpy as np

from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3, so3

WIDEST_PX, RATIO = 1600.0, 4.0  # 6 mm on pixels of 3.75 micrometres, to 24 mm
SIZE_WH = (1280, 960)


def zoom_rig_at(setting: float) -> StereoRig:
    """The rig at a setting from 0 (wide) to 1 (tele).

    As zoom lenses do, and differently in both: the focal length grows by a smooth law that is no power of the setting, the principal
    point wanders over 15 px, barrel distortion turns to pincushion, and the lens groups shift the optical axis by some hundredths of a
    degree and the centre by half a millimetre.
    """
    s = float(setting)
    cameras = []
    for side in (0, 1):
        bend = 0.03 * np.sin(2 * np.pi * (s + 0.1 * side)) - 0.04 * s * (1 - s)
        focal_px = WIDEST_PX * RATIO ** (s + bend) * (1 + 0.004 * side)
        cx = 640 + (-1) ** side * (4 + 9 * s**2 + 2.0 * np.sin(4.2 * s + side))
        cy = 478 + 7 * s * (1 - 0.6 * s) - 3.0 * np.cos(3.1 * s + 2 * side)
        radius = np.hypot(*SIZE_WH) / 2 / focal_px
        k1 = (-0.030 + 0.042 * s + 0.004 * np.sin(3 * s + side)) / radius**2
        k2 = (0.004 - 0.006 * s) / radius**4
        p1, p2 = 2e-4 * np.cos(2 * s + side), -1.5e-4 * np.sin(2 * s - side)
        cameras.append(Camera("brown4", SIZE_WH, np.array([focal_px, 1.0006 * focal_px, cx, cy, 0.0, k1, k2, p1, p2])))
    turn = np.radians([0.10 + 0.03 * np.sin(2.5 * s), -0.15 + 0.04 * s**2, 0.05 - 0.02 * s])
    t = np.array([-0.120, 2e-4 * s, 5e-4 * np.sin(2 * s)])
    return StereoRig(cameras[0], cameras[1], SE3(so3.exp(turn), t))
