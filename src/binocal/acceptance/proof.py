"""When a solve from a rough start needs no diagnosis of its views: the conditions under which its result is proven.

Verification is cheaper than diagnosis: a rig that fits every image as well as a homography of the image's own, gives every corner
weight, and is well determined leaves nothing to repair, to reject or to warn of. The limits ask for more than the refusals and
warnings of :mod:`binocal.acceptance.rules` do; what fails here is diagnosed, not refused.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.acceptance.figures import corner_spacing_px, focal_sigma_share, translation_sigma
from binocal.result import StereoCalibration
from binocal.shapes import Bool, Float, Int
from binocal.solvers import robust

IMAGE_OUTLIER_SHARE = 0.05  # of one image: four corners of 88
EVEN_RATIO = 2.0  # RMS of the worst image over the median one's; noise alone reaches 1.3 at 88 corners, 1.7 at 12
HOMOGRAPHY_RATIO = 1.2  # over what free homographies leave, lens and all
NOISE_SHARE = 0.01  # corner noise over corner spacing: half of what small real images reach
SPACING_VIEWS = 4  # give the spacing to a tenth, which is enough here
CENTRE_SHARE = 0.08  # of the image's size; lenses sit within 0.1
FOCAL_SIGMA_SHARE = 0.005  # the scene's geometry is then beyond question: weak sets start at 0.01
BASELINE_SIGMA_SHARE = 0.02


def fits_evenly(
    n_seen: Int[ndarray, "images"],
    used: tuple[Bool[ndarray, "views n"], ...],
    whitened2: tuple[Float[ndarray, "views n"], ...],
    plain2: tuple[Float[ndarray, "views n"], ...],
    homography_px: float,
) -> bool:
    """Whether every image fits alike, and all of them as well as homographies of their own.

    ``used``, ``whitened2`` and ``plain2`` hold, camera by camera, which corners carry weight and their squared residual lengths as
    the solver weighs them and in pixels; ``n_seen`` counts the corners of each image, in the same order.
    ``homography_px`` is the RMS residual of one coordinate under free homographies.
    """
    n_used = np.concatenate([is_used.sum(axis=1) for is_used in used])
    if (n_used < (1 - IMAGE_OUTLIER_SHARE) * n_seen).any():
        return False
    mean2 = np.sort(_sums(whitened2, used) / n_seen)
    is_even = mean2[-1] < EVEN_RATIO**2 * max(mean2[len(mean2) // 2], robust.SCALE_FLOOR_PX**2)
    rms_px = np.sqrt(_sums(plain2, used).sum() / (2 * n_seen.sum()))
    return bool(is_even and rms_px < HOMOGRAPHY_RATIO * homography_px + robust.SCALE_FLOOR_PX)


def _sums(lengths2: tuple[ndarray, ...], used: tuple[ndarray, ...]) -> Float[ndarray, "images"]:
    """Sum over the used corners of every image."""
    return np.concatenate([np.where(u, px2, 0.0).sum(axis=1) for px2, u in zip(lengths2, used, strict=True)])


def is_beyond_doubt(calibration: StereoCalibration) -> bool:
    """Whether the rig is so well determined and so ordinary that no check of a diagnosed set could object."""
    rig = calibration.rig
    if calibration.evidence is None or calibration.findings or rig.is_swapped:
        return False
    if not calibration.noise_px < NOISE_SHARE * corner_spacing_px(calibration.evidence.detections, SPACING_VIEWS):
        return False
    for side, camera in (("left", rig.left), ("right", rig.right)):
        size = np.array(camera.size_wh)
        offset = np.abs(camera.parameters[2:4] - (size - 1) / 2)
        if np.any(offset > CENTRE_SHARE * size) or focal_sigma_share(calibration, side) > FOCAL_SIGMA_SHARE:
            return False
    return translation_sigma(calibration) < BASELINE_SIGMA_SHARE * rig.baseline_m
