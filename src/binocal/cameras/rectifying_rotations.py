"""The rotations that lay the baseline of two cameras on an image axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.errors import DegenerateGeometryError
from binocal.geometry import SE3, so3
from binocal.shapes import Float

MAX_AXIS_ANGLE_DEG = (
    60.0  # beyond it the cameras stand behind each other rather than side by side: no common image is left
)


@dataclass(frozen=True, slots=True, eq=False)
class RectifyingRotations:
    """``R_rect_left`` and ``R_rect_right`` (OpenCV's R1, R2), and how the baseline lies in the rectified frames.

    ``offset_m`` is what takes a coordinate along the baseline from ``rect_left`` to ``rect_right``: minus the baseline, plus it if
    the cameras are swapped.
    """

    R_rect_left: Float[ndarray, "3 3"]
    R_rect_right: Float[ndarray, "3 3"]
    is_vertical: bool
    offset_m: float

    @property
    def along(self) -> int:
        """The axis that the baseline lies on: 0 for x, 1 for y."""
        return int(self.is_vertical)


def rectifying_rotations(T_right_left: SE3) -> RectifyingRotations:
    """Each camera is turned by half of the rotation between them, then both by the smallest rotation that lays the baseline on an axis.

    This is Bouguet's method, the one that OpenCV uses. Deviation: where the right camera is held upside down or on its side beside
    the left one, its image is first turned by the quarter turns that bring it upright; half of 180° would lay both on their side.

    Raises:
        DegenerateGeometryError: The baseline is zero, or within 30° of the direction between both cameras' axes.
    """
    t = T_right_left.t
    if not np.linalg.norm(t) > 0:
        raise DegenerateGeometryError("the rig has no baseline (T = 0): its images cannot be rectified.")
    upright = max((_quarter_turns(k) for k in range(4)), key=lambda S: np.trace(S @ T_right_left.R))
    half_rad = so3.log(upright @ T_right_left.R) / 2
    t_mid = so3.exp(-half_rad) @ upright @ t
    axis = 0 if abs(t_mid[0]) >= abs(t_mid[1]) else 1
    along = np.zeros(3)
    along[axis] = 1.0 if t_mid[axis] > 0 else -1.0
    turn = np.cross(t_mid, along)
    sine, cosine = np.linalg.norm(turn), t_mid @ along
    angle_rad = np.arctan2(sine, cosine)
    if angle_rad > np.radians(MAX_AXIS_ANGLE_DEG):
        raise DegenerateGeometryError(
            f"the baseline is {np.degrees(angle_rad):.0f} deg from the nearer image axis (at most "
            f"{MAX_AXIS_ANGLE_DEG:.0f}): the cameras stand one behind the other and their images cannot be rectified."
        )
    W = so3.exp(turn * (angle_rad / sine)) if sine > 0 else np.eye(3)
    R_rect_left, R_rect_right = W @ so3.exp(half_rad), W @ so3.exp(-half_rad) @ upright
    return RectifyingRotations(R_rect_left, R_rect_right, axis == 1, float((R_rect_right @ t)[axis]))


def _quarter_turns(n: int) -> Float[ndarray, "3 3"]:
    """N quarter turns about the optical axis, exactly."""
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[n]
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], dtype=float)
