"""Known lengths in the scene: what the user points at in a left image, found in the right one, gives a rig's baseline its length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.calibrators.known_length import SeenLength, with_known_lengths
from binocal.cameras import StereoRig
from binocal.datasets import StereoPair
from binocal.datasets.frames import name_some
from binocal.errors import DataError
from binocal.findings import finding, refusal
from binocal.images.reading import read_grey_image
from binocal.matching.along_epipolar import NotMatchedError, match_along_epipolar
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.values import ArrayValue

LEAST_TOLD = 0.2  # the largest share of the baseline that its standard deviation may be
ENDS = ("first", "second")


@dataclass(frozen=True, slots=True, eq=False)
class KnownLength(ArrayValue):
    """Two points of a pair's left image and the distance of what they show, metres; ``pair`` is a name, or an index from 0."""

    pair: str
    left_px: Float[ndarray, "2 2"]
    length_m: float
    sigma_m: float = 0.0


def measure_known_lengths(
    calibration: StereoCalibration, pairs: Sequence[StereoPair], lengths: Sequence[KnownLength]
) -> StereoCalibration:
    """The calibration with the length of its translation from known lengths; their right ends are sought in the images.

    Raises:
        DataError: There is no such pair, or an end cannot be found (finding ``known-length-not-found``), or the lengths say too
            little of the baseline (``known-length-tells-too-little``).
    """
    scaled = with_known_lengths(calibration, [_seen(calibration.rig, pairs, length) for length in lengths])
    rig, along = scaled.rig, scaled.rig.T_right_left.t / scaled.rig.baseline_m
    sigma_m = float(np.sqrt(along @ scaled.covariance.block("translation") @ along))
    if not sigma_m < LEAST_TOLD * rig.baseline_m:
        raise refusal(finding("known-length-tells-too-little", baseline_m=rig.baseline_m, sigma_m=sigma_m))
    return scaled


def _seen(rig: StereoRig, pairs: Sequence[StereoPair], length: KnownLength) -> SeenLength:
    pair = pair_called(length.pair, pairs)
    left, right = (read_grey_image(path) for path in (pair.left_path, pair.right_path))
    found = []
    for end, place in zip(ENDS, length.left_px, strict=True):
        try:
            found.append(match_along_epipolar(left, right, rig, place))
        except NotMatchedError as error:
            x, y = place.tolist()
            raise refusal(
                finding("known-length-not-found", pair=pair.name, end=end, x_px=x, y_px=y, why=str(error))
            ) from None
    return SeenLength(
        length.left_px,
        np.stack([one.right_px for one in found]),
        np.stack([one.covariance_px2 for one in found]),
        np.stack([one.warp for one in found]),
        length.length_m,
        length.sigma_m,
        pair.name,
    )


def pair_called(name: str, pairs: Sequence[StereoPair]) -> StereoPair:
    """The pair of that name, else of that number.

    Raises:
        DataError: There is none.
    """
    for pair in pairs:
        if pair.name == name:
            return pair
    if name.isdecimal() and int(name) < len(pairs):
        return pairs[int(name)]
    there = name_some(pair.name for pair in pairs)
    raise DataError(
        f"a known length is of pair {name}, which is none: give a pair's name ({there}) or its number from 0."
    )
