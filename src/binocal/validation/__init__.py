"""A calibration put to the test on its own corners: halves of the views, a freer lens, the residuals, rays of all pixels.

Each check is a finding with a size, a note where all is well and a warning where not. They cost about as much as the solve itself, so
they are for whoever asks: ``binocal calibrate`` does by default. :mod:`~binocal.validation.halves`, :mod:`~binocal.validation.lens` and
:mod:`~binocal.validation.residuals` return arrays, which a report draws.
"""

from __future__ import annotations

from binocal.validation.checks import ValidationReport, validate
from binocal.validation.halves import CrossValidation, cross_validate
from binocal.validation.lens import LensAdequacy, measure_lens_adequacy
from binocal.validation.overview import CheckLine, overview
from binocal.validation.residuals import (
    SmoothedResiduals,
    Whiteness,
    corner_residuals,
    measure_whiteness,
    smooth_residuals,
)

__all__ = [
    "CheckLine",
    "CrossValidation",
    "LensAdequacy",
    "SmoothedResiduals",
    "ValidationReport",
    "Whiteness",
    "corner_residuals",
    "cross_validate",
    "measure_lens_adequacy",
    "measure_whiteness",
    "overview",
    "smooth_residuals",
    "validate",
]
