"""The checks of a whole set, put to a solve: copies before it, all others after it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from binocal import acceptance
from binocal.acceptance.whole_set import APART_T
from binocal.calibrators.base import MIN_VIEWS
from binocal.calibrators.board_and_exposures import RealViewsSolve
from binocal.calibrators.summary import assumption_findings, noise_findings
from binocal.evidence import Detections
from binocal.findings import Finding, Severity, finding, refusal
from binocal.result import RejectedView, StereoCalibration
from binocal.set_checks.copies import different_poses, first_of_copies
from binocal.set_checks.shifted_lists import find_shift

SAME_POSE_SIGMAS = 3 * np.sqrt(2)  # of corner noise between two views: below, they are one pose measured twice
SHIFTED_LEAVES = 5.0  # times the noise with exposures freed; what leaves more is motion that a shift resembles
FEW_POSES_SHARE = 0.6  # of the views
MOST_COPIES = 0.5  # share of the views


def without_copies(detections: Detections) -> tuple[Detections, tuple[RejectedView, ...], tuple[Finding, ...]]:
    """The views, each once; the copies, and what is said of them."""
    first = first_of_copies(detections)
    is_copy = (first != np.arange(len(first))) & (
        detections.left_is_seen.any(axis=1) | detections.right_is_seen.any(axis=1)
    )
    if not is_copy.any():
        return detections, (), ()
    names = detections.names
    copies = [(names[view], names[first[view]]) for view in np.flatnonzero(is_copy)]
    rejected = tuple(RejectedView(name, f"a copy of view {original}", "view-copied") for name, original in copies)
    view, original = copies[0]
    found = finding("views-copied", n_copies=len(copies), n_given=len(names), view=view, original=original)
    return detections.select(~is_copy), rejected, (found,)


def refuse_copies(detections: Detections) -> None:
    """For a set that no rig follows from: raises DegenerateGeometryError where copies are most of its views, or leave too few."""
    given, copies, found = without_copies(detections)
    if copies and (given.n_views < MIN_VIEWS or len(copies) > MOST_COPIES * detections.n_views):
        n_left = given.n_views
        plural = "" if n_left == 1 else "s"
        figures = {**found[0].figures, "n_left": n_left, "plural": plural}
        raise refusal(finding("too-few-views-beside-copies", **figures), {view.name: view.reason for view in copies})


def refuse_shifted_lists(calibration: StereoCalibration, solve: RealViewsSolve) -> None:
    """Raises InconsistentViewsError: one camera's corner lists are off by a row or column in all views."""
    shift = find_shift(solve.problem.nominal, solve.nominal_bundle, solve.nominal_noise_px)
    if shift is None or shift.noise_px > SHIFTED_LEAVES * solve.noise_px:
        return
    found = finding(
        "corner-lists-shifted",
        line=shift.line,
        by=shift.by,
        what="add one to" if shift.by > 0 else "subtract one from",
        repaired_px=shift.noise_px,
        noise_px=solve.nominal_noise_px,
    )
    raise refusal(found, acceptance.describe_views(calibration))


def checked_as_a_whole(
    calibration: StereoCalibration,
    solve: RealViewsSolve,
    given: Detections,
    copies: tuple[RejectedView, ...],
    doubts: tuple[Finding, ...],
) -> StereoCalibration:
    """The calibration with what there is to say of its set: warnings before its other findings, copies among the rejected.

    Raises:
        InconsistentViewsError: The pairs were not taken together, by far, or one camera's corner lists are shifted.
    """
    views, exposure = calibration.corners.detections, calibration.exposure
    rejected = (*copies, *calibration.rejected)
    if solve.motion is not None and solve.motion.T > APART_T:
        refuse_shifted_lists(calibration, solve)
    motion = acceptance.gross_motion(exposure, acceptance.corner_spacing_px(views))
    if motion is not None:
        raise refusal(motion, acceptance.describe_views(calibration))
    names = [view.name for view in calibration.views]
    found = list(doubts)
    if exposure is not None:
        found += acceptance.exposure_findings(exposure, solve.motion, names)
    found += acceptance.left_out_findings(given.names, names, rejected)
    n_rig = sum(name.startswith(("rotation", "translation")) for name in calibration.covariance.names)
    n_given = given.n_views - len(copies)
    found += acceptance.weight_findings(solve.reduced.view_information, n_rig, views, n_given)
    found += acceptance.gap_findings(views, calibration.board_shape)
    found += acceptance.scale_findings(views)
    n_poses = int(different_poses(views, SAME_POSE_SIGMAS * solve.noise_px).sum())
    if n_poses <= FEW_POSES_SHARE * views.n_views:
        found.append(finding("few-different-poses", n_given=views.n_views, n_poses=n_poses))
    said = (*assumption_findings(solve), *noise_findings(solve, names, has_covariances=given.has_covariances))
    if not found and not copies and not said:
        return calibration
    before = [f for f in calibration.findings if f.severity is not Severity.NOTE]
    notes = [f for f in calibration.findings if f.severity is Severity.NOTE]
    return replace(calibration, findings=(*found, *before, *notes, *said), rejected=rejected)
