"""The kinds of agents, by what their actions mean."""

from __future__ import annotations

from enum import StrEnum


class AgentKind(StrEnum):
    """What an agent's action is; the value is the name of the calibrator that uses it.

    ``DRL`` steers the robust solver: damping, kernel scale, stretch and correction of its next step. ``DRL_INCREMENTS`` changes R
    and T itself, as in the paper (section 3.2.2). ``DRL_STREETS`` steers the solve from matches of natural images; it is what
    ``recalibrate --calibrator drl`` uses.
    """

    DRL = "drl"
    DRL_INCREMENTS = "drl-increments"
    DRL_STREETS = "drl-streets"

    @staticmethod
    def of_stored(name: str) -> AgentKind:
        """The kind that a file names; files of 0.1 say ``steering`` and ``increments``.

        Raises:
            ValueError: No kind has that name.
        """
        return AgentKind({"steering": "drl", "increments": "drl-increments"}.get(name, name))
