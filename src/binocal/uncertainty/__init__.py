"""How far a calibrated rig can be trusted: standard deviations of depth, rows and projection from its covariance.

Pure functions of a rig, its covariance and places in its images; first order throughout. :mod:`~binocal.uncertainty.derivatives`
says how corners move with the rig's parameters, :mod:`~binocal.uncertainty.depth`, :mod:`~binocal.uncertainty.rows` and
:mod:`~binocal.uncertainty.projection` what follows for each figure, :mod:`~binocal.uncertainty.field` where both cameras see.
"""

from __future__ import annotations

from binocal.uncertainty.covariance import Covariance, MeanBoardPose
from binocal.uncertainty.depth import DepthSigma, depth_sigma
from binocal.uncertainty.field import CommonField, common_field
from binocal.uncertainty.projection import projection_covariance_px2, projection_sigma_px
from binocal.uncertainty.rows import row_sigma_px

__all__ = [
    "CommonField",
    "Covariance",
    "DepthSigma",
    "MeanBoardPose",
    "common_field",
    "depth_sigma",
    "projection_covariance_px2",
    "projection_sigma_px",
    "row_sigma_px",
]
