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
    if arguments is None:  # a process of its own: whoever calls this as a function keeps his handlers
        _end_while_loading()
    from binocal.cli.process import end_on_signals, ignore_signals, settle_process
    from binocal.cli.running import run

    if arguments is None:
        end_on_signals("--json" in sys.argv)
    settle_process()
    code = run(arguments)
    if arguments is None:
        ignore_signals()
    return code


def _end_while_loading() -> None:
    """An interrupt before anything was begun is a line and its exit code; modules are loading, which an exception would break."""
    import os
    import signal

    def end(*_: object) -> None:
        os.write(2, b"binocal: interrupted; no file was left half written.\n")
        os._exit(130)

    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, end)
