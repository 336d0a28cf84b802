"""What every file format of rigs is: a record of functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from binocal.cameras import StereoRig


@runtime_checkable
class RigWriter(Protocol):
    """Writes a rig, aside and then renamed.

    Raises:
        OutputExistsError: Something is there and ``force`` is False.
        DataError: The file cannot be written, or what ``losses`` names must not be lost in silence.
    """

    def __call__(self, path: Path, rig: StereoRig, *, force: bool = False) -> None:
        """Write it."""
        ...


@dataclass(frozen=True, slots=True)
class Format:
    """One format: how its files are recognised, read and written, and what they cannot hold.

    ``suffixes`` are what its files are called, the first of a new one. ``probe`` decides from a file's content, whatever its
    name, whether it is of this format; it raises nothing. ``read`` raises :class:`binocal.errors.FormatError`, whose text
    says what is wrong where. ``write`` is None where files are only read. ``losses`` names what of a rig a file cannot
    hold; what it does not name comes back as it was. Frames, pixel origins and units are binocal's on this side of it
    (docs/conventions.md).
    """

    name: str
    description: str
    suffixes: tuple[str, ...]
    probe: Callable[[Path], bool]
    read: Callable[[Path], StereoRig]
    write: RigWriter | None
    losses: Callable[[StereoRig], tuple[str, ...]]
