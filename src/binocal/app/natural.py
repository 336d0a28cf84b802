"""``binocal recalibrate`` and ``binocal check``: a rig from natural images, and whether a rig is still what its file says."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from binocal.app.known_lengths import KnownLength, measure_known_lengths, pair_called
from binocal.app.natural_drift import (
    AGAINST_RIG,
    Drift,
    depth_error_percent,
    drift_of,
    made_by_recalibrate,
    reference_document,
    reference_values,
)
from binocal.app.pair_choice import choose_pairs
from binocal.app.pair_matching import matches_of
from binocal.calibrators.natural import NaturalRequest, calibrate_from_matches
from binocal.cameras import Camera, StereoRig
from binocal.datasets import Dataset, StereoPair, open_dataset
from binocal.datasets.folder import list_pairs
from binocal.datasets.frames import name_some
from binocal.errors import DataError
from binocal.evidence.point_matches import PointMatches
from binocal.findings import Finding, finding
from binocal.formats import rig_json
from binocal.formats.rig_file import load_rig
from binocal.matching.relative_pose import estimate_relative_pose
from binocal.metrics.rows import RowFigures, row_figures
from binocal.progress import ProgressCallback, ShouldStop
from binocal.result import Covariance, ResidualSummary, StereoCalibration
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.relative_pose import RelativePose
from binocal.solvers.robust import TUKEY_END

MAX_PAIRS = 8  # the random part of the error is below that of the intrinsics after four
LEAST_BASELINE_M, MOST_BASELINE_M = 1e-3, 100.0  # between a rig of tiny cameras and one on a ship
MOST_LENGTH_CHANGE, MOST_LENGTH_SIGMAS = 0.05, 4.0  # of a baseline given, from the file's
REFERENCE = "reference"
"""Where a rig file holds its own result of ``recalibrate``."""
ROWS_OFF_PX, ROWS_OFF_RATIO = 1.0, 4.0
"""Median row error by the rig as given, and over that by the best pose, beyond which the rig no longer fits: matchers lose the rows."""


@dataclass(frozen=True, slots=True, eq=False)
class NaturalSource:
    """Pairs and what is known of the rig that took them.

    ``covariance`` is that of the rig's parameters, if a file says it; ``reference`` the result of an earlier ``recalibrate``, see
    :data:`REFERENCE`.
    """

    pairs: Sequence[StereoPair]
    rig: StereoRig
    covariance: Covariance | None = None
    reference: Mapping[str, Any] | None = None
    length_from: str = "the old rig"
    made: Mapping[str, Any] | None = None
    """The same of a rig that is itself a result of ``recalibrate``."""
    findings: tuple[Finding, ...] = ()
    """What the data set has to say of its files."""

    @property
    def intrinsics(self) -> Covariance | None:
        """The covariance, if it says something of the cameras' parameters."""
        names = () if self.covariance is None else self.covariance.names
        return self.covariance if any(name.startswith(("left.", "right.")) for name in names) else None


@dataclass(frozen=True, slots=True, eq=False)
class NaturalOptions:
    """``from_old_rig``: the rig's pose is the start and bounds the result; else nothing is known but the cameras."""

    from_old_rig: bool = True
    baseline_m: float | None = None
    max_pairs: int = MAX_PAIRS
    seed: int = 0
    progress: ProgressCallback | None = None
    should_stop: ShouldStop | None = None
    calibrator: str = "drl"
    """See :func:`binocal.calibrators.natural_solves.solves_of`."""
    known_lengths: tuple[KnownLength, ...] = ()
    """Of the scene: they give the translation its length, in place of ``baseline_m`` and the old rig's."""


@dataclass(frozen=True, slots=True, eq=False)
class NaturalRun:
    """A recalibration: the result, rows before and after, and how far it is from the rig that was given."""

    calibration: StereoCalibration
    before: RowFigures
    after: RowFigures
    drift: Drift
    matches: PointMatches
    elapsed_s: Mapping[str, float] = field(default_factory=dict)

    @property
    def rows_are_off(self) -> bool:
        """Whether the rig as given leaves rows that matchers lose and another pose mends, whatever its angles.

        Not where a reference says what the rig was like from the start.
        """
        return self.drift.against == AGAINST_RIG and self.before.median_px > max(
            ROWS_OFF_PX, ROWS_OFF_RATIO * self.after.median_px
        )

    @property
    def has_drifted(self) -> bool:
        """The verdict: an angle or the direction of the translation has surely moved, or rows are off."""
        return self.drift.is_sure or self.rows_are_off

    @property
    def depth_error_percent(self) -> dict[str, float]:
        """What the drift in yaw does to depth, percent, by distance in metres; empty without a length."""
        return depth_error_percent(self.calibration.rig, self.drift)


def recalibrate(source: NaturalSource, options: NaturalOptions | None = None) -> NaturalRun:
    """Rotation and direction of translation from natural pairs, intrinsics held.

    Raises:
        DataError: An image cannot be read or is not of the rig's cameras.
        CalibrationError: The images tell no rig.
        CancelledError: ``should_stop`` said so.
    """
    options = options or NaturalOptions()
    if not source.pairs:
        raise DataError("no pairs of images.")
    _refuse_no_baseline(source.rig)
    for known in options.known_lengths:
        pair_called(known.pair, source.pairs)  # refused before anything is computed
    cameras = source.rig.left, source.rig.right
    started = time.perf_counter()
    near, listeners = source.rig.T_right_left, (options.progress, options.should_stop)
    chosen = choose_pairs(source.pairs, cameras, near, options.max_pairs, *listeners)
    matches, left_out = matches_of([source.pairs[i] for i in chosen], cameras, *listeners)
    matched = time.perf_counter()
    old = source.rig.T_right_left if options.from_old_rig else None
    length, sigma_m, said = options.baseline_m, 0.0, "--baseline"
    if length is None and source.rig.is_metric:
        length, sigma_m, said = source.rig.baseline_m, _baseline_sigma_m(source), source.length_from
    elif length is None:
        said = "nothing: lengths are in baselines"
    request = NaturalRequest(
        cameras,
        old,
        length,
        sigma_m,
        said,
        source.intrinsics,
        lambda found: estimate_relative_pose(cameras, found.left_px, found.right_px),
        options.seed,
        filed=source.rig.T_right_left,
        calibrator=options.calibrator,
    )
    calibration = calibrate_from_matches(matches, request)
    if options.known_lengths:
        calibration = measure_known_lengths(calibration, source.pairs, options.known_lengths)
    unlike = length_unlike_file(calibration, source)
    calibration = replace(calibration, findings=(*left_out, *calibration.findings, *unlike, *source.findings))
    right = _right_matches(cameras, calibration, matches)
    drift = drift_of(calibration, source.rig, source.covariance, source.reference, source.made)
    elapsed = {"matching": matched - started, "solve": time.perf_counter() - matched}
    return NaturalRun(
        calibration, row_figures(source.rig, right), row_figures(calibration.rig, right), drift, right, elapsed
    )


def _refuse_no_baseline(rig: StereoRig) -> None:
    length = rig.baseline_m
    if length == 0:
        raise DataError("the rig's translation is zero: both cameras stand in one place; give another rig.")
    if rig.is_metric and not LEAST_BASELINE_M <= length <= MOST_BASELINE_M:
        raise DataError(
            f"the rig's cameras stand {length:.3g} m apart, and 1 mm to 100 m are possible; lengths in its file are metres."
        )


def length_unlike_file(calibration: StereoCalibration, source: NaturalSource) -> list[Finding]:
    """What is said of a baseline that was given or measured and is far from the file's: images do not show a wrong one."""
    given_m, filed_m = calibration.rig.baseline_m, source.rig.baseline_m
    sigma_m = np.hypot(calibration.baseline_sigma_m, _baseline_sigma_m(source))
    apart_m = abs(given_m - filed_m)
    if not source.rig.is_metric or apart_m <= max(MOST_LENGTH_CHANGE * filed_m, MOST_LENGTH_SIGMAS * sigma_m):
        return []
    said = calibration.provenance["length_from"]
    return [finding("baseline-unlike-file", said=said, given_m=given_m, filed_m=filed_m, ratio=given_m / filed_m)]


def _baseline_sigma_m(source: NaturalSource) -> float:
    """What the rig's file says of the length of its translation; 0 where it says nothing."""
    if source.covariance is None or "translation.x" not in source.covariance.names:
        return 0.0
    along = source.rig.T_right_left.t / source.rig.baseline_m
    return float(np.sqrt(max(along @ source.covariance.block("translation") @ along, 0.0)))


def _right_matches(
    cameras: tuple[Camera, Camera], calibration: StereoCalibration, matches: PointMatches
) -> PointMatches:
    problem, has_rays = EpipolarProblem.of_matches(cameras, matches)
    residuals = np.abs(problem.residuals_px(RelativePose.of(calibration.rig.T_right_left)))
    return matches.select(np.flatnonzero(has_rays)[residuals < TUKEY_END * calibration.noise_px])


def with_reference(rig: StereoCalibration, run: NaturalRun) -> StereoCalibration:
    """The rig as it was given, with this result as its reference."""
    return replace(rig, extra={**rig.extra, REFERENCE: reference_document(run.calibration)})


def as_given(rig: StereoRig, length_from: str | None = None) -> StereoCalibration:
    """A rig of which nothing more is known, but perhaps where its length is from: a foreign file's, a data set's."""
    nothing = Covariance((), np.zeros((0, 0)))
    provenance = {} if length_from is None else {"length_from": length_from}
    return StereoCalibration(rig, nothing, ResidualSummary(np.nan, np.nan, np.nan), np.nan, (), provenance=provenance)


def load_given_rig(path: Path) -> StereoCalibration:
    """A rig.json whole, or what any other file says of the rig.

    Raises:
        DataError: It cannot be read.
    """
    if rig_json.holds_calibration(path):
        return rig_json.read_calibration(path)
    return as_given(load_rig(path))


def source_of_dataset(text: str, given: StereoCalibration | None, rig_of: str | None = None) -> NaturalSource:
    """Pairs of a data set (``KIND:PATH``), with its own cameras unless a rig is given.

    Of a data set with several calibrations that of the pair ``rig_of``, or the given rig's, or that of most pairs; see
    :meth:`binocal.datasets.Dataset.of_one_rig`.

    Raises:
        DataError: Its layout is broken, or neither it nor a rig says what its cameras are.
    """
    return source_of_part(open_dataset(text).of_one_rig(frame=rig_of, like=None if given is None else given.rig), given)


def source_of_part(part: Dataset, given: StereoCalibration | None) -> NaturalSource:
    """The pairs of a data set that has one calibration, or a given one.

    Raises:
        DataError: Neither it nor a rig says what its cameras are.
    """
    if given is not None:
        return _source_of(part.stereo_pairs, given, part.findings)
    if part.rig is None:
        raise DataError(f"{part.path}: nothing says what cameras took these images; give the rig with --rig.")
    return NaturalSource(part.stereo_pairs, part.rig, length_from=part.scale_source, findings=part.findings)


def source_of_images(left: str, right: str, given: StereoCalibration) -> NaturalSource:
    """Pairs of two globs or folders.

    Raises:
        DataError: There are none.
    """
    pairing = list_pairs(left, right)
    pairs = [StereoPair(pair.name, pair.left_path, pair.right_path) for pair in pairing.pairs]
    findings: tuple[Finding, ...] = ()
    if pairing.left_out:
        names = name_some(path.name for path in pairing.left_out)
        findings = (finding("dataset-frames-left-out", n_out=len(pairing.left_out), n_pairs=len(pairs), names=names),)
    return _source_of(pairs, given, findings)


def _source_of(pairs: Sequence[StereoPair], given: StereoCalibration, findings: tuple[Finding, ...]) -> NaturalSource:
    """Pairs of a rig that was given."""
    reference = given.extra.get(REFERENCE)
    if reference is not None:
        reference_values(reference)  # refused before anything is computed
    return NaturalSource(
        pairs, given.rig, given.covariance, reference, made=made_by_recalibrate(given), findings=findings
    )
