"""``binocal evaluate``: a rig against the truth, or on images of a board that it has not seen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal.app.corners import FoundCorners, find_corners
from binocal.app.measured import checked_board, scale_as_measured
from binocal.boards import Board, BoardSet, parse_board
from binocal.boards.board_set import SEPARATOR
from binocal.cameras import StereoRig
from binocal.errors import CalibrationError, DataError, DegenerateGeometryError
from binocal.evidence import Detections
from binocal.evidence.right_poses import MOST_OFF_BALANCE
from binocal.findings import Finding, finding, refusal
from binocal.formats import rig_json
from binocal.metrics import image, pose
from binocal.metrics.common_rows import CommonRows, common_rows
from binocal.metrics.held_out import Criterion, criteria_on_exact_views, exact_views, is_inside
from binocal.progress import ProgressCallback, ShouldStop
from binocal.requirements.agreement import Agreement
from binocal.result import Covariance, RejectedView, StereoCalibration
from binocal.shapes import Float

if TYPE_CHECKING:
    from binocal.solvers.whitening import CornerWeights

EXACT_VIEWS = 20
UNLIKE_NOISE = 1.5  # one camera's RMS over the other's: cameras of one kind scatter by a tenth
MOST_FOCAL_SIGMA_SHARE = (
    0.2  # rigs are drawn about the truth with the bound's covariance: the next 5 sigma must be cameras
)
SUSPECT_VIEW_FACTOR = 5.0  # a held-out view whose RMS is that many times the median is named
MOST_SUSPECTS = 0.2  # share of the views that may be left out; of more, the rig may be what is wrong: they stay


@dataclass(frozen=True, slots=True, eq=False)
class TruthEvaluation:
    """A calibration against the truth of a simulation. ``notes`` say what could not be compared, and why."""

    comparison: pose.TruthComparison
    noise_px: float
    """Corner noise, one standard deviation per coordinate, that the bound is computed for; NaN without a bound."""
    notes: tuple[str, ...] = ()
    criteria: tuple[Criterion, ...] = ()
    """The paper's criteria on exact new views of the true rig."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageEvaluation:
    """A rig on images of a board, best on images that the calibration has not seen."""

    pixel_error: image.PixelError
    row_error: image.RowError | None
    length_error: image.LengthError
    names: tuple[str, ...]
    rejected: tuple[RejectedView, ...] = ()
    ignored: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    detections: Detections | None = None
    """The corners, in the order that the rig gave them."""
    agreement: Agreement | None = None
    """The images against the rig's own standard deviations; None where it states none."""
    common_rows: CommonRows | None = None
    """The row error that the views share; None where too few views tell it."""
    changed: Finding | None = None
    """That the rig's file is not as the calibration wrote it, where it shows."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What the comparison with the rig has to say; of a rig without standard deviations, what its rows have."""
        said = self.agreement or self.common_rows
        found = self.changed, None if said is None else said.finding
        return tuple(one for one in found if one is not None)


def evaluate_truth(calibration: StereoCalibration, truth: rig_json.Truth, *, seed: int = 0) -> TruthEvaluation:
    """Errors of a calibration whose truth is known, each beside its Cramér-Rao bound.

    The bound is that of the views which the calibration used, for the corner noise that it measured. The criteria are measured on
    exact new views of the true rig, drawn from ``seed``.
    """
    rig, notes = calibration.rig, []
    sigma = calibration.covariance.sigma
    if truth.rig.is_metric and not rig.is_metric:
        if truth.board is not None:
            scale = truth.board.pitch_m
            notes.append("the rig is in board pitches; it was scaled by the pitch of the truth's board.")
        else:
            scale = truth.rig.baseline_m / rig.baseline_m
            notes.append("the rig has no length; it was given the truth's baseline.")
        rig = pose.scaled(rig, scale)
        sigma = {name: s * scale if name.startswith("translation.") else s for name, s in sigma.items()}
    has_skew = "left.skew" in calibration.covariance.names
    if truth.board is None:
        notes.append("no bound and no criteria on views: the images showed no board.")
        return TruthEvaluation(
            pose.compare_with_truth(rig, truth.rig, sigma=sigma, has_skew=has_skew), np.nan, tuple(notes)
        )
    bounded = _bound(calibration, truth, truth.board, has_skew, notes)
    bound = None if bounded is None else bounded[1]
    comparison = pose.compare_with_truth(rig, truth.rig, sigma=sigma, bound=bound, has_skew=has_skew)
    exact, T_left_board = exact_views(truth.rig, truth.board, EXACT_VIEWS, seed)
    criteria = criteria_on_exact_views(
        rig, exact, T_left_board, _side_m(truth.board), bounded, np.random.default_rng(seed)
    )
    noise_px = calibration.noise_px if bound is not None else float("nan")
    return TruthEvaluation(comparison, noise_px, tuple(notes), criteria)


def evaluate_images(
    rig: StereoRig,
    left: str,
    right: str,
    board: Board | BoardSet,
    *,
    calibration: StereoCalibration | None = None,
    measured_m: tuple[float, float] | None = None,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
) -> ImageEvaluation:
    """Pixel error, rectified row error and measured lengths of a rig on images of a board.

    Few views (a fifth) whose two images are not of one moment, as each camera alone fits them, are left out by name, as a
    calibration leaves them out.
    ``measured_m`` are the board's two distances by the ruler (:mod:`binocal.boards.measured`), metres.
    With the ``calibration`` that the rig is of, also whether the images agree with it as far as its standard deviations allow.

    Raises:
        DataError: The images cannot be used, their size is not the rig's, the board lacks the length it needs, or they fit the rig
            only exchanged, mirrored, upside down or paired otherwise.
    """
    boards = board if isinstance(board, BoardSet) else BoardSet((board,))
    as_drawn = board = boards.boards[0]
    if measured_m is not None:
        if len(boards.boards) > 1:
            raise DataError("the images are of several boards: what was measured of one does not hold for the others.")
        board, _ = checked_board(board, measured_m)
        boards = BoardSet((board,))
    if rig.is_metric and not board.is_metric:
        raise DataError("the rig is in metres: give the board's length a unit (such as 30mm) to compare with it.")
    known = rig if rig.is_metric == board.is_metric else None
    found = find_corners(left, right, boards, None, progress, should_stop, rig=known)
    notes = list(found.notes)
    detections, side_m = found.detections, _side_m(board)
    if measured_m is not None:
        detections, said = scale_as_measured(detections, as_drawn, measured_m)
        side_m *= float(np.sqrt(said["measured"]["scale_x"] * said["measured"]["scale_y"]))
    for side, camera, size_wh in (
        ("left", rig.left, detections.left_size_wh),
        ("right", rig.right, detections.right_size_wh),
    ):
        if camera.size_wh != size_wh:
            raise DataError(
                f"the {side} images are {size_wh[0]}x{size_wh[1]}, the rig's {side} camera is "
                f"{camera.size_wh[0]}x{camera.size_wh[1]}; use images of the size that was calibrated."
            )
    if board.is_metric and not rig.is_metric:
        if len({each.pitch_m for each in boards.boards}) > 1:
            raise DataError("the rig is in board pitches, and the boards have different ones; give one of them.")
        detections = replace(detections, object_points_m=detections.object_points_m / board.pitch_m, is_metric=False)
        side_m /= board.pitch_m
        notes.append("the rig is in board pitches: lengths are compared as if this board had calibrated it.")
    return _evaluate_detections(rig, detections, side_m, found, notes, calibration)


def _evaluate_detections(
    rig: StereoRig,
    detections: Detections,
    side_m: float,
    found: FoundCorners,
    notes: list[str],
    calibration: StereoCalibration | None,
) -> ImageEvaluation:
    from binocal.metrics.image_mixups import find_mixup
    from binocal.metrics.order import SUSPECT_PX, order_corners

    ordered = order_corners(rig, detections)
    if mixup := find_mixup(rig, detections, ordered):
        raise refusal(mixup)
    detections = ordered.detections
    notes += ordered.notes
    pixel_error = image.pixel_error(rig, detections, ordered.T_left_board)
    usual_px = float(np.nanmedian(pixel_error.view_rms_px))
    suspects = np.flatnonzero(pixel_error.view_rms_px > SUSPECT_VIEW_FACTOR * usual_px)
    alone_px = _alone_rms_px(rig, detections.select(suspects)) if len(suspects) else np.empty(0)
    miss_px = pixel_error.view_rms_px[suspects]
    of_two_moments = suspects[(miss_px > SUSPECT_PX) & (miss_px > SUSPECT_VIEW_FACTOR * alone_px)]
    rejected, T_left_board = found.rejected, ordered.T_left_board
    if len(of_two_moments) > MOST_SUSPECTS * detections.n_views:
        of_two_moments = of_two_moments[:0]
    for i in suspects:
        name, rms_px = detections.names[i], float(pixel_error.view_rms_px[i])
        if i in of_two_moments:
            why = finding("view-mismatched", miss_px=rms_px, typical_px=usual_px)
            rejected += (RejectedView(name, why.text, why.code),)
        else:
            notes.append(
                f"view {name}: {rms_px:.3g} px against {usual_px:.3g} px in the median view: "
                "its images may not belong together, or its corners are wrong."
            )
    if len(of_two_moments):
        kept = np.setdiff1d(np.arange(detections.n_views), of_two_moments)
        detections, T_left_board = detections.select(kept), T_left_board[kept]
        pixel_error = image.pixel_error(rig, detections, T_left_board)
    row_error = shared = None
    try:
        row_error = image.rectified_row_error(rig, detections)
        shared = common_rows(rig, detections)
    except CalibrationError as error:
        notes.append(f"no row error: {error}")
    lengths = image.length_error(rig, detections, side_m=side_m)
    agreement = changed = None
    if calibration is not None:
        from binocal.calibrators.agreement import measure_agreement

        changed = _changed_by_hand(calibration)
        try:
            agreement = measure_agreement(calibration, detections, T_left_board)
        except (DataError, CalibrationError) as error:
            notes.append(f"not compared with the rig's standard deviations: {error}")
    return ImageEvaluation(
        pixel_error,
        row_error,
        lengths,
        detections.names,
        rejected,
        found.ignored,
        tuple(notes),
        detections,
        agreement,
        shared,
        changed,
    )


def _changed_by_hand(calibration: StereoCalibration) -> Finding | None:
    """A rig's file that is not as it was written, as far as it shows: it names its board, or says what shape that has."""
    shape, spec = calibration.board_shape, str(calibration.provenance.get("board"))
    if SEPARATOR in spec:
        return None  # of several boards there is no middle that all views have
    try:
        points = parse_board(spec).object_points_m if shape is None else shape.points_m
    except ValueError:
        return None
    off = calibration.pose_imbalance(points.mean(axis=0))
    return finding("rig-file-changed", standard_errors=off) if off > MOST_OFF_BALANCE else None


def _alone_rms_px(rig: StereoRig, detections: Detections) -> Float[ndarray, "views"]:
    """RMS that each view's board leaves where each camera has a pose of its own: that of the worse camera."""
    from binocal.solvers.poses import estimate_board_poses

    unseen = np.full_like(detections.left_px, np.nan)
    left = estimate_board_poses(rig, replace(detections, right_px=unseen)).left_r2_px2
    right = estimate_board_poses(rig, replace(detections, left_px=unseen)).right_r2_px2
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = [np.sqrt(np.nansum(r2, axis=1) / np.isfinite(r2).sum(axis=1)) for r2 in (left, right)]
    return np.fmax(*rms)


def _bound(
    calibration: StereoCalibration, truth: rig_json.Truth, board: Board, has_skew: bool, notes: list[str]
) -> tuple[StereoRig, Covariance] | None:
    """The true rig in the camera model that was estimated, and the Cramér-Rao bound there; None, with a note, without one."""
    from binocal.solvers.covariance import cramer_rao_bound

    left = pose.in_model(truth.rig.left, calibration.rig.left.model)
    right = pose.in_model(truth.rig.right, calibration.rig.right.model)
    if left is None or right is None:
        notes.append(
            f"no bound: the rig's lens model {calibration.rig.left.model} cannot say what the true one "
            f"({truth.rig.left.model}) does."
        )
        return None
    if not calibration.noise_px > 0:
        notes.append("no bound: the calibration does not state its corner noise.")
        return None
    used = {view.name for view in calibration.views}
    chosen = [i for i, name in enumerate(truth.names) if name in used]
    if not chosen:
        notes.append("no bound: no view of the calibration has a name that the truth knows.")
        return None
    rig = replace(truth.rig, left=left, right=right)
    poses = truth.T_left_board[chosen]
    points = board.object_points_m
    try:
        bound = cramer_rao_bound(
            rig,
            points,
            poses,
            calibration.noise_px,
            left_is_seen=is_inside(rig.left.project(poses.apply(points)), rig.left.size_wh),
            right_is_seen=is_inside(rig.right.project((rig.T_right_left @ poses).apply(points)), rig.right.size_wh),
            skew=has_skew,
            weights=_weights_of_cameras(calibration, (len(chosen), len(points))),
        )
    except DegenerateGeometryError:
        notes.append("no bound: the truth's views that the calibration used do not determine the rig.")
        return None
    for side, camera in (("left", left), ("right", right)):
        for name, focal_px in zip(("fx", "fy"), camera.parameters[:2], strict=True):
            if not bound.sigma[f"{side}.{name}"] <= MOST_FOCAL_SIGMA_SHARE * focal_px:
                notes.append(f"no bound: the truth's views do not determine the {side} camera's focal length.")
                return None
    return rig, bound


def _weights_of_cameras(calibration: StereoCalibration, shape: tuple[int, int]) -> CornerWeights | None:
    """Weights of (views, n) corners by each camera's own residuals, where cameras differ in kind; None where they are alike.

    Their unit is ``noise_px``, the noise of as many equal corners that carry as much information.
    """
    from binocal.solvers.whitening import CornerWeights

    rms = np.array([calibration.rms.left_px, calibration.rms.right_px])
    if not (rms.min() > 0 and rms.max() > UNLIKE_NOISE * rms.min()):
        return None
    share = np.sqrt(2 / np.sum(rms**-2.0)) / rms  # the mean information of both is that of the unit
    left, right = (np.repeat(np.full((shape[0], 1, 1), s) * [[1.0], [0.0], [1.0]], shape[1], axis=2) for s in share)
    return CornerWeights(left, right, calibration.noise_px)


def _side_m(board: Board) -> float:
    """Distance of neighbouring points of the board, metres."""
    if board.kind == "squares":
        return min(board.pitch_m, board.gap_m)
    return board.pitch_m * (np.sqrt(2) if board.kind == "acircles" else 1.0)
