"""Whether new images agree with a rig as far as its own standard deviations allow: the result of that comparison.

It is computed by :mod:`binocal.calibrators.agreement`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.findings import Finding, finding
from binocal.shapes import Float

LEAST_P = 1e-300  # what is smaller is printed as this
NO_CAUSE = "no single change of the rig explains it: it may be of other cameras, or the pairs were not taken together"
CHANCE = 1e-4  # how often a rig that has not changed may be said to have


@dataclass(frozen=True, slots=True)
class Cause:
    """What may have changed: its size in ``unit``, one standard deviation, and the share of the statistic that it explains."""

    code: str
    words: str
    size: float
    sigma: float
    unit: str
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Squared difference between a rig and what new views say, in units of both covariances, its degrees of freedom, its p-value.

    ``shift`` is that difference (views less rig) in the covariance's ``names``, as far as the views tell; ``shift_covariance`` what
    it is known to. ``cause`` is the one that explains most, None where rig and views agree. ``is_gross``: left
    and right corners miss each other under the rig by far (``pair_px``, the median, where each camera alone leaves ``alone_px``).
    """

    statistic: float
    freedom: int
    p_value: float
    names: tuple[str, ...]
    shift: Float[ndarray, "p"]
    shift_covariance: Float[ndarray, "p p"]
    noise_px: float
    cause: Cause | None = None
    is_gross: bool = False
    alone_px: float = np.nan
    pair_px: float = np.nan

    @property
    def agrees(self) -> bool:
        """Whether the difference is one that chance makes."""
        return self.p_value >= CHANCE and not self.is_gross

    @property
    def finding(self) -> Finding | None:
        """The disagreement as a finding; None where there is none."""
        if self.agrees:
            return None
        if self.is_gross:
            cause = NO_CAUSE if self.cause is None else self.cause.words
            return finding("rig-does-not-fit", alone_px=self.alone_px, pair_px=self.pair_px, what=cause)
        what = NO_CAUSE if self.cause is None else self.cause.words
        sigmas = float(np.sqrt(self.statistic / max(self.freedom, 1)))
        return finding(
            "rig-disagrees", p_value=self.p_value, difference_sigma=sigmas, n_directions=self.freedom, what=what
        )
