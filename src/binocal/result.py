"""What a calibration is: the rig, how far it can be trusted, and what happened to every view."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.errors import DataError
from binocal.evidence import Detections
from binocal.evidence.pixel_locking import RigLocking
from binocal.evidence.right_poses import MOST_OFF_BALANCE, imbalance_of_deviations
from binocal.findings import Finding, Severity, finding
from binocal.geometry import SE3, so3
from binocal.shapes import Float
from binocal.uncertainty import Covariance, DepthSigma, MeanBoardPose, common_field, depth_sigma
from binocal.uncertainty import projection_sigma_px as projection_sigma_px_of
from binocal.uncertainty import row_sigma_px as row_sigma_px_of
from binocal.uncertainty.depth import points_at
from binocal.values import ArrayValue, frozen_array, with_sigma

SAME_RMS_PX, SAME_RMS_SHARE = (
    1e-7,
    1e-6,
)  # two ways to compute one RMS differ by 1e-12 px; other corners by 1e-3 and more
_NOT_THESE = "these are not the corners that the calibration was made from"


@dataclass(frozen=True, slots=True)
class ResidualSummary:
    """RMS distance between measured and predicted corners, pixels: per corner, not per coordinate (OpenCV's convention)."""

    left_px: float
    right_px: float
    all_px: float


@dataclass(frozen=True, slots=True)
class OutlierCorner:
    """A corner that the solver gave no weight: its camera (``left`` or ``right``), index on the board, distance from the fit."""

    camera: str
    corner: int
    distance_px: float


@dataclass(frozen=True, slots=True)
class ViewResult:
    """A view that was used. ``outliers`` among its ``n_corners`` corners (both cameras) were rejected.

    RMS is over the others.

    ``note`` says what was repaired, if anything. An RMS is NaN where the camera did not see the board. ``left_order`` and
    ``right_order`` are empty unless that camera's corners were put into another order: corner i of the view is corner
    ``order[i]`` as detected.
    """

    name: str
    rms_px: float
    left_rms_px: float
    right_rms_px: float
    n_corners: int
    outliers: tuple[OutlierCorner, ...] = ()
    note: str = ""
    left_order: tuple[int, ...] = ()
    right_order: tuple[int, ...] = ()

    @property
    def n_outliers(self) -> int:
        """Number of rejected corners."""
        return len(self.outliers)


@dataclass(frozen=True, slots=True)
class RejectedView:
    """A view that was not used, and why; ``code`` is that of the finding, where it is one."""

    name: str
    reason: str
    code: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class BoardShape(ArrayValue):
    """The board as it is, where it is not as it was drawn: its points in its own frame, with their standard deviations.

    Lengths are metres (board pitches without a scale). ``bow_m`` is the largest less the smallest height above the mean plane,
    ``stretch`` the relative extension along the board's x less that along y. No image of the board tells its scale: over all its
    points it is that of the drawing, which holds to ``scale_sigma`` (relative), as far as the print's other errors let one judge;
    baseline and lengths are uncertain by as much beyond their own standard deviations.
    """

    points_m: Float[ndarray, "n 3"]
    sigma_m: Float[ndarray, "n 3"]
    bow_m: float
    bow_sigma_m: float
    stretch: float
    stretch_sigma: float
    in_plane_rms_m: float
    scale_sigma: float

    def __post_init__(self) -> None:
        for name in ("points_m", "sigma_m"):
            array = frozen_array(getattr(self, name))
            if array.ndim != 2 or array.shape[1] != 3:
                raise ValueError(f"{name} must be (n, 3); got {array.shape}")
            object.__setattr__(self, name, array)


@dataclass(frozen=True, slots=True)
class ExposureFit:
    """Noise of one corner coordinate where each camera is fitted alone and where both are, pixels, with one board shape.

    ``are_apart``: the cameras did not see the board at one moment, and each view's right pose was given a deviation of its own, of
    standard deviation ``turn_sigma_rad`` and ``shift_sigma_m`` (0 where they are together).
    """

    alone_px: float
    pair_px: float
    are_apart: bool = False
    turn_sigma_rad: float = 0.0
    shift_sigma_m: float = 0.0

    @property
    def ratio(self) -> float:
        """Pair over alone: 1 where both cameras saw one board in one place."""
        return self.pair_px / self.alone_px if self.alone_px > 0 else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a rig was computed from.

    The used views with repaired corner orders, the board's pose in each of them, and, where the corners carry
    covariances, the misfit that was added to them (standard deviation of one coordinate). ``board_shape`` is the board as it is,
    None where it is as drawn; ``T_right_board`` the board's pose in the right camera of each view, None where it is as the rig
    has it.
    """

    detections: Detections
    T_left_board: SE3
    misfit_px: float = 0.0
    board_shape: BoardShape | None = None
    T_right_board: SE3 | None = None

    @property
    def board_points_m(self) -> Float[ndarray, "n 3"]:
        """The board's points as they are."""
        return self.detections.object_points_m if self.board_shape is None else self.board_shape.points_m


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class StereoCalibration:
    """The result of every calibrator.

    ``findings`` are warnings and notes for the user, the gravest first. ``provenance`` holds versions, calibrator, options,
    model choice.
    """

    rig: StereoRig
    covariance: Covariance
    rms: ResidualSummary
    noise_px: float
    """Estimated standard deviation of one corner coordinate, pixels; where corners carry covariances, that of as many
    equal corners that would carry as much information."""
    views: tuple[ViewResult, ...]
    rejected: tuple[RejectedView, ...] = ()
    findings: tuple[Finding, ...] = ()
    n_iterations: int = 0
    provenance: Mapping[str, Any] = field(default_factory=dict)
    evidence: Evidence | None = None
    """The corners that the rig was computed from; None when it was read from a file that does not hold them, until
    :meth:`with_evidence` brings them back."""
    T_left_board: SE3 | None = None
    """The board's pose in every used view; with evidence, that of the evidence."""
    misfit_px: float | None = None
    """The misfit that the corner weights count, see :class:`Evidence`; None where that is not known."""
    board_shape: BoardShape | None = None
    """The board as it is; None where it is as drawn, or was held so."""
    T_right_board: SE3 | None = None
    """The board's pose in the right camera of each view where the exposures were apart, see :class:`Evidence`; else None."""
    exposure: ExposureFit | None = None
    """How each camera alone fits against the pair; None where that is not known."""
    nominal_noise_px: float | None = None
    """``noise_px`` as it would be with the board held as drawn and the exposures together; None where that is not known."""
    mean_board_pose: MeanBoardPose | None = None
    """How the boards' mean pose errs with the rig, which :meth:`projection_sigma_px` needs; None where that is not known."""
    extra: Mapping[str, Any] = field(default_factory=dict)
    """What the file that it was read from says beyond this class, by key; written back as it is."""

    def __post_init__(self) -> None:
        if self.evidence is not None:
            for name in ("T_left_board", "misfit_px", "board_shape", "T_right_board"):
                object.__setattr__(self, name, getattr(self.evidence, name))

    def __repr__(self) -> str:
        rig, sigma = self.rig, self.covariance.sigma
        n_all = len(self.views) + len(self.rejected)
        lines = [
            f"<StereoCalibration: {rig.left.model}, {len(self.views)} of {n_all} views, RMS {self.rms.all_px:.3f} px, "
            f"noise {self.noise_px:.3f} px per coordinate"
        ]
        for side, camera in (("left", rig.left), ("right", rig.right)):
            values = zip(("fx", "fy", "cx", "cy"), camera.parameters.tolist(), strict=False)
            figures = ", ".join(f"{n} {with_sigma(x, sigma.get(f'{side}.{n}', math.nan))}" for n, x in values)
            lines.append(f"{side:5} {camera.size_wh[0]}x{camera.size_wh[1]} px: {figures}")
        angles = zip(("pitch", "yaw", "roll"), np.degrees(rig.euler_rad), np.degrees(self.euler_sigma_rad), strict=True)
        lines.append("turn  " + ", ".join(f"{n} {with_sigma(x, s)}" for n, x, s in angles) + " deg")
        unit, factor = rig.printed_unit
        baseline = with_sigma(factor * rig.baseline_m, factor * self.baseline_sigma_m)
        lines.append(f"baseline {baseline} {unit}")
        codes = [f"{found.code} ({found.severity.value})" for found in self.findings]
        lines.append("findings: " + (", ".join(codes) if codes else "none") + ">")
        return "\n  ".join(lines)

    @property
    def plot(self) -> Any:
        """Figures on Matplotlib's axes: ``plot.coverage()``, ``.residuals()``, ``.rig()``, ``.depth()``; the extra ``report`` draws them.

        See :class:`binocal.report.notebook.CalibrationPlots`, which is loaded from above when asked for: a result knows no figures.
        """
        return importlib.import_module("binocal.report.notebook").CalibrationPlots(self)

    def _repr_html_(self) -> str:
        """What a notebook shows: the verdict, key figures, the rig and its depth error."""
        return importlib.import_module("binocal.report.notebook").calibration_html(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The sentences of the findings that are warnings."""
        return tuple(found.text for found in self.findings if found.severity is Severity.WARNING)

    @property
    def corners(self) -> Evidence:
        """``evidence``, for whoever cannot do without.

        Raises:
            DataError: It was read from a file that holds none; the text says how to bring it back.
        """
        if self.evidence is None:
            raise DataError(
                "this calibration was read from a file, which holds no corners; "
                "give it those that `binocal calibrate --evidence` kept: calibration.with_evidence(read_detections(path))."
            )
        return self.evidence

    def with_evidence(self, detections: Detections) -> StereoCalibration:
        """The calibration with the corners that it was made from: ``detections`` as they were before it (views by name).

        Corner orders that were repaired are repaired again. With evidence the calibration is as good as new: it can be checked
        again, and its own corners be measured anew.

        Raises:
            DataError: These are not the corners that it was made from; the text names the first difference.
        """
        if self.T_left_board is None:
            raise DataError("the calibration does not hold its views' board poses; calibrate anew from the corners.")
        used = self._used_views(detections)
        orders = {
            side: {i: np.array(order) for i, v in enumerate(self.views) if (order := getattr(v, f"{side}_order"))}
            for side in ("left", "right")
        }
        used = used.reorder("left", orders["left"]).reorder("right", orders["right"])
        self._check_residuals(self._unlocked(used))
        self._check_right_poses(used)
        evidence = Evidence(used, self.T_left_board, self.misfit_px or 0.0, self.board_shape, self.T_right_board)
        return replace(self, evidence=evidence)

    def _unlocked(self, detections: Detections) -> Detections:
        """The detections as the solve took them: without their locking to the pixel grid, where some was found."""
        found = self.provenance.get("pixel_locking")
        return detections if not found else RigLocking.of_document(found).corrected(detections)

    def _used_views(self, detections: Detections) -> Detections:
        """The used views of detections that fit the rig's images and units."""
        rig = self.rig
        for side, found, expected in (
            ("left", detections.left_size_wh, rig.left.size_wh),
            ("right", detections.right_size_wh, rig.right.size_wh),
        ):
            if found != expected:
                raise DataError(f"{_NOT_THESE}: the {side} images are {found} pixels, the rig's {expected}.")
        if detections.is_metric != rig.is_metric:
            raise DataError(f"{_NOT_THESE}: only one of the board and the rig is in metres.")
        place = {name: i for i, name in enumerate(detections.names)}
        if len(place) < detections.n_views:
            raise DataError(f"{_NOT_THESE}: several views have one name.")
        missing = [view.name for view in self.views if view.name not in place]
        if missing:
            raise DataError(f"{_NOT_THESE}: view {missing[0]} is missing ({len(missing)} of {len(self.views)} are).")
        n = len(detections.object_points_m)
        if any(len(order) not in (0, n) for view in self.views for order in (view.left_order, view.right_order)):
            raise DataError(f"{_NOT_THESE}: the board has {n} points.")
        return detections.select(np.array([place[view.name] for view in self.views], dtype=int))

    def _check_residuals(self, used: Detections) -> None:
        """Raises DataError: a view's corners are not as many, or not as far from their predictions, as the calibration says."""
        assert self.T_left_board is not None  # with_evidence asked before
        points = used.object_points_m if self.board_shape is None else self.board_shape.points_m
        if len(points) != len(used.object_points_m):
            raise DataError(f"{_NOT_THESE}: the board has {len(used.object_points_m)} points, not {len(points)}.")
        in_left = self.T_left_board.apply(points)
        in_right = (
            self.rig.T_right_left.apply(in_left) if self.T_right_board is None else self.T_right_board.apply(points)
        )
        n_seen = used.left_is_seen.sum(axis=1) + used.right_is_seen.sum(axis=1)
        for i, view in enumerate(self.views):
            if n_seen[i] != view.n_corners:
                raise DataError(f"{_NOT_THESE}: view {view.name} has {n_seen[i]} corners instead of {view.n_corners}.")
        for side, camera, points, px in (
            ("left", self.rig.left, in_left, used.left_px),
            ("right", self.rig.right, in_right, used.right_px),
        ):
            r2 = np.square(px - camera.project(points)).sum(axis=-1)
            for i, view in enumerate(self.views):
                r2[i, [o.corner for o in view.outliers if o.camera == side and o.corner < r2.shape[1]]] = np.nan
                seen = r2[i][np.isfinite(r2[i])]
                found, stated = float(np.sqrt(seen.mean())) if len(seen) else np.nan, getattr(view, f"{side}_rms_px")
                if np.isnan(found) and np.isnan(stated):
                    continue
                if not abs(found - stated) <= SAME_RMS_PX + SAME_RMS_SHARE * stated:
                    raise DataError(
                        f"{_NOT_THESE}: {side} view {view.name} is {found:.4g} px from its prediction (RMS), "
                        f"not {stated:.4g} px."
                    )

    def pose_imbalance(self, centre_m: Float[ndarray, "3"]) -> float:
        """By how many standard errors R and T miss what the views' own right poses deviate from: more than 1 after a change by hand.

        ``centre_m`` is the board's. 0 where the exposures were together, and where a prior of R and T pulled them away. See
        :mod:`binocal.evidence.right_poses`.
        """
        options = self.provenance.get("options")
        has_prior = isinstance(options, Mapping) and "prior" in options
        if self.T_right_board is None or self.T_left_board is None or has_prior:
            return 0.0
        both = [i for i, v in enumerate(self.views) if np.isfinite(v.left_rms_px) and np.isfinite(v.right_rms_px)]
        left, right = (SE3(T.R[both], T.t[both]) for T in (self.T_left_board, self.T_right_board))
        return imbalance_of_deviations(self.rig.T_right_left, left, right, centre_m)

    def _check_right_poses(self, used: Detections) -> None:
        """Raises DataError: R and T were changed where the views' right poses are their own: residuals do not tell that."""
        points = used.object_points_m if self.board_shape is None else self.board_shape.points_m
        off = self.pose_imbalance(points.mean(axis=0))
        if off > MOST_OFF_BALANCE:
            raise DataError(finding("rig-file-changed", standard_errors=off).text)

    @property
    def euler_sigma_rad(self) -> tuple[float, float, float]:
        """Standard deviations of the paper's angles gamma, lambda, mu, radians; NaN where unknown.

        First order, through central differences of the angles by the rotation vector (step 1e-6 rad, error below 1e-9).
        """
        R, step = self.rig.T_right_left.R, 1e-6
        J = np.empty((3, 3))
        for i in range(3):
            w = np.zeros(3)
            w[i] = step
            difference = np.subtract(so3.to_paper_angles(so3.exp(w) @ R), so3.to_paper_angles(so3.exp(-w) @ R))
            J[:, i] = ((difference + np.pi) % (2 * np.pi) - np.pi) / (2 * step)
        gamma, lambda_, mu = np.sqrt(np.diag(J @ self.covariance.block("rotation") @ J.T)).tolist()
        return gamma, lambda_, mu

    @property
    def baseline_sigma_m(self) -> float:
        """Standard deviation of the baseline, metres (board pitches without a scale); NaN where unknown, 0 where given."""
        along = self.rig.T_right_left.t / self.rig.baseline_m
        covariance = self.covariance.block("translation")
        variance = along @ covariance @ along
        is_rounding = variance <= 1e-14 * np.trace(covariance)
        return 0.0 if is_rounding else float(np.sqrt(variance))

    @property
    def board_scale_sigma(self) -> float:
        """Relative standard deviation of the board's size, 0 where the board was not measured: its print then says nothing."""
        return 0.0 if self.board_shape is None else self.board_shape.scale_sigma

    def depth_sigma(
        self,
        point_or_range: Float[ndarray, "*n 3"] | float,
        *,
        left_px: Float[ndarray, "2"] | None = None,
        matching_px: float = 0.0,
    ) -> DepthSigma:
        """Standard deviation of depth at points of the left frame, (..., 3), or at a range and a place in the left image.

        Lengths are metres (board pitches without a scale). A range without ``left_px`` is looked at in the middle of what both
        cameras see there. ``matching_px`` is the standard deviation of a disparity. See :func:`binocal.uncertainty.depth_sigma`.

        Raises:
            ValueError: The range is not above 0, or the points are not (..., 3).
            DataError: The calibration states no covariance.
        """
        given = np.asarray(point_or_range, dtype=float)
        if given.ndim == 0:
            if not 0 < given < np.inf:
                raise ValueError(f"a range is a length above 0; got {float(given)}")
            if left_px is None:
                field = common_field(self.rig, float(given))
                points = field.points[field.middle]
            else:
                points = points_at(self.rig, np.asarray(left_px, dtype=float), float(given))
        elif given.shape[-1] == 3 and left_px is None:
            points = given
        else:
            raise ValueError(f"give points as (..., 3), or a range as one number; got {given.shape}")
        return depth_sigma(
            self.rig,
            self.stated_covariance,
            points,
            matching_px=matching_px,
            board_scale_sigma=self.board_scale_sigma,
        )

    def row_sigma_px(
        self, left_px: Float[ndarray, "*n 2"], *, range_m: Float[ndarray, "*n"] | float = np.inf
    ) -> Float[ndarray, "*n"]:
        """Standard deviation of the row error after rectification at left pixels; see :func:`binocal.uncertainty.row_sigma_px`.

        Raises:
            DataError: The calibration states no covariance.
        """
        return row_sigma_px_of(self.rig, self.stated_covariance, left_px, range_m)

    def projection_sigma_px(
        self,
        side: Literal["left", "right"],
        px: Float[ndarray, "*n 2"],
        *,
        range_m: Float[ndarray, "*n"] | float = np.inf,
    ) -> Float[ndarray, "*n"]:
        """Standard deviation of a camera's projection in its worst direction; see :func:`binocal.uncertainty.projection_sigma_px`.

        Raises:
            DataError: The calibration does not say how the board poses err with the rig.
        """
        if side not in ("left", "right"):
            raise ValueError(f"a rig has a left and a right camera; got {side!r}")
        if self.mean_board_pose is None:
            raise DataError(
                "this calibration does not say how its board poses err with its cameras (an older file): calibrate anew, and "
                "projection uncertainty can be told."
            )
        return projection_sigma_px_of(self.rig, self.stated_covariance, self.mean_board_pose, side, px, range_m)

    @property
    def stated_covariance(self) -> Covariance:
        """``covariance``, for whoever cannot do without.

        Raises:
            DataError: It has none, or unknown entries.
        """
        if not self.covariance.names or not np.isfinite(self.covariance.matrix).all():
            raise DataError(
                "this calibration states no covariance of its parameters, so no uncertainty follows: calibrate anew."
            )
        return self.covariance
