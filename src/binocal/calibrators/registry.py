"""The calibrators by name. Each entry imports its method only when called."""

from __future__ import annotations

from collections.abc import Callable

from binocal.calibrators.base import Calibrator


def _lm() -> Calibrator:
    from binocal.calibrators.lm import calibrate_lm

    return calibrate_lm


def _drl() -> Calibrator:
    from binocal.calibrators.learned import calibrate_drl

    return calibrate_drl


def _drl_increments() -> Calibrator:
    from binocal.calibrators.learned import calibrate_drl_increments

    return calibrate_drl_increments


CALIBRATORS: dict[str, Callable[[], Calibrator]] = {"drl": _drl, "drl-increments": _drl_increments, "lm": _lm}


def load_calibrator(name: str) -> Calibrator:
    """The calibrator of that name.

    Raises:
        ValueError: No such calibrator.
    """
    try:
        return CALIBRATORS[name]()
    except KeyError:
        raise ValueError(f"unknown calibrator {name!r}; known: {', '.join(CALIBRATORS)}") from None
