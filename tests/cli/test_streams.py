"""Commands whose stdout or stderr takes nothing, says little, or is closed; commands that are interrupted: processes of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import cv2
import numpy as np
import pytest

from binocal.formats import rig_json
from rigs import make_calibration

UNKNOWN = ["evaluate", "n\udcff\xe9.json", "--truth", "none.json"]


def run(arguments, folder, shell_end="", **env):
    """The command through a shell, which redirects as ``shell_end`` says."""
    command = f'exec "$0" -m binocal "$@" {shell_end}'
    return subprocess.run(
        ["sh", "-c", command, sys.executable, *map(os.fsencode, arguments)],
        cwd=folder,
        env=os.environ | env,
        capture_output=True,
        timeout=60,
    )


def one_line(text: bytes) -> bytes:
    assert text.count(b"\n") == 1 and b"Traceback" not in text
    return text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("streams")
    rig_json.write_calibration(place / "rig.json", make_calibration())
    return place


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["calibrate", "--help"]])
def test_a_stdout_that_takes_nothing_is_one_line_and_a_failure(folder, arguments):
    for end in (">/dev/full", ">&-"):
        done = run(arguments, folder, end)
        assert done.returncode == 1 and b"stdout" in one_line(done.stderr)


def test_a_stderr_that_takes_nothing_changes_no_exit_code(folder):
    for end in ("2>/dev/full", "2>&-"):
        done = run([*UNKNOWN, "--json"], folder, end)
        assert done.returncode == 3 and json.loads(done.stdout)["error"]["code"] == "format"


def test_a_file_gets_no_closed_streams_number(folder):
    code = "import os; from binocal.cli.streams import settle_streams; settle_streams(); print(os.open('.', 0) > 2)"
    done = subprocess.run(
        ["sh", "-c", 'exec "$0" -c "$1" <&- 2>&-', sys.executable, code], cwd=folder, capture_output=True
    )
    assert done.stdout == b"True\n"


def test_names_that_are_not_utf8_are_escaped(folder):
    done = run([*UNKNOWN, "--json"], folder)
    assert done.returncode == 3 and b"n\\udcff" in one_line(done.stderr)
    assert json.loads(done.stdout)["error"]["path"] == "n\udcff\xe9.json"


def test_an_encoding_without_our_characters_is_no_failure(folder):
    done = run([*UNKNOWN, "--json"], folder, PYTHONIOENCODING="ascii")
    assert done.returncode == 3 and one_line(done.stderr) and done.stdout.isascii()
    assert json.loads(done.stdout)["error"]["path"] == "n\udcff\xe9.json"


INTERRUPT_WHILE_LOADING = """
import os, signal, sys, threading
class Interrupter:
    def find_spec(self, name, *_):
        if name == os.environ["AT"] and not self.done:
            self.done = True
            os.kill(os.getpid(), signal.SIGINT)
            if threading.current_thread() is not threading.main_thread():
                threading.Event().wait()  # as a module that another interrupted import holds up
    done = False
sys.meta_path.insert(0, Interrupter())
from binocal.cli import main
sys.exit(main())
"""


@pytest.mark.parametrize(
    "module",
    [
        "binocal.cli.process",
        "binocal.cli.running",
        "typer",
        "binocal.cli.verbs",
        "numpy",
        "binocal.app",
        "binocal.result",
    ],
)
def test_an_interrupt_while_modules_load_is_one_line(folder, module):
    arguments = ["evaluate", "rig.json", "--truth", "none.json", "--json"]
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPT_WHILE_LOADING, *arguments],
        cwd=folder,
        env=os.environ | {"AT": module},
        capture_output=True,
        timeout=60,
    )
    assert done.returncode == 130 and b"interrupted" in one_line(done.stderr)
    if module not in ("binocal.cli.process", "binocal.cli.running"):  # by then it knows what was asked for
        assert json.loads(done.stdout)["error"]["code"] == "interrupted"


def test_an_interrupt_while_another_thread_loads_modules_ends_all_threads(tmp_path):
    for side in ("left", "right"):
        for index in range(3):
            image = np.random.default_rng(index).integers(0, 255, (96, 128), dtype=np.uint8)
            cv2.imwrite(str(tmp_path / f"{side}{index}.png"), image)
    arguments = ["calibrate", "--left", "left*", "--right", "right*", "--board", "chessboard:9x6:20mm"]
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPT_WHILE_LOADING, *arguments],
        cwd=tmp_path,
        env=os.environ | {"AT": "binocal.calibrators.learned"},
        capture_output=True,
        timeout=60,
    )
    assert done.returncode == 130 and b"interrupted" in one_line(done.stderr)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_command_and_leaves_nothing(tmp_path, number):
    arguments = ["simulate", "--board", "chessboard:11x8:10mm", "--pairs", "500", "--output", "set"]
    process = subprocess.Popen(
        [sys.executable, "-m", "binocal", *arguments],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )
    while not any(tmp_path.glob(".set.*.part/left_*.png")):
        assert process.poll() is None
    process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130 and b"interrupted" in one_line(said) and os.listdir(tmp_path) == []


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path):
    arguments = ["simulate", "--board", "chessboard:11x8:10mm", "--pairs", "3", "--output", "set"]
    done = subprocess.run(
        ["sh", "-c", 'ulimit -f 100; exec "$0" -m binocal "$@"', sys.executable, *arguments],
        cwd=tmp_path,
        capture_output=True,
        timeout=60,
    )
    assert done.returncode == 1 and b"cannot be written" in one_line(done.stderr) and os.listdir(tmp_path) == []


def test_an_interrupt_when_all_is_done_changes_nothing(folder):
    code = "import os, signal, sys; from binocal.cli import main; code = main(); os.kill(os.getpid(), signal.SIGINT); sys.exit(code)"
    done = subprocess.run([sys.executable, "-c", code, "--version"], cwd=folder, capture_output=True, timeout=60)
    assert done.returncode == 0 and done.stderr == b"" and done.stdout.startswith(b"binocal ")
