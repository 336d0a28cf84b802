"""Data sets by a word and a path: ``kitti:/data/2011_09_26/2011_09_26_drive_0001_sync``."""

from __future__ import annotations

import os
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from types import MappingProxyType

from binocal.datasets.cityscapes import open_cityscapes
from binocal.datasets.dataset import Dataset
from binocal.datasets.euroc import open_euroc
from binocal.datasets.kitti import open_kitti
from binocal.datasets.middlebury import open_middlebury
from binocal.datasets.plain_folder import open_folder
from binocal.findings import finding, refusal

KINDS: MappingProxyType[str, Callable[[Path, str], Dataset]] = MappingProxyType(
    {
        "kitti": open_kitti,
        "cityscapes": open_cityscapes,
        "euroc": open_euroc,
        "middlebury": open_middlebury,
        "folder": open_folder,
    }
)


def open_dataset(text: str | PathLike[str]) -> Dataset:
    """The data set of ``KIND:PATH`` or ``KIND:PATH:CHOICE``, listed and checked; no image is decoded yet.

    Kinds are kitti (choice gray or colour), cityscapes (a split, or split/city), euroc, middlebury (a scene) and folder.

    Raises:
        DataError: The kind is unknown, or the layout is broken; its finding says what is missing where.
    """
    kind, colon, rest = os.fspath(text).partition(":")
    if not colon or not rest or kind.lower() not in KINDS:
        raise refusal(finding("dataset-kind-unknown", given=os.fspath(text), kinds=", ".join(KINDS)))
    path, choice = _split_choice(rest)
    if not path.is_dir():
        problem = "is a file, not a folder" if path.exists() else "there is no such folder"
        raise refusal(finding("dataset-layout-unknown", path=str(path), kind=kind.lower(), problem=problem))
    return KINDS[kind.lower()](path, choice)


def _split_choice(rest: str) -> tuple[Path, str]:
    """The path, which may hold colons itself, and the choice after the last one where that is no part of a name."""
    whole = Path(os.path.expanduser(rest))
    before, colon, choice = rest.rpartition(":")
    shorter = Path(os.path.expanduser(before))
    if colon and before and not whole.exists() and shorter.is_dir():
        return shorter, choice
    return whole, ""
