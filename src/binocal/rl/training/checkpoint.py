"""A run's checkpoint on disk: everything that going on needs."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import torch

from binocal.errors import FormatError
from binocal.input_file import check_ordinary
from binocal.output import write_aside
from binocal.rl.training.trainer import Training

VERSION = 1
_DAMAGED = (  # what unpickling bytes that are none raises
    *(OSError, RuntimeError, EOFError, pickle.UnpicklingError, ValueError, LookupError, TypeError),
    *(AttributeError, ImportError, ArithmeticError, MemoryError, AssertionError),
)


def save_checkpoint(training: Training, path: Path) -> None:
    """Writes a checkpoint; a kill while writing leaves the one before."""
    content = io.BytesIO()
    torch.save({"version": VERSION, **training.state()}, content)
    write_aside(path, content.getbuffer(), force=True)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """What :func:`save_checkpoint` wrote, for :meth:`binocal.rl.training.trainer.Training.restore`.

    Only open checkpoints of your own: the format can carry code.

    Raises:
        FormatError: The file is not a checkpoint of this version.
    """
    check_ordinary(path)
    try:
        state = torch.load(path, weights_only=False)
    except _DAMAGED as error:
        raise FormatError(path, f"not a readable checkpoint ({' '.join(str(error).split())[:200]}).") from None
    if not isinstance(state, dict) or state.get("version") != VERSION:
        raise FormatError(path, "a checkpoint of another version; train anew.")
    return state
