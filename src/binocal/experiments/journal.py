"""The results of an experiment as they come, one line of JSON each: what was done is not done again after a cut."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from binocal.errors import FormatError, OutputError
from binocal.experiments.case import Result
from binocal.experiments.row import NAN, Measured

Key = tuple[str, str, int]
"""Case, method, seed."""


class Journal:
    """An append-only file. Its first line says what the experiment is; a last line that was cut is taken away.

    Every line is on the disk before :meth:`add` returns.

    Raises:
        FormatError: The file is of another experiment, or none.
        OutputError: It cannot be written.
    """

    def __init__(self, path: Path, experiment: Mapping[str, Any]) -> None:
        self.path = path
        self.results: dict[Key, Result] = {}
        begin = _line({"experiment": experiment})
        content = path.read_bytes() if path.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        lines = whole.splitlines()
        if lines and lines[0] != begin.strip():
            raise FormatError(
                path, "the journal of another experiment; choose another folder, or --force to begin anew"
            )
        for number, line in enumerate(lines[1:], 2):
            self._take(number, line)
        try:
            self._file = path.open("r+b" if path.exists() else "w+b")
            self._file.truncate(len(whole))
            self._file.seek(len(whole))
            if not lines:
                self._write(begin)
        except OSError as error:
            raise OutputError(path, error.strerror or str(error)) from None

    def _take(self, number: int, line: bytes) -> None:
        try:
            entry = json.loads(line)
            measured = tuple(
                Measured(criterion, unit, _number(value), _number(bound), table)
                for criterion, unit, value, bound, table in entry["measured"]
            )
            result = Result(entry["case"], entry["calibrator"], entry["seed"], measured, entry["failure"])
        except (ValueError, KeyError, TypeError) as error:
            raise FormatError(self.path, f"line {number} is no result ({error}); --force begins anew") from None
        self.results[result.case, result.calibrator, result.seed] = result

    def has(self, case: str, calibrator: str, seed: int) -> bool:
        """Whether that was done."""
        return (case, calibrator, seed) in self.results

    def add(self, result: Result) -> None:
        """One more result."""
        measured = [[m.criterion, m.unit, _plain(m.value), _plain(m.bound), m.table] for m in result.measured]
        entry = {"case": result.case, "calibrator": result.calibrator, "seed": result.seed}
        try:
            self._write(_line(entry | {"measured": measured, "failure": result.failure}))
        except OSError as error:
            raise OutputError(self.path, error.strerror or str(error)) from None
        self.results[result.case, result.calibrator, result.seed] = result

    def _write(self, line: bytes) -> None:
        self._file.write(line)
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """No more results."""
        self._file.close()


def _line(entry: Mapping[str, Any]) -> bytes:
    return json.dumps(entry, sort_keys=True, ensure_ascii=False).encode() + b"\n"


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return NAN if value is None else float(value)
