"""What a training run went through, as plain arrays: the material of the paper's figure 5."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, fields
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy import ndarray

from binocal.errors import FormatError
from binocal.input_file import check_ordinary
from binocal.output import write_aside
from binocal.shapes import Float, Int

SCHEMA = "binocal-training/1"
CONVERGED_SHARE = 0.05  # of the loss's whole fall
SMOOTHED_SHARE = 0.02  # of the run; single updates scatter by more than the share above
TARGETS = ("soft", "hard")


@dataclass(frozen=True, slots=True, eq=False)
class TrainingHistory:
    """One run: its seed, its kind of targets, and what was measured on the way.

    ``step`` counts updates; ``critic_loss`` (squared rewards) and ``target_lag`` (RMS difference of the actor's parameters and its
    target's; NaN where it was not measured) belong to it. ``value_predicted`` and ``value_monte_carlo`` are the critic's value of held-out
    states and the discounted return that followed. The last three belong together: at ``held_out_step``, the share of
    held-out rigs that arrive, and their mean iterations, failures counted as the longest episode.
    """

    targets: str
    seed: int
    step: Int[ndarray, "n"]
    critic_loss: Float[ndarray, "n"]
    target_lag: Float[ndarray, "n"]
    value_predicted: Float[ndarray, "m"]
    value_monte_carlo: Float[ndarray, "m"]
    held_out_step: Int[ndarray, "k"]
    held_out_success: Float[ndarray, "k"]
    held_out_iterations: Float[ndarray, "k"]

    def __post_init__(self) -> None:
        if self.targets not in TARGETS:
            raise ValueError(f"targets must be soft or hard; got {self.targets!r}")
        for name in _ARRAYS:
            array = np.array(getattr(self, name), dtype=int if name.endswith("step") else float)
            if array.ndim != 1:
                raise ValueError(f"{name} must have one axis; got shape {array.shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        for group in (_ARRAYS[:3], _ARRAYS[3:5], _ARRAYS[5:]):
            lengths = {name: len(getattr(self, name)) for name in group}
            if len(set(lengths.values())) > 1:
                raise ValueError(f"arrays that belong together differ in length: {lengths}")

    @property
    def converged_step(self) -> int | None:
        """The paper's convergence: the first step from which the loss stays within 5 % of its whole fall from where it ends.

        It is the loss averaged over 2 % of the run that counts. None where it never fell.
        """
        return converged_step(self.step, self.critic_loss)


_ARRAYS = tuple(f.name for f in fields(TrainingHistory) if f.name not in ("targets", "seed"))


def converged_step(step: Int[ndarray, "n"], loss: Float[ndarray, "n"]) -> int | None:
    """See :attr:`TrainingHistory.converged_step`."""
    smooth = smoothed(loss)
    if len(smooth) < 2:
        return None
    final, fall = smooth[-1], smooth.max() - smooth[-1]
    if not fall > 0:
        return None
    outside = np.flatnonzero(np.abs(smooth - final) > CONVERGED_SHARE * fall)
    return int(step[outside[-1] + 1])


def smoothed(loss: Float[ndarray, "n"]) -> Float[ndarray, "n"]:
    """The mean over the last 2 % of the run; over less at its beginning."""
    width = max(1, round(SMOOTHED_SHARE * len(loss)))
    total = np.concatenate([[0.0], np.cumsum(loss)])
    end = np.arange(1, len(loss) + 1)
    begin = np.maximum(end - width, 0)
    return (total[end] - total[begin]) / (end - begin)


def write_history(history: TrainingHistory, path: Path) -> None:
    """Writes ``.npz``, whole or not at all."""
    label = json.dumps({"schema": SCHEMA, "targets": history.targets, "seed": history.seed})
    content = io.BytesIO()
    np.savez_compressed(content, label=np.array(label), **{name: getattr(history, name) for name in _ARRAYS})
    write_aside(path, content.getvalue(), force=True)


def load_history(path: Path) -> TrainingHistory:
    """Reads what :func:`write_history` wrote.

    Raises:
        FormatError: The file is not a training history.
        OSError: There is no such file.
    """
    if path.exists():
        check_ordinary(path)
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            label = json.loads(str(file["label"]))
            if label["schema"] != SCHEMA:
                raise FormatError(path, f"schema {label['schema']!r} where {SCHEMA!r} was expected")
            return TrainingHistory(label["targets"], int(label["seed"]), *(file[name] for name in _ARRAYS))
    except (KeyError, ValueError, TypeError, EOFError, BadZipFile) as error:
        raise FormatError(path, f"not a training history: {error}") from error
