"""How far segments point past a vanishing point, in standard deviations of their ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Int

FAMILY_SHARE = 0.15  # of an image's segments, that belong to one family: streets with trees and cars have 10 to 30 %


@dataclass(frozen=True, slots=True, eq=False)
class PencilForms:
    """The forms by which segments meet a vanishing point v (homogeneous, pixels), one row for each segment.

    The distance in standard deviations is ``value v / sqrt(vᵀ variance v)``: by how much both ends must move at right angles to the
    segment, to first order, for its line to pass through v. Source: Sampson 1982, as for conics; Hartley & Zisserman 2004, 4.2.6.
    """

    value: Float[ndarray, "n 3"]
    variance: Float[ndarray, "n 3 3"]
    turn_sigma_rad: Float[ndarray, "n"]
    """Standard deviation of the segment's direction."""

    @staticmethod
    def of(
        ends_px: Float[ndarray, "n 2 2"], covariance_px2: Float[ndarray, "n 2 2"], floor_px: float = 0.0
    ) -> PencilForms:
        """Of segments with the covariance of their ends' displacements; ``floor_px`` is added to each end, independently."""
        C = covariance_px2 + floor_px**2 * np.eye(2)
        along = ends_px[:, 1] - ends_px[:, 0]
        length = np.linalg.norm(along, axis=1)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
        one = np.ones(len(ends_px))
        a, b = (np.column_stack([ends_px[:, k], one]) for k in range(2))
        n = np.column_stack([normal, 0 * one])
        by_ends = np.stack([np.cross(n, b), np.cross(a, n)], axis=1)
        variance = by_ends.transpose(0, 2, 1) @ C @ by_ends
        turn = np.sqrt(C[:, 0, 0] + C[:, 1, 1] - 2 * C[:, 0, 1]) / length
        return PencilForms(np.cross(a, b), variance, turn)

    def select(self, index: ndarray) -> PencilForms:
        """Some of the segments."""
        return PencilForms(self.value[index], self.variance[index], self.turn_sigma_rad[index])

    def distances(self, points: Float[ndarray, "k 3"]) -> Float[ndarray, "k n"]:
        """Signed distances in standard deviations to each of some points, for all segments."""
        variance = np.einsum("ki,nij,kj->kn", points, self.variance, points, optimize=True)
        return (points @ self.value.T) / np.sqrt(np.maximum(variance, 1e-300))

    def distances_of_own(self, points: Float[ndarray, "n 3"]) -> tuple[Float[ndarray, "n"], Float[ndarray, "n 3"]]:
        """Distance of each segment to a point of its own, and its derivative by the point."""
        turned = np.einsum("nij,nj->ni", self.variance, points)
        variance = np.maximum(np.sum(points * turned, axis=1), 1e-300)
        size = np.sqrt(variance)
        r = np.sum(points * self.value, axis=1) / size
        return r, (self.value - (r / size)[:, None] * turned) / size[:, None]

    def evidence(self, r2: Float[ndarray, "*k n"], n_families: int | Int[ndarray, "n"]) -> Float[ndarray, "*k n"]:
        """Log of how much more likely each segment is where it may be of a family than where segments turn at random.

        ``r2`` is the squared distance to the nearest of ``n_families`` vanishing points. A segment of a family turns by its own
        standard deviation about the point, any other one anywhere within half a turn. The mean of the exponential over random
        segments is 1 at most, so that a sum of S comes about by chance with probability exp(-S) at most (Markov's inequality).
        """
        peak = FAMILY_SHARE * np.pi / (np.sqrt(2 * np.pi) * np.maximum(self.turn_sigma_rad, 1e-9))
        return np.log(1 - n_families * FAMILY_SHARE + peak * np.exp(-0.5 * r2))


def nearest(distances: Float[ndarray, "k n"]) -> tuple[Int[ndarray, "n"], Float[ndarray, "n"]]:
    """Which of k points each segment is nearest to, and its signed distance."""
    which = np.abs(distances).argmin(axis=0)
    return which, distances[which, np.arange(distances.shape[1])]
