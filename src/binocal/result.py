"""What a calibration is: the rig, how far it can be trusted, and what happened to every view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.shapes import Float


@dataclass(frozen=True, slots=True, eq=False)
class Covariance:
    """Covariance of the rig's estimated parameters, by name.

    Names: ``left.fx`` … ``left.k1`` …, ``right.…``, ``rotation.x/y/z`` (a small rotation vector in radians that
    multiplies ``R`` from the left, so it lives in the right camera's frame), ``translation.x/y/z`` (metres, or board
    pitches without a scale).
    """

    names: tuple[str, ...]
    matrix: Float[ndarray, "p p"]

    def __post_init__(self) -> None:
        matrix = np.array(self.matrix, dtype=float)
        if matrix.shape != (len(self.names),) * 2:
            raise ValueError(f"{len(self.names)} names for a covariance of shape {matrix.shape}")
        matrix.setflags(write=False)
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


@dataclass(frozen=True, slots=True)
class ResidualSummary:
    """RMS distance, pixels, between measured and predicted corners (OpenCV's convention.

    Per corner, not per coordinate).
    """

    left_px: float
    right_px: float
    all_px: float


@dataclass(frozen=True, slots=True)
class OutlierCorner:
    """A corner that the solver gave no weight.

    Which camera (``left`` or ``right``), its index on the board, its distance from the fit.
    """

    camera: str
    corner: int
    distance_px: float


@dataclass(frozen=True, slots=True)
class ViewResult:
    """A view that was used. ``outliers`` among its ``n_corners`` corners (both cameras) were rejected.

    RMS is over the others.

    ``note`` says what was repaired, if anything. An RMS is NaN where the camera did not see the board.
    """

    name: str
    rms_px: float
    left_rms_px: float
    right_rms_px: float
    n_corners: int
    outliers: tuple[OutlierCorner, ...] = ()
    note: str = ""

    @property
    def n_outliers(self) -> int:
        """Number of rejected corners."""
        return len(self.outliers)


@dataclass(frozen=True, slots=True)
class RejectedView:
    """A view that was not used, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a rig was computed from.

    The used views with repaired corner orders, the board's pose in each of them, and, where the corners carry
    covariances, the misfit that was added to them (standard deviation of one coordinate).
    """

    detections: Detections
    T_left_board: SE3
    misfit_px: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class StereoCalibration:
    """The result of every calibrator.

    ``warnings`` are sentences for the user, the gravest first. ``provenance`` holds versions, calibrator, options,
    model choice.
    """

    rig: StereoRig
    covariance: Covariance
    rms: ResidualSummary
    noise_px: float
    """Estimated standard deviation of one corner coordinate, pixels; where corners carry covariances, that of as many
    equal corners that would tell as much."""
    views: tuple[ViewResult, ...]
    rejected: tuple[RejectedView, ...] = ()
    warnings: tuple[str, ...] = ()
    n_iterations: int = 0
    provenance: Mapping[str, Any] = field(default_factory=dict)
    evidence: Evidence | None = None
    """The corners that the rig was computed from; None when it was read from a file, which does not hold them."""

    @property
    def euler_sigma_rad(self) -> tuple[float, float, float]:
        """Standard deviations of the paper's angles gamma, lambda, mu, radians; NaN where unknown.

        First order, through central differences of the angles by the rotation vector (step 1e-6 rad, error below 1e-9).
        """
        R, step = self.rig.T_right_left.R, 1e-6
        J = np.empty((3, 3))
        for i in range(3):
            w = np.zeros(3)
            w[i] = step
            difference = np.subtract(so3.to_paper_angles(so3.exp(w) @ R), so3.to_paper_angles(so3.exp(-w) @ R))
            J[:, i] = ((difference + np.pi) % (2 * np.pi) - np.pi) / (2 * step)
        gamma, lambda_, mu = np.sqrt(np.diag(J @ self.covariance.block("rotation") @ J.T)).tolist()
        return gamma, lambda_, mu

    @property
    def baseline_sigma_m(self) -> float:
        """Standard deviation of the baseline, metres (board pitches without a scale); NaN where unknown."""
        along = self.rig.T_right_left.t / self.rig.baseline_m
        return float(np.sqrt(along @ self.covariance.block("translation") @ along))
