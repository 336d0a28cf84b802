"""Every exception of binocal.

::

    BinocalError
    ├── DataError               the input cannot be used            (CLI exit code 3)
    │   ├── FormatError         a file is not what it should be
    │   ├── DetectionError      no usable board in the images
    │   ├── SceneError          the simulator cannot place the board as asked
    │   ├── OutputExistsError   a result would overwrite a file
    │   └── OutputError         a result cannot be written, on a full disk say   (CLI exit code 1)
    ├── CalibrationError        the input is readable, no trustworthy rig follows from it   (CLI exit code 3)
    │   ├── TooFewViewsError
    │   ├── TooFewPointsError
    │   ├── DegenerateGeometryError
    │   ├── InconsistentViewsError
    │   └── NotConvergedError   (CLI exit code 1)
    ├── CancelledError          the caller asked to stop                      (CLI exit code 130)
    ├── PluginError             what an installed package adds fails to load   (CLI exit code 1)
    └── MissingExtraError       an optional dependency is not installed   (CLI exit code 1)

``ValueError`` and ``TypeError`` mean that the caller's code is wrong (shape, dtype, option).
Each exception carries its figures as fields; its text says what happened, where, and what to do.
"""

from __future__ import annotations

from typing import Any


class BinocalError(Exception):
    """Base of every error that binocal raises on purpose. Its text and its fields survive pickling and copying.

    ``findings`` are the :class:`binocal.findings.Finding` values that it was raised for, of refusals.
    """

    findings: tuple[Any, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        """A constructor that takes fields cannot be called with the text that Exception keeps."""
        return _rebuilt, (type(self), self.args, self.__dict__)


def _rebuilt(kind: type[BinocalError], args: tuple[Any, ...], fields: dict[str, Any]) -> BinocalError:
    error = kind.__new__(kind, *args)
    error.args = args
    error.__dict__.update(fields)
    return error


class DataError(BinocalError):
    """The input cannot be used."""


class FormatError(DataError):
    """A file is not what it should be; ``path`` names it."""

    def __init__(self, path: object, problem: str) -> None:
        super().__init__(f"{path}: {problem}")
        self.path, self.problem = path, problem


class DetectionError(DataError):
    """No usable board was found; ``reasons`` maps an image or view to why."""

    def __init__(self, message: str, reasons: dict[str, str] | None = None) -> None:
        super().__init__(message)
        self.reasons = dict(reasons or {})


class SceneError(DataError):
    """The simulator found no board poses as asked; ``placed`` of ``wanted`` views succeeded."""

    def __init__(self, problem: str, placed: int, wanted: int) -> None:
        super().__init__(f"{placed} of {wanted} board poses found: {problem}")
        self.placed, self.wanted = placed, wanted


class OutputExistsError(DataError, FileExistsError):
    """A result would overwrite what is already there; ``path`` names it."""

    def __init__(self, path: object) -> None:
        super().__init__(f"{path} exists already; choose another output, or overwrite it with --force (force=True).")
        self.path = path


class OutputError(DataError):
    """A result cannot be written, because the disk is full say; ``path`` names it. What was there is as it was."""

    def __init__(self, path: object, problem: str) -> None:
        super().__init__(f"{path}: cannot be written: {problem}.")
        self.path, self.problem = path, problem


class CalibrationError(BinocalError):
    """The input is readable, but no trustworthy rig follows from it; ``rejected`` maps a view to why it was dropped."""

    def __init__(self, message: str, rejected: dict[str, str] | None = None) -> None:
        super().__init__(message)
        self.rejected = dict(rejected or {})


class TooFewViewsError(CalibrationError):
    """Fewer usable views than the geometry needs; ``why`` says what became of the others, where that is known."""

    def __init__(
        self, found: int, needed: int, rejected: dict[str, str] | None = None, *, why: str = "", remedy: str = ""
    ) -> None:
        self.remedy = remedy or "add views with the board tilted 20-45 deg in different directions"
        plural = "" if found == 1 else "s"
        super().__init__(f"{found} usable view{plural}, {needed} needed{why and ': '}{why}; {self.remedy}.", rejected)
        self.found, self.needed, self.why = found, needed, why


class TooFewPointsError(CalibrationError):
    """Fewer corners than the geometry needs."""

    def __init__(self, where: str, found: int, needed: int) -> None:
        super().__init__(f"{where}: {found} corners, {needed} needed.")
        self.where, self.found, self.needed = where, found, needed


class DegenerateGeometryError(CalibrationError):
    """The views leave parameters undetermined; the text names which, and what to add."""


class InconsistentViewsError(CalibrationError):
    """Left and right corners contradict each other in most views: order, pairing or board are wrong."""


class NotConvergedError(CalibrationError):
    """The solver stopped without reaching a minimum."""


class CancelledError(BinocalError):
    """The caller's ``should_stop`` said so; nothing was returned or written."""


class PluginError(BinocalError):
    """What an installed package adds through an entry point fails to load, or is not what it should be."""

    def __init__(self, group: str, name: str, package: str, problem: str) -> None:
        super().__init__(
            f"{name!r} ({group}) of the package {package}: {problem}; repair or uninstall that package, or use another name."
        )
        self.group, self.name, self.package, self.problem = group, name, package, problem


class MissingExtraError(BinocalError):
    """An optional dependency is not installed."""

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(f"{feature} needs an optional dependency: pip install 'binocal[{extra}]'")
        self.feature, self.extra = feature, extra
