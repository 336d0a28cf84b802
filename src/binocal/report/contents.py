"""What a report shows: everything is computed before, and drawn from here."""

from __future__ import annotations

from dataclasses import dataclass, field

from numpy import ndarray

from binocal.boards import Board
from binocal.evidence import Detections
from binocal.findings import Finding, Severity
from binocal.planning import ViewPlan
from binocal.requirements import Verdict
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.uncertainty.maps import ProjectionMap, RangeMap
from binocal.validation import CheckLine, ValidationReport


@dataclass(frozen=True, slots=True, eq=False)
class ViewImages:
    """A pair of images, small, as JPEG files; ``sizes_wh`` are those of the images themselves (left, right)."""

    name: str
    left_jpeg: bytes
    right_jpeg: bytes
    sizes_wh: tuple[tuple[int, int], tuple[int, int]]


@dataclass(frozen=True, slots=True)
class RectifiedImages:
    """A pair of a view before and after rectification, side by side with lines along rows, and its depth; JPEG files.

    ``projection`` is that of the rectified images, ``measured`` the share of the left one that has a depth, between ``near`` and
    ``far``.
    """

    name: str
    before_jpeg: bytes
    after_jpeg: bytes
    depth_jpeg: bytes
    projection: str
    is_vertical: bool
    measured: float
    near: float
    far: float


@dataclass(frozen=True, slots=True, eq=False)
class ReportContents:
    """A calibration, and what was computed from it.

    ``name`` is what the rig is called, ``detections`` all corners as detected, those of rejected views too (None: not at hand).
    ``ranges`` are maps of depth at rising ranges, ``at_boards`` the one at the boards' distance; ``projection`` those of both cameras.
    ``board`` is the one of the plans. ``images`` are small pairs of views, ``rectified`` one of them brought to common rows.
    ``notes`` say what could not be shown, and why. ``commands`` repeat calibration and report.
    """

    name: str
    calibration: StereoCalibration
    checks: tuple[CheckLine, ...] = ()
    validation: ValidationReport = field(default_factory=ValidationReport)
    verdicts: tuple[Verdict, ...] = ()
    plans: tuple[ViewPlan, ...] = ()
    detections: Detections | None = None
    ranges: tuple[RangeMap, ...] = ()
    at_boards: RangeMap | None = None
    projection: tuple[ProjectionMap, ...] = ()
    matching_px: float = 0.0
    notes: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    board: Board | None = None
    images: tuple[ViewImages, ...] = ()
    rectified: RectifiedImages | None = None

    @property
    def board_points_m(self) -> Float[ndarray, "n 3"] | None:
        """The board's points as they are, or as drawn; None where nobody says what it is."""
        if self.calibration.evidence is not None:
            return self.calibration.evidence.board_points_m
        if self.calibration.board_shape is not None:
            return self.calibration.board_shape.points_m
        return None if self.board is None else self.board.object_points_m

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Those of the calibration, and what the checks found wrong; each once, warnings first."""
        found = {(one.code, one.text): one for one in self.calibration.findings}
        codes = {code for code, _ in found}
        found |= {(one.code, one.text): one for one in self.validation.warnings if one.code not in codes}
        return tuple(sorted(found.values(), key=lambda one: one.severity is not Severity.WARNING))
