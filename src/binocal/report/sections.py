"""The sections of a report, in their order: each a title, a sentence on what it shows, figures and tables."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from binocal.findings import KINDS, Finding, Severity
from binocal.report.contents import ReportContents
from binocal.report.corner_sections import coverage_section, residual_section
from binocal.report.headline import GRAVE, by_weight
from binocal.report.image_sections import rectified_section, view_section
from binocal.report.plan_sections import next_section, plan_section
from binocal.report.rig_sections import board_section, rig_section
from binocal.report.section import Notice, Section, Table
from binocal.report.sigma_sections import depth_section, projection_section
from binocal.requirements import Outcome, Verdict
from binocal.values import with_sigma

_WORDS = {
    None: ("good", "ok"),
    Severity.NOTE: ("", "note"),
    Severity.WARNING: ("care", "warning"),
    Severity.REFUSAL: ("bad", "refused"),
}


def sections_of(contents: ReportContents) -> tuple[Section, ...]:
    """Those that have something to show."""
    made = (
        next_section(contents),
        key_section(contents),
        finding_section(contents),
        rig_section(contents),
        board_section(contents),
        coverage_section(contents),
        residual_section(contents),
        projection_section(contents),
        depth_section(contents),
        plan_section(contents),
        rectified_section(contents),
        view_section(contents),
        repeat_section(contents),
    )
    return tuple(section for section in made if section is not None)


def key_section(contents: ReportContents) -> Section:
    """The rig in figures, each with its standard deviation, and the checks."""
    calibration = contents.calibration
    rig, sigma = calibration.rig, calibration.covariance.sigma
    unit, factor = rig.printed_unit
    rows = [
        ("baseline", _pm(factor * rig.baseline_m, factor * calibration.baseline_sigma_m, unit)),
        *(
            (f"{word} of the right camera", _pm(angle, error, "deg"))
            for word, angle, error in zip(
                ("pitch", "yaw", "roll"),
                np.degrees(rig.euler_rad),
                np.degrees(calibration.euler_sigma_rad),
                strict=True,
            )
        ),
    ]
    cameras = []
    for name in ("fx", "fy", "cx", "cy"):
        index = ("fx", "fy", "cx", "cy").index(name)
        cells = [
            _pm(float(getattr(rig, side).parameters[index]), sigma.get(f"{side}.{name}", float("nan")), "px")
            for side in ("left", "right")
        ]
        cameras.append((name, *cells))
    sizes = [f"{camera.size_wh[0]} x {camera.size_wh[1]} px" for camera in (rig.left, rig.right)]
    cameras += [
        ("image", *sizes),
        ("lens model", rig.left.model, rig.right.model),
        ("RMS of the corners", f"{calibration.rms.left_px:.3f} px", f"{calibration.rms.right_px:.3f} px"),
    ]
    checks = tuple((line.name, _WORDS[line.severity][1], line.text) for line in contents.checks)
    tables = [
        Table(("rig", "estimate ± standard deviation"), tuple(rows)),
        Table(("cameras", "left", "right"), tuple(cameras)),
    ]
    if checks:
        tables.append(Table(("check", "result", "what was found"), checks, "Checks on the rig's own corners", 9))
    return Section("figures", "Key figures", "", (), tuple(tables))


def finding_section(contents: ReportContents) -> Section | None:
    """Warnings and notes with what to do, and the needs' verdicts."""
    notices = [_verdict_notice(verdict) for verdict in contents.verdicts]
    warnings = by_weight(contents.findings)
    for found in (*warnings, *(one for one in contents.findings if one not in warnings)):
        level, word = _WORDS[found.severity]
        kind = KINDS.get(found.code)
        title = kind.title if kind is not None else "Warning"
        level = "bad" if found.code in GRAVE else level
        notices.append(Notice(level, word, title, _without_remedy(found), found.remedy, found.code))
    notices += [Notice("", "note", "Not shown", note) for note in contents.notes]
    if not notices:
        return None
    return Section(
        "findings", "Findings", "What was found, the gravest first, and what to do about it.", notices=tuple(notices)
    )


def repeat_section(contents: ReportContents) -> Section:
    """Versions, options, inputs: everything to repeat the calibration."""
    rows = [
        (str(key), _plain(value)) for key, value in contents.calibration.provenance.items() if key != "input_sha256"
    ]
    tables = [Table(("provenance", "value"), tuple(rows), numbers_from=9)]
    hashes = contents.calibration.provenance.get("input_sha256")
    if isinstance(hashes, Mapping) and hashes:
        listed = tuple((str(name), str(value)) for name, value in hashes.items())
        tables.append(Table(("input", "SHA-256"), listed, "Files that it was computed from", numbers_from=9))
    return Section(
        "repeat",
        "To repeat it",
        "The same inputs, options and versions give the same rig.",
        tables=tuple(tables),
        texts=("\n".join(contents.commands),) if contents.commands else (),
    )


def _verdict_notice(verdict: Verdict) -> Notice:
    level, word = {
        Outcome.PASS: ("good", "pass"),
        Outcome.FAIL: ("bad", "fail"),
        Outcome.UNDECIDED: ("care", "undecided"),
    }[verdict.outcome]
    return Notice(level, word, verdict.requirement.text, verdict.sentence)


def _without_remedy(found: Finding) -> str:
    """The sentence less what it says to do, which stands below it."""
    text = found.text
    if found.remedy and found.remedy in text:
        before, _, after = text.partition(found.remedy)
        text = before.rstrip(" ;,") + after
    return text[:1].upper() + text[1:].rstrip(".") + "."


def _pm(value: float, sigma: float, unit: str) -> str:
    return f"{with_sigma(value, sigma)} {unit}"


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
