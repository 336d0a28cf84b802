"""Sections about what comes next: what to do, and the board poses that would help most."""

from __future__ import annotations

from binocal.cameras import StereoRig
from binocal.planning import ViewPlan
from binocal.report import rig_figures
from binocal.report.axes import image_height
from binocal.report.contents import ReportContents
from binocal.report.headline import by_weight, poor_depth
from binocal.report.numbers import three_digits
from binocal.report.section import Picture, Section, Table
from binocal.report.svg import WIDTH_INCHES, figure_svg
from binocal.requirements import Outcome


def next_section(contents: ReportContents) -> Section:
    """What to do, in order: what warnings ask for, then views that needs ask for, then what tests the rig."""
    warnings = [found for found in by_weight(contents.findings) if found.remedy]
    steps = [_sentence(found.remedy) for found in warnings]
    is_open = any(verdict.outcome is not Outcome.PASS for verdict in contents.verdicts)
    for plan in contents.plans:
        if not plan.views:
            steps += [f"No plan for {plan.requirement.text}: {plan.why}."] if is_open else []
        elif is_open:
            enough = "which is enough" if plan.is_enough else f"which is not enough; {plan.why}"
            steps.append(f"Add {_count(plan)} drawn below for {plan.requirement.text}: {_change(plan)}, {enough}.")
        elif not contents.verdicts and poor_depth(contents.at_boards):
            steps.append(f"Add {_count(plan)} drawn below: the error of depth at its worst place, {_change(plan)}.")
    if warnings:
        steps.append("Calibrate anew, and make this report again.")
    else:
        steps.append(
            f"Test it on images that it has not seen: binocal evaluate {contents.name} --left 'LEFT*' --right 'RIGHT*' --board SPEC."
        )
        steps.append(f"Rectify and measure: binocal rectify {contents.name}, binocal depth {contents.name}.")
        steps.append(f"Look now and then whether it still holds: binocal check --rig {contents.name}.")
    return Section("next", "What to do next", steps=tuple(dict.fromkeys(steps)))


def plan_section(contents: ReportContents) -> Section | None:
    """The board poses to show next, as outlines in the left image, and as a table."""
    plans = [plan for plan in contents.plans if plan.views]
    points_m, rig = contents.board_points_m, contents.calibration.rig
    if not plans or points_m is None:
        return None
    pictures, tables = [], []
    for number, plan in enumerate(plans, start=1):
        figure = figure_svg(
            lambda axes, plan=plan: rig_figures.draw_plan(axes, plan, points_m, rig),
            name=f"plan-{number}",
            title=f"Outlines of the boards to show next in the left image, for {plan.requirement.text}",
            height=image_height(rig.left.size_wh, WIDTH_INCHES),
        )
        pictures.append(
            Picture(figure, f"{plan.requirement.text}: {_change(plan)}. The number stands in the board's first corner.")
        )
        tables.append(_plan_table(plan, rig))
    lead = (
        "Board poses that lower the figure fastest, in the order in which they help. Show the board about so; that it is exactly so does "
        "not matter."
    )
    return Section("plan", "Views to add", lead, tuple(pictures), tuple(tables))


def _plan_table(plan: ViewPlan, rig: StereoRig) -> Table:
    unit, factor = rig.printed_unit
    rows = [
        (
            f"{i}",
            f"({view.left_px[0]:.0f}, {view.left_px[1]:.0f})",
            f"{three_digits(factor * view.distance_m)} {unit}",
            f"{view.tilt_deg:.0f} deg",
            view.away,
            plan.requirement.shown(view.figure),
        )
        for i, view in enumerate(plan.views, start=1)
    ]
    head = ("view", "board's centre (px)", "distance", "tilt", "farther side", f"then {plan.requirement.quantity}")
    return Table(head, tuple(rows), f"Views for {plan.requirement.text}")


def _count(plan: ViewPlan) -> str:
    return f"the {len(plan.views)} views" if len(plan.views) > 1 else "the view"


def _change(plan: ViewPlan) -> str:
    need = plan.requirement
    return f"{need.shown(plan.figure)} becomes {need.shown(plan.views[-1].figure)}"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".") + "."
