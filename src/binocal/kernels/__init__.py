"""The compiled kernel: the inner loops of the joint solver and of the detection of boards.

Everything compiled is called through the modules of this package, which make arrays contiguous and give names to what comes
back: :mod:`~binocal.kernels.linearization`, :mod:`~binocal.kernels.steps` and :mod:`~binocal.kernels.transforms` for the solver
(their names are here too), :mod:`~binocal.kernels.images` and :mod:`~binocal.kernels.corner_fits` for images.

The kernel holds no lock while it works and gives the same result for any number of threads. Its formulas are those of
:mod:`binocal.cameras` and :mod:`binocal.solvers.robust`; tests/kernels states them plainly in NumPy and compares.
"""

from __future__ import annotations

try:
    from binocal.kernels import _kernel  # noqa: F401 - to say what is missing
except ImportError as error:
    raise ImportError(
        "binocal's compiled kernel is missing or was built for another Python; install binocal with pip "
        "(from a working tree: make, or pip install -e .)"
    ) from error

from binocal.kernels.joint_views import PoseSteps, StereoSums, reduce_stereo, solve_definite
from binocal.kernels.linearization import (
    PointEquations,
    ViewEquations,
    accumulate,
    accumulate_with_points,
    median_lengths2,
    point_gradients,
    robust_costs,
    squared_lengths,
    unweighted_columns,
)
from binocal.kernels.steps import LastIteration, Steps, observe, reduced_equations, reduced_information, solve_steps
from binocal.kernels.transforms import compose_poses, fit_planes, pixels_behind, step_poses

__all__ = [
    "LastIteration",
    "PointEquations",
    "PoseSteps",
    "Steps",
    "StereoSums",
    "ViewEquations",
    "accumulate",
    "accumulate_with_points",
    "compose_poses",
    "fit_planes",
    "median_lengths2",
    "observe",
    "pixels_behind",
    "point_gradients",
    "reduce_stereo",
    "reduced_equations",
    "reduced_information",
    "robust_costs",
    "solve_definite",
    "solve_steps",
    "squared_lengths",
    "step_poses",
    "unweighted_columns",
]
