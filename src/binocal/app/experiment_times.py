"""The paper's table 4: seconds from images and from corners to the rig, on quiet processors, one method after the other."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from binocal.app.corners import detect_corners
from binocal.app.natural import NaturalOptions, NaturalRun, NaturalSource, recalibrate, source_of_dataset
from binocal.boards import Board
from binocal.calibrators import calibrate
from binocal.errors import BinocalError
from binocal.evidence import Detections
from binocal.experiments.case import Result
from binocal.experiments.journal import Key
from binocal.experiments.options import ExperimentOptions
from binocal.experiments.row import NAN, Measured, Row, row_of
from binocal.geometry import so3
from binocal.threads import n_threads

TABLE, STREET_TABLE = "4", "streets"
PAPER_SECONDS = {"KITTI": 5.2, "Cityscapes": 6.2, "measured": 5.3}
"""What the paper's table 4 prints for its algorithm, 1000 images each, on a machine that it does not name."""
MEASURED, BOARD = "measured", "chessboard:11x8:20mm"
BOARD_METHODS = ("drl", "lm", "from-guess", "opencv", "alternating", "absolute-orientation", "heterogeneous")
STREET_METHODS = ("drl", "portfolio", "lm")
MAX_PAIRS = 8
LONG_S = 5.0  # a solve that took longer is not repeated
REPEATS = 3

MOST_TIMED = len(BOARD_METHODS) + 2 * len(STREET_METHODS)

Has = Callable[[str, str], bool]
"""Whether a case's method is in the journal already."""


def timed_results(options: ExperimentOptions, has: Has) -> Iterator[Result]:
    """Every set and method that the journal lacks. Nothing else should run meanwhile."""
    yield from _measured(options, has)
    for name in ("KITTI", "Cityscapes"):
        yield from _street(name, options, has)


def _measured(options: ExperimentOptions, has: Has) -> Iterator[Result]:
    """Boards before the paper's rig: all images are decoded and searched, every calibrator has the same corners."""
    missing = [name for name in BOARD_METHODS if not has(MEASURED, name)]
    if not missing:
        return
    from binocal.experiments.sets import render_boards

    board = Board.from_spec(BOARD)
    with tempfile.TemporaryDirectory(prefix="binocal-experiment-") as place:
        folder = Path(place)
        render_boards(board, max(options.n_images // 2, 8), options.seed, folder)
        left, right = str(folder / "left_*.png"), str(folder / "right_*.png")
        decode_s = _decode_s(sorted(folder.glob("*.png")))
        begin = time.perf_counter()
        corners = detect_corners(left, right, board)
        found_s = time.perf_counter() - begin
        for name in missing:
            yield _timed_calibration(name, corners, options.seed, decode_s, found_s)


def _decode_s(paths: list[Path]) -> float:
    """Seconds to decode all images, on as many threads as are used to search them."""
    from binocal.images import read_grey_image

    begin = time.perf_counter()
    with ThreadPoolExecutor(n_threads()) as pool:
        for _ in pool.map(read_grey_image, paths):
            pass
    return time.perf_counter() - begin


def _timed_calibration(name: str, corners: Detections, seed: int, decode_s: float, found_s: float) -> Result:
    taken: list[float] = []
    try:
        while len(taken) < REPEATS and (not taken or taken[0] < LONG_S):
            begin = time.perf_counter()
            calibrate(corners, calibrator=name, model="brown4")
            taken.append(time.perf_counter() - begin)
    except BinocalError as error:
        return Result(MEASURED, name, seed, failure=" ".join(str(error).split()))
    solve_s = float(np.median(taken))
    return Result(
        MEASURED,
        name,
        seed,
        (
            Measured("seconds from images", "s", found_s + solve_s, table=TABLE),
            Measured("times the decoding of the images", "", (found_s + solve_s) / decode_s, table=TABLE),
            Measured("seconds from corners", "s", solve_s, table=TABLE),
        ),
    )


def _street(name: str, options: ExperimentOptions, has: Has) -> Iterator[Result]:
    """A street: the pairs that tell most are matched; the rig that is given is the old one."""
    methods = STREET_METHODS[:1] if options.is_quick else STREET_METHODS
    missing = [method for method in methods if not has(name, method)]
    given = {"KITTI": options.kitti, "Cityscapes": options.cityscapes}[name]
    if not missing or (given is None and name == "Cityscapes" and options.is_quick):
        return
    n_pairs = 2 if options.is_quick else MAX_PAIRS
    with tempfile.TemporaryDirectory(prefix="binocal-experiment-") as place:
        if given is None:
            from binocal.experiments.sets import STREETS, render_street

            pairs = render_street(STREETS[name], 2 * n_pairs, options.seed, Path(place))
            source = NaturalSource(pairs, STREETS[name].rig())
        else:
            source = source_of_dataset(f"{name.lower()}:{given}", None)
        whole: NaturalRun | None = None
        for method in missing:
            try:
                run = recalibrate(source, NaturalOptions(max_pairs=n_pairs, seed=options.seed, calibrator=method))
                whole = whole or recalibrate(source, NaturalOptions(max_pairs=2 * n_pairs, seed=options.seed))
            except BinocalError as error:
                yield Result(name, method, options.seed, failure=" ".join(str(error).split()))
                continue
            yield Result(name, method, options.seed, (*_street_times(run), *_street_errors(run, whole, source)))


def _street_times(run: NaturalRun) -> tuple[Measured, ...]:
    total = run.elapsed_s["matching"] + run.elapsed_s["solve"]
    return (
        Measured("seconds from images", "s", total, table=TABLE),
        Measured("seconds from corners", "s", run.elapsed_s["solve"], table=TABLE),
    )


def _street_errors(run: NaturalRun, whole: NaturalRun, source: NaturalSource) -> tuple[Measured, ...]:
    """How far the result is from the set's own rig, and what it costs that some of the pairs are left out."""
    found, given = run.calibration.rig.T_right_left, source.rig.T_right_left
    cosine = float(found.t @ given.t / np.linalg.norm(found.t) / np.linalg.norm(given.t))
    sigmas = [float(np.sqrt(np.trace(r.calibration.covariance.block("rotation")))) for r in (run, whole)]
    turn, off = so3.angle_rad(found.R @ given.R.T), np.arccos(np.clip(cosine, -1.0, 1.0))
    figures = (
        ("rotation from the set's own", "deg", float(np.degrees(turn)), float(np.degrees(sigmas[0]))),
        ("direction of the translation from the set's own", "deg", float(np.degrees(off)), NAN),
        ("pairs used", "", float(len(run.calibration.views)), NAN),
        ("sigma of the rotation over that of twice the pairs", "", sigmas[0] / sigmas[1], NAN),
    )
    return tuple(Measured(name, unit, value, sigma, STREET_TABLE) for name, unit, value, sigma in figures)


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
    """Rows of the sets of table 4, each from one run."""
    rows = []
    for case, methods in ((MEASURED, BOARD_METHODS), ("KITTI", STREET_METHODS), ("Cityscapes", STREET_METHODS)):
        for method in methods:
            result = results.get((case, method, options.seed))
            if result is None:
                continue
            failed = int(bool(result.failure))
            for measured in result.measured or (None,):
                is_printed = measured is not None and measured.criterion == "seconds from images" and method == "drl"
                paper = PAPER_SECONDS[case] if is_printed else None
                rows.append(row_of(TABLE, case, method, [] if measured is None else [measured], paper, 1, failed))
    return rows
