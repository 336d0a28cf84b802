"""Corners of a board at several settings of zoom lenses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.errors import DataError
from binocal.evidence.detections import Detections
from binocal.shapes import Float
from binocal.values import ArrayValue, frozen_array


@dataclass(frozen=True, slots=True, eq=False)
class ZoomSettings(ArrayValue):
    """Detections at each setting of the zoom, kept in ascending order of the settings, whatever unit these have.

    They may be given in any order. Both lenses stand at the same setting in a view; the images are of one size at all settings.
    """

    settings: Float[ndarray, "k"]
    detections: tuple[Detections, ...]

    def __post_init__(self) -> None:
        settings = frozen_array(self.settings)
        if settings.ndim != 1 or len(settings) != len(self.detections):
            raise ValueError(f"{len(self.detections)} sets of detections for settings of shape {settings.shape}")
        if not np.isfinite(settings).all():
            raise DataError(f"setting {int(np.argmin(np.isfinite(settings))) + 1} of the zoom is not a finite number.")
        order = np.argsort(settings, kind="stable")
        settings = settings[order]
        object.__setattr__(self, "detections", tuple(self.detections[i] for i in order.tolist()))
        repeated = np.flatnonzero(np.diff(settings) == 0)
        if len(repeated):
            first, second = (order[repeated[0] : repeated[0] + 2] + 1).tolist()
            raise DataError(
                f"zoom setting {settings[repeated[0]]:g} is given twice (sets {first} and {second}): put its views into one set."
            )
        for name in ("left_size_wh", "right_size_wh", "is_metric"):
            values = [getattr(d, name) for d in self.detections]
            other = next((i for i, value in enumerate(values) if value != values[0]), None)
            if other is not None:
                what = {"is_metric": "unit of length"}.get(name, f"{name.split('_')[0]} image size")
                raise DataError(
                    f"the {what} differs between zoom setting {settings[0]:g} ({values[0]}) and {settings[other]:g} ({values[other]})."
                )
        object.__setattr__(self, "settings", frozen_array(settings))

    @property
    def n_views(self) -> int:
        """Number of views at all settings."""
        return sum(d.n_views for d in self.detections)
