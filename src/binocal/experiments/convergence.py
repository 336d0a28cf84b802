"""The paper's figure 5 for solvers: what each one's loss is after every iteration, on the same corners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from binocal.calibrators import calibrate
from binocal.cameras import StereoRig
from binocal.experiments.case import Case, Made, Sample
from binocal.experiments.guesses import CornersForGuesses
from binocal.experiments.row import Measured, Row
from binocal.report.curves import Curve
from binocal.solvers.loop import listening

TABLE, LOSS = "figure 5", "loss"
CASE = "corners of 20 views, 0.05 px"
FALL = "iterations until 95 % of the loss's fall"
END = "iterations until within 5 % of the last loss"
SHARE = 0.05
AFTER = (*range(11), 12, 15, 20, 25, 30, 35, 40, 50, 60, 70, 80)
"""Iterations after which the loss is written down."""
PAPER = {("drl", FALL): 30.0, ("absolute-orientation", FALL): 70.0, ("wide-field", FALL): 70.0}
"""The paper's figure 5: its own algorithm near 30, its [8] and [11] near 70."""


@dataclass(frozen=True, slots=True)
class Traced:
    """A calibrator whose iterations are followed. ``choices`` take the place of the sample's."""

    label: str
    calibrator: str
    options: Mapping[str, Any] = field(default_factory=dict)
    choices: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self, sample: Sample) -> tuple[Made, ...]:
        """See :class:`binocal.experiments.case.Method`."""
        corners, _ = sample.evidence
        losses = _Losses()
        with listening(losses):
            made = calibrate(
                corners, calibrator=self.calibrator, options=self.options, **{**sample.choices, **self.choices}
            )
        return (Made(made.rig, made, loss_figures(losses.of_calibration())),)


class _Losses:
    """Mean squares of the residuals that each stage of a calibration works on, px²; one for each calibration."""

    def __init__(self) -> None:
        self._stages: list[list[float]] = []
        self._sizes: list[int] = []

    def __call__(self, problem: Any, state: Any, n_done: int) -> None:
        lengths2 = np.concatenate([np.ravel(side) for side in problem.residual_lengths2(state.estimate)])
        seen = lengths2[lengths2 > 0]
        if n_done == 0:
            self._stages.append([])
            self._sizes.append(len(seen))
        self._stages[-1].append(float(np.mean(seen)))

    def of_calibration(self) -> list[float]:
        """The loss at the start and after every iteration, up to the last stage that sees all corners: the others check it.

        Where a stage begins is no iteration: the loss that it begins with takes the place of the one that the stage before ended with.
        """
        last = max(i for i, size in enumerate(self._sizes) if size == max(self._sizes))
        losses: list[float] = []
        for stage in self._stages[: last + 1]:
            losses[-1:] = stage
        return losses


def iterations_until(losses: Sequence[float], most: float) -> int:
    """After how many iterations the loss stays at most so large."""
    above = np.flatnonzero(np.array(losses) > most)
    return int(above[-1]) + 1 if above.size else 0


def loss_figures(losses: Sequence[float]) -> dict[str, tuple[float, str]]:
    """When the loss has converged, and what it is along the way; after the last iteration it stays."""
    first, last = losses[0], losses[-1]
    figures: dict[str, tuple[float, str]] = {
        FALL: (float(iterations_until(losses, last + SHARE * (first - last))), ""),
        END: (float(iterations_until(losses, (1 + SHARE) * last)), ""),
    }
    return figures | {_after(n): (losses[min(n, len(losses) - 1)], "px²") for n in AFTER}


def _after(n_iterations: int) -> str:
    return f"loss after iteration {n_iterations}"


def as_traced(made: Made, sample: Sample) -> list[Measured]:
    """The iterations in the table of figure 5, the losses in one of their own, which is drawn."""
    return [
        Measured(name, unit, value, table=TABLE if name in (FALL, END) else LOSS)
        for name, (value, unit) in made.said.items()
    ]


def convergence_cases(prior: StereoRig) -> list[Case]:
    """Every calibrator for boards that iterates here; OpenCV does not tell its iterations."""
    baseline = {"baseline_m": prior.baseline_m}
    names = ("drl", "drl-increments", "lm", "alternating", "absolute-orientation", "heterogeneous")
    methods = (
        *(Traced(name, name) for name in names),
        Traced("wide-field", "wide-field", choices={"model": "fisheye4"}),
        Traced("from-guess", "from-guess", baseline),
        Traced("lm from the guess", "from-guess", {**baseline, "agent": "lm"}),
    )
    return [Case(CASE, CornersForGuesses(prior), as_traced, methods, PAPER, TABLE)]


def loss_curves(rows: Sequence[Row]) -> list[Curve]:
    """The loss of every method by iteration: median over the seeds."""
    by_method: dict[str, dict[str, float]] = {}
    for row in rows:
        if row.table == LOSS and row.criterion is not None and row.median is not None:
            by_method.setdefault(row.calibrator, {})[row.criterion] = row.median
    return [Curve(label, AFTER, tuple(losses[_after(n)] for n in AFTER)) for label, losses in by_method.items()]
