"""Pass, fail or undecided: a figure with its own uncertainty against a limit.

Source: ISO 14253-1 (2017), decision rules for verifying conformity: what is proven to lie within the limit passes, what is proven to
lie beyond it fails, and in between, in the guard band about the limit, nothing is proven.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from binocal.requirements.figures import Figure
from binocal.requirements.requirement import Requirement


class Outcome(StrEnum):
    """What is proven of a requirement."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"


@dataclass(frozen=True, slots=True)
class Verdict:
    """A requirement, the figure that it asks for, and what is proven."""

    requirement: Requirement
    figure: Figure
    outcome: Outcome

    @property
    def sentence(self) -> str:
        """The verdict in words: what, how large, where worst, why."""
        need, figure = self.requirement, self.figure
        words = {
            Outcome.PASS: "met",
            Outcome.FAIL: "not met",
            Outcome.UNDECIDED: "undecided",
        }[self.outcome]
        text = f"{need.text}: {words}"
        if not np.isfinite(figure.value):
            return f"{text}; {figure.why}"
        text += f"; {figure.what} is {need.shown(figure.value)} ± {need.shown(figure.guard)}"
        if figure.where:
            text += f", worst {figure.where}"
        if self.outcome is Outcome.UNDECIDED:
            text += "; the limit lies within what the figure is known to"
        return text + (f"; {figure.why}" if figure.why else "")


def decide(requirement: Requirement, figure: Figure) -> Verdict:
    """The verdict on a figure. One that is unknown proves nothing, unless it is known to be beyond measure."""
    if figure.is_impossible:
        outcome = Outcome.FAIL
    elif not np.isfinite(figure.value):
        outcome = Outcome.UNDECIDED
    elif figure.value + figure.guard <= requirement.limit:
        outcome = Outcome.PASS
    elif figure.value - figure.guard > requirement.limit:
        outcome = Outcome.FAIL
    else:
        outcome = Outcome.UNDECIDED
    return Verdict(requirement, figure, outcome)
