"""Cuts every verb that writes at many moments, by signals and by a full disk, and looks at what is left.

`python tests/interruptions.py [--moments 50] [--verbs simulate ...] [--ways INT TERM KILL DISK]`, from the project's root. Whatever the
moment, the output is the former one or the new one, never a mixture; a signal that can be handled and a full disk leave nothing else
and say so in a line; what a kill leaves is hidden and gone after the next run. The full disk is a small file system in memory, which
needs Linux's `unshare`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

BINOCAL = (sys.executable, "-m", "binocal")
BOARD = ("--board", "chessboard:9x6:20mm")
ON_IMAGES = ("--left", "../set/left_*.png", "--right", "../set/right_*.png", *BOARD)
WAYS = ("INT", "TERM", "KILL", "DISK")
LOADING_S = 0.12  # in which the interpreter itself starts: its own traceback is not ours
SLACK_BYTES = 64 << 10  # of a file system in memory: pages and names


@dataclass(frozen=True)
class Verb:
    """A command that writes into its working folder, and the same with other content for what was there before."""

    name: str
    former: tuple[str, ...]
    new: tuple[str, ...]


def _calibrate(model: str) -> tuple[str, ...]:
    outputs = ("--output", "rig.json", "--evidence", "corners.npz", "--opencv", "rig.yml")
    return ("calibrate", *ON_IMAGES, "--model", model, *outputs, "--force")


def _simulate(seed: int, pairs: int) -> tuple[str, ...]:
    return ("simulate", *BOARD, "--pairs", str(pairs), "--seed", str(seed), "--output", "set", "--force")


def _demo(seed: int) -> tuple[str, ...]:
    return ("demo", "--output", "demo", "--seed", str(seed), "--force")


VERBS = {
    verb.name: verb
    for verb in (
        Verb("simulate", _simulate(1, 2), _simulate(2, 1)),
        Verb("calibrate", _calibrate("brown5"), _calibrate("brown4")),
        Verb("demo", _demo(1), _demo(2)),
    )
}


def snapshot(folder: Path) -> dict[str, str]:
    """Every file by its name, hidden parts left out, with a digest of its content; times in a rig.json do not count."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not any(part.endswith(".part") for part in path.relative_to(folder).parts):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    return found


def parts(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*.part"))


def run(arguments: tuple[str, ...], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*BINOCAL, *arguments], cwd=folder, capture_output=True, text=True, errors="replace")


def cut_by_signal(verb: Verb, way: str, after_s: float, folder: Path) -> tuple[int, str]:
    """The exit code and stderr of the command, which gets the signal after a time."""
    process = subprocess.Popen(
        [*BINOCAL, *verb.new],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        process.wait(after_s)
    except subprocess.TimeoutExpired:
        process.send_signal(getattr(signal, f"SIG{way}"))
    _, said = process.communicate(timeout=600)
    return process.returncode, said


def run_on_small_disk(verb: Verb, size: int, folder: Path) -> tuple[int, str, dict[str, str], list[str]]:
    """The exit code, stderr, and what is there, of the command in a copy of the folder that has so many bytes more."""
    command = [sys.executable, __file__, "--on-disk", json.dumps([verb.new, str(folder), size])]
    mounted = ["unshare", "-rm", *command]
    done = subprocess.run(mounted, capture_output=True, text=True, check=True, cwd=folder.parent)
    return tuple(json.loads(done.stdout))  # type: ignore[return-value]


def _on_disk(new: tuple[str, ...], folder: str, size: int) -> None:
    """In a name space of its own: mounts the small file system over a folder beside, and runs there."""
    place = Path(folder).with_name("disk")
    place.mkdir(exist_ok=True)
    used = sum(-(-path.stat().st_size // 4096) * 4096 for path in Path(folder).rglob("*") if path.is_file())
    total = used + SLACK_BYTES + size
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={total}", "tmpfs", place], check=True)
    shutil.copytree(folder, place, dirs_exist_ok=True)
    done = run(tuple(new), place)
    print(json.dumps([done.returncode, done.stderr, snapshot(place), parts(place)]))


def problems(verb: Verb, ways: tuple[str, ...], moments: int, root: Path) -> Iterator[str]:
    """What is not as it should be; nothing, if all is well."""
    root.mkdir(parents=True)
    if verb.name == "calibrate":
        assert run(_simulate(0, 5), root).returncode == 0
    former, fresh = root / "former", root / "fresh"
    for folder, arguments in ((former, verb.former), (fresh, verb.new)):
        folder.mkdir()
        done = run(arguments, folder)
        assert done.returncode == 0, done.stderr
    shutil.copytree(former, root / "timed")
    began = time.monotonic()
    assert run(verb.new, root / "timed").returncode == 0
    took_s = time.monotonic() - began
    old, new = snapshot(former), snapshot(fresh)
    assert snapshot(root / "timed") == new != old, "the same command writes the same files"
    for way in ways:
        for is_first in (False, True) if way != "DISK" else (False,):
            for index in range(moments):
                before = {} if is_first else old
                work = root / "work"
                shutil.rmtree(work, ignore_errors=True)
                work.mkdir() if is_first else shutil.copytree(former, work)
                share = (index + 0.5) / moments
                if way == "DISK":
                    n_bytes = sum(path.stat().st_size for path in fresh.rglob("*") if path.is_file())
                    code, said, left, hidden = run_on_small_disk(verb, int(share * n_bytes), former)
                else:
                    code, said = cut_by_signal(verb, way, share * 1.05 * took_s, work)
                    left, hidden = snapshot(work), parts(work)
                where = (
                    f"{verb.name} {way} {'first' if is_first else 'again'} at {share:.2f}: code {code}, {said[-300:]!r}"
                )
                if left not in (before, new):
                    changed = sorted(name for name in left.keys() | new if left.get(name) != new.get(name))
                    yield f"{where}: a mixture, {changed}"
                if code == 0 and left != new:
                    yield f"{where}: fine, but not what it should be"
                if way != "KILL" and hidden:
                    yield f"{where}: left {hidden}"
                is_starting = way in ("INT", "TERM") and share * 1.05 * took_s < LOADING_S
                expected = {"INT": (0, 130), "TERM": (0, 130), "KILL": (0, -9), "DISK": (0, 1)}[way]
                if not is_starting and (code not in expected or (code in (1, 130) and said.count("\n") != 1)):
                    yield f"{where}: not one line and the right exit code"
                if way == "KILL" and hidden:
                    done = run(verb.new, work)
                    if done.returncode or snapshot(work) != new or parts(work):
                        yield f"{where}: the next run leaves {parts(work)}, {done.stderr}"
            print(f"{verb.name} {way}{' first' if is_first else ''}: {moments} moments of {took_s:.1f} s", flush=True)


def has_name_spaces() -> bool:
    """Whether a small file system of one's own can be mounted."""
    if shutil.which("unshare") is None:
        return False
    return subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode == 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=50)
    parser.add_argument("--verbs", nargs="*", default=sorted(VERBS))
    parser.add_argument("--ways", nargs="*", default=WAYS)
    parser.add_argument("--on-disk", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.on_disk:
        _on_disk(*json.loads(options.on_disk))
        return 0
    # a shell's background commands ignore SIGINT, and their children would; a handler of our own is not inherited
    signal.signal(signal.SIGINT, signal.default_int_handler)
    ways = tuple(options.ways)
    if "DISK" in ways and not has_name_spaces():
        print("no full disk: this system lets nobody mount one (unshare -rm)")
        ways = tuple(way for way in ways if way != "DISK")
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name in options.verbs:
            for problem in problems(VERBS[name], ways, options.moments, Path(folder) / name):
                found.append(problem)
                print(problem, flush=True)
    print(f"{len(found)} problems")
    return min(len(found), 1)


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(main())
