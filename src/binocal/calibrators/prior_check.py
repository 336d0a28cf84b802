"""Whether the new views agree with what was known of the rig before.

Without the prior the views fit as well as they can; with it they fit worse and move the rig away from it. Both together, in units
of noise and of the prior's standard deviations, follow a chi-squared distribution if prior and views are of one rig: the
likelihood-ratio statistic, with one degree of freedom for each parameter that the prior informs of or holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocal.findings import Finding, finding, refusal
from binocal.solvers import robust
from binocal.solvers.board_views import BundleMinimum, BundleProblem
from binocal.solvers.prior import PriorTerm, RigPrior

CHANCE = 1e-4  # how often prior and views of one rig may be said to differ
REFUSED_SIGMA = (
    5.0  # RMS over the parameters; real rigs, whose errors are alike within a view, reach 4.5 and are warned of
)


@dataclass(frozen=True, slots=True)
class Disagreement:
    """The statistic and its degrees of freedom."""

    statistic: float
    freedom: int

    @property
    def rms_sigma(self) -> float:
        """RMS difference over the parameters, in standard deviations."""
        return float(np.sqrt(self.statistic / self.freedom)) if self.freedom else 0.0

    @property
    def chance(self) -> float:
        """How often it is as large by chance alone."""
        from scipy.special import chdtrc  # a tenth of a second to import, which only a prior is worth

        return float(chdtrc(self.freedom, self.statistic)) if self.freedom else 1.0


def disagreement(
    prior: RigPrior, known: tuple[BundleProblem, BundleMinimum], free: tuple[BundleProblem, BundleMinimum]
) -> Disagreement:
    """Of the minimum with the prior (``known``) and that without it (``free``), of the same views."""
    (problem, minimum), (free_problem, free_minimum) = known, free
    scale = np.maximum(free_minimum.scale_px, robust.SCALE_FLOOR_PX)
    costs = [
        sum(float(robust.costs(r2, scale, "hampel").sum()) for r2 in free_problem.residual_lengths2(m.estimate))
        for m in (minimum, free_minimum)
    ]
    energy = float(PriorTerm(prior).energy(problem, minimum.estimate)) if prior.names else 0.0
    statistic = 2 * max(costs[0] - costs[1], 0.0) / float(scale) ** 2 + 2 * energy
    return Disagreement(statistic, len(prior.names) + free_problem.n_free - problem.n_free)


def check_disagreement(found: Disagreement) -> tuple[Finding, ...]:
    """A warning where prior and views differ by more than chance.

    Raises:
        InconsistentViewsError: They differ by so much that one of them is wrong.
    """
    figures = {"difference_sigma": found.rms_sigma, "n_parameters": found.freedom}
    if not found.rms_sigma < REFUSED_SIGMA:
        raise refusal(finding("prior-contradicted", **figures))
    return (finding("prior-doubtful", **figures),) if found.chance < CHANCE else ()
