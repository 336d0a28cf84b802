"""Whether matches are of one moment, of these cameras, and of the rig that was given: what is refused, and which pairs are left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeGuard

import numpy as np
from numpy import ndarray

from binocal.calibrators.natural_cameras import asked
from binocal.evidence.point_matches import PointMatches
from binocal.findings import Finding, finding, refusal
from binocal.geometry import SE3, so3
from binocal.shapes import Bool
from binocal.solvers.epipolar import MAD_TO_SIGMA, EpipolarProblem, parallax_and_sides
from binocal.solvers.epipolar_covariance import PairsApart
from binocal.solvers.epipolar_diagnosis import Ask
from binocal.solvers.relative_pose import RelativePose
from binocal.solvers.robust import TUKEY_END

MIN_MATCHES = 30
MIN_RIGHT_SHARE = 0.15  # of the matches; unfiltered ones of self-similar scenes keep 0.2 and more
WHOLE_ROWS_SHARE = 0.5  # of the matches on equal rows to a thousandth of a pixel: a grid's, not a scene's
CONTRARY_SHARE = 0.5  # of the pooled share of right matches, below which a pair contradicts the others
CLEAR_PX, CLEAR_NOISE, MIN_CLEAR = 3.0, 10.0, 20
"""Parallax, in pixels and of the noise, and of how many points, for the side on which they lie to be told."""
MOST_TURN_DEG, MOST_DIRECTION_DEG, MOST_SIGMAS = 15.0, 6.0, 3.0
"""From the rig that was given; beyond them it was not bent by heat or a knock, and the direction moves by no more than the turn else."""
MOST_FORWARD_DEG = 15.0
"""From the rig's file where its pose is no start: by how much more or less the translation may lie along the view. Cameras are mounted
anew side by side or one above the other as before; one that moved on between the exposures seems to stand behind the other."""
MOST_NOISE_PX = 1.0  # no matcher leaves more; what another parameter of the cameras would take away of it is theirs
UPSIDE_DOWN_DEG, REVERSED_DEG = 120.0, 100.0
_KNOCKED = "the rig was knocked on the way or flexes, its cameras do not expose together"
_SEE_WHEN = "see with `binocal check --stream` when, and give pairs from before or after it"
RECTIFIED_PX, UNRECTIFIED_PX, RECTIFIED_SHARE = 0.7, 2.0, 0.75
"""Median difference of matches' rows as they are, and by the rig given, for images that were rectified before; the former's share of
the noise in the rig's best pose."""
APART_SHARE, APART_OVER_REGIONS = 0.25, 5.0
"""Of the squared residuals, that a pose for each pair would take away, and over what regions explain, for pairs to disagree: EuRoC's and
BumbleBee2's have up to 0.11 and 3.5, KITTI's grey ones 0.43 to 0.61 and 10 to 18."""
TORN_SHARE, TORN_PX = 0.8, 0.3
"""The same share and the RMS in pixels, beyond which no pose is that of all: a right camera knocked by 0.08 deg of pitch half-way leaves
0.92 and 0.34 px, KITTI's grey cameras 0.61 and 0.11 px."""
NAMED = 3  # pairs in one sentence


def refuse_whole_rows(matches: PointMatches) -> None:
    """Raises InconsistentViewsError: rows are those of a pixel grid."""
    on_grid = np.abs(matches.left_px[:, 1] - matches.right_px[:, 1]) < 1e-3
    if on_grid.mean() > WHOLE_ROWS_SHARE:
        raise refusal(finding("matches-on-whole-rows", share_percent=100 * float(on_grid.mean())))


def refuse_rectified(problem: EpipolarProblem, matches: PointMatches, given: SE3 | None, noise_px: float) -> None:
    """Raises InconsistentViewsError: points lie on equal rows, nearer than the rig that was given can bring them in any pose."""
    if given is None:
        return
    by_rig_px = float(np.median(np.abs(problem.residuals_px(RelativePose.of(given)))) * np.sqrt(2))
    for axis, name in ((1, "rows"), (0, "columns")):
        apart_px = float(np.median(np.abs(matches.left_px[:, axis] - matches.right_px[:, axis])))
        is_nearer = MAD_TO_SIGMA * apart_px < RECTIFIED_SHARE * np.sqrt(2) * noise_px
        if is_nearer and apart_px < RECTIFIED_PX and by_rig_px > UNRECTIFIED_PX:
            raise refusal(finding("images-already-rectified", lines=name, apart_px=apart_px, by_rig_px=by_rig_px))


def refuse_wrong(matches: PointMatches, is_right: Bool[ndarray, "n"], noise_px: float) -> None:
    """Raises InconsistentViewsError: too few matches agree with one pose."""
    n_right = int(is_right.sum())
    if n_right < MIN_MATCHES or n_right < MIN_RIGHT_SHARE * len(matches):
        raise refusal(finding("matches-contradict", n_right=n_right, n_matches=len(matches), noise_px=noise_px))


def clear_sides(
    problem: EpipolarProblem, estimate: RelativePose, noise_px: float
) -> tuple[Bool[ndarray, "n"], Bool[ndarray, "n"]]:
    """Which points have a parallax that tells their side, and which lie in front of both cameras."""
    parallax_px, side = parallax_and_sides(problem, estimate)
    return parallax_px > max(CLEAR_PX, CLEAR_NOISE * noise_px), side > 0


def contradicting_pairs(
    problem: EpipolarProblem,
    matches: PointMatches,
    estimate: RelativePose,
    noise_px: float,
) -> dict[int, str]:
    """Pairs that show another rig than all together, and why: few of their matches fit, or their points lie behind the cameras."""
    is_right = np.abs(problem.residuals_px(estimate)) < TUKEY_END * noise_px
    usual = is_right.mean()
    is_clear, is_in_front = clear_sides(problem, estimate, noise_px)
    found: dict[int, str] = {}
    for pair in range(matches.n_pairs):
        own = matches.pair == pair
        told = own & is_right & is_clear
        if own.sum() >= MIN_MATCHES and is_right[own].mean() < CONTRARY_SHARE * usual:
            found[pair] = (
                f"{100 * is_right[own].mean():.0f} % of its matches fit, of all {100 * usual:.0f} %: not of one moment, or the rig was knocked?"
            )
        elif told.sum() >= MIN_CLEAR and is_in_front[told].mean() < 0.5:
            found[pair] = "its points lie behind the cameras: left and right exchanged?"
    return found


def pairs_left_out(matches: PointMatches, odd: Mapping[int, str], has_old: bool) -> Finding:
    """What is said of pairs that contradict the others.

    Raises:
        InconsistentViewsError: They are as many as the others, so that nothing says which are right.
    """
    what = named([f"{matches.names[pair]} ({why})" for pair, why in odd.items()])
    n_odd, n_pairs = len(odd), matches.n_pairs
    if n_odd > n_pairs / 2 or (n_odd == n_pairs / 2 and not has_old):
        raise refusal(finding("pairs-contradict", n_odd=n_odd, n_pairs=n_pairs, what=what))
    return finding("pairs-left-out", n_odd=n_odd, n_pairs=n_pairs, what=what)


def pairs_disagree(apart: PairsApart | None) -> list[Finding]:
    """What is said of pairs that differ by more than errors of their matches explain."""
    if not _differ(apart):
        return []
    share_percent, over = 100 * apart.share, apart.over_regions
    return [finding("pairs-disagree", apart_px=apart.apart_px, share_percent=share_percent, over_regions=over)]


def _differ(apart: PairsApart | None) -> TypeGuard[PairsApart]:
    """Whether pairs differ by more than errors of their matches explain."""
    return apart is not None and apart.share >= APART_SHARE and apart.over_regions >= APART_OVER_REGIONS


def refuse_torn(apart: PairsApart | None, n_pairs: int) -> None:
    """Raises InconsistentViewsError: pairs differ by so much that no pose is that of all."""
    if _differ(apart) and apart.share >= TORN_SHARE and apart.apart_px >= TORN_PX:
        raise refusal(pairs_of_several_poses(n_pairs))


def refuse_knocked(names: Sequence[str], n_pairs: int, estimate: RelativePose, of_others: RelativePose) -> None:
    """Raises InconsistentViewsError: pairs that contradict the others show one pose together, as far away as a knock may be."""
    turn_deg, direction_deg = _away_deg(of_others, estimate)
    if turn_deg > MOST_TURN_DEG or direction_deg > MOST_DIRECTION_DEG + turn_deg:
        return
    shown = f"{named(list(names))} show a right camera that is turned by {turn_deg:.2g} deg against that of the others"
    what = f"{shown}: {_KNOCKED}, or pairs are mixed up"
    raise refusal(finding("pairs-contradict", n_odd=len(names), n_pairs=n_pairs, what=what, remedy=_SEE_WHEN))


def named(texts: list[str]) -> str:
    """The first few, and how many more."""
    more = f", and {len(texts) - NAMED} more" if len(texts) > NAMED else ""
    return ", ".join(texts[:NAMED]) + more


def is_mixed_up(estimate: RelativePose, given: SE3 | None) -> bool:
    """Whether one camera's images are upside down against the other's, or the sides are exchanged, by the rig given."""
    return given is not None and bool(_mixed_up(*_away_deg(estimate, RelativePose.of(given))))


def _mixed_up(turn_deg: float, direction_deg: float) -> str:
    """How the images are, in words; nothing where they are as they should be."""
    if turn_deg > UPSIDE_DOWN_DEG:
        return "one camera's images are upside down against the other's, as the rig's file does not have them"
    if direction_deg > REVERSED_DEG:
        return "left and right are exchanged, or both images are mirrored or upside down"
    return ""


def _away_deg(estimate: RelativePose, old: RelativePose) -> tuple[float, float]:
    """Turn, and angle between the directions of the translation."""
    turn_deg = float(np.degrees(so3.angle_rad(estimate.R @ old.R.T)))
    return turn_deg, float(np.degrees(np.arccos(np.clip(estimate.t @ old.t, -1, 1))))


def refuse_other_rig(
    estimate: RelativePose, given: SE3 | None, direction_sigma_deg: float, ask: Ask | None, noise_px: float
) -> None:
    """Raises InconsistentViewsError: the rig that was given cannot have become the one that the images show, or has other cameras."""
    if given is None:
        return
    turn_deg, direction_deg = _away_deg(estimate, RelativePose.of(given))
    most_deg = MOST_DIRECTION_DEG + MOST_SIGMAS * direction_sigma_deg + min(turn_deg, MOST_TURN_DEG)
    has_other_cameras = ask is not None and noise_px > MOST_NOISE_PX
    if turn_deg <= MOST_TURN_DEG and direction_deg <= most_deg and not has_other_cameras:
        return
    mixed_up = _mixed_up(turn_deg, direction_deg)
    if mixed_up:
        cause = mixed_up
    elif ask is not None:
        cause = f"the rig's cameras are not those of the images, which ask for {asked(ask)}"
    else:
        cause = (
            "the two images of a pair are not of one moment, the rig's file is of another rig, or its mount has broken"
        )
    raise refusal(finding("rig-is-another", turn_deg=turn_deg, direction_deg=direction_deg, cause=cause))


def unlike_file(estimate: RelativePose, filed: SE3, direction_sigma_deg: float) -> list[Finding]:
    """What is said of a pose that was found without the rig file's and is far from it.

    Raises:
        InconsistentViewsError: No other mounting explains it.
    """
    old = RelativePose.of(filed)
    turn_deg, direction_deg = _away_deg(estimate, old)
    cause = _mixed_up(turn_deg, direction_deg)
    forward_deg = abs(_forward_deg(estimate) - _forward_deg(old))
    if not cause and forward_deg > MOST_FORWARD_DEG + MOST_SIGMAS * direction_sigma_deg:
        cause = f"one camera seems to stand {forward_deg:.0f} deg farther along the view: the two images of a pair are not of one moment"
    figures = {"turn_deg": turn_deg, "direction_deg": direction_deg}
    if cause:
        remedy = "check the images and their sides, and give a rig's file whose translation points roughly as it does"
        raise refusal(finding("rig-is-another", cause=cause, remedy=remedy, **figures))
    most_deg = MOST_DIRECTION_DEG + MOST_SIGMAS * direction_sigma_deg + min(turn_deg, MOST_TURN_DEG)
    is_far = turn_deg > MOST_TURN_DEG or direction_deg > most_deg
    return [finding("pose-unlike-file", turn_deg=turn_deg, direction_deg=direction_deg)] if is_far else []


def _forward_deg(pose: RelativePose) -> float:
    """How far the translation points along the cameras' common view, out of the plane across it."""
    view = pose.R[:, 2] + np.array([0.0, 0.0, 1.0])
    return float(np.degrees(np.arcsin(np.clip(pose.t @ view / max(float(np.linalg.norm(view)), 1e-9), -1, 1))))


def pairs_of_several_poses(n_pairs: int) -> Finding:
    """What is said where every pair fits these cameras with a pose of its own, and no one pose fits them all."""
    return finding(
        "pairs-contradict",
        n_odd=n_pairs,
        n_pairs=n_pairs,
        what=f"each fits these cameras with a pose of its own, and no one pose fits all: {_KNOCKED}, or its file is of other cameras",
        remedy=_SEE_WHEN,
    )
