"""Whether the pairs of ``rectangles`` are what was stated of them, and what is the likeliest cause where they are not.

The corners of a pair alone tell most of the cameras' angles. So the pairs are solved a second time with attitudes that hardly count: what
that leaves in the images is the corners' own noise, and how far its angles lie from the attitudes, in the standard deviations of both,
shows whether the attitudes are as good as stated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.calibrators.rectangle_pairs import Solves, is_fitting, left_noise_px, settle
from binocal.cameras import StereoRig
from binocal.evidence.rectangles import RectanglePairs
from binocal.findings import Finding, finding, refusal
from binocal.shapes import Float

OUTSIDE_PX = 2.0  # a corner may be extrapolated by so much
FREE_DEG = 10.0  # standard deviation of an attitude that hardly counts
MOST_SIGMAS = 3.0  # of the attitudes, by the median pair: sound ones have 0.7 to 1.3, one pair alone 0.2 to 1.9
DOUBTFUL_SIGMAS = 1.5
LEAST_PAIRS = 8  # from which so little says something
NOISE_SHARE = 0.005  # of the rectangle's extent in the image: corners are found five times as well
LEAST_NOISE_PX = 1.0  # and below that nothing is wrong, whatever the share
MOST_NOISE_SHARE = 0.02
LEAST_SHARE = 0.5  # of the pairs that must fit
MOST_PAIRS = 8  # that other readings are tried on
CLEARLY = 0.5  # of the noise, for another reading of the same numbers to be the right one


def check_inside(rig: StereoRig, pairs: RectanglePairs) -> None:
    """Raises DataError: a corner lies outside its image; the text says so where x and y look exchanged."""
    sides = tuple(zip(("left", "right"), (rig.left, rig.right), (pairs.left_px, pairs.right_px), strict=True))
    is_turned = all(not _beyond_px(px[..., ::-1], camera.size_wh).max() > OUTSIDE_PX for _, camera, px in sides)
    for side, camera, px in sides:
        beyond = _beyond_px(px, camera.size_wh)
        if not beyond.max() > OUTSIDE_PX:
            continue
        pair, corner = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        x, y = px[pair, corner].tolist()
        width, height = camera.size_wh
        raise refusal(
            finding(
                "rectangle-outside-image",
                remedy="x and y look exchanged: give columns before rows" if is_turned else None,
                camera=side,
                pair=pairs.names[int(pair)],
                corner=int(corner),
                x_px=x,
                y_px=y,
                width_px=width,
                height_px=height,
                n_pairs=int((beyond.max(axis=1) > OUTSIDE_PX).sum()),
            )
        )


def _beyond_px(px: Float[ndarray, "pairs 4 2"], size_wh: tuple[int, int]) -> Float[ndarray, "pairs 4"]:
    """By how much corners lie outside an image."""
    return np.maximum(-0.5 - px, px - (np.array(size_wh) - 0.5)).max(axis=-1)


@dataclass(frozen=True, slots=True)
class CheckedPairs:
    """Attitudes whose standard deviations hold, and what there is to say of them."""

    pairs: RectanglePairs
    findings: tuple[Finding, ...]


def check_agreement(
    rig: StereoRig,
    pairs: RectanglePairs,
    solves: Solves,
    stated_noise_px: float | None,
    check_stop: Callable[[], None],
) -> CheckedPairs:
    """The pairs, their attitudes' standard deviations widened where corners show them to be too small.

    Raises:
        InconsistentViewsError: Corners, attitudes and rectangle contradict each other; the text names the likeliest cause.
    """
    _, free = settle(rig, _released(pairs), stated_noise_px, check_stop)
    if not any(map(is_fitting, free)):
        return CheckedPairs(pairs, ())  # corners of no rectangle: no fault of the attitudes
    noise_px, extent_px = left_noise_px(free), _extent_px(pairs)
    are_many = sum(map(is_fitting, free)) >= LEAST_SHARE * pairs.n_pairs
    if noise_px > max(LEAST_NOISE_PX, NOISE_SHARE * extent_px) or not are_many:
        _refuse_other_reading(rig, pairs, noise_px, stated_noise_px, check_stop)
    off = _AttitudeErrors.of(pairs, free)
    n_used = sum(map(is_fitting, solves))
    if off is not None and off.sigmas > MOST_SIGMAS:
        said = float(np.degrees(np.median(pairs.attitude_sigma_rad[off.rows])))
        raise refusal(
            finding(
                "attitudes-contradict-corners",
                remedy=_reading_of_attitudes(pairs, off, free),
                off_deg=off.rms_deg,
                stated_deg=said,
                n_used=n_used,
                n_pairs=pairs.n_pairs,
            )
        )
    held_px = left_noise_px(solves)
    if n_used < LEAST_SHARE * pairs.n_pairs or held_px > max(LEAST_NOISE_PX, MOST_NOISE_SHARE * extent_px):
        raise refusal(
            finding(
                "rectangles-do-not-fit", n_used=n_used, n_pairs=pairs.n_pairs, noise_px=held_px, extent_px=extent_px
            )
        )
    if off is None or off.sigmas <= DOUBTFUL_SIGMAS or len(off.rows) < LEAST_PAIRS:
        return CheckedPairs(pairs, ())
    sigma = pairs.attitude_sigma_rad.copy()
    said = float(np.degrees(np.median(sigma[off.rows])))
    sigma[off.rows] = np.maximum(sigma[off.rows], np.radians(off.rms_deg))
    weak = finding("attitudes-less-certain", off_deg=off.rms_deg, stated_deg=said)
    return CheckedPairs(replace(pairs, attitude_sigma_rad=sigma), (weak,))


def _released(pairs: RectanglePairs) -> RectanglePairs:
    """The pairs with attitudes that hardly count, but for those in which the cameras stand as in the initial rig."""
    sigma = np.where(_is_at_rest(pairs), 0.0, np.maximum(pairs.attitude_sigma_rad, np.radians(FREE_DEG)))
    return replace(pairs, attitude_sigma_rad=sigma)


def _is_at_rest(pairs: RectanglePairs) -> ndarray:
    turned = np.any(pairs.left_attitude_rad != 0, axis=1) | np.any(pairs.right_attitude_rad != 0, axis=1)
    return (pairs.attitude_sigma_rad == 0) & ~turned


def _extent_px(pairs: RectanglePairs) -> float:
    """Of the rectangle in the images: its longer side, in the median pair."""
    return float(np.median([np.ptp(px, axis=1).max(axis=-1) for px in (pairs.left_px, pairs.right_px)]))


@dataclass(frozen=True, slots=True, eq=False)
class _AttitudeErrors:
    """How far attitudes lie from the angles that corners tell, in the median pair: in both's standard deviations, and degrees."""

    rows: ndarray
    sigmas: float
    rms_deg: float

    @classmethod
    def of(
        cls, pairs: RectanglePairs, free: Solves, attitudes: Float[ndarray, "pairs 2 2"] | None = None
    ) -> _AttitudeErrors | None:
        """Of other ``attitudes`` than the pairs have, if given; None where no pair tells."""
        given = _attitudes(pairs) if attitudes is None else attitudes
        at_rest = _is_at_rest(pairs)
        rows = [i for i, solve in enumerate(free) if is_fitting(solve) and not at_rest[i]]
        squares, off2 = [], []
        for i in rows:
            solve = free[i]
            assert solve is not None  # it fits
            variance = np.diag(solve.covariance)[:4] + pairs.attitude_sigma_rad[i] ** 2
            away2 = np.square(solve.angles_rad - given[i]).ravel()
            squares.append(float(np.mean(away2 / variance)))
            off2.append(float(np.mean(away2)))
        if not rows:
            return None
        return cls(np.array(rows), float(np.sqrt(np.median(squares))), float(np.degrees(np.sqrt(np.median(off2)))))


def _attitudes(pairs: RectanglePairs) -> Float[ndarray, "pairs 2 2"]:
    return np.stack([pairs.left_attitude_rad, pairs.right_attitude_rad], axis=1)


def _reading_of_attitudes(pairs: RectanglePairs, off: _AttitudeErrors, free: Solves) -> str | None:
    """What would bring the attitudes to the angles that corners tell; None where nothing simple does."""
    a = _attitudes(pairs)
    readings: Sequence[tuple[str, ndarray]] = (
        ("they look like radians where degrees are meant: give degrees", np.degrees(a)),
        ("they look like degrees where radians are meant: give radians", np.radians(a)),
        ("those of left and right look exchanged", a[:, ::-1]),
        ("yaw and pitch look exchanged: give yaw first", a[..., ::-1]),
        ("yaw and pitch look of the opposite sign: positive yaw turns a camera to its right, positive pitch up", -a),
        ("yaw looks of the opposite sign: positive yaw turns a camera to its right", a * [-1, 1]),
        ("pitch looks of the opposite sign: positive pitch turns a camera up", a * [1, -1]),
    )
    found = [(_AttitudeErrors.of(pairs, free, read), words) for words, read in readings]
    best, words = min(
        ((errors.sigmas if errors is not None else np.inf, words) for errors, words in found), key=lambda pair: pair[0]
    )
    if best < DOUBTFUL_SIGMAS and best < CLEARLY * off.sigmas:
        return words
    return None


def _refuse_other_reading(
    rig: StereoRig,
    pairs: RectanglePairs,
    noise_px: float,
    stated_noise_px: float | None,
    check_stop: Callable[[], None],
) -> None:
    """Raises InconsistentViewsError: the same corners, read another way, fit far better."""
    free = _released(pairs.select(range(min(pairs.n_pairs, MOST_PAIRS))))
    readings = (
        ("those of left and right look exchanged", replace(free, left_px=free.right_px, right_px=free.left_px)),
        (
            "x and y look exchanged: give columns before rows",
            replace(free, left_px=free.left_px[..., ::-1], right_px=free.right_px[..., ::-1]),
        ),
        (
            "each pair looks as if it shows a rectangle of its own: give each a number of its own",
            replace(free, rectangle=np.arange(free.n_pairs)),
        ),
    )
    for words, read in readings:
        _, solves = settle(rig, read.in_one_turn(), stated_noise_px, check_stop)
        other_px = left_noise_px(solves) if any(map(is_fitting, solves)) else np.inf
        if other_px < CLEARLY * noise_px and sum(map(is_fitting, solves)) > LEAST_SHARE * free.n_pairs:
            raise refusal(finding("rectangles-misread", remedy=words, noise_px=noise_px, other_px=float(other_px)))
