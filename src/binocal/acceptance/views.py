"""What the views of a solved rig show, and which of them are no observation of this board."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.acceptance.figures import board_normals
from binocal.evidence import Detections
from binocal.findings import Finding, finding
from binocal.result import StereoCalibration
from binocal.shapes import Bool, Float

MIN_VIEW_INLIER_SHARE = 0.5
"""Share of a view's corners in one camera that must carry weight: where most contradict the rest, it is no observation of this board."""


def contradicting_views(
    views: Detections,
    lengths2: tuple[Float[ndarray, "views n"], Float[ndarray, "views n"]],
    used: tuple[Bool[ndarray, "views n"], Bool[ndarray, "views n"]],
) -> dict[int, Finding]:
    """Views most of whose corners in a camera got no weight, by index, and why.

    ``lengths2`` are squared residual lengths in pixels of the left and the right camera, ``used`` says which corners carry weight.
    """
    contradicting: dict[int, Finding] = {}
    for camera, is_seen, px2, is_used in zip(
        ("left", "right"), (views.left_is_seen, views.right_is_seen), lengths2, used, strict=True
    ):
        n_seen, n_used = is_seen.sum(axis=1), is_used.sum(axis=1)
        for i in np.nonzero((n_seen > 0) & (n_used < MIN_VIEW_INLIER_SHARE * n_seen))[0]:
            contradicting[int(i)] = finding(
                "view-contradicts",
                camera=camera,
                n_unused=int(n_seen[i] - n_used[i]),
                n_seen=int(n_seen[i]),
                typical_px=float(np.sqrt(np.median(px2[i][is_seen[i]]))),
            )
    return contradicting


def describe_views(calibration: StereoCalibration) -> dict[str, str]:
    """What each used view shows, for a refusal: tilt, place and residual. Views that were rejected before keep their reasons."""
    described = {view.name: view.reason for view in calibration.rejected}
    if calibration.evidence is None:
        return described
    evidence = calibration.evidence.detections
    width, height = evidence.left_size_wh
    tilt_deg = np.degrees(np.arccos(np.clip(np.abs(board_normals(calibration)[:, 2]), 0, 1)))
    for index, view in enumerate(calibration.views):
        px = evidence.left_px[index]
        seen = px[np.isfinite(px[:, 0])]
        place = ""
        if len(seen):
            share = np.ptp(seen, axis=0) / (width, height)
            x, y = seen.mean(axis=0)
            place = f", {100 * share[0]:.0f} % x {100 * share[1]:.0f} % of the left image around ({x:.0f}, {y:.0f})"
        described[view.name] = (
            f"not used, the set is refused: board tilted {tilt_deg[index]:.0f} deg{place}, residual {view.rms_px:.2f} px"
        )
    return described
