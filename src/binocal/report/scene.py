"""The rig as a scene in 3-D: outlines of both cameras' views, of the boards that were shown, and of those to show next.

Everything is in the left camera's frame (x right, y down, z forward), metres, or board pitches without a scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.geometry import SE3
from binocal.planning import ViewPlan
from binocal.report.numbers import three_digits
from binocal.result import StereoCalibration
from binocal.shapes import Float

FRUSTUM_SHARE = 0.45  # of the boards' median distance: how far the outline of a camera's view lies
PER_EDGE = 4  # points on each edge of an image, which a wide lens bends
MOST_BOARDS = 150  # of the views; more hide each other
LEAST_AHEAD = 0.25  # of a ray's length, to be drawn to a plane ahead; others to a sphere


@dataclass(frozen=True, slots=True, eq=False)
class CameraOutline:
    """A camera's centre, and what the border of its image sees at one distance."""

    side: str
    centre: Float[ndarray, "3"]
    outline: Float[ndarray, "n 3"]


@dataclass(frozen=True, slots=True, eq=False)
class BoardOutline:
    """The four corners of a board's points, and what it is."""

    name: str
    text: str
    outline: Float[ndarray, "4 3"]
    is_suggested: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RigScene:
    """Both cameras, and the boards."""

    cameras: tuple[CameraOutline, CameraOutline]
    boards: tuple[BoardOutline, ...]
    unit: str

    def document(self) -> dict[str, Any]:
        """As plain data, to four digits, for the page's script."""
        return {
            "unit": self.unit,
            "cameras": [{"side": c.side, "at": _digits(c.centre), "outline": _digits(c.outline)} for c in self.cameras],
            "boards": [
                {"name": b.name, "text": b.text, "outline": _digits(b.outline), "next": b.is_suggested}
                for b in self.boards
            ],
        }


def rig_scene(
    calibration: StereoCalibration, points_m: Float[ndarray, "n 3"] | None, plans: Sequence[ViewPlan] = ()
) -> RigScene:
    """The scene of a calibration; ``points_m`` are the board's, without which no board is drawn."""
    rig, poses = calibration.rig, calibration.T_left_board
    unit = "m" if rig.is_metric else "board pitches"
    far = (
        float(np.median(np.linalg.norm(poses.t, axis=-1)))
        if poses is not None and len(poses.t)
        else 10 * rig.baseline_m
    )
    T_left_right = rig.T_right_left.inverse()
    cameras = (
        CameraOutline("left", np.zeros(3), _view_outline(rig.left, FRUSTUM_SHARE * far)),
        CameraOutline("right", T_left_right.t, T_left_right.apply(_view_outline(rig.right, FRUSTUM_SHARE * far))),
    )
    boards: list[BoardOutline] = []
    if points_m is not None and poses is not None:
        corners = board_corners(points_m)
        views = list(enumerate(calibration.views))
        for i, view in views[:: max(1, -(-len(views) // MOST_BOARDS))]:
            T = SE3(poses.R[i], poses.t[i])
            text = f"view {view.name}: {three_digits(float(np.linalg.norm(poses.t[i])))} {unit} away, RMS {view.rms_px:.3f} px"
            boards.append(BoardOutline(view.name, text, T.apply(corners)))
        number = 0
        for plan in plans:
            for shown in plan.views:
                number += 1
                text = (
                    f"suggested view {number}: {three_digits(shown.distance_m)} {unit} away, tilted by {shown.tilt_deg:.0f} deg, "
                    f"{shown.away} side farther"
                    if shown.away
                    else f"suggested view {number}: {three_digits(shown.distance_m)} {unit} away"
                )
                boards.append(BoardOutline(f"next {number}", text, shown.T_left_board.apply(corners), True))
    return RigScene(cameras, tuple(boards), unit)


def board_corners(points_m: Float[ndarray, "n 3"]) -> Float[ndarray, "4 3"]:
    """The corners of the rectangle about a board's points, in its mean plane."""
    (x0, y0), (x1, y1) = points_m[:, :2].min(axis=0), points_m[:, :2].max(axis=0)
    z = float(points_m[:, 2].mean())
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])


def _view_outline(camera: Camera, distance: float) -> Float[ndarray, "n 3"]:
    """What the border of an image sees, in a plane ahead or, of a wide lens, on a sphere; places without a ray are left out."""
    width, height = camera.size_wh
    t = np.linspace(0, 1, PER_EDGE, endpoint=False)
    border = np.concatenate(
        [
            np.stack([t * (width - 1), 0 * t], axis=-1),
            np.stack([0 * t + width - 1, t * (height - 1)], axis=-1),
            np.stack([(1 - t) * (width - 1), 0 * t + height - 1], axis=-1),
            np.stack([0 * t, (1 - t) * (height - 1)], axis=-1),
        ]
    )
    rays = camera.unproject(border)
    rays = rays[np.isfinite(rays).all(axis=-1)]
    is_narrow = len(rays) > 0 and bool((rays[:, 2] > LEAST_AHEAD).all())
    return distance * (rays / rays[:, 2:] if is_narrow else rays)


def _digits(values: Float[ndarray, "*n"]) -> Any:
    size = float(np.abs(values).max(initial=1e-12))
    return np.round(values, max(0, 4 - int(np.floor(np.log10(max(size, 1e-12)))))).tolist()
