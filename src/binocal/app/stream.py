"""``binocal check --stream``: a rig watched pair by pair, its drift, and when it was knocked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.app.natural import NaturalSource
from binocal.app.natural_drift import (
    AGAINST_REFERENCE,
    AGAINST_RIG,
    ANGLES,
    Drift,
    covariance_in_common,
    depth_error_percent,
    reference_values,
    turn_between,
)
from binocal.app.pair_matching import matches_of
from binocal.calibrators.drift import DriftTrack, MeasuredTurn, track_drift
from binocal.calibrators.natural import NaturalRequest, calibrate_from_matches
from binocal.datasets import StereoPair
from binocal.datasets.frames import name_some, time_of_name_ns
from binocal.errors import CalibrationError, CancelledError
from binocal.findings import Finding, finding
from binocal.geometry import SE3
from binocal.progress import ProgressCallback, ShouldStop
from binocal.result import StereoCalibration
from binocal.shapes import Float


@dataclass(frozen=True, slots=True, eq=False)
class StreamOptions:
    """``every`` pairs in a row are one measurement. ``fps``: pairs per second, in place of the times that the images have."""

    every: int = 1
    fps: float | None = None
    seed: int = 0
    progress: ProgressCallback | None = None
    should_stop: ShouldStop | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StreamRun:
    """What a stream told: every measurement, the running estimate, what was skipped and why, and the drift at its end."""

    turns: tuple[MeasuredTurn, ...]
    track: DriftTrack
    skipped: tuple[tuple[str, str], ...]
    drift: Drift
    depth_error_percent: dict[str, float]
    findings: tuple[Finding, ...]

    @property
    def has_drifted(self) -> bool:
        """Whether the rig has turned from what it was, or was knocked on the way."""
        return self.drift.is_sure or bool(self.track.jumps)


@dataclass(frozen=True, slots=True, eq=False)
class _Measurement:
    turn: MeasuredTurn
    direction: Float[ndarray, "3"]
    common_variance_rad2: Float[ndarray, "3"]
    """Of the turn, by the intrinsics, which all pairs have in common; less twice what the rig as given has of the same error."""


def check_stream(source: NaturalSource, options: StreamOptions | None = None) -> StreamRun:
    """The rig's turn from its reference, or from the rig as given, pair by pair. No image is kept.

    Pairs that do not tell the turn are skipped by name.

    Raises:
        DataError: An image cannot be read or is not of the rig's cameras.
        DegenerateGeometryError: Too few pairs tell the turn.
        CancelledError: ``should_stop`` said so.
    """
    options = options or StreamOptions()
    start, was = _start(source)
    groups = [source.pairs[k : k + options.every] for k in range(0, len(source.pairs), options.every)]
    measured: list[_Measurement] = []
    skipped: list[tuple[str, str]] = []
    for count, group in enumerate(groups):
        if options.should_stop is not None and options.should_stop():
            raise CancelledError("cancelled while measuring.")
        try:
            measured.append(_measure(source, group, start, _time_s(group, count, options), options.seed))
        except CalibrationError as error:
            skipped.append((group[0].name, str(error)))
        if options.progress is not None:
            options.progress("pairs", min((count + 1) * options.every, len(source.pairs)), len(source.pairs))
    turns = tuple(one.turn for one in measured)
    try:
        track = track_drift(turns)
    except CalibrationError as error:
        error.rejected = dict(skipped)
        raise
    drift = _drift(measured, track, source, start, was)
    findings = (*_findings(turns, track, skipped), *source.findings)
    return StreamRun(turns, track, tuple(skipped), drift, depth_error_percent(source.rig, drift), findings)


def _start(source: NaturalSource) -> tuple[SE3, Float[ndarray, "3"]]:
    """What turns are counted from, and how uncertain that is (variances in squared radians)."""
    if source.reference is not None:
        R, t, random = reference_values(source.reference)
        return SE3(R, t), np.diagonal(random)
    known = source.covariance
    has_turn = known is not None and "rotation.x" in known.names
    return source.rig.T_right_left, np.diagonal(known.block("rotation")) if known and has_turn else np.zeros(3)


def _time_s(group: Sequence[StereoPair], index: int, options: StreamOptions) -> float | None:
    """The middle of the times of a group of pairs; None where one has none."""
    if options.fps is not None:
        return (index * options.every + 0.5 * (len(group) - 1)) / options.fps
    times = [time_of_name_ns(pair.left_path.stem) if pair.left_time_ns is None else pair.left_time_ns for pair in group]
    known = [time for time in times if time is not None]
    # a float holds no nanoseconds of our century: the half is taken of a difference
    return (known[0] + (known[-1] - known[0]) // 2) / 1e9 if len(known) == len(times) else None


def _measure(
    source: NaturalSource, group: Sequence[StereoPair], start: SE3, time_s: float | None, seed: int
) -> _Measurement:
    cameras = source.rig.left, source.rig.right
    matches, _ = matches_of(group, cameras)
    request = NaturalRequest(cameras, start, intrinsics=source.intrinsics, seed=seed)
    found = calibrate_from_matches(matches, request)
    _refuse_untold(found)
    random = np.diagonal(np.array(found.provenance["random_rotation_covariance_rad2"]))
    common = np.maximum(np.diagonal(found.covariance.block("rotation")) - random, 0.0)
    if source.covariance is not None and source.made is not None and source.reference is None:
        common = common - 2 * np.diagonal(covariance_in_common(found.covariance, source.covariance))[:3]
    T = found.rig.T_right_left
    turn = MeasuredTurn(group[0].name, turn_between(start.R, T.R), np.degrees(np.sqrt(random)), time_s)
    return _Measurement(turn, T.t, common)


def _refuse_untold(found: StereoCalibration) -> None:
    """Raises CalibrationError: an angle was kept as it was, which is no measurement."""
    for one in found.findings:
        if one.code == "scene-tells-too-little-kept" and one.figures["least_told"] in ANGLES:
            raise CalibrationError(one.text)


def _drift(
    measured: Sequence[_Measurement], track: DriftTrack, source: NaturalSource, start: SE3, was: Float[ndarray, "3"]
) -> Drift:
    """At the end of the stream. Errors of a region are much the same in all pairs: they do not average out, nor do the intrinsics'."""
    of_regions = np.median([one.turn.sigma_deg for one in measured], axis=0)
    common = np.zeros(3)
    if source.reference is None:
        common = np.median([one.common_variance_rad2 for one in measured], axis=0)
    sigma = np.sqrt(
        track.level_sigma_deg[-1] ** 2 + of_regions**2 + np.degrees(np.sqrt(np.maximum(common + was, 0.0))) ** 2
    )
    direction = np.sum([one.direction for one in measured], axis=0)
    cosine = direction @ start.t / np.linalg.norm(direction) / np.linalg.norm(start.t)
    against = AGAINST_RIG if source.reference is None else AGAINST_REFERENCE
    return Drift(track.level_deg[-1], sigma, float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))), against)


def _findings(turns: Sequence[MeasuredTurn], track: DriftTrack, skipped: Sequence[tuple[str, str]]) -> list[Finding]:
    found = [
        finding(
            "stream-jumped",
            angle=ANGLES[jump.angle],
            pair=turns[jump.at].name,
            told_at=turns[jump.told_at].name,
            size_deg=jump.size_deg,
            sigma_deg=jump.sigma_deg,
        )
        for jump in track.jumps
    ]
    if skipped:
        names = name_some(name for name, _ in skipped)
        figures = {"n_skipped": len(skipped), "n_used": len(turns), "names": names, "reason": skipped[0][1]}
        found.append(finding("stream-pairs-skipped", **figures))
    if any(turn.time_s is None for turn in turns):
        found.append(finding("stream-without-times"))
    return found
