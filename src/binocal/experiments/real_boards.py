"""Real recordings of boards: a random half calibrates, lengths are measured on the other half."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from binocal.errors import CalibrationError
from binocal.evidence import Detections
from binocal.experiments.case import ByCalibrator, Case, Made, Method, Sample, by_calibrator
from binocal.experiments.row import Measured
from binocal.metrics import image
from binocal.metrics.order import order_corners

TABLE = "real boards"
LEAST_VIEWS = 6  # three calibrate
NAMES = ("drl", "lm", "from-guess", "opencv", "alternating", "absolute-orientation", "heterogeneous")


@dataclass(frozen=True, slots=True, eq=False)
class Halves:
    """Random halves of a recording's views."""

    views: Detections
    model: str

    def __call__(self, seed: int) -> Sample:
        """See :class:`binocal.experiments.case.Case`."""
        order = np.random.default_rng([seed, 7]).permutation(self.views.n_views)
        middle = len(order) // 2
        first, second = (self.views.select(np.sort(part)) for part in (order[:middle], order[middle:]))
        return Sample(first, None, choices={"model": self.model}, held_out=second)


def length_errors(made: Made, sample: Sample) -> list[Measured]:
    """Lengths on the half that was not used, its corner orders as the rig under test has them."""
    assert sample.held_out is not None  # given by the case
    views = order_corners(made.rig, sample.held_out).detections
    lengths = image.length_error(made.rig, views)
    found = [
        Measured("held-out length error", "%", lengths.scale_rms_percent),
        Measured("held-out error of a single side", "%", lengths.side_rms_percent),
    ]
    try:
        return [*found, Measured("held-out row error", "px", image.rectified_row_error(made.rig, views).rms_px)]
    except CalibrationError:  # the rig cannot be rectified
        return found


def methods_of(model: str) -> tuple[Method, ...]:
    """Every calibrator for boards; ``wide-field`` fits the lenses that it knows."""
    return (
        *(by_calibrator(name) for name in NAMES),
        ByCalibrator("wide-field", "wide-field", choices={"model": "fisheye4"}),
    )


def real_board_cases(recordings: Sequence[tuple[str, Detections, str]]) -> list[Case]:
    """A case of each recording (name, all of its views, camera model) that has views enough to be halved."""
    return [
        Case(f"{name}, {views.n_views} pairs", Halves(views, model), length_errors, methods_of(model), table=TABLE)
        for name, views, model in recordings
        if views.n_views >= LEAST_VIEWS
    ]
