"""JSON documents that lose nothing: writing them, reading them with complaints that name file and key, keeping unknown keys."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from binocal.errors import FormatError
from binocal.input_file import read_text

_LARGEST = sys.float_info.max
_LARGEST_WHOLE = 2**53  # beyond it JSON readers disagree
MOST_DIGITS = 600  # of a whole number; Python may be set to convert no more than 640
_SURROGATE = re.compile("[\ud800-\udfff]")


def dump_json(document: Mapping[str, Any]) -> str:
    """JSON text of a document, one line per top-level key and per item of a list of records; NaN is an error."""
    lines = []
    for key, value in document.items():
        if isinstance(value, Sequence) and value and isinstance(value[0], Mapping):
            items = ",\n".join(f"    {json.dumps(item, allow_nan=False, ensure_ascii=False)}" for item in value)
            text = f"[\n{items}\n  ]"
        else:
            text = json.dumps(value, allow_nan=False, ensure_ascii=False)
        lines.append(f"  {json.dumps(key, ensure_ascii=False)}: {text}")
    text = "{\n" + ",\n".join(lines) + "\n}\n"
    # names of files may hold bytes that are no UTF-8; Python keeps them as lone surrogates
    return _SURROGATE.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def jsonable(value: Any) -> Any:
    """The value in JSON's own types; what is not finite becomes None, a dataclass a dictionary."""
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: jsonable(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, np.ndarray):
        return jsonable(value.tolist())
    if isinstance(value, np.generic):
        return jsonable(value.item())
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Sequence | set | frozenset):
        return [jsonable(item) for item in value]
    return str(value)


def unknown_keys(document: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """What ``document`` says beyond ``known``, its own rewriting: keys at any depth, records of a list by their labels."""
    unknown: dict[str, Any] = {}
    for key, value in document.items():
        if key not in known:
            unknown[key] = value
        elif isinstance(value, dict) and isinstance(known[key], dict):
            if inner := unknown_keys(value, known[key]):
                unknown[key] = inner
        elif (
            (records := _records(value)) is not None
            and (others := _records(known[key])) is not None
            and (inner := unknown_keys(records, others))
        ):
            unknown[key] = inner
    return unknown


def with_unknown_keys(document: dict[str, Any], unknown: Mapping[str, Any]) -> dict[str, Any]:
    """The document with what :func:`unknown_keys` kept; records that are gone take theirs with them."""
    merged = dict(document)
    for key, value in unknown.items():
        if key not in document:
            merged[key] = jsonable(value)
        elif isinstance(document[key], dict) and isinstance(value, Mapping):
            merged[key] = with_unknown_keys(document[key], value)
        elif (records := _records(document[key])) is not None and isinstance(value, Mapping):
            merged[key] = [with_unknown_keys(record, value.get(label, {})) for label, record in records.items()]
    return merged


def _records(value: Any) -> dict[str, dict[str, Any]] | None:
    """Records of a list by their names, or by their places where those are missing or not unique; None: no records."""
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        return None
    names = [item.get("name") for item in value]
    is_named = all(isinstance(name, str) for name in names) and len(set(names)) == len(names)
    return dict(zip(names if is_named else map(str, range(len(value))), value, strict=True))


@dataclass(frozen=True, slots=True)
class Node:
    """A JSON object that knows its file and its place in it, so that every complaint can name them."""

    path: Path
    place: str
    value: Mapping[str, Any]

    def _get(self, key: str, expected: str) -> Any:
        if key not in self.value:
            raise FormatError(self.path, f"key '{self.place}{key}' is missing; expected {expected}")
        return self.value[key]

    def fail(self, key: str, expected: str) -> FormatError:
        """The error of a key that holds something else than expected."""
        return FormatError(self.path, f"key '{self.place}{key}': expected {expected}, got {shown(self.value.get(key))}")

    def number(self, key: str, *, allow_null: bool = False) -> float:
        """A finite number; NaN for ``null`` where that is allowed."""
        expected = "a number or null" if allow_null else "a number"
        value = self._get(key, expected)
        if value is None and allow_null:
            return math.nan
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _LARGEST:
            raise self.fail(key, expected)
        return float(value)

    def integer(self, key: str) -> int:
        """A whole number."""
        value = self._get(key, "a whole number")
        if isinstance(value, bool) or not isinstance(value, int) or abs(value) > _LARGEST_WHOLE:
            raise self.fail(key, "a whole number")
        return value

    def boolean(self, key: str) -> bool:
        """The truth value under a key."""
        value = self._get(key, "true or false")
        if not isinstance(value, bool):
            raise self.fail(key, "true or false")
        return value

    def order(self, key: str) -> tuple[int, ...]:
        """A permutation of 0, 1, ...; empty where there is none."""
        value = self.value.get(key, [])
        if not isinstance(value, list) or not all(type(item) is int for item in value):
            raise self.fail(key, "a list of whole numbers")
        if any(not 0 <= item < len(value) for item in value) or len(set(value)) < len(value):
            raise self.fail(key, "each of 0 to n - 1 once")
        return tuple(value)

    def text(self, key: str) -> str:
        """A text."""
        value = self._get(key, "a text")
        if not isinstance(value, str):
            raise self.fail(key, "a text")
        return value

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        """One of some texts."""
        value = self.text(key)
        if value not in choices:
            raise self.fail(key, f"one of {', '.join(choices)}")
        return value

    def texts(self, key: str) -> list[str]:
        """A list of texts."""
        value = self._get(key, "a list of texts")
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self.fail(key, "a list of texts")
        return value

    def mapping(self, key: str) -> Node:
        """An object."""
        value = self._get(key, "an object")
        if not isinstance(value, dict):
            raise self.fail(key, "an object")
        return Node(self.path, f"{self.place}{key}.", value)

    def mappings(self, key: str) -> list[Node]:
        """A list of objects."""
        value = self._get(key, "a list of objects")
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.fail(key, "a list of objects")
        return [Node(self.path, f"{self.place}{key}[{i}].", item) for i, item in enumerate(value)]

    def array(self, key: str, shape: tuple[int, ...], *, allow_null: bool = False) -> np.ndarray:
        """Numbers of that shape; -1 is any length."""
        words = f"{'x'.join('n' if n < 0 else str(n) for n in shape)} numbers"
        value = self._get(key, words)
        if allow_null:
            value = _null_to_nan(value)
        try:
            array = np.array(value)
        except (ValueError, OverflowError, RecursionError):
            raise self.fail(key, words) from None
        if array.size == 0 and 0 in shape:
            return np.zeros(shape)
        is_numeric = array.dtype.kind in "if" and (allow_null or np.all(np.isfinite(array)))
        has_shape = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
        if not (is_numeric and has_shape):
            raise self.fail(key, words)
        return array.astype(float)


def _null_to_nan(value: Any) -> Any:
    if isinstance(value, list):
        return [_null_to_nan(item) for item in value]
    return math.nan if value is None else value


def shown(value: Any) -> str:
    """A value as a message quotes it: the beginning of its JSON text."""
    return json.dumps(value, default=str)[:60]


def _refuse_constant(word: str) -> Any:
    raise ValueError(f"it holds {word}; an unknown number is null")


def parse_whole(digits: str) -> int:
    """A whole number of a text; one with thousands of digits is an error of the text's, not of Python's settings."""
    if len(digits) > MOST_DIGITS:
        raise ValueError(f"it holds a whole number of {len(digits)} digits")
    return int(digits)


def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON; of a key that stands twice, nobody knows which value is meant."""
    value = dict(pairs)
    if len(value) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise ValueError(f"one object holds the key {shown(twice)} twice")
    return value


def load_document(path: str | Path, schema: str) -> Node:
    """The whole of a file of that schema.

    Raises:
        FormatError: The file cannot be read, is no JSON, or of another schema.
    """
    path = Path(path)
    text = read_text(path)
    try:
        value = json.loads(text, parse_constant=_refuse_constant, parse_int=parse_whole, object_pairs_hook=unique_keys)
    except RecursionError:
        raise FormatError(path, "is not JSON: it is nested too deeply") from None
    except ValueError as error:
        raise FormatError(path, f"is not JSON: {error}") from None
    if not isinstance(value, dict) or "schema" not in value:
        raise FormatError(path, f"is not a binocal file: key 'schema' is missing; expected \"{schema}\"")
    if value["schema"] != schema:
        raise FormatError(path, f"key 'schema': expected \"{schema}\", got {shown(value['schema'])}")
    return Node(path, "", value)
