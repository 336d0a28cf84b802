"""The words that every experiment is written in: a sample from a seed, a method that makes a rig of it, a case that measures the rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from binocal.boards import Board
from binocal.calibrators import calibrate
from binocal.cameras import StereoRig
from binocal.errors import BinocalError, DetectionError
from binocal.evidence import Detections
from binocal.experiments.row import Measured
from binocal.metrics.held_out import draw_rigs
from binocal.result import Covariance, StereoCalibration

Text = float | str
OPENCV_THROUGHOUT = "opencv, its own corners"


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Evidence with its truth. ``choices`` go to :func:`binocal.calibrate`; ``truth`` is what a case measures against.

    ``bound`` is the Cramér-Rao bound of the true rig's parameters, of a board that is not as drawn by what is known of its print;
    ``known_board_bound`` is then that of the same board, were it known exactly. ``held_out`` are views that no method sees, ``prior`` is what the
    rig's data sheet says. ``training`` are views that an agent may be trained on before. ``opencv_corners`` are those of the same images
    by cv2's finder, where it found any.
    """

    evidence: Any
    truth: Any
    board: Board | None = None
    bound: Covariance | None = None
    choices: Mapping[str, Any] = field(default_factory=dict)
    held_out: Detections | None = None
    prior: StereoRig | None = None
    training: Detections | None = None
    opencv_corners: Detections | None = None
    known_board_bound: Covariance | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """What a method made of a sample: a rig, and the whole calibration where the method is a calibrator.

    ``said`` are figures that the method tells of itself, by name, each with its unit.
    """

    rig: StereoRig
    calibration: StereoCalibration | None = None
    said: Mapping[str, tuple[float, str]] = field(default_factory=dict)


@runtime_checkable
class Method(Protocol):
    """Makes a rig of a sample, under the name of its rows. Several rigs are one result: each criterion's RMS over them counts.

    Raises:
        BinocalError: It makes none; that is counted.
    """

    @property
    def label(self) -> str:
        """The rows' name for it."""
        ...

    def __call__(self, sample: Sample) -> Sequence[Made]:
        """The rig or the rigs."""
        ...


@dataclass(frozen=True, slots=True)
class ByCalibrator:
    """A calibrator with its options; ``choices`` take the place of the sample's (another camera model)."""

    label: str
    calibrator: str
    options: Mapping[str, Any] = field(default_factory=dict)
    choices: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self, sample: Sample) -> Sequence[Made]:
        """See :class:`Method`."""
        choices = {**sample.choices, **self.choices}
        made = calibrate(sample.evidence, calibrator=self.calibrator, options=self.options, **choices)
        return (Made(made.rig, made),)


@dataclass(frozen=True, slots=True)
class OpenCVThroughout:
    """``opencv`` from the corners that cv2's own finder gives of the same images: as its users run it."""

    label: str = OPENCV_THROUGHOUT

    def __call__(self, sample: Sample) -> Sequence[Made]:
        """See :class:`Method`."""
        if sample.opencv_corners is None:
            raise DetectionError("OpenCV finds the board in no pair.")
        made = calibrate(sample.opencv_corners, calibrator="opencv", **sample.choices)
        return (Made(made.rig, made),)


def by_calibrator(name: str, **options: Any) -> ByCalibrator:
    """The calibrator of that name, its options in the label."""
    words = ", ".join(f"{key} {value}" for key, value in options.items())
    return ByCalibrator(f"{name} ({words})" if words else name, name, options)


@dataclass(frozen=True, slots=True)
class PriorUnchanged:
    """What the data sheet says, without a calibration."""

    label: str = "prior unchanged"

    def __call__(self, sample: Sample) -> Sequence[Made]:
        """See :class:`Method`."""
        if sample.prior is None:
            raise ValueError("the case has no prior")
        return (Made(sample.prior),)


@dataclass(frozen=True, slots=True)
class AtBound:
    """Rigs scattered about the truth as the Cramér-Rao bound says: no unbiased method does better on average."""

    label: str = "Cramér-Rao bound"
    n_rigs: int = 40  # more than parameters, so that their covariance is the bound itself
    seed: int = 0

    def __call__(self, sample: Sample) -> Sequence[Made]:
        """See :class:`Method`."""
        if sample.bound is None:
            raise ValueError("the case has no bound")
        rigs = draw_rigs(sample.truth, sample.bound, self.n_rigs, np.random.default_rng(self.seed))
        return [Made(rig) for rig in rigs]


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """What to make from a seed, by which methods, what to measure of each, and what is printed of it elsewhere.

    ``paper`` is looked up by (label, criterion), then by criterion. ``make``, ``measure`` and ``methods`` are sent to other processes:
    functions of a module, or of dataclasses.
    """

    name: str
    make: Callable[[int], Sample]
    measure: Callable[[Made, Sample], list[Measured]]
    methods: tuple[Method, ...]
    paper: Mapping[Any, Text] = field(default_factory=dict)
    table: str = ""

    def printed(self, label: str, criterion: str) -> Text | None:
        """What is printed elsewhere of a method's criterion, if anything is."""
        return self.paper.get((label, criterion), self.paper.get(criterion))


@dataclass(frozen=True, slots=True)
class Result:
    """What one method came to on one sample; ``failure`` is why it made nothing."""

    case: str
    calibrator: str
    seed: int
    measured: tuple[Measured, ...] = ()
    failure: str = ""


def results_of(case: Case, seed: int, labels: Sequence[str] | None = None) -> list[Result]:
    """Each method (of those labelled so) on the sample of a seed."""
    wanted = [m for m in case.methods if labels is None or m.label in labels]
    sample = case.make(seed)
    return [_result(case, method, sample, seed) for method in wanted]


def _result(case: Case, method: Method, sample: Sample, seed: int) -> Result:
    try:
        measured = [case.measure(made, sample) for made in method(sample)]
    except BinocalError as error:
        return Result(case.name, method.label, seed, failure=" ".join(str(error).split()))
    if len(measured) == 1:
        return Result(case.name, method.label, seed, tuple(measured[0]))
    return Result(case.name, method.label, seed, tuple(_rms(each) for each in zip(*measured, strict=True)))


def _rms(values: tuple[Measured, ...]) -> Measured:
    """One figure of several."""
    return replace(values[0], value=float(np.sqrt(np.mean([v.value**2 for v in values]))))
