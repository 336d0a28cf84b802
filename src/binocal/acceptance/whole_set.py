"""What there is to say of a whole set of views: exposures, changes of the rig, too few views, copies, a wrong gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.boards import parse_board
from binocal.evidence import Detections
from binocal.findings import Finding, finding
from binocal.result import BoardShape, ExposureFit, RejectedView
from binocal.set_checks.pair_motion import Change, PairMotion
from binocal.shapes import Float
from binocal.solvers.shape_model import pitch_of

APART_T = 12.0  # of the relative poses' excess: between grey real sets (below 9) and those not triggered together (11.6 and more)
CLEARLY_APART_T, CLEARLY_APART_RATIO = 4.0, 1.5  # or less, where the pair fits that much worse than the cameras alone
GROSS_RATIO = 15.0  # the pair over the cameras alone: above, a moving board has been measured, not a rig
GROSS_SHARE = 0.03  # and of the corners' spacing: below, freed exposures still give a rig whose sigmas hold
HOPELESS_RATIO = 2.0  # the same where what is left determines no rig
LEAST_WEIGHT = 3.2  # views' worth of pairs; clean sets of six have 3.8 and more
LEAST_VIEWS = 4
LEFT_OUT_SHARE = 0.5  # of the given views: a majority must be used
MANY_SHARE = 0.2  # of the given views: sound recordings have none to a tenth left out
MAX_NAMES = 6
NO_SUSPECTS = ("view-without-corners", "view-copied", "view-on-a-line", "view-at-one-point")
"""Reasons for which a view is left out that say nothing of the rig."""
LEAST_PITCH_M, LARGEST_PITCH_M = 0.3e-3, 1.0  # of neighbouring points: targets of microscopes and of rooms
FREED = "every view's right pose was freed, and the standard deviations count it"
NOT_FREED = "the right poses were held together, so the rig is worse than it need be"
GAP_SHARE = 0.5  # of the offsets' squares, for a gap to be what is wrong
GAP_SIGMAS = 4.0


def exposure_findings(exposure: ExposureFit, motion: PairMotion | None, names: Sequence[str]) -> tuple[Finding, ...]:
    """A change of the rig, or exposures that are apart; nothing where the pair fits as well as each camera."""
    if motion is None:
        return ()
    if motion.change is not None:
        return (_change_finding(motion.change, names),)
    is_clear = motion.T > CLEARLY_APART_T and exposure.ratio > CLEARLY_APART_RATIO
    if motion.T > APART_T or is_clear:
        how = FREED if exposure.are_apart else NOT_FREED
        return (finding("exposures-apart", alone_px=exposure.alone_px, pair_px=exposure.pair_px, how=how),)
    return ()


def gross_motion(exposure: ExposureFit | None, spacing_px: float, also: str = "") -> Finding | None:
    """The refusal of pairs that were not taken together; ``also``: what else makes the set useless, which lowers the limit.

    ``spacing_px`` is the distance of neighbouring corners.
    """
    if exposure is None:
        return None
    moved_px = float(np.sqrt(max(exposure.pair_px**2 - exposure.alone_px**2, 0.0)))
    is_gross = exposure.ratio > GROSS_RATIO and moved_px > GROSS_SHARE * spacing_px
    if not (is_gross or (also and exposure.ratio > HOPELESS_RATIO)):
        return None
    return finding(
        "pairs-not-together",
        alone_px=exposure.alone_px,
        pair_px=exposure.pair_px,
        moved_px=moved_px,
        also=f", and {also}" if also else "",
    )


def _change_finding(change: Change, names: Sequence[str]) -> Finding:
    what = {
        "turned": f"turned by {change.size:.2g} deg",
        "refocused": f"of another focal length by {change.size:.2g} %",
        "shifted": f"shifted in its image by {change.size:.2g} px",
    }[change.kind]
    figures = {"camera": change.camera, "what": what, "size": change.size, "kind": change.kind}
    if change.course == "step":
        return finding("rig-changed", view=names[change.view], **figures)
    if change.course == "drift":
        return finding("rig-drifts", **figures)
    members = [names[view] for view in change.members]
    return finding("rig-has-two-states", n_views=len(members), views=_listed(members), **figures)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:MAX_NAMES]) + (" ..." if len(names) > MAX_NAMES else "")


def left_out_findings(
    names: Sequence[str], used: Sequence[str], rejected: Sequence[RejectedView]
) -> tuple[Finding, ...]:
    """Views at one end of the recording that all contradict the others, or many anywhere. ``names`` are the given views in order."""
    place = {name: i for i, name in enumerate(names)}
    out = sorted(place[view.name] for view in rejected if view.name in place and view.code not in NO_SUSPECTS)
    k, n = len(out), len(names)
    if k < 2 or not used:
        return ()
    at_start, at_end = out[-1] < k + 2, out[0] >= n - k - 2
    if at_start == at_end:
        if k <= MANY_SHARE * n:
            return ()
        return (finding("many-views-left-out", n_out=k, n_given=n, views=_listed([names[i] for i in out])),)
    end = "the beginning" if at_start else "the end"
    return (finding("changed-from-view", first=names[out[0]], last=names[out[-1]], end=end),)


def weight_findings(
    view_information: Float[ndarray, "V k k"], n_rig: int, detections: Detections, n_given: int
) -> tuple[Finding, ...]:
    """A rig that rests on few views, or on a minority of those given. The last ``n_rig`` of k are the rig's, 0 where it is held."""
    if n_rig == 0:
        return ()
    rig = view_information[:, -n_rig:, -n_rig:]
    total = rig.sum(axis=0)
    size = 1 / np.sqrt(np.maximum(np.diagonal(total), 1e-300))
    shares = np.einsum("vij,ji->v", rig * size[:, None] * size, np.linalg.pinv(total * size[:, None] * size))
    shares = shares / n_rig
    weight = float(1 / np.sum(shares**2)) if np.any(shares > 0) else 0.0
    shared = detections.left_is_seen.any(axis=1) & detections.right_is_seen.any(axis=1)
    n_used, n_shared = detections.n_views, int(shared.sum())
    if weight >= LEAST_WEIGHT and n_shared >= LEAST_VIEWS and n_used >= LEFT_OUT_SHARE * n_given:
        return ()
    return (finding("rests-on-few-views", weight=weight, n_used=n_used, n_given=n_given, n_shared=n_shared),)


def scale_findings(detections: Detections) -> tuple[Finding, ...]:
    """A board whose size in metres no board has."""
    if not detections.is_metric:
        return ()
    pitch_m = pitch_of(np.ascontiguousarray(detections.object_points_m.T))
    if LEAST_PITCH_M <= pitch_m <= LARGEST_PITCH_M:
        return ()
    return (finding("scale-doubtful", pitch_m=pitch_m),)


def gap_findings(detections: Detections, shape: BoardShape | None) -> tuple[Finding, ...]:
    """An AprilGrid whose gap is not as given, by the pattern of its points' offsets."""
    spec = detections.board_spec or ""
    if shape is None or not spec.startswith("aprilgrid:"):
        return ()
    board = parse_board(spec)
    nominal, gap = detections.object_points_m, board.tag_gap_ratio
    step = 1e-4
    other = replace(board, tag_gap_ratio=gap + step)
    pattern = (other.object_points_m - board.object_points_m) / step
    pattern = pattern * np.ptp(nominal, axis=0).max() / np.ptp(board.object_points_m, axis=0).max()
    pattern = _without_similarity(pattern, nominal)
    offset = _without_similarity(shape.points_m - nominal, nominal)
    weight = pattern.ravel() @ pattern.ravel()
    if not weight > 0:
        return ()
    change = float(pattern.ravel() @ offset.ravel() / weight)
    explained = change**2 * weight / max(float(offset[:, :2].ravel() @ offset[:, :2].ravel()), 1e-300)
    sigma = float(np.median(shape.sigma_m[:, :2]) / np.sqrt(weight))
    if explained < GAP_SHARE or abs(change) < GAP_SIGMAS * sigma:
        return ()
    return (finding("aprilgrid-gap-wrong", given=gap, found=gap + change),)


def _without_similarity(offset: Float[ndarray, "n 3"], points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
    """Offsets in the plane less their best shift, turn and scale."""
    x, y = (points[:, i] - points[:, i].mean() for i in (0, 1))
    zero, one = np.zeros_like(x), np.ones_like(x)
    A = np.stack([np.r_[one, zero], np.r_[zero, one], np.r_[-y, x], np.r_[x, y]], axis=1)
    flat = np.r_[offset[:, 0], offset[:, 1]]
    rest = flat - A @ np.linalg.lstsq(A, flat, rcond=None)[0]
    out = np.zeros_like(offset)
    out[:, 0], out[:, 1] = rest[: len(x)], rest[len(x) :]
    return out
