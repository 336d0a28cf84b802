"""Cross-validation: two rigs, each from every other view, and how far they differ over the images in pixels and in depth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.calibrators import calibrate_as_requested
from binocal.calibrators.base import CalibrationRequest
from binocal.cameras import Camera
from binocal.errors import BinocalError, CancelledError
from binocal.geometry import so3
from binocal.metrics.image import triangulate
from binocal.result import StereoCalibration
from binocal.shapes import Bool, Float
from binocal.uncertainty import CommonField, common_field, depth_sigma
from binocal.uncertainty.field import image_grid

MIN_VIEWS = 8  # halves of fewer than four say little
COVERED_SHARE = 0.08  # of the image's diagonal: a place so near a corner is covered
MOST_CORNERS = 500  # evenly chosen, to say what is covered
FAR = 3.0  # times the boards' median distance


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidation:
    """How two halves of the views differ.

    ``left_px`` and ``right_px`` are the distances between the pixels at which the two see one direction, over grids of the images, once
    the second camera is turned to fit the first where corners were (what one has turned in its camera, the other has in its board
    poses; Kogan, mrcal documentation, "differencing"); ``is_covered`` says where there were corners. ``field`` is a grid of the left
    image at the ``ranges`` (the boards' median distance, and three times that), ``depth`` the relative difference of depth there,
    ``depth_sigma`` its stated standard deviation. ``failure``: a half gave no rig, and why; all else is empty then.
    """

    left_px: Float[ndarray, "rows columns"]
    right_px: Float[ndarray, "rows columns"]
    is_covered: tuple[Bool[ndarray, "rows columns"], Bool[ndarray, "rows columns"]]
    fields: tuple[CommonField, ...] = ()
    depth: tuple[Float[ndarray, "rows columns"], ...] = ()
    depth_sigma: tuple[Float[ndarray, "rows columns"], ...] = ()
    failure: str = ""

    @property
    def rms_px(self) -> float:
        """RMS of the projection's difference where corners were, both cameras."""
        parts = [px[own] for px, own in zip((self.left_px, self.right_px), self.is_covered, strict=True)]
        return _rms(np.concatenate(parts)) if parts else np.nan

    @property
    def depth_rms(self) -> float:
        """RMS of the relative difference of depth at the boards' distance."""
        return _rms(self.depth[0]) if self.depth else np.nan

    @property
    def depth_stated(self) -> float:
        """RMS of its stated standard deviation."""
        return _rms(self.depth_sigma[0]) if self.depth_sigma else np.nan

    @property
    def depth_z(self) -> float:
        """RMS of the difference over its stated standard deviation, at all ranges: 1 where standard deviations are right."""
        z = [d / s for d, s in zip(self.depth, self.depth_sigma, strict=True)]
        return _rms(np.concatenate([part.ravel() for part in z])) if z else np.nan


def cross_validate(calibration: StereoCalibration, request: CalibrationRequest | None = None) -> CrossValidation | None:
    """The used views in two halves, every other one, each calibrated as the whole was; None with fewer than eight views.

    ``request`` is that of the calibration; its prior does not count, which both halves would share.

    Raises:
        DataError: The calibration holds no corners.
        CancelledError: The request's ``should_stop`` said so.
    """
    views = calibration.corners.detections
    if views.n_views < MIN_VIEWS:
        return None
    request = replace(
        request or CalibrationRequest(),
        model=calibration.rig.left.model,
        prior=None,
        max_views=None,
        options={},
        progress=None,
    )
    halves = []
    for start in (0, 1):
        try:
            half = views.select(np.arange(start, views.n_views, 2))
            halves.append(calibrate_as_requested(half, request, calibrator="lm"))
        except CancelledError:
            raise
        except BinocalError as error:
            none = np.full((0, 0), np.nan)
            return CrossValidation(none, none, (none > 0, none > 0), failure=" ".join(str(error).split()))
    a, b = halves
    px, covered = [], []
    for side, corners in (("left", views.left_px), ("right", views.right_px)):
        own = _covered(getattr(a.rig, side), corners)
        px.append(projection_difference_px(getattr(a.rig, side), getattr(b.rig, side), own))
        covered.append(own)
    fields, depth, sigma = [], [], []
    assert a.T_left_board is not None  # it was just solved
    near = float(np.median(np.linalg.norm(a.T_left_board.t, axis=-1)))
    for range_m in (near, FAR * near):
        field = common_field(a.rig, range_m)
        difference, stated = depth_difference(a, b, field)
        fields.append(field)
        depth.append(difference)
        sigma.append(stated)
    return CrossValidation(px[0], px[1], (covered[0], covered[1]), tuple(fields), tuple(depth), tuple(sigma))


def projection_difference_px(
    a: Camera, b: Camera, fitted: Bool[ndarray, "rows columns"]
) -> Float[ndarray, "rows columns"]:
    """Distance, pixels, at which two calibrations of one camera see what the first sees at a grid of pixels, far away.

    The second camera is turned so that both agree best where ``fitted`` (Wahba's problem, by singular values).
    """
    px = image_grid(a, fitted.shape[::-1])
    rays_a, rays_b = a.unproject(px), b.unproject(px)
    use = fitted & np.isfinite(rays_a).all(axis=-1) & np.isfinite(rays_b).all(axis=-1)
    if use.sum() < 3:
        return np.full(fitted.shape, np.nan)
    R_b_a = so3.project_to_rotation(rays_b[use].T @ rays_a[use])
    return np.linalg.norm(b.project(rays_a @ R_b_a.T) - px, axis=-1)


def depth_difference(
    a: StereoCalibration, b: StereoCalibration, field: CommonField
) -> tuple[Float[ndarray, "rows columns"], Float[ndarray, "rows columns"]]:
    """Relative difference of depth: what the second measures from the pixels of the first; and its stated standard deviation."""
    points = np.where(field.is_common[..., None], field.points, np.nan)
    flat = points.reshape(-1, 3)
    pixels = a.rig.left.project(flat), a.rig.right.project(a.rig.T_right_left.apply(flat))
    measured, _ = triangulate(b.rig, *pixels)
    difference = (np.linalg.norm(measured, axis=-1) / np.linalg.norm(flat, axis=-1) - 1).reshape(field.is_common.shape)
    told = [depth_sigma(c.rig, c.stated_covariance, points) for c in (a, b)]
    return difference, np.hypot(*(t.calibration_m / t.depth_m for t in told))


def _covered(camera: Camera, corners: Float[ndarray, "views n 2"]) -> Bool[ndarray, "rows columns"]:
    seen = corners[np.isfinite(corners[..., 0])]
    seen = seen[:: max(len(seen) // MOST_CORNERS, 1)]
    grid = image_grid(camera)
    distance = np.linalg.norm(grid[:, :, None] - seen, axis=-1).min(axis=-1, initial=np.inf)
    return distance < COVERED_SHARE * float(np.hypot(*camera.size_wh))


def _rms(values: ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")
