"""Which board poses to show next, so that a rig meets a requirement with few more views.

:mod:`~binocal.planning.candidates` says what each possible view would tell of the rig, :mod:`~binocal.planning.plan` chooses.
"""

from __future__ import annotations

from binocal.planning.plan import PlannedView, ViewPlan, plan_views

__all__ = ["PlannedView", "ViewPlan", "plan_views"]
