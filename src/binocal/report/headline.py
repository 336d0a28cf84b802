"""The verdict on a calibration in words, from what was found of it: the first line of a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.findings import KINDS, Finding, Severity
from binocal.report.numbers import three_digits, two_digits
from binocal.requirements import Outcome, Verdict
from binocal.requirements.figures import COVERAGE
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.uncertainty.maps import RangeMap
from binocal.validation.overview import POOR_DEPTH_PERCENT, worst_percent

GRAVE = frozenset(
    (
        "board-scale-uncertain", "corners-not-of-rig", "focal-length-uncertain", "halves-disagree", "image-size-doubtful",
        "image-size-suspect", "many-views-left-out", "prior-doubtful", "rests-on-few-views", "rig-changed", "rig-drifts",
        "rig-has-two-states", "scale-doubtful", "start-simplified",
    )
)  # fmt: skip
"""Warnings after which a rig should not be used before they are seen to; with the others it is usable with care."""
FIRST_OF_CARE = ("cameras-exchanged", "exposures-apart")  # what a user can mend at once
MOST_POINTS = 4
UNCHECKED = "Nothing was checked anew: the corners of the calibration are not at hand"


@dataclass(frozen=True, slots=True)
class Headline:
    """The verdict in words: ``level`` is ``good``, ``care`` or ``bad``; ``sentence`` stands first, ``points`` say why."""

    level: str
    sentence: str
    points: tuple[str, ...] = ()


def headline_of(
    calibration: StereoCalibration,
    findings: Sequence[Finding],
    verdicts: Sequence[Verdict] = (),
    at_boards: RangeMap | None = None,
) -> Headline:
    """The verdict: needs first, where some were stated, then the warnings, the gravest first, then what depth is good to."""
    warnings = by_weight(findings)
    is_grave = bool(warnings) and warnings[0].code in GRAVE
    depth = depth_sentence(calibration, at_boards)
    poor = poor_depth(at_boards)
    titles = list(dict.fromkeys(_title(found) for found in warnings))
    outcomes = [v.outcome for v in verdicts]
    n = len(verdicts)
    if Outcome.FAIL in outcomes:
        level, sentence = "bad", f"Not good enough: {_count(outcomes.count(Outcome.FAIL), n)} not met."
    elif is_grave:
        level, sentence = "bad", f"Do not rely on this rig yet: {_lower(titles[0])}{' and ' + poor if poor else ''}."
        titles = titles[1:]
    elif Outcome.UNDECIDED in outcomes:
        level = "care"
        sentence = f"Not proven to be good enough: {_count(outcomes.count(Outcome.UNDECIDED), n)} undecided."
    elif warnings:
        level = "care"
        met = f"all {n} needs are met" if n > 1 else "the need is met" if n else ""
        more = f" (and {len(titles) - 1} more warning{'s' if len(titles) > 2 else ''})" if len(titles) > 1 else ""
        sentence = (
            f"Use with care: {met + ', but ' if met else ''}{_lower(titles[0])}{more}{', and ' + poor if poor else ''}."
        )
        titles = titles[1:]
    elif poor and not n:
        level, sentence = "care", f"Use with care: {poor}."
        titles = [] if calibration.evidence is not None else [UNCHECKED]
    elif not n and calibration.evidence is None:
        level, sentence, titles = "good" if depth else "care", "No fault is known.", [UNCHECKED]
    else:
        level = "good"
        met = (
            f"Good enough: all {n} needs are met"
            if n > 1
            else "Good enough: the need is met"
            if n
            else "No fault found"
        )
        sentence = f"{met}."
    needs = [v.sentence for v in sorted(verdicts, key=_order)]
    points = [_closed(point) for point in [*needs, *titles][:MOST_POINTS]]
    return Headline(level, sentence, (*points, depth) if depth else tuple(points))


def by_weight(findings: Sequence[Finding]) -> list[Finding]:
    """The warnings, those first after which the rig should not be used."""

    def rank(found: Finding) -> int:
        if found.code in GRAVE:
            return 0
        return 1 + FIRST_OF_CARE.index(found.code) if found.code in FIRST_OF_CARE else 1 + len(FIRST_OF_CARE)

    return sorted((found for found in findings if found.severity is Severity.WARNING), key=rank)


def depth_sentence(calibration: StereoCalibration, at_boards: RangeMap | None) -> str:
    """What depth is good to at the boards' distance; empty where that is not known."""
    if at_boards is None or not at_boards.field.is_common.any():
        return ""
    unit = "m" if calibration.rig.is_metric else "board pitches"
    relative = _relative_percent(at_boards)
    middle, worst = float(relative[at_boards.field.middle]), float(np.nanmax(relative))
    distance = f"{three_digits(at_boards.field.depth_m)} {unit}"
    return (
        f"At {distance}, where the boards were, the calibration leaves depth uncertain by {two_digits(middle)} % in the middle of the "
        f"common view and by {two_digits(worst)} % at its worst place (95 %)."
    )


def poor_depth(at_boards: RangeMap | None) -> str:
    """What is to be said first of depth that is known badly somewhere; empty where it is known well all over."""
    worst = 0.0 if at_boards is None else worst_percent(at_boards)
    return "" if worst < POOR_DEPTH_PERCENT else f"depth is uncertain by up to {two_digits(worst)} % (95 %)"


def _relative_percent(at_boards: RangeMap) -> Float[ndarray, "rows columns"]:
    """The 95 % error of depth that is the calibration's, at each place."""
    return COVERAGE * 100 * at_boards.depth.calibration_m / at_boards.depth.depth_m


def _order(verdict: Verdict) -> int:
    return (Outcome.FAIL, Outcome.UNDECIDED, Outcome.PASS).index(verdict.outcome)


def _title(found: Finding) -> str:
    kind = KINDS.get(found.code)
    return kind.title if kind is not None else found.text


def _count(n: int, of: int) -> str:
    return f"{n} of {of} needs are" if of > 1 else "the need is"


def _closed(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else text + "."


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:] if not text[1:2].isupper() else text
