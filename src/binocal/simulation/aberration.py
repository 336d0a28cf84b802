"""Colour images of a board through a lens that images each colour at another scale (lateral chromatic aberration)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.cameras import Camera
from binocal.geometry import SE3
from binocal.shapes import UInt
from binocal.simulation.imaging import read_out
from binocal.simulation.renderer import RenderOptions, render_light

OUTWARD = (-1.0, 0.0, 1.0)  # of blue, green, red: simple lenses bend blue most, achromats less and not in this order


def colour_cameras(camera: Camera, aberration_px: float) -> tuple[Camera, Camera, Camera]:
    """What blue, green and red see: green is the camera, in the image's farthest corner red lies so far outward and blue inward."""
    _, _, cx, cy = camera.parameters[:4]
    width, height = camera.size_wh
    corner = float(np.hypot(max(cx, width - 1 - cx), max(cy, height - 1 - cy)))
    scaled = []
    for outward in OUTWARD:
        parameters = camera.parameters.copy()
        parameters[:2] *= 1 + outward * aberration_px / corner
        scaled.append(replace(camera, parameters=parameters))
    return scaled[0], scaled[1], scaled[2]


def render_colour_image(
    camera: Camera,
    T_camera_board: SE3,
    board: Board,
    options: RenderOptions,
    aberration_px: float,
    rng: np.random.Generator,
) -> UInt[ndarray, "h w 3"]:
    """Blue-green-red image of the board, each colour with noise of its own; a sensor with three layers, not a mosaic.

    Raises:
        ValueError: As in :func:`binocal.simulation.renderer.render_image`.
    """
    background = int(rng.integers(2**63))
    layers = []
    for seen in colour_cameras(camera, aberration_px):
        light = render_light(seen, T_camera_board, board, options, np.random.default_rng(background))
        layers.append(read_out(light, rng, noise_dn=options.noise_dn, gamma=options.gamma, bit_depth=options.bit_depth))
    return np.stack(layers, axis=-1)
