"""A few moments of `interruptions.py`, which cuts commands and looks at what is left; by hand it takes 50 of each."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["calibrate", "simulate"])
def test_whenever_a_command_is_cut_its_output_is_whole(verb):
    script = Path(__file__).with_name("interruptions.py")
    done = subprocess.run(
        [sys.executable, str(script), "--moments", "3", "--verbs", verb],
        cwd=script.parents[1],
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
