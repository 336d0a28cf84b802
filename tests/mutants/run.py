"""Does the fast suite notice when a guard is taken out? ``make mutants``, or ``python tests/mutants/run.py [ID ...]``.

Each mutant of ``mutants.toml`` is one small change of the source: a comparison turned, a check left out, a sign flipped. It is made
in a copy of the source tree and the named tests are run on the copy. A mutant that they pass survives: the guard is not held by any
test. Prints a line for each and exits with 1 if one survives, with 2 if the list does not fit the source.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "binocal"
LIST = Path(__file__).with_name("mutants.toml")
LONGEST_RUN_S = 600  # an endless loop is noticed too


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change: ``old`` stands exactly once in ``file`` (below the package) and becomes ``new``; ``tests`` must notice."""

    id: str
    guard: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


def load_mutants() -> list[Mutant]:
    """The kept list, in order."""
    entries = tomllib.loads(LIST.read_text(encoding="utf-8"))["mutant"]
    return [Mutant(**{**entry, "tests": tuple(entry["tests"])}) for entry in entries]


def list_problems(mutants: list[Mutant]) -> list[str]:
    """Where the list no longer fits the source: a sentence each."""
    problems = [f"{m.id}: the id is used twice" for i, m in enumerate(mutants) if m.id in {n.id for n in mutants[:i]}]
    for mutant in mutants:
        path = PACKAGE / mutant.file
        count = path.read_text(encoding="utf-8").count(mutant.old) if path.is_file() else -1
        if count < 0:
            problems.append(f"{mutant.id}: there is no {mutant.file}")
        elif count != 1:
            problems.append(f"{mutant.id}: its text stands {count} times in {mutant.file}, not once: {mutant.old!r}")
        if mutant.old == mutant.new:
            problems.append(f"{mutant.id}: changes nothing")
        problems += [
            f"{mutant.id}: there is no {test}" for test in mutant.tests if not (ROOT / test.split("::")[0]).exists()
        ]
    return problems


def run_tests(source: Path, tests: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    """The fast ones of these tests on a source tree, until one fails."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-m", "not slow", "-p", "no:cacheprovider", "-n0", *tests]
    environment = os.environ | {"PYTHONPATH": str(source), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        return subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LONGEST_RUN_S, check=False
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 1, "did not end", "")


def is_killed(mutant: Mutant) -> tuple[bool, str]:
    """Whether the tests notice the mutant, and which one does (or how the run ended)."""
    with tempfile.TemporaryDirectory(prefix="binocal-mutant-") as folder:
        copy = Path(folder) / "binocal"
        shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__", "cpp"))
        path = copy / mutant.file
        path.write_text(path.read_text(encoding="utf-8").replace(mutant.old, mutant.new), encoding="utf-8")
        result = run_tests(Path(folder), mutant.tests)
    failed = [line for line in result.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    # 1: tests failed. Anything else, such as a mutant that cannot be imported, says nothing about the guard.
    return result.returncode == 1, failed[0] if failed else f"pytest exit code {result.returncode}"


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", help="only these mutants")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    mutants = load_mutants()
    problems = list_problems(mutants)
    unknown = set(arguments.ids) - {m.id for m in mutants}
    problems += [f"there is no mutant {name}" for name in sorted(unknown)]
    if problems:
        print(*problems, sep="\n", file=sys.stderr)
        return 2
    mutants = [m for m in mutants if not arguments.ids or m.id in arguments.ids]
    tests = tuple(dict.fromkeys(test for m in mutants for test in m.tests))
    plain = run_tests(PACKAGE.parent, tests)
    if plain.returncode:
        print("the tests fail without any mutant:", plain.stdout[-2000:], sep="\n", file=sys.stderr)
        return 2
    survivors = []
    with ThreadPoolExecutor(arguments.workers) as pool:
        for mutant, (killed, by) in zip(mutants, pool.map(is_killed, mutants), strict=True):
            print(f"{'killed  ' if killed else 'SURVIVES'} {mutant.id}: {mutant.guard} ({by})", flush=True)
            survivors += [] if killed else [mutant.id]
    print(f"{len(mutants) - len(survivors)} of {len(mutants)} mutants killed")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
