"""binocal: stereo-camera calibration that measures depth and says how far the depth can be trusted."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from binocal.rl.registration import register_if_loaded

__version__ = "0.1.0"

if TYPE_CHECKING:
    from binocal.app.natural import NaturalOptions
    from binocal.app.stream import StreamOptions
    from binocal.app.without_board import check, check_stream, recalibrate
    from binocal.boards import Board, BoardSet, load_board
    from binocal.calibrators import CalibrationRequest, calibrate
    from binocal.cameras import Camera, StereoRig
    from binocal.datasets import open_dataset
    from binocal.detection import detect, detect_boards, detect_pairs
    from binocal.errors import (
        BinocalError,
        CalibrationError,
        DataError,
        DegenerateGeometryError,
        DetectionError,
        FormatError,
        InconsistentViewsError,
        MissingExtraError,
        NotConvergedError,
        OutputError,
        OutputExistsError,
        PluginError,
        TooFewPointsError,
        TooFewViewsError,
    )
    from binocal.evidence import Detections
    from binocal.findings import Finding, Severity
    from binocal.formats.detections_npz import read_detections, write_detections
    from binocal.formats.rig_json import read_calibration, read_rig, write_calibration
    from binocal.geometry import SE3
    from binocal.rectification import Rectification, rectify
    from binocal.result import Covariance, OutlierCorner, RejectedView, ResidualSummary, StereoCalibration, ViewResult
    from binocal.solvers.prior import RigPrior
    from binocal.threads import set_threads

# Where each public name lives; it is imported when first asked for, so that `import binocal` stays light.
_NAMES_IN = {
    "binocal.app.natural": ("NaturalOptions",),
    "binocal.app.stream": ("StreamOptions",),
    "binocal.app.without_board": ("check", "check_stream", "recalibrate"),
    "binocal.datasets": ("open_dataset",),
    "binocal.boards": ("Board", "BoardSet", "load_board"),
    "binocal.calibrators": ("CalibrationRequest", "calibrate"),
    "binocal.cameras": ("Camera", "StereoRig"),
    "binocal.detection": ("detect", "detect_boards", "detect_pairs"),
    "binocal.evidence": ("Detections",),
    "binocal.errors": (
        "BinocalError",
        "CalibrationError",
        "DataError",
        "DegenerateGeometryError",
        "DetectionError",
        "FormatError",
        "InconsistentViewsError",
        "MissingExtraError",
        "NotConvergedError",
        "OutputError",
        "OutputExistsError",
        "PluginError",
        "TooFewPointsError",
        "TooFewViewsError",
    ),
    "binocal.formats.detections_npz": ("read_detections", "write_detections"),
    "binocal.formats.rig_json": ("read_calibration", "read_rig", "write_calibration"),
    "binocal.geometry": ("SE3",),
    "binocal.findings": ("Finding", "Severity"),
    "binocal.solvers.prior": ("RigPrior",),
    "binocal.threads": ("set_threads",),
    "binocal.rectification": ("Rectification", "rectify"),
    "binocal.result": (
        "Covariance",
        "OutlierCorner",
        "RejectedView",
        "ResidualSummary",
        "StereoCalibration",
        "ViewResult",
    ),
}
_MODULE_OF = {name: module for module, names in _NAMES_IN.items() for name in names}

__all__ = [
    "SE3",
    "BinocalError",
    "Board",
    "BoardSet",
    "CalibrationError",
    "CalibrationRequest",
    "Camera",
    "Covariance",
    "DataError",
    "DegenerateGeometryError",
    "DetectionError",
    "Detections",
    "Finding",
    "FormatError",
    "InconsistentViewsError",
    "MissingExtraError",
    "NaturalOptions",
    "NotConvergedError",
    "OutlierCorner",
    "OutputError",
    "OutputExistsError",
    "PluginError",
    "Rectification",
    "RejectedView",
    "ResidualSummary",
    "RigPrior",
    "Severity",
    "StereoCalibration",
    "StereoRig",
    "StreamOptions",
    "TooFewPointsError",
    "TooFewViewsError",
    "ViewResult",
    "__version__",
    "calibrate",
    "check",
    "check_stream",
    "detect",
    "detect_boards",
    "detect_pairs",
    "load_board",
    "open_dataset",
    "read_calibration",
    "read_detections",
    "read_rig",
    "recalibrate",
    "rectify",
    "set_threads",
    "write_calibration",
    "write_detections",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'binocal' has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})


class _Package(ModuleType):
    """This package: importing it, for the first time or again, makes the environment known to a loaded Gymnasium.

    ``gymnasium.make("binocal:…")`` imports ``binocal`` and expects to find the environment then. Where ``binocal`` was imported before
    Gymnasium nothing of it runs again, but Python reads ``__spec__`` at every import.
    """

    @property
    def __spec__(self) -> Any:  # type: ignore[override] # pyright: ignore
        register_if_loaded()
        return vars(self)["__spec__"]

    @__spec__.setter
    def __spec__(self, spec: Any) -> None:  # pyright: ignore
        vars(self)["__spec__"] = spec


sys.modules[__name__].__class__ = _Package
register_if_loaded()
