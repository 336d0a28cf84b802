"""The process of a command: its settings give way to the user's, and what it looks for at its end."""

import os
import subprocess
import sys

SHOW = """
import gc, os
from binocal.cli.process import settle_process
settle_process()
import atexit
atexit._run_exitfuncs()
print(os.environ["OPENBLAS_NUM_THREADS"], gc.get_threshold()[0], gc.get_freeze_count() > 0)
"""


def _settled(**env):
    shown = subprocess.run(
        [sys.executable, "-c", SHOW], env=os.environ | env, capture_output=True, text=True, check=True
    )
    return shown.stdout.split()


def test_a_command_collects_garbage_seldom_and_not_when_it_ends():
    assert _settled()[1:] == ["100000", "True"]


def test_the_users_own_setting_stays():
    assert _settled(OPENBLAS_NUM_THREADS="3")[0] == "3"
