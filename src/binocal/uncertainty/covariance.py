"""Covariances by name: of the rig's parameters, and of the boards' mean pose beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Float
from binocal.values import ArrayValue, frozen_array

MEAN_POSE_NAMES = tuple(f"board.{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz")
"""Names of the mean board pose's six, behind those of the rig where both stand in one covariance."""


@dataclass(frozen=True, slots=True, eq=False)
class Covariance(ArrayValue):
    """Covariance of the rig's estimated parameters, by name.

    Names: ``left.fx`` … ``left.k1`` …, ``right.…``, ``rotation.x/y/z`` (a small rotation vector in radians that
    multiplies ``R`` from the left, so it lives in the right camera's frame), ``translation.x/y/z`` (metres, or board
    pitches without a scale).
    """

    names: tuple[str, ...]
    matrix: Float[ndarray, "p p"]

    def __post_init__(self) -> None:
        matrix = frozen_array(self.matrix)
        if matrix.shape != (len(self.names),) * 2:
            raise ValueError(f"{len(self.names)} names for a covariance of shape {matrix.shape}")
        object.__setattr__(self, "matrix", matrix)

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of each parameter."""
        return dict(zip(self.names, np.sqrt(np.diag(self.matrix)).tolist(), strict=True))

    def block(self, name: str) -> Float[ndarray, "3 3"]:
        """Covariance of ``rotation`` or ``translation``, in the order x, y, z; NaN where it was not estimated."""
        wanted = [f"{name}.{axis}" for axis in "xyz"]
        if not set(wanted) <= set(self.names):
            return np.full((3, 3), np.nan)
        index = [self.names.index(item) for item in wanted]
        return self.matrix[np.ix_(index, index)]


@dataclass(frozen=True, slots=True, eq=False)
class MeanBoardPose(ArrayValue):
    """How the estimated board poses, taken together, err with the rig: what ties one camera's pixels to the world.

    The mean over the views of the small motion xi = (rotation, translation) by which an estimated ``T_left_board`` differs from the
    true one, multiplied from the left: it lives in the left camera's frame (radians; metres, or board pitches without a scale).
    ``covariance`` is that of these six, ``with_rig`` their covariance with the rig's parameters, in the order of its names.
    """

    covariance: Float[ndarray, "6 6"]
    with_rig: Float[ndarray, "6 p"]

    def __post_init__(self) -> None:
        for name, rows in (("covariance", 6), ("with_rig", 6)):
            array = frozen_array(getattr(self, name))
            if array.ndim != 2 or len(array) != rows or (name == "covariance" and array.shape != (6, 6)):
                raise ValueError(f"{name} of a mean board pose has six rows; got {array.shape}")
            object.__setattr__(self, name, array)

    def joint(self, covariance: Covariance) -> Covariance:
        """One covariance of the rig's parameters and, behind them, the mean board pose (:data:`MEAN_POSE_NAMES`).

        Raises:
            ValueError: It belongs to a rig with other parameters.
        """
        p = len(covariance.names)
        if self.with_rig.shape[1] != p:
            raise ValueError(f"a mean board pose of {self.with_rig.shape[1]} parameters for a covariance of {p}")
        matrix = np.empty((p + 6, p + 6))
        matrix[:p, :p], matrix[p:, p:] = covariance.matrix, self.covariance
        matrix[p:, :p], matrix[:p, p:] = self.with_rig, self.with_rig.T
        return Covariance(covariance.names + MEAN_POSE_NAMES, matrix)
