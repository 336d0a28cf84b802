"""What ``rectify`` and ``depth`` print, as text and as a document."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from binocal.app.depth import DOCUMENT as DEPTH_DOCUMENT
from binocal.app.depth import MOST_SIGMA_SHARE, DepthOptions, DepthRun, PairDepth
from binocal.app.rectify import DOCUMENT, RectifyRun, rectification_document
from binocal.cameras import StereoRig
from binocal.rectification import Rectification

MOST_PAIRS = 12  # listed one by one; the document has all


def rectify_document(rig: StereoRig, run: RectifyRun, output: Path) -> dict[str, Any]:
    """The rectification, the pairs, and where they are."""
    return rectification_document(rig, run.rectification) | {"pairs": list(run.names), "output": str(output)}


def rectify_text(rig: StereoRig, run: RectifyRun, output: Path) -> str:
    """How it was rectified, what is shown, what was written."""
    return "\n".join(
        [
            *_rectification_lines(rig, run.rectification),
            f"Wrote    {len(run.names)} pair{'' if len(run.names) == 1 else 's'} and {output / DOCUMENT}",
        ]
    )


def depth_text(rig: StereoRig, run: DepthRun, options: DepthOptions, output: Path) -> str:
    """How depth was measured, and each pair's share and uncertainty."""
    unit = "m" if rig.is_metric else "squares"
    far = "infinity" if np.isinf(run.distances.far) else f"{run.distances.far:.4g} {unit}"
    lines = _rectification_lines(rig, run.rectification)
    given = "" if options.distances is not None else " (no --range given)"
    lines.append(
        f"Search   {run.distances.near:.4g} {unit} to {far}{given}: disparities {run.search_px[0]} to {run.search_px[1]} px"
    )
    known = (
        "" if run.knows_covariance else "; what the calibration leaves uncertain is unknown: the file does not say it"
    )
    lines.append(f"Noise    {options.matching_noise_px:g} px of a disparity taken as given{known}")
    lines += ["", f"{'pair':<16} {'measured':>9} {'median':>14} {'± all':>15} {'matching':>15} {'calibration':>15}"]
    lines += [_pair_line(pair, unit) for pair in run.pairs[:MOST_PAIRS]]
    if len(run.pairs) > MOST_PAIRS:
        lines.append(f"and {len(run.pairs) - MOST_PAIRS} more")
    uncertain = [pair.uncertain for pair in run.pairs]
    if max(uncertain, default=0) > 0.005:
        lines.append(
            f"Dropped: up to {100 * max(uncertain):.0f} % of the pixels, uncertain by more than {100 * MOST_SIGMA_SHARE:.0f} % of their distance"
        )
    beyond = [pair.beyond_png for pair in run.pairs]
    if max(beyond, default=0) > 0:
        lines.append(
            f"warning: up to {100 * max(beyond):.1f} % of the pixels are too far for the 16-bit PNG; the TIFF has them, or use a "
            f"smaller --png-units than {options.png_units:g}"
        )
    count = len(run.pairs)
    lines += [
        "",
        f"Wrote    depth, sigma and clouds of {count} pair{'' if count == 1 else 's'}, and {output / DEPTH_DOCUMENT}",
    ]
    return "\n".join(lines)


def _pair_line(pair: PairDepth, unit: str) -> str:
    def length(value: float) -> str:
        if np.isnan(value):
            return "-"
        return f"{1e3 * value:.3g} mm" if unit == "m" and value < 0.1 else f"{value:.4g} {unit}"

    return (
        f"{pair.name:<16} {100 * pair.measured:>7.0f} % {length(pair.median):>14} {length(pair.median_sigma):>15} "
        f"{length(pair.median_sigma_matching):>15} {length(pair.median_sigma_calibration):>15}"
    )


def _rectification_lines(rig: StereoRig, r: Rectification) -> list[str]:
    unit, scale = rig.printed_unit
    stand = "one above the other" if r.is_vertical else "side by side"
    middles = "" if r.infinity_px == 0 else f", disparity {r.infinity_px:+.0f} px at infinity"
    return [
        f"Cameras  {stand}, {scale * abs(r.offset_m):.2f} {unit} apart",
        f"Rectify  {r.projection}, {r.size_wh[0]} x {r.size_wh[1]}, focal length {r.left.focal_px[0]:.1f} px{middles}",
        f"Shown    {100 * r.kept:.0f} % of what both cameras see; left image covered to {100 * r.covered[0]:.0f} %, right to "
        f"{100 * r.covered[1]:.0f} %",
    ]
