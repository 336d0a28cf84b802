"""The length of a rig's translation from known lengths in the scene, with its standard deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.findings import Finding, finding, refusal
from binocal.geometry import SE3
from binocal.metrics.image import triangulate
from binocal.result import Covariance, StereoCalibration
from binocal.shapes import Float
from binocal.uncertainty.derivatives import pair_derivatives, variance_of
from binocal.values import ArrayValue

POINTED_SIGMA_PX = 0.5
"""How well a user points at the ends of a length in the left image."""
DISAGREEING_SIGMAS = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class SeenLength(ArrayValue):
    """A length of the scene whose ends are known in both images of a pair.

    ``right_sigma_px2`` is the covariance of each right end about its left one's partner; ``warps`` say how the right end moves
    with the left one on the same surface.
    """

    left_px: Float[ndarray, "2 2"]
    right_px: Float[ndarray, "2 2"]
    right_covariance_px2: Float[ndarray, "2 2 2"]
    warps: Float[ndarray, "2 2 2"]
    length_m: float
    sigma_m: float = 0.0
    pair: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _Scale:
    """The baseline that one length gives; how it changes with the rig's parameters, and the variance it has beside theirs."""

    baseline_m: float
    by_parameters: Float[ndarray, "p"]
    own_variance_m2: float


def with_known_lengths(calibration: StereoCalibration, lengths: Sequence[SeenLength]) -> StereoCalibration:
    """The calibration with the length of its translation as known lengths have it, weighted by how well each tells it.

    Its standard deviation counts the ends (the pointing, :data:`POINTED_SIGMA_PX`, and the matching), the lengths' own, and what
    the rig's other parameters are uncertain by, with which it is correlated.

    Raises:
        DataError: An end of a length lies behind a camera or has no parallax (finding ``known-length-not-found``).
    """
    scales = [_scale(calibration, length) for length in lengths]
    weight = 1 / np.maximum([scale.own_variance_m2 for scale in scales], 1e-18)
    weight = weight / weight.sum()
    baseline_m = float(weight @ [scale.baseline_m for scale in scales])
    by_parameters = weight @ np.stack([scale.by_parameters for scale in scales])
    own = float(weight**2 @ [scale.own_variance_m2 for scale in scales])
    rig, names = calibration.rig, calibration.covariance.names
    unit = rig.T_right_left.t / rig.baseline_m
    there = [names.index(f"translation.{axis}") for axis in "xyz"]
    # the translation's new error: its direction's old one at the new length, and along it the error of the length
    M = np.eye(len(names))
    M[np.ix_(there, there)] = baseline_m / rig.baseline_m * (np.eye(3) - np.outer(unit, unit))
    M[there] += np.outer(unit, by_parameters)
    matrix = M @ calibration.covariance.matrix @ M.T
    matrix[np.ix_(there, there)] += own * np.outer(unit, unit)
    return replace(
        calibration,
        rig=StereoRig(rig.left, rig.right, SE3(rig.T_right_left.R, baseline_m * unit), True),
        covariance=Covariance(names, matrix),
        findings=(*calibration.findings, *_disagreements(calibration, lengths, scales)),
        provenance={
            **calibration.provenance,
            "length_from": "a known length in the scene" if len(lengths) == 1 else "known lengths in the scene",
            "known_lengths": [
                {
                    "pair": length.pair,
                    "left_px": length.left_px.tolist(),
                    "right_px": length.right_px.tolist(),
                    "length_m": length.length_m,
                    "baseline_m": scale.baseline_m,
                    "baseline_sigma_m": float(
                        np.sqrt(_variance(calibration, scale.by_parameters) + scale.own_variance_m2)
                    ),
                }
                for length, scale in zip(lengths, scales, strict=True)
            ],
        },
    )


def _scale(calibration: StereoCalibration, length: SeenLength) -> _Scale:
    """The baseline is the old one times the true length over the measured one."""
    rig = calibration.rig
    ends, is_there = triangulate(rig, length.left_px, length.right_px)
    measured = float(np.linalg.norm(ends[1] - ends[0]))
    if not (is_there.all() and measured > 0):
        end = int(is_there[0])
        x, y = length.left_px[end].tolist()
        why = "it is too far away to have any parallax, or lies where the other end does"
        names = ("first", "second")
        raise refusal(finding("known-length-not-found", pair=length.pair, end=names[end], x_px=x, y_px=y, why=why))
    along = np.stack([ends[0] - ends[1], ends[1] - ends[0]]) / measured
    of = pair_derivatives(rig, calibration.covariance.names, ends)
    by_point = np.concatenate([of.left_by_point, of.right_by_point @ rig.T_right_left.R], axis=1)  # (2, 4, 3)
    to_point = np.linalg.pinv(by_point)  # of pixels, least squares
    by_pixels = np.einsum("ni,nij->nj", along, to_point)  # of the measured length by each end's four pixels
    by_parameters = -np.einsum("nj,njp->p", by_pixels, np.concatenate([of.left, of.right], axis=1))
    # the rig's own length is not asked: a longer one makes the measured length longer alike
    unit = rig.T_right_left.t / rig.baseline_m
    there = [calibration.covariance.names.index(f"translation.{axis}") for axis in "xyz"]
    by_parameters[there] -= unit * (unit @ by_parameters[there])
    pointed = by_pixels[:, :2] + np.einsum("nj,njk->nk", by_pixels[:, 2:], length.warps)
    variance = POINTED_SIGMA_PX**2 * (pointed**2).sum()
    variance += np.einsum("ni,nij,nj->", by_pixels[:, 2:], length.right_covariance_px2, by_pixels[:, 2:])
    baseline_m = rig.baseline_m * length.length_m / measured
    relative = variance / measured**2 + (length.sigma_m / length.length_m) ** 2
    return _Scale(baseline_m, -baseline_m / measured * by_parameters, float(baseline_m**2 * relative))


def _variance(calibration: StereoCalibration, gradient: Float[ndarray, "p"]) -> float:
    return float(variance_of(gradient, calibration.covariance.matrix))


def _disagreements(
    calibration: StereoCalibration, lengths: Sequence[SeenLength], scales: Sequence[_Scale]
) -> list[Finding]:
    """The pair of lengths that differ most, if by more than their standard deviations allow."""
    worst, said = DISAGREEING_SIGMAS, []
    for j, b in enumerate(scales):
        for i, a in enumerate(scales[:j]):
            variance = _variance(calibration, a.by_parameters - b.by_parameters) + a.own_variance_m2 + b.own_variance_m2
            z = abs(a.baseline_m - b.baseline_m) / np.sqrt(variance)
            if z > worst:
                worst = z
                said = [
                    finding(
                        "known-lengths-disagree",
                        first=f"{lengths[i].length_m:g} m in pair {lengths[i].pair}",
                        second=f"{lengths[j].length_m:g} m in pair {lengths[j].pair}",
                        first_m=a.baseline_m,
                        second_m=b.baseline_m,
                        sigmas=z,
                    )
                ]
    return said
