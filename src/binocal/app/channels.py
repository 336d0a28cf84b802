"""``binocal channels``: what each colour of a set's images says, and what using the right one is worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from binocal.app.corners import find_corners
from binocal.boards import Board
from binocal.calibrators.base import CalibrationRequest
from binocal.errors import BinocalError, CancelledError, DataError, DetectionError
from binocal.evidence import Detections
from binocal.metrics.aberration import Aberration, aberration_between
from binocal.progress import ProgressCallback, ShouldStop

COLOURS = ("red", "blue")
REFERENCE = "green"
N_SPLITS = 4  # of the views into halves
MIN_GAIN = 0.05  # in the rows of views left out, from which a colour is preferred to grey
MIN_SHARE_OF_HALVES = 0.8  # in which it must be better, too: one split's luck is no gain


@dataclass(frozen=True, slots=True)
class ChannelRow:
    """One channel: how many corners both cameras saw, and what a calibration from them is like.

    ``noise_px`` is the corners' standard deviation as the fit found it, ``baseline_sigma`` relative to the baseline, ``held_out_px`` the
    median RMS row error of a half of the views on the rig of the other half, measured in this same channel; ``halves_px`` are those of
    every half of every split, which are the same for all channels. NaN and ``problem`` where no rig came of it.
    """

    channel: str
    n_views: int = 0
    n_corners: int = 0
    rms_px: float = np.nan
    noise_px: float = np.nan
    baseline_sigma: float = np.nan
    halves_px: tuple[float, ...] = ()
    problem: str = ""

    @property
    def held_out_px(self) -> float:
        """Of the halves, the median; NaN where one gave no rig."""
        return float(np.median(self.halves_px)) if self.halves_px else np.nan

    def n_better(self, other: ChannelRow) -> int:
        """In how many halves this channel's rows are better than another's."""
        return sum(own < theirs for own, theirs in zip(self.halves_px, other.halves_px, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class ChannelStudy:
    """A row for each channel, and the aberration of each colour against green by camera (None: too few common corners)."""

    rows: tuple[ChannelRow, ...]
    aberrations: Mapping[tuple[str, str], Aberration | None]
    ignored: tuple[tuple[str, str], ...] = ()

    @property
    def best(self) -> ChannelRow | None:
        """The channel whose rig serves views that it has not seen best; grey, unless another is clearly better in most halves."""
        sound = {row.channel: row for row in self.rows if row.halves_px}
        if not sound:
            return None
        best = min(sound.values(), key=lambda row: row.held_out_px)
        grey = sound.get("grey")
        if grey is None or best is grey:
            return best
        is_clear = best.n_better(grey) >= MIN_SHARE_OF_HALVES * len(grey.halves_px)
        return best if is_clear and best.held_out_px < (1 - MIN_GAIN) * grey.held_out_px else grey


def study_channels(
    left: str,
    right: str,
    board: Board,
    request: CalibrationRequest | None = None,
    *,
    calibrator: str = "lm",
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
) -> ChannelStudy:
    """Measure the corners of colour images in grey, red, green and blue, and calibrate from each.

    Raises:
        DataError: The images cannot be used, or have no colours.
        CancelledError: ``should_stop`` returned True.
    """
    from binocal.images import CHANNELS
    from binocal.images.preprocessing import Preparation

    request = replace(request or CalibrationRequest(), should_stop=should_stop)
    found: dict[str, Detections] = {}
    rows: list[ChannelRow] = []
    splits: list[tuple[str, ...]] = []
    ignored: tuple[tuple[str, str], ...] = ()
    for channel in (REFERENCE, *(name for name in CHANNELS if name != REFERENCE)):
        try:
            at = find_corners(left, right, board, Preparation(channel), progress, should_stop)
        except DetectionError as error:
            if channel == REFERENCE:
                raise
            rows.append(ChannelRow(channel, problem=str(error)))
            continue
        ignored = at.ignored
        found[channel] = at.detections
        splits = splits or _draw_splits(at.detections.names, request.seed)
        rows.append(_row(channel, at.detections, splits, request, calibrator))
    if all(_are_equal(found[REFERENCE], found[colour]) for colour in COLOURS if colour in found):
        raise DataError("the images' colours are equal: they hold grey levels, so there is no channel to choose.")
    aberrations = {
        (side, colour): aberration_between(found[REFERENCE], found[colour], side) if colour in found else None
        for side in ("left", "right")
        for colour in COLOURS
    }
    order = {name: i for i, name in enumerate(CHANNELS)}
    return ChannelStudy(tuple(sorted(rows, key=lambda row: order[row.channel])), aberrations, ignored)


def _are_equal(a: Detections, b: Detections) -> bool:
    return a.names == b.names and all(
        np.array_equal(getattr(a, side), getattr(b, side), equal_nan=True) for side in ("left_px", "right_px")
    )


def _row(
    channel: str,
    detections: Detections,
    splits: Sequence[tuple[str, ...]],
    request: CalibrationRequest,
    calibrator: str,
) -> ChannelRow:
    from binocal.calibrators import calibrate_as_requested

    both = detections.left_is_seen & detections.right_is_seen
    counted = ChannelRow(channel, int(both.any(axis=1).sum()), int(both.sum()))
    try:
        calibration = calibrate_as_requested(detections, request, calibrator=calibrator)
    except CancelledError:
        raise
    except BinocalError as error:
        return replace(counted, problem=str(error))
    rig = calibration.rig
    return replace(
        counted,
        rms_px=calibration.rms.all_px,
        noise_px=calibration.noise_px,
        baseline_sigma=calibration.baseline_sigma_m / rig.baseline_m,
        halves_px=_held_out(detections, splits, replace(request, model=rig.left.model), calibrator),
    )


def _held_out(
    detections: Detections, splits: Sequence[tuple[str, ...]], request: CalibrationRequest, calibrator: str
) -> tuple[float, ...]:
    """RMS row error of each half of each split on the rig of its other half; empty where a half gives none."""
    from binocal.calibrators import calibrate_as_requested
    from binocal.metrics.image import row_differences

    errors = []
    for first in splits:
        is_first = np.isin(detections.names, first)
        for used in (is_first, ~is_first):
            try:
                rig = calibrate_as_requested(detections.select(used), request, calibrator=calibrator).rig
                rows = row_differences(rig, detections.select(~used)).ravel()
            except CancelledError:
                raise
            except BinocalError:
                return ()
            rows = rows[np.isfinite(rows)]
            if not rows.size:
                return ()
            errors.append(float(np.sqrt(np.mean(rows**2))))
    return tuple(errors)


def _draw_splits(names: tuple[str, ...], seed: int) -> list[tuple[str, ...]]:
    """The first halves of the views, drawn anew for each split; the same for all channels."""
    rng = np.random.default_rng(seed)
    return [tuple(rng.permutation(names)[: len(names) // 2].tolist()) for _ in range(N_SPLITS)]
