"""The verbs as typer commands. Each parses, calls :mod:`binocal.app`, presents, and returns an exit code.

The modules' order is that of the help.
"""

from __future__ import annotations

# isort: off
from binocal.cli.verbs import (  # noqa: F401 - each adds its own
    demo,
    board,
    calibrate,
    simulate,
    evaluate,
    report,
    channels,
    rectified,
    natural,
    train,
    experiment,
    bench,
)
from binocal.cli.options import app

# isort: on

__all__ = ["app"]
