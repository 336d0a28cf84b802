"""Is a solved rig a result, or only a number? Every refusal and every warning of a solved rig, in one table.

None of the checks changes the rig. :data:`RULES` is the table; :func:`apply_rules` applies it.
"""

from __future__ import annotations

from binocal.acceptance.figures import corner_spacing_px
from binocal.acceptance.proof import fits_evenly, is_beyond_doubt
from binocal.acceptance.rules import OBSERVABILITY, OUTLIERS, RULES, Limit, Rule, apply_rules, findings_of_rules
from binocal.acceptance.views import contradicting_views, describe_views
from binocal.acceptance.whole_set import (
    exposure_findings,
    gap_findings,
    gross_motion,
    left_out_findings,
    scale_findings,
    weight_findings,
)

__all__ = [
    "OBSERVABILITY",
    "OUTLIERS",
    "RULES",
    "Limit",
    "Rule",
    "apply_rules",
    "contradicting_views",
    "corner_spacing_px",
    "describe_views",
    "exposure_findings",
    "findings_of_rules",
    "fits_evenly",
    "gap_findings",
    "gross_motion",
    "is_beyond_doubt",
    "left_out_findings",
    "scale_findings",
    "weight_findings",
]
