"""Rigs by name with the light that their cameras see: the paper's, a colour camera beside a thermal one, thermal pairs of wide field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3, so3
from binocal.simulation.renderer import RenderOptions
from binocal.simulation.rigs import table2_rig

VISIBLE = RenderOptions()
THERMAL = RenderOptions(black_dn=150.0, white_dn=95.0, background_dn=115.0, clutter_dn=12.0)
"""Ink is warmer than the paper about it, by a third of the contrast of visible light, before a plain background."""
THERMAL_BLUR = 1.5  # times that of the colour camera beside it, in pixels


LIGHTS = {"visible": (VISIBLE, VISIBLE), "colour-thermal": (VISIBLE, THERMAL), "thermal": (THERMAL, THERMAL)}
"""What the left and the right camera see."""


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """A rig, and the light by which its two cameras see a board, one of :data:`LIGHTS`."""

    rig: StereoRig
    light: str = "visible"

    def with_lens_and_noise(self, blur_px: float, noise_dn: float) -> tuple[RenderOptions, RenderOptions]:
        """Both cameras' options; a thermal camera beside one of visible light is blurred more."""
        left, right = LIGHTS[self.light]
        factor = THERMAL_BLUR if left is not right else 1.0
        return (
            replace(left, blur_px=blur_px, noise_dn=noise_dn),
            replace(right, blur_px=factor * blur_px, noise_dn=noise_dn),
        )


def colour_thermal_setup() -> Setup:
    """A colour camera of 1280 x 720 and 60 degrees, and a thermal one of 640 x 480 and 60 degrees, 100 mm apart."""
    left = Camera("brown4", (1280, 720), np.array([1105.0, 1104.0, 645.0, 356.0, 0.0, -0.09, 0.08, 3e-4, -2e-4]))
    right = Camera("brown4", (640, 480), np.array([560.0, 559.5, 316.0, 243.0, 0.0, -0.21, 0.09, -5e-4, 4e-4]))
    T_right_left = SE3(so3.exp(np.radians([0.4, 1.0, -0.5])), np.array([-0.100, 0.004, 0.006]))
    return Setup(StereoRig(left, right, T_right_left), "colour-thermal")


def wide_thermal_setup(field_deg: float) -> Setup:
    """Two thermal cameras of 640 x 512 and so many degrees across, 200 mm apart.

    Fields and kind after Wang, Li, Liu, Huang & Chen 2020 (180 and 210 degrees); the numbers are ours.
    """
    width, height = 640, 512
    focal_px = width / 2 / np.radians(field_deg / 2)
    left, right = (
        Camera("fisheye4", (width, height), np.r_[f * focal_px, 1.002 * f * focal_px, middle, 0.0, bend])
        for f, middle, bend in (
            (1.0, (322.4, 252.9), (0.010, -0.005, 0.0010, 0.0)),
            (0.99, (316.0, 258.0), (0.008, -0.004, 0.0008, 0.0)),
        )
    )
    T_right_left = SE3(so3.exp(np.radians([0.5, -1.0, 0.7])), np.array([-0.200, 0.003, 0.004]))
    return Setup(StereoRig(left, right, T_right_left), "thermal")


SETUPS: dict[str, Callable[[], Setup]] = {
    "table2": lambda: Setup(table2_rig()),
    "colour-thermal": colour_thermal_setup,
    "thermal-180": lambda: wide_thermal_setup(180.0),
    "thermal-210": lambda: wide_thermal_setup(210.0),
}
