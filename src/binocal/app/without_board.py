"""The package's own functions for natural images: from pairs, data sets or the words for them to a rig or a verdict."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from pathlib import Path

from binocal.app import natural, stream
from binocal.app.natural import NaturalOptions, NaturalRun, NaturalSource
from binocal.app.stream import StreamOptions, StreamRun
from binocal.cameras import StereoRig
from binocal.datasets import Dataset, StereoPair, open_dataset
from binocal.errors import DataError
from binocal.result import StereoCalibration

Pairs = str | Dataset | NaturalSource | Iterable[StereoPair | tuple[str | PathLike[str], str | PathLike[str]]]
"""``KIND:PATH``, an open data set, or pairs: :class:`binocal.datasets.StereoPair`, or paths of left and right images."""
Rig = StereoCalibration | StereoRig


def recalibrate(source: Pairs, rig: Rig | None = None, options: NaturalOptions | None = None) -> NaturalRun:
    """Rotation and direction of translation anew from natural images, intrinsics held; ``calibration`` of the result is the new rig.

    Args:
        source: The pairs. A data set brings its own rig; of several calibrations one is used, and the findings say so.
        rig: The rig that took them. Of a calibration the covariance counts, and its own reference, if it holds one.
        options: How; the defaults are those of the command line.

    Raises:
        DataError: An image cannot be read or is not of the rig's cameras, or nothing says what cameras took them.
        CalibrationError: The images tell no rig.
    """
    return natural.recalibrate(source_of(source, rig), options)


def check(source: Pairs, rig: Rig | None = None, options: NaturalOptions | None = None) -> NaturalRun:
    """Whether a rig is still calibrated: ``has_drifted``, ``drift``, ``before`` and ``after`` of the result.

    Arguments and errors are those of :func:`recalibrate`.
    """
    return natural.recalibrate(source_of(source, rig), options)


def check_stream(source: Pairs, rig: Rig | None = None, options: StreamOptions | None = None) -> StreamRun:
    """A rig watched pair by pair, in the pairs' order: ``drift`` at the end, ``track`` with jumps and rates, ``has_drifted``.

    Arguments and errors are those of :func:`recalibrate`; images are read one pair at a time.
    """
    return stream.check_stream(source_of(source, rig), options)


def source_of(source: Pairs, rig: Rig | None = None) -> NaturalSource:
    """What the other functions work on.

    Raises:
        DataError: A data set's layout is broken, or nothing says what cameras took the images.
        ValueError: A source comes with a rig of its own and another one.
    """
    if isinstance(source, NaturalSource):
        if rig is not None:
            raise ValueError("a NaturalSource has a rig; give it alone.")
        return source
    given = natural.as_given(rig) if isinstance(rig, StereoRig) else rig
    if isinstance(source, str):
        source = open_dataset(source)
    if not isinstance(source, Dataset):
        pairs = tuple(pair if isinstance(pair, StereoPair) else _pair_of(*pair) for pair in source)
        if not pairs:
            raise DataError("no pairs of images were given; give pairs of one moment each, (left, right).")
        if given is None and not any(pair.rig for pair in pairs):
            raise DataError("images alone do not say what cameras took them: give a rig.")
        source = Dataset("pairs", "pairs", Path(), pairs, None, "the pairs' own rig")
    return natural.source_of_part(source.of_one_rig(like=None if given is None else given.rig), given)


def _pair_of(left: str | PathLike[str], right: str | PathLike[str]) -> StereoPair:
    return StereoPair(Path(left).stem, Path(left), Path(right))
