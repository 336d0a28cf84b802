"""Two cameras and the transform between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from binocal.cameras.camera import Camera
from binocal.cameras.epipolar_projection import ProjectionKind
from binocal.cameras.rectified_pair import Rectification, rectify_cameras
from binocal.geometry import SE3, so3


@dataclass(frozen=True, slots=True, eq=False)
class StereoRig:
    """Left and right camera and ``T_right_left`` (what OpenCV calls R, T); the rig's frame is the left camera's.

    ``is_metric`` is False when the board's size was unknown; lengths are then in board squares.
    """

    left: Camera
    right: Camera
    T_right_left: SE3
    is_metric: bool = True

    @property
    def baseline_m(self) -> float:
        """Distance of the two cameras' centres, metres (squares if not metric)."""
        return float(np.linalg.norm(self.T_right_left.t))

    @property
    def euler_rad(self) -> tuple[float, float, float]:
        """The paper's angles gamma, lambda, mu (eqs 3-5), radians."""
        return so3.to_paper_angles(self.T_right_left.R)

    @property
    def printed_unit(self) -> tuple[str, float]:
        """The unit to print lengths in, and the factor to it: millimetres, or board squares where the scale is unknown."""
        return ("mm", 1e3) if self.is_metric else ("squares", 1.0)

    @property
    def is_swapped(self) -> bool:
        """True when the camera called right stands to the left of the other: see :func:`are_exchanged`."""
        return are_exchanged(self.T_right_left)

    def rectify(
        self,
        *,
        size_wh: tuple[int, int] | None = None,
        alpha: float | None = None,
        projection: Literal["auto"] | ProjectionKind = "auto",
    ) -> Rectification:
        """How both cameras' images are brought to common rows (columns, where one camera stands above the other).

        The rectified images stand upright as the left one does. What both cameras see, at any distance, fills them: rows and columns
        of which less than half would be covered are cut, ``kept`` and ``covered`` of the result say what is shown. ``projection`` is a
        pinhole as long as no area of that is stretched ten times as much as another, else a projection on a cylinder or sphere about
        the baseline (:mod:`binocal.cameras.epipolar_projection`).

        Args:
            size_wh: Size of the rectified images; by default the left image's, or, where what both see has another shape, one of that
                shape and of as many pixels.
            alpha: 0 zooms to where both images are covered all over, 1 shows every pixel of both cameras, as in OpenCV's
                ``stereoRectify``; values between lie between.
            projection: ``auto``, ``pinhole``, ``cylindrical`` or ``equirectangular``.

        Raises:
            DegenerateGeometryError: The baseline is zero, or lies along the viewing direction; or the cameras see nothing in common.
            ValueError: A size, ``alpha`` or a projection that is none.
        """
        return rectify_cameras(
            self.left, self.right, self.T_right_left, size_wh=size_wh, alpha=alpha, projection=projection
        )


def are_exchanged(T_right_left: SE3) -> bool:
    """Whether each camera, as it is held, sees the one called left to its right, or the one called right to its left.

    A vertical rig has no such order, nor has one with a camera on its side or upside down, where the two see it otherwise:
    there, exchanging left and right would change nothing.
    """
    left_from_right, right_from_left = T_right_left.t, T_right_left.inverse().t
    is_horizontal = all(abs(t[0]) >= abs(t[1]) for t in (left_from_right, right_from_left))
    return bool(is_horizontal and left_from_right[0] > 0 > right_from_left[0])
