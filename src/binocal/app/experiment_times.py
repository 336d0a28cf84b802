"""The paper's table 4: seconds from images and from corners to the rig, on quiet processors, one method after the other."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from binocal.app.corners import detect_corners
from binocal.app.natural import NaturalOptions, NaturalRun, NaturalSource, recalibrate, source_of_dataset
from binocal.boards import Board
from binocal.calibrators import calibrate
from binocal.datasets.folder import list_pairs
from binocal.errors import BinocalError, DataError
from binocal.evidence import Detections
from binocal.experiments.case import OPENCV_THROUGHOUT, Result
from binocal.experiments.journal import Key
from binocal.experiments.options import LEAST_PAIRS, ExperimentOptions
from binocal.experiments.row import NAN, Measured, Row, row_of
from binocal.geometry import so3
from binocal.threads import n_threads

TABLE, STREET_TABLE = "4", "streets"
MEASURED, STREETS = "measured", ("KITTI", "Cityscapes", "measured, streets")
PAPER_SECONDS = {
    "drl": {"KITTI": 5.2, "Cityscapes": 6.2, MEASURED: 5.3},
    "alternating": {"KITTI": 9.2, "Cityscapes": 16.5, MEASURED: 20.2},
    "absolute-orientation": {"KITTI": 7.1, "Cityscapes": 14.7, MEASURED: 21.1},
    "heterogeneous": {"KITTI": 8.1, "Cityscapes": 13.0, MEASURED: 18.5},
    "wide-field": {"KITTI": 10.4, "Cityscapes": 11.1, MEASURED: 15.4},
}
"""What the paper's table 4 prints, 1000 images each, on a machine that it does not name."""
BOARD_METHODS = {
    "drl": ("drl", "brown4"),
    "lm": ("lm", "brown4"),
    "from-guess": ("from-guess", "brown4"),
    OPENCV_THROUGHOUT: ("opencv", "brown4"),
    "alternating": ("alternating", "brown4"),
    "absolute-orientation": ("absolute-orientation", "brown4"),
    "heterogeneous": ("heterogeneous", "brown4"),
    "wide-field": ("wide-field", "fisheye4"),
}
"""Calibrator and camera model by the rows' name."""
STREET_METHODS = ("drl", "portfolio", "lm")
MAX_PAIRS = {"KITTI": 8, "Cityscapes": 4, "measured, streets": 4}
"""Pairs that are used. Of images of 2 million pixels eight take 17 s of processor time, four 8 s."""
LEAST_STREET_PAIRS = 2  # of a set of streets
LONG_S = 5.0  # a solve that took longer is not repeated
REPEATS = 3

MOST_TIMED = len(BOARD_METHODS) + len(STREETS) * len(STREET_METHODS)

Has = Callable[[str, str], bool]
"""Whether a case's method is in the journal already."""


def check_streets(options: ExperimentOptions) -> None:
    """Whether the folders of real streets are what they are given as.

    Raises:
        DataError: One is not of its layout, or holds too few pairs; it names the folder.
    """
    for option, folder in (("kitti", options.kitti), ("cityscapes", options.cityscapes)):
        if folder is None:
            continue
        n_pairs = len(source_of_dataset(f"{option}:{folder}", None).pairs)
        if n_pairs < LEAST_STREET_PAIRS:
            raise DataError(f"{folder}: --{option} has {n_pairs} pairs, at least {LEAST_STREET_PAIRS} are needed.")


def timed_results(options: ExperimentOptions, has: Has) -> Iterator[Result]:
    """Every set and method that the journal lacks. Nothing else should run meanwhile."""
    yield from _measured(options, has)
    for name in STREETS:
        yield from _street(name, options, has)


@dataclass(frozen=True, slots=True)
class Found:
    """The corners of each board's images, and the seconds that finding them took, decoding included."""

    corners: tuple[Detections, ...]
    elapsed_s: float


def _measured(options: ExperimentOptions, has: Has) -> Iterator[Result]:
    """Both boards before the paper's rig: all images are decoded and searched, every calibrator has the same corners, but for OpenCV."""
    missing = [name for name in BOARD_METHODS if not has(MEASURED, name)]
    if not missing:
        return
    from binocal.experiments.sets import render_measured

    with tempfile.TemporaryDirectory(prefix="binocal-experiment-") as place:
        folders = render_measured(max(options.n_images // 2, 2 * LEAST_PAIRS), options.seed, Path(place))
        decode_s = _decode_s(sorted(Path(place).glob("*/*.png")))
        ours = _found(folders, lambda left, right, board: detect_corners(left, right, board))
        for name in missing:
            try:
                found = _found(folders, _by_opencv) if name == OPENCV_THROUGHOUT else ours
            except BinocalError as error:
                yield Result(MEASURED, name, options.seed, failure=" ".join(str(error).split()))
                continue
            yield _timed_calibration(name, found, options.seed, decode_s)


def _found(folders: Mapping[str, Path], find: Callable[[str, str, Board], Detections]) -> Found:
    begin = time.perf_counter()
    corners = tuple(
        find(str(folder / "left_*.png"), str(folder / "right_*.png"), Board.from_spec(spec))
        for spec, folder in folders.items()
    )
    return Found(corners, time.perf_counter() - begin)


def _by_opencv(left: str, right: str, board: Board) -> Detections:
    """As OpenCV's users find them."""
    from binocal.detection.opencv_finder import detect_with_opencv

    return detect_with_opencv(list_pairs(left, right).pairs, board)


def _decode_s(paths: list[Path]) -> float:
    """Seconds to decode all images, on as many threads as are used to search them."""
    from binocal.images import read_grey_image

    begin = time.perf_counter()
    with ThreadPoolExecutor(n_threads()) as pool:
        for _ in pool.map(read_grey_image, paths):
            pass
    return time.perf_counter() - begin


def _timed_calibration(name: str, found: Found, seed: int, decode_s: float) -> Result:
    """A rig from each board; seconds are those of both together."""
    taken: list[float] = []
    calibrator, model = BOARD_METHODS[name]
    try:
        while len(taken) < REPEATS and (not taken or taken[0] < LONG_S):
            begin = time.perf_counter()
            for corners in found.corners:
                calibrate(corners, calibrator=calibrator, model=model)
            taken.append(time.perf_counter() - begin)
    except BinocalError as error:
        return Result(MEASURED, name, seed, failure=" ".join(str(error).split()))
    solve_s = float(np.median(taken))
    total_s = found.elapsed_s + solve_s
    return Result(
        MEASURED,
        name,
        seed,
        (
            Measured("seconds from images", "s", total_s, table=TABLE),
            Measured("times the decoding of the images", "", total_s / decode_s, table=TABLE),
            Measured("seconds from corners", "s", solve_s, table=TABLE),
            Measured("pairs", "", float(sum(c.n_views for c in found.corners)), table=TABLE),
        ),
    )


def _street(name: str, options: ExperimentOptions, has: Has) -> Iterator[Result]:
    """Streets: the pairs that tell most are matched; the rig that is given is the old one."""
    methods = STREET_METHODS[:1] if options.is_quick else STREET_METHODS
    missing = [method for method in methods if not has(name, method)]
    given = {"KITTI": options.kitti, "Cityscapes": options.cityscapes}.get(name)
    if not missing or (given is None and name != "KITTI" and options.is_quick):
        return
    n_pairs = 2 if options.is_quick else MAX_PAIRS[name]
    with tempfile.TemporaryDirectory(prefix="binocal-experiment-") as place:
        if given is None:
            from binocal.experiments.sets import render_streets, rig_of_street

            known = MEASURED if name not in ("KITTI", "Cityscapes") else name
            pairs = render_streets(known, 2 * n_pairs, options.seed, Path(place))
            source = NaturalSource(pairs, rig_of_street(known))
        else:
            source = source_of_dataset(f"{name.lower()}:{given}", None)
        others: Others | None = None
        for method in missing:
            try:
                run = recalibrate(source, NaturalOptions(max_pairs=n_pairs, seed=options.seed, calibrator=method))
                others = others or _other_choices(source, n_pairs, options.seed)
                times = _street_times(source, options, n_pairs, method)
            except BinocalError as error:
                yield Result(name, method, options.seed, failure=" ".join(str(error).split()))
                continue
            yield Result(name, method, options.seed, (*times, *_street_errors(run, others, source)))


def _street_times(source: NaturalSource, options: ExperimentOptions, n_pairs: int, method: str) -> tuple[Measured, ...]:
    """Of as many pairs as the set has images for; where there are fewer, they repeat, and nothing but the time is taken from that."""
    from binocal.experiments.sets import repeated

    pairs = repeated(source.pairs, options.n_images // 2)
    run = recalibrate(
        replace(source, pairs=pairs), NaturalOptions(max_pairs=n_pairs, seed=options.seed, calibrator=method)
    )
    total = run.elapsed_s["matching"] + run.elapsed_s["solve"]
    return (
        Measured("seconds from images", "s", total, table=TABLE),
        Measured("seconds from corners", "s", run.elapsed_s["solve"], table=TABLE),
        Measured("pairs", "", float(len(pairs)), table=TABLE),
    )


class Others(NamedTuple):
    """What the choice of pairs is measured against: twice as many of them, and as many evenly over the drive."""

    twice: NaturalRun
    even: NaturalRun


def _other_choices(source: NaturalSource, n_pairs: int, seed: int) -> Others:
    even = np.unique(np.linspace(0, len(source.pairs) - 1, n_pairs).round().astype(int))
    evenly = replace(source, pairs=[source.pairs[i] for i in even])
    return Others(
        recalibrate(source, NaturalOptions(max_pairs=2 * n_pairs, seed=seed)),
        recalibrate(evenly, NaturalOptions(max_pairs=n_pairs, seed=seed)),
    )


def _street_errors(run: NaturalRun, others: Others, source: NaturalSource) -> tuple[Measured, ...]:
    """How far the result is from the set's own rig, which pairs were chosen, and what the choice costs and gains."""
    found, given = run.calibration.rig.T_right_left, source.rig.T_right_left
    cosine = float(found.t @ given.t / np.linalg.norm(found.t) / np.linalg.norm(given.t))
    own, twice, even = (_turn_sigma(each) for each in (run, *others))
    turn, off = so3.angle_rad(found.R @ given.R.T), np.arccos(np.clip(cosine, -1.0, 1.0))
    place = {pair.name: i for i, pair in enumerate(source.pairs)}
    used = [place[view.name] for view in run.calibration.views]
    figures = (
        ("rotation from the set's own", "deg", float(np.degrees(turn)), float(np.degrees(own))),
        ("direction of the translation from the set's own", "deg", float(np.degrees(off)), NAN),
        ("pairs used", "", float(len(used)), NAN),
        ("sigma of the rotation over that of twice the pairs", "", own / twice, NAN),
        ("sigma of the rotation over that of as many pairs evenly", "", own / even, NAN),
        *((f"place in the drive of pair {k + 1} of those used", "", float(i), NAN) for k, i in enumerate(used)),
    )
    return tuple(Measured(name, unit, value, sigma, STREET_TABLE) for name, unit, value, sigma in figures)


def _turn_sigma(run: NaturalRun) -> float:
    return float(np.sqrt(np.trace(run.calibration.covariance.block("rotation"))))


def recordings_of(folder: str | Path) -> list[tuple[str, Detections, str]]:
    """Name, views and camera model of the recording in a folder, or of every one in the folders of it.

    Raises:
        DataError: There is none; or the images of one cannot be used.
    """
    from binocal.benchmark.real_sets import load_set, sets_in

    return [(source.name, load_set(source).detections, source.model) for source in sets_in(Path(folder))]


def recordings_in_colour(folder: str | Path) -> list[tuple[str, dict[str, Detections], str]]:
    """Name, views by channel and camera model of every recording that is in colour.

    Raises:
        DataError: There is none of either kind; or the images of one cannot be used.
    """
    from binocal.benchmark.real_sets import load_channels, sets_in

    found = [(source.name, load_channels(source), source.model) for source in sets_in(Path(folder))]
    return [(name, channels, model) for name, channels, model in found if channels is not None]


def rows_of_timed(options: ExperimentOptions, results: Mapping[Key, Result]) -> list[Row]:
    """Rows of the sets of table 4, each from one run, and every method's time over ``drl``'s."""
    rows = []
    for case, methods in ((MEASURED, tuple(BOARD_METHODS)), *((street, STREET_METHODS) for street in STREETS)):
        of_drl = _seconds(results.get((case, "drl", options.seed)))
        for method in methods:
            result = results.get((case, method, options.seed))
            if result is None:
                continue
            failed, own = int(bool(result.failure)), _seconds(result)
            ratios = [
                Measured(f"{name}, over drl's", "", own[name] / of_drl[name], table=TABLE)
                for name in own
                if name in of_drl
            ]
            for measured in [*result.measured, *ratios] or [None]:
                is_printed = measured is not None and measured.criterion == "seconds from images"
                paper = PAPER_SECONDS.get(method, {}).get(case) if is_printed else None
                rows.append(row_of(TABLE, case, method, [] if measured is None else [measured], paper, 1, failed))
    return rows


def _seconds(result: Result | None) -> dict[str, float]:
    return {} if result is None else {m.criterion: m.value for m in result.measured if m.unit == "s"}
