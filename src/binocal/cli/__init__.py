"""The command line: parses, calls one verb of :mod:`binocal.app`, presents. ``binocal.cli:main`` is the entry point.

Nothing heavy is imported before a verb runs, so that ``binocal --help`` answers at once.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code is returned (and used by the console script).

    0 fine, 1 failure while running, 2 usage, 3 input unusable, 4 finished but below the quality asked for,
    130 interrupted.
    """
    try:
        from binocal.cli.process import interrupted_by_signals, settle_process
        from binocal.cli.running import run

        settle_process()
        with interrupted_by_signals():
            return run(arguments)
    except KeyboardInterrupt:  # while the modules load: nothing was begun
        sys.stderr.write("binocal: interrupted; no file was left half written.\n")
        return 130
