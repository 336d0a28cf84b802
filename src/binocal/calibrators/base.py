"""What every calibrator is: a function from evidence and a request to a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, get_args, runtime_checkable

from binocal.errors import CancelledError
from binocal.progress import ProgressCallback, ShouldStop
from binocal.result import StereoCalibration
from binocal.solvers.prior import RigPrior

BoardShapeChoice = Literal["auto", "flat", "warp", "free"]
ExposureChoice = Literal["auto", "together", "apart"]
MIN_VIEWS = 3  # two views determine four intrinsics and leave nothing to check them with


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationRequest:
    """What the user may choose.

    ``model`` is a camera model's name, or ``auto``: brown4, unless rows and lengths of held-out views speak decisively for
    another; a calibrator itself is only ever asked for a named one.
    ``seed`` feeds every random choice. With ``max_views`` only the views that determine depth best
    are used, at most so many. ``options`` are the method's own; one that it does not know is an error.
    ``prior`` is what is known of the rig before, part of it held exactly.
    ``board_shape``: whether the board is as drawn (``flat``), bowed, stretched and sheared (``warp``), any (``free``), or what the
    views say (``auto``). ``exposure``: whether both cameras saw each view at one moment (``together``), not (``apart``), or what the
    views say.
    """

    model: str = "auto"
    skew: bool = False
    seed: int = 0
    max_views: int | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    progress: ProgressCallback | None = None
    should_stop: ShouldStop | None = None
    prior: RigPrior | None = None
    board_shape: BoardShapeChoice = "auto"
    exposure: ExposureChoice = "auto"

    def __post_init__(self) -> None:
        for name, choices in (("board_shape", BoardShapeChoice), ("exposure", ExposureChoice)):
            if getattr(self, name) not in get_args(choices):
                raise ValueError(f"{name} is {getattr(self, name)!r}; it can be {', '.join(get_args(choices))}")
        if self.max_views is not None and self.max_views < MIN_VIEWS:
            raise ValueError(f"max_views is {self.max_views}; a calibration needs at least {MIN_VIEWS} views")
        object.__setattr__(self, "options", dict(self.options))

    def report(self, what: str, done: int, total: int) -> None:
        """Say how far the work is, and ask whether to go on.

        Raises:
            CancelledError: ``should_stop`` returned True.
        """
        if self.progress is not None:
            self.progress(what, done, total)
        self.check_stop()

    def check_stop(self) -> None:
        """Ask whether to go on.

        Raises:
            CancelledError: ``should_stop`` returned True.
        """
        if self.should_stop is not None and self.should_stop():
            raise CancelledError("the calibration was stopped as asked; nothing was written.")

    def check_options(self, *known: str) -> None:
        """See that the method knows all of its options.

        Raises:
            ValueError: It does not; the text names the unknown one and those that are known.
        """
        for name in self.options:
            if name not in known:
                raise ValueError(f"the calibrator has no option {name!r}; it has {', '.join(known) or 'none'}")


@runtime_checkable
class Calibrator(Protocol):
    """A method that calibrates a stereo rig.

    Deterministic: the same evidence and request give the same calibration. It asks ``request.check_stop()`` between its parts,
    and its provenance holds what it alone knows; who asked for what is added by :func:`binocal.calibrate`.

    Raises:
        TypeError: It cannot work from this kind of evidence.
        ValueError: An option is unknown.
        CalibrationError: No trustworthy rig follows from the evidence.
        CancelledError: ``request.should_stop`` said so.
    """

    def __call__(self, evidence: Any, request: CalibrationRequest) -> StereoCalibration:
        """The calibration that this evidence determines; each calibrator works from one kind of it, most from Detections."""
        ...
