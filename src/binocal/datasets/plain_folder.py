"""A plain folder of left and right images: no cameras, nothing known of scale or rectification."""

from __future__ import annotations

from pathlib import Path

from binocal.datasets.dataset import Dataset, StereoPair
from binocal.datasets.folder import list_pairs
from binocal.datasets.frames import name_some, side_missing
from binocal.findings import finding, refusal

SIDES = (
    ("left", "right"),
    ("Left", "Right"),
    ("LEFT", "RIGHT"),
    ("l", "r"),
    ("L", "R"),
    ("image_left", "image_right"),
    ("left_images", "right_images"),
    ("cam0", "cam1"),
    ("image_0", "image_1"),
    ("image_2", "image_3"),
)
_PATTERNS = (
    ("*[Ll][Ee][Ff][Tt]*", "*[Rr][Ii][Gg][Hh][Tt]*"),
    ("[Ll][0-9_-]*", "[Rr][0-9_-]*"),
    ("*[_-][Ll].*", "*[_-][Rr].*"),
    ("im0.*", "im1.*"),
)


def open_folder(path: Path, choice: str = "") -> Dataset:
    """The pairs of a folder with two folders of images (left and right, or the like), or with images named left and right.

    Images are paired as ``--left`` and ``--right`` are (:func:`binocal.datasets.list_pairs`).

    Raises:
        DataError: There are no two sides, or no names are shared.
    """
    if choice:
        problem = f"the choice {choice!r} means nothing here"
        raise refusal(
            finding("dataset-layout-unknown", remedy="leave it out", path=str(path), kind="folder", problem=problem)
        )
    left, right = _find_sides(path)
    pairing = list_pairs(left, right)
    pairs = tuple(StereoPair(pair.name, pair.left_path, pair.right_path) for pair in pairing.pairs)
    alone = [str(file.relative_to(path)) for file in pairing.left_out]
    findings = ()
    if alone:
        names = name_some(alone)
        findings = (finding("dataset-frames-left-out", n_out=len(alone), n_pairs=len(pairs), names=names),)
    return Dataset("folder", "plain folder", path, pairs, None, "unknown", pairing.ignored, findings)


def _find_sides(path: Path) -> tuple[str | list[Path], str | list[Path]]:
    """What to give as left and right."""
    names = {entry.name for entry in path.iterdir() if entry.is_dir()}
    for left, right in SIDES:
        if left in names and right in names:
            return str(path / left), str(path / right)
        if left in names or right in names:
            side, missing = ("right", right) if left in names else ("left", left)
            raise side_missing(path / missing, side, "there is no such folder")
    for left, right in _PATTERNS:
        lefts, rights = (sorted(file for file in path.glob(pattern) if file.is_file()) for pattern in (left, right))
        if lefts and rights:
            return [file for file in lefts if file not in rights], [file for file in rights if file not in lefts]
    problem = "there are neither two folders such as left and right nor images named left and right"
    raise refusal(finding("dataset-layout-unknown", path=str(path), kind="folder", problem=problem))
