"""The calibrators by name: built-in ones, those that installed packages add, and the weights that :func:`binocal.app.train` wrote.

Each imports its method only when called.
"""

from __future__ import annotations

from collections.abc import Callable

from binocal import plugins
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
    """The calibrator of that name, or the one that the agent in that file of weights controls.

    Raises:
        ValueError: No such calibrator; the text names those that are known.
        PluginError: An installed package adds it, and it fails to load.
        FormatError: The file of weights cannot be read, or fits another version.
    """
    if name.endswith(WEIGHTS_SUFFIX):
        from binocal.calibrators.learned import calibrator_of_weights

        return calibrator_of_weights(name)
    if name in CALIBRATORS:
        return CALIBRATORS[name]()
    added = plugins.load_plugin(plugins.CALIBRATORS, name)
    if added is None:
        known = ", ".join(known_calibrators())
        raise ValueError(f"unknown calibrator {name!r}; known: {known}, or a {WEIGHTS_SUFFIX} file")
    return added


def known_calibrators() -> tuple[str, ...]:
    """Names of all calibrators, the built-in ones first."""
    added = plugins.plugin_names(plugins.CALIBRATORS)
    return (*CALIBRATORS, *(name for name in added if name not in CALIBRATORS))
