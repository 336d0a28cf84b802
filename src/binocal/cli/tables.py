"""What a person reads: plain text that is the same on a terminal and in a log. Degrees and millimetres live here."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from binocal.app import CalibrationRun, DemoCase, ImageEvaluation, TrainedAgent, TruthEvaluation
from binocal.cameras import camera_model
from binocal.cli.exits import one_line
from binocal.cli.grouping import group_lines, list_names
from binocal.cli.streams import say
from binocal.metrics.common_rows import LEAST_VIEWS, CommonRows
from binocal.metrics.pose import ParameterError
from binocal.requirements.agreement import LEAST_P, Agreement
from binocal.result import RejectedView, StereoCalibration
from binocal.values import counted, with_sigma

CONVENTION = (
    "x_right = R x_left + t. R is the right camera turned from the left one's pose by pitch about its own x (right),\n"
    "then yaw about y (down), then roll about z (forward)."
)
SURE_SIGMAS = 3.0  # of a bow or stretch, to be shown


def list_left_out(ignored: Sequence[tuple[str, str]], rejected: Sequence[RejectedView], notes: Sequence[str]) -> None:
    """Everything that was left out, one line for each reason, on stderr."""
    lines = group_lines("ignored", "file", ignored)
    lines += group_lines("dropped", "view", [(view.name, view.reason) for view in rejected])
    for line in (*lines, *(f"note: {one_line(note)}" for note in notes)):
        say(line)


def calibration_text(
    run: CalibrationRun, output: Path, beside: Sequence[Path] = (), max_rms_px: float | None = None
) -> str:
    """Summary of a calibration: warnings first, then cameras, pair, fit, views."""
    calibration = run.calibration
    lines = [f"warning: {one_line(text)}" for text in calibration.warnings]
    if max_rms_px is not None and not calibration.rms.all_px <= max_rms_px:
        lines.append(f"warning: the RMS is {calibration.rms.all_px:.3f} px, above --max-rms {max_rms_px:g}.")
    lines += [""] if lines else []
    lines += [_cameras_table(calibration), "", _pair_table(calibration), ""]
    rms = calibration.rms
    lines.append(f"RMS      {rms.left_px:.3f} px left, {rms.right_px:.3f} px right, {rms.all_px:.3f} px together")
    lines.append(f"Corners  noise {calibration.noise_px:.3f} px per coordinate, {_outlier_words(calibration)}")
    lines += _real_lines(calibration)
    choice = calibration.provenance.get("model_choice")
    if choice:
        lines.append(f"Model    {one_line(choice['reason'])}")
    lines += _agent_lines(calibration)
    lines += _view_lines(calibration)
    if run.ignored:
        lines.append(f"Files    {len(run.ignored)} ignored (listed above, on stderr)")
    if run.elapsed_s:
        lines.append(
            f"Time     {run.elapsed_s['images']:.2f} s for the images, {run.elapsed_s['solve']:.2f} s to solve"
        )
    written = " and ".join(str(path) for path in (output, *beside))
    return "\n".join([*lines, f"Wrote    {written}"])


def _real_lines(calibration: StereoCalibration) -> list[str]:
    """What was found of the board, of the exposures, and of what views have in common."""
    lines = []
    shape, exposure = calibration.board_shape, calibration.exposure
    is_bent = shape is not None and (
        shape.bow_m > SURE_SIGMAS * shape.bow_sigma_m or abs(shape.stretch) > SURE_SIGMAS * shape.stretch_sigma
    )
    if shape is not None and is_bent:
        unit, factor = calibration.rig.printed_unit
        lines.append(
            f"Board    measured along: bow {with_sigma(factor * shape.bow_m, factor * shape.bow_sigma_m)} {unit}, x over y stretched by "
            f"{with_sigma(100 * shape.stretch, 100 * shape.stretch_sigma)} %; lengths are the drawing's to "
            f"{100 * shape.scale_sigma:.2g} %"
        )
    if exposure is not None and exposure.are_apart:
        lines.append(
            f"Exposure not together: each camera alone fits to {exposure.alone_px:.3f} px, the pair to {exposure.pair_px:.3f} px; "
            "every view's right pose was freed"
        )
    factor = calibration.provenance.get("views_in_common", {}).get("sigma_factor", 1.0)
    if factor > 1:
        lines.append(
            f"Sigmas   {factor:.1f} times those of the corner noise: errors are alike within views (delete-one-view jackknife)"
        )
    return lines


def _agent_lines(calibration: StereoCalibration) -> list[str]:
    """What the agent did, and which guard took over, if one did."""
    agent = calibration.provenance.get("agent")
    if not agent:
        return []
    n_controlled, n_all = agent["iterations"], calibration.n_iterations
    if not n_controlled and not any(solve["fallback_reason"] for solve in agent["solves"]):
        return ["Agent    not needed: the start was near enough for plain steps"]
    remaining = max((solve["remaining_sigma"] for solve in agent["solves"]), default=0.0)
    guards = sorted({solve["fallback_reason"] for solve in agent["solves"] if solve["fallback_reason"]})
    line = f"Agent    controlled {n_controlled} of {n_all} iterations, to {remaining:.2g} sigma from the optimum, which the others reached"
    return [line, *(f"         a guard took over: {one_line(guard)}" for guard in guards)]


def truth_text(evaluation: TruthEvaluation) -> str:
    """Every parameter beside the truth and the bound, then the paper's figures."""
    c = evaluation.comparison
    lines = [f"note: {one_line(note)}" for note in evaluation.notes]
    lines += [""] if lines else []
    rows = [_parameter_row(parameter) for parameter in c.parameters]
    lines.append(format_table(("parameter", "truth", "value", "error", "sigma", "error/bound", ""), rows))
    lines += ["", _criteria_table(evaluation)]
    return "\n".join(lines)


def images_text(evaluation: ImageEvaluation, is_metric: bool) -> str:
    """The criteria that need no truth."""
    pixel, row, length = evaluation.pixel_error, evaluation.row_error, evaluation.length_error
    rows = [
        (
            "pixel error (RMS, eq. 19)",
            f"{pixel.all_px:.3f} px",
            f"left {pixel.left_px:.3f}, right {pixel.right_px:.3f}",
        ),
    ]
    if row is not None:
        rows.append(("rectified row error (RMS)", f"{row.rms_px:.3f} px", f"median {row.median_px:+.3f}"))
    against = "" if is_metric else ", in board pitches"
    rows += [
        (
            "relative length error (RMS)",
            f"{length.scale_rms_percent:.4f} %",
            f"mean {length.scale_mean_percent:+.4f}, {counted(length.n_views, 'view')}{against}",
        ),
        ("error of a single side (RMS)", f"{length.side_rms_percent:.3f} %", f"{length.n_sides} sides")
        if length.n_sides
        else ("error of a single side (RMS)", "unknown", "no two neighbouring points seen"),
    ]
    table = format_table(("criterion", "", ""), rows, align="lrl")
    lines = [f"warning: {one_line(found.text)}" for found in evaluation.findings]
    lines += ["", table] if lines else [table]
    if evaluation.agreement is not None:
        lines.append(agreement_text(evaluation.agreement))
    else:
        lines.append(common_rows_text(evaluation.common_rows))
    return "\n".join([*lines, *_rejected_lines(evaluation.rejected, len(evaluation.names))])


def agreement_text(agreement: Agreement) -> str:
    """One line: do the images agree with the rig, with the p-value."""
    words = "agree" if agreement.agrees else "do not agree"
    return (
        f"Agreement: the images {words} with what the rig's standard deviations allow "
        f"(p = {max(agreement.p_value, LEAST_P):.2g}, {agreement.freedom} directions)"
    )


def common_rows_text(rows: CommonRows | None) -> str:
    """One line on a rig that states no standard deviations: the row error that the views share, with the p-value."""
    if rows is None:
        return f"Agreement: cannot be judged: the rig states no standard deviations, and there are fewer than {LEAST_VIEWS} views"
    return (
        f"Agreement: only by rows, without the rig's standard deviations: off by {rows.common_px:.2g} px (RMS) in all "
        f"{rows.n_views} views alike (p = {max(rows.p_value, LEAST_P):.2g}), by {rows.rest_px:.2g} px otherwise"
    )


def demo_text(cases: Sequence[DemoCase], output: Path) -> str:
    """Both boards side by side with the truth."""
    lines = []
    for case in cases:
        n_views = len(case.run.calibration.views)
        lines += [
            f"{case.name} board: {counted(n_views, 'pair')}, RMS {case.run.calibration.rms.all_px:.3f} px, corner noise "
            f"{case.run.calibration.noise_px:.4f} px",
            *(f"warning: {one_line(text)}" for text in case.run.calibration.warnings),
            "",
            truth_text(case.evaluation),
            f"{case.run.elapsed_s['images']:.2f} s for the images, {case.run.elapsed_s['solve']:.2f} s to solve",
            "",
        ]
    return "\n".join([*lines, f"Wrote images, truth.json and rig.json of both boards into {output}"])


def training_text(trained: TrainedAgent) -> str:
    """How a run went: held-out checks, the evaluation table, where the files lie."""
    run = trained.run
    lines = [] if not run.was_resumed else ["went on with the run that was cut here", ""]
    rows = [
        (
            f"{check.n_steps}",
            f"{check.critic_loss:.3f}",
            f"{check.value_predicted:.2f} / {check.value_returned:.2f}",
            f"{check.target_lag:.4f}",
            " ".join(f"{value:.2f}" for value in check.iterations),
            " ".join(f"{100 * value:.0f}" for value in check.success),
        )
        for check in run.checks
    ]
    head = ("steps", "critic loss", "value / return", "target lag", "held-out iterations", "arrived, %")
    lines += [format_table(head, rows), ""]
    if run.rows:
        evaluated = [row.cells[:-1] for row in run.rows]  # without settings, which are long
        header = run.rows[0].HEADER[:-1]
        lines += [format_table(header, evaluated, align="ll".ljust(len(header), "r")), ""]
    if trained.test_half is not None:
        rig = trained.test_half.rig
        lines += [
            f"second half: baseline {rig.baseline_m * 1e3:.3f} mm, RMS {trained.test_half.rms.all_px:.3f} px, "
            f"{trained.test_half.n_iterations} iterations",
            "",
        ]
    rate = run.n_steps / max(run.elapsed_s, 1e-9)
    lines.append(f"{run.n_steps} steps in {run.elapsed_s:.0f} s ({rate:.0f} per second, gradient steps included)")
    if not run.is_complete:
        lines.append("Not all steps were taken; the same command goes on from here")
    return "\n".join([*lines, f"Wrote weights, card, history and table into {run.folder}"])


def format_table(header: Sequence[str], rows: Sequence[Sequence[str]], *, align: str = "") -> str:
    """Aligned columns, two blanks apart; ``align`` has l or r per column (first left, others right unless given)."""
    align = align or "l" + "r" * (len(header) - 1)
    table = [tuple(header), *(tuple(row) for row in rows)] if any(header) else [tuple(row) for row in rows]
    widths = [max(len(row[i]) for row in table) for i in range(len(align))]
    lines = [
        "  ".join(cell.ljust(w) if a == "l" else cell.rjust(w) for cell, w, a in zip(row, widths, align, strict=True))
        for row in table
    ]
    return "\n".join(line.rstrip() for line in lines)


def _cameras_table(calibration: StereoCalibration) -> str:
    rig, sigma = calibration.rig, calibration.covariance.sigma
    names = list(camera_model(rig.left.model).parameter_names)
    names += [name for name in camera_model(rig.right.model).parameter_names if name not in names]
    rows = []
    for name in names:
        cells = []
        for side, camera in (("left", rig.left), ("right", rig.right)):
            values = dict(zip(camera_model(camera.model).parameter_names, camera.parameters.tolist(), strict=True))
            cells.append(with_sigma(values[name], sigma.get(f"{side}.{name}", math.nan)) if name in values else "")
        if name == "skew" and not any(rig_side.parameters[4] for rig_side in (rig.left, rig.right)):
            continue
        rows.append((name, "px" if name in ("fx", "fy", "cx", "cy", "skew") else "", *cells))
    models = rig.left.model if rig.left.model == rig.right.model else f"{rig.left.model}, {rig.right.model}"
    return format_table((models, "", "left", "right"), rows, align="llrr")


def _pair_table(calibration: StereoCalibration) -> str:
    rig, sigma = calibration.rig, calibration.covariance.sigma
    angles_deg, angle_sigmas_deg = np.degrees(rig.euler_rad), np.degrees(calibration.euler_sigma_rad)
    rows = [
        (name, "deg", with_sigma(value, s))
        for name, value, s in zip(("pitch", "yaw", "roll"), angles_deg.tolist(), angle_sigmas_deg.tolist(), strict=True)
    ]
    unit, factor = rig.printed_unit
    for axis, value in zip("xyz", rig.T_right_left.t.tolist(), strict=True):
        rows.append(
            (f"t.{axis}", unit, with_sigma(factor * value, factor * sigma.get(f"translation.{axis}", math.nan)))
        )
    rows.append(("baseline", unit, with_sigma(factor * rig.baseline_m, factor * calibration.baseline_sigma_m)))
    return format_table(("right camera", "", ""), rows, align="llr") + "\n" + CONVENTION


def _outlier_words(calibration: StereoCalibration) -> str:
    n_outliers = sum(view.n_outliers for view in calibration.views)
    n_corners = sum(view.n_corners for view in calibration.views)
    return f"{n_outliers} of {n_corners} left out as outliers"


def _view_lines(calibration: StereoCalibration) -> list[str]:
    lines = _rejected_lines(calibration.rejected, len(calibration.views))
    worst = sorted((v for v in calibration.views if math.isfinite(v.rms_px)), key=lambda v: -v.rms_px)[:3]
    if worst:
        lines.append("Worst    " + ", ".join(f"{view.name} {view.rms_px:.3f} px" for view in worst))
    lines += [f"         view {view.name}: {one_line(view.note)}" for view in calibration.views if view.note]
    return lines


def _rejected_lines(rejected: Sequence[RejectedView], n_used: int) -> list[str]:
    lines = [f"Views    {n_used} used, {len(rejected)} dropped"]
    by_reason: dict[str, list[str]] = defaultdict(list)
    for view in rejected:
        by_reason[one_line(view.reason)].append(view.name)
    for reason, names in by_reason.items():
        lines.append(f"         view{'s' if len(names) > 1 else ''} {list_names(names)}: {reason}")
    return lines


def _parameter_row(p: ParameterError) -> tuple[str, ...]:
    """Rotation in degrees, translation in millimetres, everything else in its own unit."""
    block = p.name.partition(".")[0]
    factor = {"rotation": 180 / math.pi, "translation": 1e3}.get(block, 1.0)
    unit = {"rotation": " deg", "translation": " mm"}.get(block, "")
    if not unit and p.name.rpartition(".")[2] in ("fx", "fy", "cx", "cy", "skew"):
        unit = " px"
    sigma = factor * p.sigma
    digits = min(10, max(2, 2 - math.floor(math.log10(sigma)))) if math.isfinite(sigma) and sigma > 0 else 5
    return (
        p.name + unit,
        f"{factor * p.truth:.{digits}f}",
        f"{factor * p.value:.{digits}f}",
        f"{factor * p.error:+.{digits}f}",
        f"{sigma:.{digits}f}" if math.isfinite(sigma) else "-",
        f"{p.error_per_bound:+.2f}" if math.isfinite(p.error_per_bound) else "-",
        "" if p.is_correct else "off",
    )


def _criteria_table(evaluation: TruthEvaluation) -> str:
    c = evaluation.comparison
    rows = [
        ("rotation error", "deg", c.rotation_error_deg, c.rotation_bound_deg),
        ("translation error", "mm", c.translation_error_mm, c.translation_bound_mm),
        *((criterion.name, criterion.unit, criterion.value, criterion.bound) for criterion in evaluation.criteria),
    ]
    cells = [
        (name, unit, f"{value:.4f}", f"{bound:.4f}" if bound > 0 else "-", f"{value / bound:.2f}" if bound > 0 else "-")
        for name, unit, value, bound in rows
    ]
    table = format_table(("criterion", "", "value", "bound", "value/bound"), cells, align="llrrr")
    right = f"parameters within tolerance (eq. 20): {c.n_correct} of {len(c.parameters)}"
    return f"{table}\n{right}, {c.parameter_accuracy_percent:.0f} %; baseline error {c.baseline_error_mm:+.4f} mm"
