"""The calibrators by name, or by the weights that :func:`binocal.app.train` wrote. Each imports its method only when called."""

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


WEIGHTS_SUFFIX = ".safetensors"


def load_calibrator(name: str) -> Calibrator:
    """The calibrator of that name, or led by the agent in that file of weights.

    Raises:
        ValueError: No such calibrator.
        FormatError: The file of weights cannot be read, or fits another version.
    """
    if name.endswith(WEIGHTS_SUFFIX):
        from binocal.calibrators.learned import calibrator_of_weights

        return calibrator_of_weights(name)
    try:
        return CALIBRATORS[name]()
    except KeyError:
        known = ", ".join(CALIBRATORS)
        raise ValueError(f"unknown calibrator {name!r}; known: {known}, or a {WEIGHTS_SUFFIX} file") from None
