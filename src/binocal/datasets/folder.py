"""Left and right images of a folder, paired by the name or number that they share."""

from __future__ import annotations

import glob
import os
import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

from binocal.datasets.naming import Naming, bear_different_numbers, find_naming, natural_key
from binocal.errors import DataError

IMAGE_SUFFIXES = frozenset((".png", ".jpg", ".jpeg", ".jpe", ".tif", ".tiff", ".bmp", ".dib", ".pgm", ".ppm", ".pnm"))
_NO_IMAGE = "is not an image (by its suffix)"
_COPY = re.compile(r"^(?P<original>.+?)(?:\s*[-_ ]?\s*copy(?:\s*\(?\d+\)?)?|\s*\(\d+\))$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ImagePair:
    """A left and a right image that were taken together; ``name`` is what their file names share."""

    name: str
    left_path: Path
    right_path: Path


@dataclass(frozen=True, slots=True)
class Pairing:
    """Pairs in natural order (2 before 10), and every other file with the reason why it is in no pair."""

    pairs: tuple[ImagePair, ...]
    ignored: tuple[tuple[Path, str], ...] = ()
    notes: tuple[str, ...] = ()
    """What is odd about the pairs that were taken."""

    @property
    def left_out(self) -> tuple[Path, ...]:
        """The images among the ignored files."""
        return tuple(path for path, reason in self.ignored if reason != _NO_IMAGE)


def list_pairs(
    left: str | PathLike[str] | Sequence[str | PathLike[str]],
    right: str | PathLike[str] | Sequence[str | PathLike[str]],
) -> Pairing:
    """Pairs of left and right images, each side given as a glob, a folder, a file or a sequence of files.

    Images are paired by what their names share once the part that distinguishes the sides is taken away (left01 and
    right01, imageL0 and imageR0, cam0/17.png and cam1/17.png). Leading zeros do not count unless they distinguish images
    apart. Nothing is paired by position: orphans, copies ("left03 (1).jpg") and double numbers are listed in
    ``ignored``. Two single files are a pair whatever they are called; numbers that differ are noted.

    Raises:
        DataError: A side holds no image, no name is shared, or left and right are the same images.
    """
    ignored: dict[Path, str] = {}
    notes: tuple[str, ...] = ()
    sides = [_list_images(side, source, ignored) for side, source in (("left", left), ("right", right))]
    lefts, rights = sides
    if len(lefts) == len(rights) == 1 and lefts[0] != rights[0]:
        naming = find_naming(lefts, rights)
        name = naming.left_names.get(lefts[0], "") if naming else ""
        candidates = [ImagePair(name or lefts[0].stem, lefts[0], rights[0])]
        if bear_different_numbers(lefts[0], rights[0]):
            notes = (
                f"{lefts[0].name} and {rights[0].name} bear different numbers: they are taken for a pair because no other image was "
                "given; make sure that they are of one moment.",
            )
    else:
        naming = find_naming(lefts, rights)
        if naming is None:
            if set(lefts) & set(rights):
                raise DataError(
                    f"{left} and {right}: left and right are the same images; name each camera's own images."
                )
            raise DataError(
                f"{len(lefts)} left and {len(rights)} right images share no name or number (such as "
                f"{lefts[0].name} and {rights[0].name}); give images of one moment one number, "
                "such as left01.png and right01.png."
            )
        candidates = _match(naming, lefts, rights, ignored)
    if len({pair.name for pair in candidates}) < len(candidates):
        candidates = [replace(pair, name=str(pair.left_path)) for pair in candidates]
    pairs = _drop_identical(candidates, ignored)
    order = sorted(ignored, key=lambda path: natural_key(str(path)))
    return Pairing(tuple(pairs), tuple((path, ignored[path]) for path in order), notes)


def list_images(
    source: str | PathLike[str] | Sequence[str | PathLike[str]],
) -> tuple[list[Path], Sequence[tuple[Path, str]]]:
    """One camera's images in natural order, given as in :func:`list_pairs`; and other files with the reason why they are left out.

    Raises:
        DataError: There is no image.
    """
    ignored: dict[Path, str] = {}
    return _list_images("images", source, ignored), tuple(ignored.items())


def _list_images(
    side: str, source: str | PathLike[str] | Sequence[str | PathLike[str]], ignored: dict[Path, str]
) -> list[Path]:
    """The side's images in natural order; what is no image or a copy goes to ``ignored``."""
    is_listed = not isinstance(source, (str, PathLike))
    if is_listed:
        found = [Path(path) for path in source]
        text = f"the list of {len(found)} {side} images"
    else:
        text = os.fspath(source)
        found = _expand(side, text)
    found = sorted({Path(os.path.normpath(path)) for path in found}, key=lambda path: natural_key(str(path)))
    images = []
    for path in found:
        is_named = is_listed or str(path) == os.path.normpath(os.path.expanduser(text))
        if path.suffix.lower() in IMAGE_SUFFIXES or (is_named and not path.is_dir()):
            images.append(path)
        elif not path.is_dir():
            ignored[path] = _NO_IMAGE
    present = {(path.parent, path.stem.lower()) for path in images}
    for path in list(images):
        copy = _COPY.match(path.stem)
        if copy and (path.parent, copy["original"].strip().lower()) in present:
            ignored[path] = f"is a copy of {copy['original'].strip()}{path.suffix}"
            images.remove(path)
    if not images:
        raise DataError(f"{side}: no image in {text}; {_describe_folder(text if not is_listed else '')}")
    return images


def _expand(side: str, text: str) -> list[Path]:
    text = os.path.expanduser(text)
    path = Path(text)
    if path.is_file():  # before globbing: a real name may hold brackets
        return [path]
    if path.is_dir():
        return [entry for entry in path.iterdir() if not entry.name.startswith(".")]
    matches = [Path(match) for match in glob.glob(_with_literal_folder(text), recursive=True)]
    folders = [match for match in matches if match.is_dir()]
    files = [match for match in matches if not match.is_dir()]
    if folders and not files:
        return [entry for folder in folders for entry in folder.iterdir() if not entry.name.startswith(".")]
    if not matches:
        raise DataError(f"{side}: nothing matches {text}; {_describe_folder(text)}")
    return files


def _with_literal_folder(text: str) -> str:
    """The glob, with brackets and stars taken for what they are where a folder of that very name exists ("rig [2]/left*")."""
    folder = Path(text).parent
    while folder != folder.parent and not folder.is_dir():
        folder = folder.parent
    if not glob.has_magic(str(folder)):
        return text
    return os.path.join(glob.escape(str(folder)), os.path.relpath(text, folder))


def _describe_folder(text: str) -> str:
    """What the folder of a glob does hold, as the end of an error's sentence."""
    if not text:
        return "name at least one PNG, JPEG, TIFF or BMP file."
    folder = Path(os.path.expanduser(text))
    while folder != folder.parent and (glob.has_magic(str(folder)) or not folder.is_dir()):
        missing, folder = folder, folder.parent
        if not glob.has_magic(str(missing)) and folder.is_dir() and missing.suffix == "":
            return f"there is no {missing.name} in {folder}; check the folder's name."
    names = sorted((entry.name for entry in folder.iterdir() if not entry.name.startswith(".")), key=natural_key)
    if not names:
        return f"{folder} is empty."
    return f"{folder} holds {len(names)} entries such as {', '.join(names[:4])}; check the pattern."


def _match(naming: Naming, lefts: list[Path], rights: list[Path], ignored: dict[Path, str]) -> list[ImagePair]:
    """Pairs of equal keys; everything else is explained in ``ignored``."""
    by_key: dict[str, dict[object, list[Path]]] = {"left": defaultdict(list), "right": defaultdict(list)}
    for side, paths, keys in (("left", lefts, naming.left_keys), ("right", rights, naming.right_keys)):
        for path in paths:
            if path in keys:
                by_key[side][keys[path]].append(path)
    pairs, used = [], set()
    for key, paths in by_key["left"].items():
        partners = by_key["right"].get(key, [])
        if len(paths) == len(partners) == 1:
            pairs.append(ImagePair(naming.left_names[paths[0]], paths[0], partners[0]))
            used.update((paths[0], partners[0]))
    for side, other, paths, keys in (
        ("left", "right", lefts, naming.left_keys),
        ("right", "left", rights, naming.right_keys),
    ):
        for path in paths:
            if path in used:
                continue
            key = keys.get(path)
            same = [] if key is None else by_key[side][key]
            partners = [] if key is None else by_key[other].get(key, [])
            if len(same) > 1:
                duplicate = next(candidate for candidate in same if candidate != path)
                ignored[path] = f"{side} has another image of the same name or number, {duplicate.name}"
            elif partners:
                ignored[path] = f"{other} has {len(partners)} images for it: {', '.join(p.name for p in partners)}"
            else:
                ignored[path] = f"has no {other} partner"
    return sorted(pairs, key=lambda pair: natural_key(pair.name))


def _drop_identical(pairs: list[ImagePair], ignored: dict[Path, str]) -> list[ImagePair]:
    """Pairs whose two files differ; the same bytes on both sides are no stereo pair."""
    kept = []
    for pair in pairs:
        if _are_same_bytes(pair.left_path, pair.right_path):
            ignored[pair.left_path] = f"is the same image as {pair.right_path}"
            ignored[pair.right_path] = f"is the same image as {pair.left_path}"
        else:
            kept.append(pair)
    if pairs and not kept:
        first = pairs[0]
        raise DataError(
            f"left and right are the same images (such as {first.left_path} and {first.right_path}): one file given twice, or both "
            "black or white all over; name each camera's own images, and see that they show something."
        )
    return kept


def _are_same_bytes(left: Path, right: Path) -> bool:
    """Missing files differ from everything: reading them reports them by name."""
    try:
        if os.path.samefile(left, right):
            return True
        return left.stat().st_size == right.stat().st_size > 0 and left.read_bytes() == right.read_bytes()
    except OSError:
        return False
