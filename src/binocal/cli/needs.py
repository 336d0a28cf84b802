"""Requirements, verdicts and plans on the command line: read from options, printed, as documents."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import typer

from binocal.app.needs import NeedReport
from binocal.cli.exits import one_line
from binocal.cli.tables import format_table
from binocal.planning import PlannedView, ViewPlan
from binocal.requirements import Outcome, Requirement, Verdict, parse_requirement
from binocal.values import counted

SHOWN_VIEWS = 8  # of a plan in the table; --json has all
_MARKS = {Outcome.PASS: "Pass", Outcome.FAIL: "FAIL", Outcome.UNDECIDED: "Undecided"}


def parse_needs(texts: Sequence[str] | None, *, is_metric: bool | None) -> tuple[Requirement, ...]:
    """The requirements of ``--require``; ``is_metric``: whether the board has a size, None where that is not known yet."""
    needs = []
    for text in texts or ():
        try:
            need = parse_requirement(text)
        except ValueError as error:
            raise typer.BadParameter(f"--require {error}.") from None
        if need.is_metric is not None and is_metric is not None and need.is_metric != is_metric:
            unit = (
                "metres, the board has no size: give its length a unit"
                if need.is_metric
                else "board pitches, the board in metres"
            )
            raise typer.BadParameter(f"--require {need.text!r} is in {unit}.")
        needs.append(need)
    return tuple(needs)


def needs_text(report: NeedReport, unit: tuple[str, float]) -> list[str]:
    """A line for each verdict, and a table for each plan; ``unit`` prints lengths."""
    lines = [f"{_MARKS[v.outcome]:<8} {one_line(v.sentence)}" for v in report.verdicts]
    for plan in report.plans:
        lines += _plan_lines(plan, unit)
    return lines


def _plan_lines(plan: ViewPlan, unit: tuple[str, float]) -> list[str]:
    need = plan.requirement
    if not plan.views:
        return [f"Plan     for {need.text}: none; {plan.why}"]
    n = len(plan.views)
    after = need.shown(plan.views[-1].figure)
    views = counted(n, "more view")
    head = (
        f"Plan     {views} meet{'s' if n == 1 else ''} {need.text}: {need.shown(plan.figure)} becomes {after}"
        if plan.is_enough
        else f"Plan     {views} {'does' if n == 1 else 'do'} not meet {need.text}: {need.shown(plan.figure)} becomes {after}; {plan.why}"
    )
    rows = [
        (
            f"{i}",
            f"({v.left_px[0]:.0f}, {v.left_px[1]:.0f})",
            f"{unit[1] * v.distance_m:.0f} {unit[0]}" if unit[0] == "mm" else f"{v.distance_m:.1f} {unit[0]}",
            f"{v.tilt_deg:.0f} deg",
            v.away,
            need.shown(v.figure),
        )
        for i, v in enumerate(plan.views[:SHOWN_VIEWS], start=1)
    ]
    table = format_table(("view", "board's centre", "distance", "tilt", "farther side", "then"), rows, align="rllrlr")
    lines = [head, *(f"         {line}" for line in table.splitlines())]
    return lines if n <= SHOWN_VIEWS else [*lines, f"         and {n - SHOWN_VIEWS} more (--json lists all)"]


def needs_document(report: NeedReport) -> dict[str, Any]:
    """Verdicts and plans as plain data."""
    return {
        "requirements": [_verdict_document(v) for v in report.verdicts],
        "plans": [_plan_document(p) for p in report.plans],
    }


def _verdict_document(verdict: Verdict) -> dict[str, Any]:
    need, figure = verdict.requirement, verdict.figure
    return {
        "requirement": need.text,
        "quantity": need.quantity,
        "outcome": str(verdict.outcome),
        "value": figure.value,
        "guard": figure.guard,
        "limit": need.limit,
        "unit": "share" if need.is_relative else need.unit,
        "where": figure.where,
        "text": verdict.sentence,
    }


def _plan_document(plan: ViewPlan) -> dict[str, Any]:
    return {
        "requirement": plan.requirement.text,
        "value": plan.figure,
        "is_enough": plan.is_enough,
        "why": plan.why,
        "views": [_view_document(view) for view in plan.views],
    }


def _view_document(view: PlannedView) -> dict[str, Any]:
    return {
        "left_px": view.left_px,
        "distance_m": view.distance_m,
        "tilt_deg": view.tilt_deg,
        "farther_side": view.away,
        "R": view.T_left_board.R,
        "T": view.T_left_board.t,
        "value": view.figure,
    }
