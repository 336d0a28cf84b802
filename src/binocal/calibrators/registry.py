"""The calibrators by name: built-in ones, those that installed packages add, and the weights that :func:`binocal.app.train` wrote.

Each imports its method only when called.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from binocal import plugins
from binocal.calibrators.base import CalibrationRequest, Calibrator


def _lm() -> Calibrator:
    from binocal.calibrators.lm import calibrate_lm

    return calibrate_lm


def _drl() -> Calibrator:
    from binocal.calibrators.learned import calibrate_drl

    return calibrate_drl


def _drl_increments() -> Calibrator:
    from binocal.calibrators.learned import calibrate_drl_increments

    return calibrate_drl_increments


def _from_guess() -> Calibrator:
    from binocal.calibrators.from_guess import calibrate_from_guess

    return calibrate_from_guess


def _opencv() -> Calibrator:
    from binocal.calibrators.opencv import calibrate_opencv

    return calibrate_opencv


def _alternating() -> Calibrator:
    from binocal.calibrators.alternating import calibrate_alternating

    return calibrate_alternating


def _absolute_orientation() -> Calibrator:
    from binocal.calibrators.absolute_orientation import calibrate_absolute_orientation

    return calibrate_absolute_orientation


def _heterogeneous() -> Calibrator:
    from binocal.calibrators.heterogeneous import calibrate_heterogeneous

    return calibrate_heterogeneous


def _wide_field() -> Calibrator:
    from binocal.calibrators.wide_field import calibrate_wide_field

    return calibrate_wide_field


def _rectangles() -> Calibrator:
    from binocal.calibrators.rectangles import calibrate_rectangles

    return calibrate_rectangles


def _zoom() -> Calibrator:
    from binocal.calibrators.zoom import calibrate_zoom

    return calibrate_zoom


CALIBRATORS: dict[str, Callable[[], Calibrator]] = {
    "drl": _drl,
    "drl-increments": _drl_increments,
    "lm": _lm,
    "from-guess": _from_guess,
    "opencv": _opencv,
    "alternating": _alternating,
    "absolute-orientation": _absolute_orientation,
    "heterogeneous": _heterogeneous,
    "wide-field": _wide_field,
    "rectangles": _rectangles,
    "zoom": _zoom,
}


@dataclass(frozen=True, slots=True)
class Traits:
    """What a built-in calibrator takes: the kind of evidence (``board``, ``rectangles`` or ``zoom``), and what of a request.

    ``only_model`` is the one camera model that it solves for, None: any.
    """

    evidence: str = "board"
    only_model: str | None = None
    takes_skew: bool = True
    takes_prior: bool = True
    needs_prior: bool = False
    frees_board_and_exposures: bool = True
    takes_model: bool = True


_IN_STAGES = Traits(takes_prior=False, frees_board_and_exposures=False)
TRAITS: dict[str, Traits] = {
    "opencv": Traits(takes_skew=False, takes_prior=False, frees_board_and_exposures=False),
    "absolute-orientation": _IN_STAGES,
    "from-guess": Traits(takes_prior=False),
    "wide-field": Traits(only_model="fisheye4"),
    "rectangles": Traits(
        evidence="rectangles", takes_skew=False, needs_prior=True, frees_board_and_exposures=False, takes_model=False
    ),
    "zoom": Traits(evidence="zoom", takes_skew=False, takes_prior=False),
}
"""Of those that do not take everything."""


def evidence_of(name: str) -> str:
    """The kind of evidence that a calibrator works from."""
    return TRAITS.get(name, Traits()).evidence


def model_for(name: str, model: str) -> str:
    """The camera model to solve for: the only one that a calibrator has where ``auto`` is asked for."""
    return TRAITS.get(name, Traits()).only_model or model if model == "auto" else model


def unsuited(name: str, request: CalibrationRequest) -> str:
    """Why a calibrator cannot do what a request asks for, in one sentence; empty where it can."""
    traits, model = TRAITS.get(name, Traits()), model_for(name, request.model)
    if traits.only_model is not None and model != traits.only_model:
        return f"calibrator {name!r} solves for {traits.only_model} lenses alone; got {model}"
    if not traits.takes_model and request.model != "auto" and not _is_of_prior(request):
        return f"calibrator {name!r} takes the cameras of the prior, not {request.model}"
    if traits.needs_prior and request.prior is None:
        return f"calibrator {name!r} needs a prior: the cameras and the pose between them before they turned"
    if request.skew and not traits.takes_skew:
        return f"calibrator {name!r} knows no skew; drl and lm do"
    if request.prior is not None and not traits.takes_prior:
        return f"calibrator {name!r} takes no prior; drl and lm do"
    if not traits.frees_board_and_exposures:
        if request.board_shape not in ("auto", "flat"):
            return (
                f"calibrator {name!r} takes the board as drawn, not {request.board_shape}; drl and lm measure its shape"
            )
        if request.exposure == "apart":
            return f"calibrator {name!r} takes both exposures for one moment; drl and lm free them"
    return ""


def _is_of_prior(request: CalibrationRequest) -> bool:
    return request.prior is not None and request.model == request.prior.rig.left.model


def refuse_unsuited(name: str, request: CalibrationRequest) -> None:
    """Raises ValueError: the calibrator cannot do what the request asks for."""
    if why := unsuited(name, request):
        raise ValueError(why)


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
