"""Which images are of one moment: by equal names, or by the nearest time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from binocal.datasets.folder import IMAGE_SUFFIXES
from binocal.datasets.naming import natural_key
from binocal.findings import finding, refusal

UNITS_NS = {19: 1, 16: 1000, 13: 1_000_000}  # by the number of digits of a time since 1970
MOST_NAMED = 5  # unmatched images named in a sentence; the data set lists all


def list_images(folder: Path, side: str) -> dict[str, Path]:
    """Images of a folder by their stem, in natural order.

    Raises:
        DataError: There is no such folder, or no image in it (finding ``dataset-side-missing``).
    """
    if not folder.is_dir():
        raise side_missing(folder, side, "there is no such folder")
    found = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and path.name[0] != "."]
    if not found:
        raise side_missing(folder, side, "it holds no image")
    return {path.stem: path for path in sorted(found, key=lambda path: natural_key(path.name))}


def side_missing(folder: Path, side: str, problem: str) -> Exception:
    """The refusal of a data set that lacks one camera's images."""
    return refusal(finding("dataset-side-missing", path=str(folder), side=side, problem=problem))


def match_by_name(
    left: Mapping[str, Path], right: Mapping[str, Path], places: tuple[Path, Path]
) -> list[tuple[str, Path, Path]]:
    """Images of equal names as (name, left, right), in the left ones' order; ``places`` are the two folders.

    Raises:
        DataError: An image has no partner (finding ``dataset-frames-unmatched``): published sets are complete, so a part is missing.
    """
    alone = [(name, path, places[1]) for name, path in left.items() if name not in right]
    alone += [(name, path, places[0]) for name, path in right.items() if name not in left]
    if alone:
        raise refusal(
            finding(
                "dataset-frames-unmatched",
                n_unmatched=len(alone),
                n_left=len(left),
                n_right=len(right),
                first=str(alone[0][1]),
                place=str(alone[0][2]),
                names=name_some(name for name, _, _ in alone),
            )
        )
    return [(name, path, right[name]) for name, path in left.items()]


def name_some(names: Iterable[str]) -> str:
    """The first few names, and how many more there are."""
    listed = list(names)
    more = f" and {len(listed) - MOST_NAMED} more" if len(listed) > MOST_NAMED else ""
    return ", ".join(listed[:MOST_NAMED]) + more


def match_by_time(left_ns: Sequence[int], right_ns: Sequence[int], tolerance_ns: float) -> list[tuple[int, int]]:
    """Indices (left, right) of times that are each other's nearest, at most ``tolerance_ns`` apart.

    Both lists are in ascending order.
    """
    nearest_right = _find_nearest(left_ns, right_ns)
    nearest_left = _find_nearest(right_ns, left_ns)
    return [
        (i, j)
        for i, j in enumerate(nearest_right)
        if nearest_left[j] == i and abs(left_ns[i] - right_ns[j]) <= tolerance_ns
    ]


def _find_nearest(times_ns: Sequence[int], others_ns: Sequence[int]) -> list[int]:
    """For each time the index of the nearest other one; integers, as a float holds no nanoseconds of our century."""
    nearest, j = [], 0
    for time in times_ns:
        while j + 1 < len(others_ns) and abs(others_ns[j + 1] - time) < abs(others_ns[j] - time):
            j += 1
        nearest.append(j)
    return nearest


def time_of_name_ns(name: str) -> int | None:
    """The time since 1970 that a file is named by, in nanoseconds; None where its name is no such time.

    Its length tells the unit: 19 digits are nanoseconds, 16 microseconds, 13 milliseconds, as of any time from 2001 to 2286.
    """
    digits = name if name.isdecimal() and name.isascii() and name[0] != "0" else ""
    return int(digits) * UNITS_NS[len(digits)] if len(digits) in UNITS_NS else None
