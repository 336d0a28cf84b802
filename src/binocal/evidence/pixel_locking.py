"""Corners that lock to the pixel grid: the curve that describes it, and corners without it.

:mod:`binocal.solvers.pixel_locking` finds it in the residuals of a solve.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.evidence.detections import Detections
from binocal.shapes import Float
from binocal.values import ArrayValue, frozen_array

_PHASES = 256  # at which a pixel is sampled for the amplitude


@dataclass(frozen=True, slots=True, eq=False)
class PixelLocking(ArrayValue):
    """How one camera's measured corners depend on their place between the pixels.

    The error of the coordinate u of an axis (x, then y) is the sum over frequencies f (cycles per pixel) of
    ``cosines_px`` cos(2 pi f u) + ``sines_px`` sin(2 pi f u); both are 0 where a frequency is not significant on that axis.
    ``variance_share`` is the share of each axis's residual variance that the curve explains.
    """

    frequencies_per_px: Float[ndarray, "k"]
    cosines_px: Float[ndarray, "2 k"]
    sines_px: Float[ndarray, "2 k"]
    variance_share: Float[ndarray, "2"]

    def __post_init__(self) -> None:
        for name in ("frequencies_per_px", "cosines_px", "sines_px", "variance_share"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        shape = (2, len(self.frequencies_per_px))
        if self.cosines_px.shape != shape or self.sines_px.shape != shape or self.variance_share.shape != (2,):
            raise ValueError(
                f"{shape[1]} frequencies need cosines and sines {shape} and shares (2,); got {self.cosines_px.shape}, "
                f"{self.sines_px.shape}, {self.variance_share.shape}"
            )

    @property
    def amplitude_px(self) -> Float[ndarray, "2"]:
        """Half of the distance between each axis's largest and least error."""
        longest = 12.0  # px: the common period of all frequencies
        u = np.repeat(longest * np.arange(12 * _PHASES)[:, None] / (12 * _PHASES), 2, axis=1)
        return 0.5 * np.ptp(self.errors_px(u), axis=0)

    @property
    def period_px(self) -> Float[ndarray, "2"]:
        """Each axis's strongest period; NaN where nothing is significant."""
        power = self.cosines_px**2 + self.sines_px**2
        strongest = self.frequencies_per_px[power.argmax(axis=1)]
        return np.where(power.any(axis=1), 1 / strongest, np.nan)

    def errors_px(self, points_px: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """The curve at measured corners; NaN where they are."""
        phase = 2 * np.pi * points_px[..., None] * self.frequencies_per_px
        return np.sum(self.cosines_px * np.cos(phase) + self.sines_px * np.sin(phase), axis=-1)

    def corrected(self, points_px: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Measured corners of this camera without the error: of the set that it was found in, or of another."""
        return points_px - self.errors_px(points_px)

    def document(self) -> dict[str, Any]:
        """Plain data, as ``rig.json`` may hold it; :meth:`of_document` reads it."""
        return {
            "frequencies_per_px": self.frequencies_per_px.tolist(),
            "cosines_px": self.cosines_px.tolist(),
            "sines_px": self.sines_px.tolist(),
            "variance_share": self.variance_share.tolist(),
        }

    @staticmethod
    def of_document(document: Mapping[str, Any]) -> PixelLocking:
        """The value that :meth:`document` wrote.

        Raises:
            ValueError: A number is missing or of another shape.
        """
        names = ("frequencies_per_px", "cosines_px", "sines_px", "variance_share")
        missing = [name for name in names if name not in document]
        if missing:
            raise ValueError(f"pixel locking without {', '.join(missing)}")
        return PixelLocking(*(np.asarray(document[name], dtype=float) for name in names))


@dataclass(frozen=True, slots=True, eq=False)
class RigLocking:
    """The pixel locking of both cameras; None of one whose corners do not lock."""

    left: PixelLocking | None = None
    right: PixelLocking | None = None

    @property
    def is_found(self) -> bool:
        """Whether either camera's corners lock."""
        return self.left is not None or self.right is not None

    def corrected(self, detections: Detections) -> Detections:
        """The detections without the error: those that it was found in, or others of the same cameras and detector."""
        return replace(
            detections,
            left_px=detections.left_px if self.left is None else self.left.corrected(detections.left_px),
            right_px=detections.right_px if self.right is None else self.right.corrected(detections.right_px),
        )

    def document(self) -> dict[str, Any]:
        """Plain data: ``left`` and ``right`` where they are."""
        sides = (("left", self.left), ("right", self.right))
        return {side: locking.document() for side, locking in sides if locking is not None}

    @staticmethod
    def of_document(document: Mapping[str, Any]) -> RigLocking:
        """The value that :meth:`document` wrote.

        Raises:
            ValueError: A number is missing or of another shape.
        """
        return RigLocking(
            *(PixelLocking.of_document(document[side]) if side in document else None for side in ("left", "right"))
        )
