"""What ``vanishing-points`` prints, as text and as a document."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocal.app.scene_lines import SceneRun
from binocal.calibrators.scene_lines import NAMES
from binocal.cli.exits import one_line
from binocal.cli.grouping import list_names
from binocal.cli.tables import format_table
from binocal.findings import finding_document
from binocal.values import counted, with_sigma

UNTOLD = "not measured by the lines"


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def scene_document(run: SceneRun) -> dict[str, Any]:
    """Values with standard deviations (null: not told), assumptions, families, the check."""
    found, sigma = run.intrinsics, run.intrinsics.covariance.sigma
    check = run.check
    return {
        **{f"{name}_px": _number(value) for name, value in zip(NAMES, found.values, strict=True)},
        "sigma_px": {name: sigma.get(name) for name in NAMES},
        "covariance_px2": {"names": list(found.covariance.names), "matrix": found.covariance.matrix.tolist()},
        "assumed": {
            "square_pixels": True,
            "skew": 0.0,
            "principal_point_px": list(found.assumed_centre_px),
            "principal_point_sigma_px": found.assumed_centre_sigma_px,
            "lens": run.lens,
        },
        "n_segments": run.n_segments,
        "noise_px": found.noise_px,
        "images": [
            {
                "name": image.name,
                "in_family": list(image.in_family),
                "n_others": image.n_others,
                "left_out": image.reason,
            }
            for image in found.images
        ],
        "ignored": [{"path": str(path), "reason": reason} for path, reason in run.ignored],
        "findings": [finding_document(f) for f in found.findings],
        "check": None
        if check is None
        else {
            "agrees": check.agrees,
            **{
                name: {"rig_px": float(value), "z": _number(z)}
                for name, value, z in zip(NAMES, check.values, check.z, strict=True)
            },
        },
    }


def scene_text(run: SceneRun) -> str:
    """The verdict on the rig first, if there is one, then the figures and what they rest on."""
    found, check = run.intrinsics, run.check
    sigma = found.covariance.sigma
    lines = []
    if check is not None:
        worst = int(np.nanargmax(np.abs(check.z)))
        says = f"the lines put {NAMES[worst]} {check.z[worst]:+.1f} standard deviations from the rig's"
        lines.append(f"agrees: {says}." if check.agrees else f"contradicts: {says}; calibrate the camera anew.")
    lines += [f"warning: {one_line(f.text)}" for f in found.findings]
    lines += [""] if lines else []
    rows = []
    for k, name in enumerate(NAMES):
        value = float(found.values[k])
        row = [name, "px", with_sigma(value, sigma[name]) if np.isfinite(value) else UNTOLD]
        if check is not None:
            row += [f"{check.values[k]:.2f}", f"{check.z[k]:+.1f}" if np.isfinite(check.z[k]) else "-"]
        rows.append(row)
    header = ("lines", "", "value") + (("rig", "z") if check is not None else ())
    lines += [format_table(header, rows, align="ll" + "r" * (len(header) - 2)), ""]
    x, y = found.assumed_centre_px
    lines.append(
        f"Assumed  square pixels, no skew, families at right angles, principal point at ({x:.1f}, {y:.1f}) ± "
        f"{found.assumed_centre_sigma_px:.0f} px, lens: {run.lens}"
    )
    used = [image for image in found.images if not image.reason]
    lines.append(
        f"Segments {run.n_segments} in {counted(len(found.images), 'image')}, off by {found.noise_px:.2f} px beyond their edges' noise"
    )
    for image in used:
        counts = ", ".join(str(n) for n in image.in_family)
        lines.append(f"         {image.name}: {counts} in the families, {image.n_others} in none")
    left_out = [image for image in found.images if image.reason]
    if left_out:
        lines.append(f"Left out {list_names([image.name for image in left_out])}: {left_out[0].reason}")
    return "\n".join(lines)
