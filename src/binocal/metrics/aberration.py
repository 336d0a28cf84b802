"""Lateral chromatic aberration: by how much a lens images one colour at another scale, from corners measured in both.

A lens bends the colours differently, so that red, green and blue images of a scene differ, to first order, by a scale that changes with
the radius (Mallon and Whelan, Pattern Recognition Letters 28, 2007, eq. 3). The shift of their centres takes up where exactly the
lens's axis is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.evidence import Detections
from binocal.shapes import Float

MIN_VIEWS = 3  # the spread between views is what the standard deviation is made of
MIN_CORNERS = 30
N_PARAMETERS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Aberration:
    """Where one colour's corners lie against another's, in one camera, pixels; positive is outward.

    ``at_corner_px`` is the radial displacement at the image's farthest corner, ``at_edge_px`` that at ``edge_px``, the greatest radius
    at which there were corners, each with a standard deviation from the spread between the views. ``shift_px`` moves the whole image.
    """

    at_corner_px: float
    at_corner_sigma_px: float
    at_edge_px: float
    at_edge_sigma_px: float
    edge_px: float
    shift_px: Float[ndarray, "2"]
    rms_px: float
    n_corners: int

    @property
    def is_seen(self) -> bool:
        """Whether it is there at three standard deviations, where there were corners."""
        return abs(self.at_edge_px) > 3 * self.at_edge_sigma_px


def chromatic_aberration(
    reference_px: Float[ndarray, "views n 2"], other_px: Float[ndarray, "views n 2"], size_wh: tuple[int, int]
) -> Aberration | None:
    """Fit ``other - reference = shift + (p - c)(a + b |p - c|²)``, c the image's middle; None with too few common corners.

    The fit is by least squares, without the corners that lie five robust standard deviations off; the covariance is that between whole
    views (White, Econometrica 48, 1980, with clusters), because what errs alike over a view does not average out within it.
    """
    both = np.asarray(np.isfinite(reference_px).all(axis=-1) & np.isfinite(other_px).all(axis=-1))
    views = np.broadcast_to(np.arange(both.shape[0])[:, None], both.shape)[both]
    if len(views) < MIN_CORNERS or len(np.unique(views)) < MIN_VIEWS:
        return None
    middle = (np.array(size_wh, dtype=float) - 1) / 2
    corner = float(np.hypot(*(middle + 0.5)))
    at = (reference_px[both] - middle) / corner
    difference = other_px[both] - reference_px[both]
    rows = _rows(at)
    kept = np.ones(len(at), dtype=bool)
    solution, misfit = np.zeros(N_PARAMETERS), difference
    for _ in range(5):
        solution = np.linalg.lstsq(rows[kept].reshape(-1, N_PARAMETERS), difference[kept].ravel(), rcond=None)[0]
        misfit = difference - rows @ solution
        size = np.hypot(*misfit.T)
        before, kept = kept, size <= 5 * max(float(np.median(size[kept])) / 1.177, 1e-9)  # 1.177: a Rayleigh's median
        if (kept == before).all():
            break
    names = np.unique(views[kept])
    if kept.sum() < MIN_CORNERS or len(names) < MIN_VIEWS:
        return None
    inverse = np.linalg.pinv(np.einsum("nij,nik->jk", rows[kept], rows[kept]))
    scores = [np.einsum("nij,ni->j", rows[own], misfit[own]) for own in (kept & (views == name) for name in names)]
    covariance = inverse @ np.einsum("vj,vk->jk", scores, scores) @ inverse * (len(names) / (len(names) - 1))
    edge = float(np.hypot(*at[kept].T).max())

    def radial(radius: float) -> tuple[float, float]:
        gradient = np.array([0, 0, radius, radius**3])
        return float(gradient @ solution), float(np.sqrt(gradient @ covariance @ gradient))

    rms = float(np.sqrt(np.mean(misfit[kept] ** 2)))
    return Aberration(*radial(1.0), *radial(edge), edge * corner, solution[:2], rms, int(kept.sum()))


def aberration_between(reference: Detections, other: Detections, side: str) -> Aberration | None:
    """:func:`chromatic_aberration` of the views that two colours' detections have in common; ``side`` is left or right."""
    names = [name for name in reference.names if name in other.names]
    if not names:
        return None
    first, second = (getattr(of, f"{side}_px")[[of.names.index(name) for name in names]] for of in (reference, other))
    return chromatic_aberration(first, second, getattr(reference, f"{side}_size_wh"))


def _rows(at: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2 4"]:
    """Derivatives of a displacement by the shift and the two terms of the scale; ``at`` in units of the corner's radius."""
    rows = np.zeros((len(at), 2, N_PARAMETERS))
    rows[:, 0, 0] = rows[:, 1, 1] = 1
    rows[:, :, 2] = at
    rows[:, :, 3] = at * (at**2).sum(axis=1, keepdims=True)
    return rows
