"""What the choice of a colour channel is worth: a simulated lens with lateral chromatic aberration, and recordings in colour."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.errors import CalibrationError, DataError
from binocal.evidence import Detections
from binocal.experiments.boards import FILL, LOOKS, MODEL
from binocal.experiments.case import Case, Made, Sample
from binocal.experiments.real_boards import LEAST_VIEWS
from binocal.experiments.rendered import render_files
from binocal.experiments.row import Measured
from binocal.images import CHANNELS
from binocal.images.preprocessing import Preparation
from binocal.metrics import image
from binocal.metrics.aberration import aberration_between
from binocal.metrics.held_out import exact_views
from binocal.metrics.order import order_corners
from binocal.metrics.pose import compare_with_truth
from binocal.simulation import PoseOptions, StereoScene, sample_board_poses, table2_rig

TABLE, REAL = "colour", "real colours"
SPEC = "chessboard:11x8:20mm"
N_PAIRS, N_HELD_OUT = 8, 10
ABERRATION_PX = 0.5
REFERENCE = "green"  # the true rig's colour


@dataclass(frozen=True, slots=True)
class ColourImages:
    """Rendered colour pairs, their corners in each channel; ``held_out`` are exact corners of green."""

    aberration_px: float

    def __call__(self, seed: int) -> Sample:
        """See :class:`binocal.experiments.case.Case`."""
        rng, rig, board = np.random.default_rng([seed, 16]), table2_rig(), parse_board(SPEC)
        scene = StereoScene(rig, board, sample_board_poses(rig, board, N_PAIRS, rng, PoseOptions(fill=FILL)))
        files = render_files(scene, LOOKS, np.random.SeedSequence([seed, 17]), aberration_px=self.aberration_px)
        found = {channel: files.corners(Preparation(channel)) for channel in CHANNELS}
        return Sample(
            found, rig, board, choices={"model": MODEL}, held_out=exact_views(rig, board, N_HELD_OUT, seed)[0]
        )


@dataclass(frozen=True, slots=True)
class InChannel:
    """A calibration from one channel's corners."""

    label: str

    def __call__(self, sample: Sample) -> tuple[Made, ...]:
        """See :class:`binocal.experiments.case.Method`.

        Raises:
            DataError: The board was not found in this channel.
        """
        found: Mapping[str, Detections] = sample.evidence
        if self.label not in found:
            raise DataError(f"the board was not found in {self.label}")
        made = calibrate(found[self.label], calibrator="lm", **sample.choices)
        return (Made(made.rig, made),)


@dataclass(frozen=True, slots=True)
class Displacement:
    """No rig's figures but the aberration of a colour against green, in the corner of the left and right image."""

    label: str

    def __call__(self, sample: Sample) -> tuple[Made, ...]:
        """See :class:`binocal.experiments.case.Method`.

        Raises:
            DataError: Too few corners are common to both colours.
        """
        found: Mapping[str, Detections] = sample.evidence
        colour = self.label.split()[0]
        said: dict[str, tuple[float, str]] = {}
        for side in ("left", "right"):
            fit = aberration_between(found[REFERENCE], found[colour], side)
            if fit is None:
                raise DataError("too few corners are common to both colours")
            said[f"aberration at the farthest corners, {side}"] = fit.at_edge_px, "px"
            said[f"its standard deviation, {side}"] = fit.at_edge_sigma_px, "px"
            said[f"aberration in the image's corner, {side}"] = fit.at_corner_px, "px"
        return (Made(sample.truth, None, said),)


DISPLACEMENTS = (Displacement("red against green"), Displacement("blue against green"))


def colour_errors(made: Made, sample: Sample) -> list[Measured]:
    """The rig against green's, and the rows of exact green corners on it; or what a displacement says."""
    if made.said:
        return said_by_method(made, sample)
    truth = compare_with_truth(made.rig, sample.truth, has_skew=False)
    assert sample.held_out is not None and made.calibration is not None  # given by the case and by the method
    focal = made.rig.left.parameters[0] / sample.truth.left.parameters[0] - 1
    return [
        Measured("stated noise", "px", made.calibration.noise_px),
        Measured("focal length against green's", "%", 100 * float(focal)),
        Measured("rotation error", "deg", truth.rotation_error_deg),
        Measured("translation error", "mm", truth.translation_error_mm),
        Measured("row error of exact green corners", "px", image.rectified_row_error(made.rig, sample.held_out).rms_px),
    ]


@dataclass(frozen=True, slots=True, eq=False)
class ColourHalves:
    """Random halves of a recording's views, by channel: ``evidence`` of the first, ``truth`` of the second."""

    found: Mapping[str, Detections]
    model: str

    def __call__(self, seed: int) -> Sample:
        """See :class:`binocal.experiments.case.Case`."""
        names = sorted(set.intersection(*(set(one.names) for one in self.found.values())))
        order = np.random.default_rng([seed, 18]).permutation(names)
        halves = [
            {channel: one.select(np.isin(one.names, part)) for channel, one in self.found.items()}
            for part in (order[: len(order) // 2], order[len(order) // 2 :])
        ]
        return Sample(halves[0], halves[1], choices={"model": self.model})


@dataclass(frozen=True, slots=True)
class HeldOutIn:
    """A calibration from one channel's corners, tested on that channel's of the other half."""

    label: str

    def __call__(self, sample: Sample) -> tuple[Made, ...]:
        """See :class:`binocal.experiments.case.Method`.

        Raises:
            CalibrationError: No rig follows from the half.
        """
        made = calibrate(sample.evidence[self.label], calibrator="lm", **sample.choices)
        views = order_corners(made.rig, sample.truth[self.label]).detections
        said = {"held-out length error": (image.length_error(made.rig, views).scale_rms_percent, "%")}
        with contextlib.suppress(CalibrationError):  # the rig cannot be rectified
            said["held-out row error"] = image.rectified_row_error(made.rig, views).rms_px, "px"
        return (Made(made.rig, made, said),)


def said_by_method(made: Made, sample: Sample) -> list[Measured]:
    """What the method measured itself."""
    return [Measured(name, unit, value) for name, (value, unit) in made.said.items()]


def real_colour_cases(recordings: Sequence[tuple[str, Mapping[str, Detections], str]]) -> list[Case]:
    """A case of each recording in colour (name, views by channel, camera model) that has views enough to be halved."""
    methods = (*(HeldOutIn(channel) for channel in CHANNELS), *DISPLACEMENTS)
    return [
        Case(
            f"{name}, {found[REFERENCE].n_views} pairs", ColourHalves(found, model), said_by_method, methods, table=REAL
        )
        for name, found, model in recordings
        if found[REFERENCE].n_views >= LEAST_VIEWS
    ]


def colour_cases() -> list[Case]:
    """A lens without aberration and one with it."""
    methods = (*(InChannel(channel) for channel in CHANNELS), *DISPLACEMENTS)
    return [
        Case(f"{px:g} px in the corner", ColourImages(px), colour_errors, methods, table=TABLE)
        for px in (0.0, ABERRATION_PX)
    ]
