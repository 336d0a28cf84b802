"""A weak prior of principal points, for lenses so long that the views hardly tell them.

Through a telephoto lens a shift of the principal point hardly differs from a turn of the camera with all boards, with terms of the
distortion in between. The solve then creeps along a valley that bends within a standard deviation, to principal points that may lie
outside of the image and standard deviations that mean little. No lens sits there: that it sits near the middle is known beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.shapes import Float
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem
from binocal.solvers.joint_system import solve_symmetric

PRIOR_SHARE = 0.05  # of the image's size, one standard deviation; lenses sit within 0.1
UNTOLD_SHARE = (
    0.02  # standard deviation of a principal point over the image's size: where the views tell less, the prior counts
)
LONG = 2.0  # image widths of focal length; the views of a shorter lens that tell too little are refused, not helped
CENTRE = (2, 3)  # places of cx and cy among a camera's parameters

Sizes = tuple[tuple[int, int], tuple[int, int]]


@dataclass(frozen=True, slots=True, eq=False)
class CentrePrior:
    """The principal points near the middle of their images, a term like any other (:class:`binocal.solvers.problem.SharedTerm`)."""

    sizes_wh: Sizes

    def energy(self, problem: BundleProblem, estimate: BundleEstimate) -> Float[ndarray, "*batch"]:
        """Half the squared distance of the free ones from the middle, in standard deviations."""
        energy = np.zeros(estimate.batch)
        for camera, values, size in zip(problem.cameras, estimate.parameters, self.sizes_wh, strict=True):
            for axis, place in enumerate(CENTRE):
                if camera.is_free[place]:
                    energy = (
                        energy + 0.5 * ((values[..., place] - (size[axis] - 1) / 2) / (PRIOR_SHARE * size[axis])) ** 2
                    )
        return energy

    def normal_equations(
        self, problem: BundleProblem, estimate: BundleEstimate
    ) -> tuple[Float[ndarray, "*batch s s"], Float[ndarray, "*batch s"]]:
        """A diagonal information; the gradient pulls towards the middle."""
        precision = np.zeros(problem.n_shared)
        gradient = np.zeros((*estimate.batch, problem.n_shared))
        for camera, values, size, first in zip(
            problem.cameras, estimate.parameters, self.sizes_wh, problem.places, strict=True
        ):
            for axis, place in enumerate(CENTRE):
                if camera.is_free[place]:
                    column = first.start + int(camera.is_free[:place].sum())
                    precision[column] = (PRIOR_SHARE * size[axis]) ** -2
                    gradient[..., column] = -precision[column] * (values[..., place] - (size[axis] - 1) / 2)
        return np.broadcast_to(np.diag(precision), (*estimate.batch, *(2 * precision.shape))), gradient


def has_centre_prior(problem: BundleProblem) -> bool:
    """Whether the prior counts in a problem."""
    return any(isinstance(term, CentrePrior) for term in problem.terms)


def with_centre_prior(
    problem: BundleProblem, near: BundleMinimum, sizes_wh: Sizes
) -> tuple[BundleProblem, BundleMinimum]:
    """The problem with the prior, and the solve as not yet at its end, where the views of a long lens hardly tell a principal point.

    Both as they are where they do. ``near`` needs not be a minimum.
    """
    if not problem.is_stereo or not any(
        values[0] > LONG * size[0] and not camera.model.sees_behind
        for camera, values, size in zip(problem.cameras, near.estimate.parameters, sizes_wh, strict=True)
    ):
        return problem, near
    information = problem.shared_information(near.estimate, near.equations)
    variance = np.diagonal(solve_symmetric(information, np.eye(len(information)))) * float(near.scale_px) ** 2
    for camera, size, first in zip(problem.cameras, sizes_wh, problem.places, strict=True):
        for axis, place in enumerate(CENTRE):
            column = first.start + int(camera.is_free[:place].sum())
            if camera.is_free[place] and not variance[column] < (UNTOLD_SHARE * size[axis]) ** 2:
                widened = replace(problem, terms=(*problem.terms, CentrePrior(sizes_wh)))
                return widened, replace(near, is_converged=np.asarray(False))
    return problem, near
