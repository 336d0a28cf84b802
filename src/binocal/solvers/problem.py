"""What the loop asks of a problem, and what a problem asks of a further term on its shared unknowns.

A problem has residuals (vectors, of which robust kernels see the lengths) and unknowns that live on a manifold. The loop knows
nothing else of it: any class with these methods can be solved, one problem or a batch at a time (:mod:`binocal.solvers.loop`).
:class:`binocal.solvers.board_views.BundleProblem` is the problem of this package; its terms are the weak priors of camera models
and an earlier calibration (:mod:`binocal.solvers.prior`).
"""

from __future__ import annotations

from typing import Protocol, TypeVar, runtime_checkable

from numpy import ndarray

from binocal.shapes import Bool, Float
from binocal.solvers import robust


@runtime_checkable
class Estimate(Protocol):
    """Values of all unknowns: a frozen dataclass whose arrays begin with the batch's dimensions."""

    @property
    def batch(self) -> tuple[int, ...]:
        """The batch's dimensions."""
        ...


@runtime_checkable
class Equations(Protocol):
    """A problem linearised at an estimate. ``cost_px2`` is its robust cost, inf where the estimate is impossible."""

    @property
    def cost_px2(self) -> Float[ndarray, "*batch"]:
        """The robust cost under the scale that the equations were made with."""
        ...

    @property
    def r2_px2(self) -> tuple[ndarray, ...]:
        """Squared residual lengths."""
        ...

    def cost_under(self, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel) -> Float[ndarray, "*batch"]:
        """The robust cost of the same residuals under another scale of the kernel."""
        ...


@runtime_checkable
class Step(Protocol):
    """A step of all unknowns; ``predicted_px2`` is the fall of the cost that the linear model predicts, NaN without a step."""

    @property
    def predicted_px2(self) -> Float[ndarray, "*batch"]:
        """The predicted fall."""
        ...


E = TypeVar("E", bound=Estimate)
Q = TypeVar("Q", bound=Equations)
S = TypeVar("S", bound=Step)


@runtime_checkable
class Problem(Protocol[E, Q, S]):
    """A robust least-squares problem, or a batch of them."""

    def residual_lengths2(self, estimate: E) -> tuple[ndarray, ...]:
        """Squared residual lengths at an estimate, inf where it is impossible."""
        ...

    def noise_estimate_px(self, r2_px2: tuple[ndarray, ...]) -> Float[ndarray, "*batch"]:
        """Noise of one residual coordinate from squared lengths: the median, floored."""
        ...

    def linearize(self, estimate: E, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel) -> Q:
        """Residuals, weights of the kernel under that scale, and normal equations."""
        ...

    def solve_step(self, estimate: E, equations: Q, damping: Float[ndarray, "*batch"]) -> S:
        """The Levenberg-Marquardt step with that damping."""
        ...

    def retract(self, estimate: E, step: S) -> E:
        """The estimate moved by a step."""
        ...

    def shared_information(self, estimate: E, equations: Q) -> Float[ndarray, "*batch s s"]:
        """Information of the shared unknowns for unit noise, all others free."""
        ...


@runtime_checkable
class SteerableProblem(Problem[E, Q, S], Protocol[E, Q, S]):
    """A problem whose steps from far away can be altered and corrected (:class:`binocal.solvers.loop_state.Action`)."""

    def solve_step(
        self,
        estimate: E,
        equations: Q,
        damping: Float[ndarray, "*batch"],
        stretch: Float[ndarray, "*batch 2"] | None = None,
        increment: Float[ndarray, "*batch 6"] | None = None,
        pose_damping: Float[ndarray, "*batch"] | None = None,
    ) -> S:
        """The step with the shared unknowns' part altered and the others' damping of its own."""
        ...

    def limited(self, step: S) -> S:
        """The step, shortened where it would go further than a linear model can mean."""
        ...

    def straightened(self, estimate: E, step: S, bend: Float[ndarray, "*batch"]) -> SteerableProblem[E, Q, S]:
        """The problem as it looks from the estimate once the step is taken, residuals followed to second order."""
        ...

    def corrected(self, step: S, correction: S, is_wanted: Bool[ndarray, "*batch"]) -> S:
        """The sum of both where a correction is wanted and small enough to be believed."""
        ...

    def with_views_at_best(self, estimate: E, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel) -> E:
        """The estimate with the views' own unknowns stepped to where they fit best beside the shared ones."""
        ...

    def with_lost_views_restored(self, candidate: E, equations: Q, start: E) -> E:
        """The candidate with what has lost all weight under a redescending kernel put back to the start's values."""
        ...


P_contra = TypeVar("P_contra", contravariant=True)
E_contra = TypeVar("E_contra", contravariant=True)


@runtime_checkable
class SharedTerm(Protocol[P_contra, E_contra]):
    """A quadratic cost on the shared unknowns of a problem beside its residuals, as a Gaussian prior is."""

    def energy(self, problem: P_contra, estimate: E_contra) -> Float[ndarray, "*batch"]:
        """Half the squared distance from the prior, in its standard deviations."""
        ...

    def normal_equations(
        self, problem: P_contra, estimate: E_contra
    ) -> tuple[Float[ndarray, "*batch s s"], Float[ndarray, "*batch s"]]:
        """Information about the shared unknowns and the downhill gradient of the energy."""
        ...
