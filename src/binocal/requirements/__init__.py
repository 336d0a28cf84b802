"""A rig against a stated need: requirements such as ``depth 1% at 5m``, the figure each asks for, and a verdict by ISO 14253-1.

:mod:`~binocal.requirements.requirement` reads them, :mod:`~binocal.requirements.figures` says how large the figure is, how well it is
known and where it is worst, :mod:`~binocal.requirements.verdict` decides.
"""

from __future__ import annotations

from binocal.requirements.figures import Figure, figure_of_calibration, freedom_of
from binocal.requirements.requirement import Requirement, parse_requirement
from binocal.requirements.verdict import Outcome, Verdict, decide

__all__ = [
    "Figure",
    "Outcome",
    "Requirement",
    "Verdict",
    "decide",
    "figure_of_calibration",
    "freedom_of",
    "parse_requirement",
]
