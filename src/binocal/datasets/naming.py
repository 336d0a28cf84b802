"""What distinguishes the left images' names from the right ones', and what is left to pair them by."""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

_TOKEN = re.compile(r"\d+|[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^\W\d_]+|[\W_]+")
# Words that name a side; a substitution of one of them by its opposite is believed before any other one.
_OPPOSITES = frozenset(
    (
        ("left", "right"),
        ("l", "r"),
        ("lft", "rgt"),
        ("lhs", "rhs"),
        ("0", "1"),
        ("1", "2"),
        ("00", "01"),
        ("01", "02"),
        ("a", "b"),
        ("master", "slave"),
        ("top", "bottom"),
        ("first", "second"),
    )
)
_MOST_COMBINATIONS = 40_000  # bounds the search for substitutions on huge folders: 200 x 200 names

_Substitution = tuple[int, str, str]  # token position (-1: wherever it stands), its text on the left, on the right


@dataclass(frozen=True, slots=True)
class Naming:
    """A key (equal on both sides for images of one moment) and a readable name for each path."""

    left_keys: dict[Path, object]
    right_keys: dict[Path, object]
    left_names: dict[Path, str]


def natural_key(text: str) -> list[tuple[int, int, str]]:
    """Sorting key that puts 2 before 10."""
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", text) if part]


def find_naming(lefts: Sequence[Path], rights: Sequence[Path]) -> Naming | None:
    """The naming that pairs most images; None where nothing is shared.

    Tried in this order of belief: the file's stem, the path below the common folder, the numbers that vary. A
    substitution of tokens (left -> right) makes the rest comparable; a number counts as the side's mark only where it
    is constant over the side.
    """
    folder = _common_folder([*lefts, *rights])
    views: list[Callable[[Path], str]] = [
        lambda path: path.stem,
        lambda path: str(path.absolute().relative_to(folder or path.absolute().anchor).with_suffix("")),
    ]
    best: tuple[tuple[int, int, int], Naming] | None = None
    for view in views:
        for substitutions in _list_substitutions(lefts, rights, view):
            naming = _build_naming(lefts, rights, view, substitutions)
            n_pairs = _count_pairs(naming)
            is_opposite = all((a.lower(), b.lower()) in _OPPOSITES for _, a, b in substitutions)
            is_reversed = any((b.lower(), a.lower()) in _OPPOSITES for _, a, b in substitutions)
            score = (n_pairs, is_opposite - is_reversed, -len(substitutions))
            if n_pairs and (best is None or score > best[0]):
                best = (score, naming)
    for naming in _name_by_varying_numbers(lefts, rights):
        n_pairs = _count_pairs(naming)
        if n_pairs > (best[0][0] if best else 0):
            best = ((n_pairs, 0, 0), naming)
    return best[1] if best else None


def bear_different_numbers(left: Path, right: Path) -> bool:
    """Whether two names say which side they are of, and numbers that differ: left01 and right02 are of two moments, cam0 and cam1 not."""
    tokens = _tokens(left.stem), _tokens(right.stem)
    if len(tokens[0]) != len(tokens[1]):
        return False
    changed = [(a.lower(), b.lower()) for a, b in zip(*tokens, strict=True) if a.lower() != b.lower()]
    numbers = [(a, b) for a, b in changed if a.isdigit() and b.isdigit()]
    sides = [
        change for change in changed if change not in numbers and (change in _OPPOSITES or change[::-1] in _OPPOSITES)
    ]
    return bool(sides) and any(int(a) != int(b) for a, b in numbers)


def _tokens(text: str) -> tuple[str, ...]:
    return tuple(_TOKEN.findall(text))


def _list_substitutions(
    lefts: Sequence[Path], rights: Sequence[Path], view: Callable[[Path], str]
) -> list[tuple[_Substitution, ...]]:
    """Sets of token changes that turn some left name into some right one, the most frequent first."""
    right_tokens: dict[int, list[tuple[Path, tuple[str, ...]]]] = defaultdict(list)
    for path in rights:
        right_tokens[len(_tokens(view(path)))].append((path, _tokens(view(path))))
    left_list = [(path, _tokens(view(path))) for path in lefts]
    names = [tokens for _, tokens in left_list], [_tokens(view(path)) for path in rights]
    constant = _constant_tokens(names[0]), _constant_tokens(names[1])
    common = _common_words(names[0]), _common_words(names[1])
    counts: Counter[tuple[_Substitution, ...]] = Counter()
    n_left = max(1, _MOST_COMBINATIONS // max(1, len(rights)))
    for path, tokens in left_list[:n_left]:
        for other, other_tokens in right_tokens[len(tokens)]:
            if other != path:
                substitutions = _compare(tokens, other_tokens, constant)
                if substitutions is not None and all(_can_tell_sides(s, common) for s in substitutions):
                    counts[substitutions] += 1
    return [substitutions for substitutions, _ in counts.most_common(30)]


def _constant_tokens(names: list[tuple[str, ...]]) -> set[tuple[int, str]]:
    """Tokens (position, text) that every name of a side has; none where the side has a single name."""
    if len(names) < 2:
        return set()
    return set.intersection(*({(index, token) for index, token in enumerate(tokens)} for tokens in names))


def _common_words(names: list[tuple[str, ...]]) -> set[str]:
    """Words in more than half of a side's names."""
    counts = Counter(token for tokens in names for token in set(tokens))
    return {token for token, count in counts.items() if 2 * count > len(names)}


def _can_tell_sides(substitution: _Substitution, common: tuple[set[str], set[str]]) -> bool:
    _, a, b = substitution
    return a.isdigit() or (a.lower(), b.lower()) in _OPPOSITES or (a in common[0] and b in common[1])


def _compare(
    left: tuple[str, ...], right: tuple[str, ...], constant: tuple[set[tuple[int, str]], set[tuple[int, str]]]
) -> tuple[_Substitution, ...] | None:
    """The changes from one name to the other; None where a change cannot be the mark of a side."""
    changes: list[_Substitution] = []
    for index, (a, b) in enumerate(zip(left, right, strict=True)):
        if a == b:
            continue
        if a.isdigit() and b.isdigit():
            if int(a) == int(b):
                continue
            if (index, a) not in constant[0] or (index, b) not in constant[1]:
                return None
            changes.append((index, a, b))
        elif a[0].isalpha() and b[0].isalpha():
            if (-1, a, b) not in changes:
                changes.append((-1, a, b))
        else:
            return None
    return tuple(changes)


def _build_naming(
    lefts: Sequence[Path], rights: Sequence[Path], view: Callable[[Path], str], substitutions: tuple[_Substitution, ...]
) -> Naming:
    left_marks = [(index, a) for index, a, _ in substitutions]
    right_marks = [(index, b) for index, _, b in substitutions]
    left_stripped = _strip(lefts, view, left_marks)
    right_stripped = _strip(rights, view, right_marks)
    names = {path: _readable(tokens) or path.stem for path, tokens in left_stripped.items()}
    return Naming(*_without_leading_zeros(left_stripped, right_stripped), names)


def _strip(
    paths: Sequence[Path], view: Callable[[Path], str], marks: list[tuple[int, str]]
) -> dict[Path, tuple[str, ...]]:
    """The tokens of each name with the side's marks blanked; names that lack a mark are left out."""
    stripped = {}
    for path in paths:
        tokens = list(_tokens(view(path)))
        for index, mark in marks:
            places = [i for i, token in enumerate(tokens) if token == mark and index in (-1, i)]
            if not places:
                break
            for place in places:
                tokens[place] = ""
        else:
            stripped[path] = tuple(tokens)
    return stripped


def _readable(tokens: tuple[str, ...]) -> str:
    text = re.sub(r"[\\/]+", "/", "".join(tokens))
    return re.sub(r"([_\-. ])[_\-. ]+", r"\1", text).strip(" _-./")


def _without_leading_zeros(
    left: dict[Path, tuple[str, ...]], right: dict[Path, tuple[str, ...]]
) -> tuple[dict[Path, object], dict[Path, object]]:
    """Keys in which 1 equals 01, unless one side holds both."""
    plain = [
        {path: tuple(str(int(t)) if t.isdigit() else t for t in tokens) for path, tokens in side.items()}
        for side in (left, right)
    ]
    for side, keys in zip((left, right), plain, strict=True):
        if len(set(keys.values())) < len(set(side.values())):
            return dict(left), dict(right)
    return dict(plain[0]), dict(plain[1])


def _name_by_varying_numbers(lefts: Sequence[Path], rights: Sequence[Path]) -> list[Naming]:
    """Namings by the stem's numbers that change within a side, together or one alone.

    The last resort for unlike names.
    """
    sides = []
    for paths in (lefts, rights):
        numbers = {path: tuple(re.findall(r"\d+", path.stem)) for path in paths}
        if len(paths) < 2 or len({len(n) for n in numbers.values()}) != 1:
            return []
        columns = list(zip(*numbers.values(), strict=True))
        varying = [index for index, column in enumerate(columns) if len(set(column)) > 1]
        sides.append({path: tuple(n[index] for index in varying) for path, n in numbers.items()})
    n_left, n_right = (len(next(iter(side.values()))) for side in sides)
    if not n_left or not n_right:
        return []
    choices = [(slice(None), slice(None))] + [
        (slice(i, i + 1), slice(j, j + 1)) for i in range(n_left) for j in range(n_right)
    ]
    namings = []
    for left_part, right_part in choices:
        left = {path: key[left_part] for path, key in sides[0].items()}
        right = {path: key[right_part] for path, key in sides[1].items()}
        if len(set(left.values())) == len(left) and len(set(right.values())) == len(right):
            namings.append(
                Naming(*_without_leading_zeros(left, right), {path: "_".join(key) for path, key in left.items()})
            )
    return namings


def _common_folder(paths: Sequence[Path]) -> Path | None:
    """The folder above all of them, some of which may be relative; None where there is none, as on two Windows drives."""
    parents = [path.absolute().parent for path in paths]
    try:
        return Path(os.path.commonpath(parents))
    except ValueError:
        return None


def _count_pairs(naming: Naming) -> int:
    """Keys that exactly one left and one other right image bear."""
    lefts, rights = Counter(naming.left_keys.values()), Counter(naming.right_keys.values())
    single_left = {key: path for path, key in naming.left_keys.items() if lefts[key] == 1}
    single_right = {key: path for path, key in naming.right_keys.items() if rights[key] == 1}
    return sum(single_left[key] != single_right[key] for key in single_left.keys() & single_right.keys())
