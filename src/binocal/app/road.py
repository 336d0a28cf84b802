"""The verbs of the road: from images to a rig, and what is known of it."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from binocal.boards import Board
from binocal.calibrators.base import CalibrationRequest
from binocal.cameras import StereoRig
from binocal.errors import BinocalError, CalibrationError, DataError, OutputExistsError
from binocal.evidence import Detections
from binocal.formats import rig_json
from binocal.geometry import SE3
from binocal.images.png import encode_png
from binocal.result import Covariance, RejectedView, StereoCalibration

if TYPE_CHECKING:
    from binocal.metrics import image, pose
    from binocal.metrics.held_out import Criterion

Progress = Callable[[str, int, int], None]
ShouldStop = Callable[[], bool]

DEMO_SQUARES_M = (0.010, 0.020)  # the two boards of PAPER table 3
EXACT_VIEWS = 20
HELD_OUT_STREAM = 999  # far from the streams that the rendered views are drawn from
SUSPECT_VIEW_FACTOR = 5.0  # a held-out view whose RMS is that many times the median is named


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """How to render: Gaussian blur of the lens (sigma, pixels), sensor noise (grey levels), seed."""

    blur_px: float = 0.8
    noise_dn: float = 3.0
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationRun:
    """A calibration from images: the result, and what became of every file.

    ``ignored`` holds (path, reason) of files left out of the pairing; ``notes`` are remarks that need no action.
    """

    calibration: StereoCalibration
    ignored: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    elapsed_s: Mapping[str, float] = field(default_factory=dict)
    detections: Detections | None = None
    """All corners as detected, those of rejected views too."""


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


@dataclass(frozen=True, slots=True, eq=False)
class DemoCase:
    """One board of the demonstration: the folder with its files, the calibration, and how near the truth it came."""

    name: str
    folder: Path
    run: CalibrationRun
    evaluation: TruthEvaluation


def calibrate_images(
    left: str,
    right: str,
    board: Board,
    request: CalibrationRequest | None = None,
    *,
    calibrator: str = "drl",
    preprocess: bool = False,
) -> CalibrationRun:
    """Calibrate from the images that two globs or folders name; ``preprocess`` strengthens their edges first.

    Raises:
        DataError: The images cannot be used.
        CalibrationError: No trustworthy rig follows from them.
        CancelledError: ``request.should_stop`` returned True.
    """
    request = request or CalibrationRequest()
    started = time.perf_counter()
    with ThreadPoolExecutor(1) as aside:
        # What the solver needs is loaded while the first images are, of which one core is enough.
        loading = aside.submit(_load_calibrator, calibrator)
        found = _detect(left, right, board, preprocess, request.progress, request.should_stop)
        calibrate = loading.result()
    detections = replace(found.detections, board_spec=rig_json.format_board(board))
    detected = time.perf_counter()
    inputs = {
        "opencv": _opencv_version(),
        "board": detections.board_spec,
        "preprocess": preprocess,
        "input_sha256": dict(found.input_sha256),
    }
    with _explained(found.ignored, found.rejected):
        calibration = calibrate(detections, request, calibrator=calibrator, inputs=inputs)
    solved = time.perf_counter()
    calibration = replace(calibration, rejected=found.rejected + calibration.rejected)
    choice = calibration.provenance.get("view_choice")
    notes = (*found.notes, f"{choice['reason']}.") if choice else found.notes
    elapsed_s = {"images": detected - started, "solve": solved - detected, "all": time.perf_counter() - started}
    return CalibrationRun(calibration, found.ignored, notes, elapsed_s, detections)


def simulate(
    rig: StereoRig,
    board: Board,
    n_pairs: int,
    output: str | Path,
    options: SimulateOptions | None = None,
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> rig_json.Truth:
    """Render ``n_pairs`` images of a board into ``output``: left_00.png, right_00.png, …, and truth.json.

    The same seed gives the same images, whatever the number of threads. ``output`` appears in full or not at all.
    With ``force``, an earlier simulation's images in it are replaced and every other file is left alone.

    Raises:
        ValueError: The board has no length unit, or there are no pairs to render.
        OutputExistsError: ``output`` holds files and ``force`` is False.
    """
    from binocal.simulation import sample_board_poses

    options = options or SimulateOptions()
    if not board.is_metric:
        raise ValueError(f"a simulated board needs its size: give the length a unit, such as {board.kind}:…:20mm")
    if n_pairs < 1:
        raise ValueError(f"there is nothing to render: {n_pairs} pairs")
    pose_seed, image_seed = np.random.SeedSequence(options.seed).spawn(2)
    T_left_board = sample_board_poses(rig, board, n_pairs, np.random.default_rng(pose_seed))
    width = max(2, len(str(n_pairs - 1)))
    names = tuple(f"{view:0{width}d}" for view in range(n_pairs))
    truth = rig_json.Truth(rig, board, names, T_left_board, options.noise_dn, options.blur_px)
    with staged_folder(output, force=force) as folder:
        _render(truth, folder, options, image_seed, progress)
        rig_json.write_truth(folder / "truth.json", truth)
    return truth


def evaluate_truth(calibration: StereoCalibration, truth: rig_json.Truth, *, seed: int = 0) -> TruthEvaluation:
    """Errors of a calibration whose truth is known, each beside its Cramér-Rao bound.

    The bound is that of the views which the calibration used, for the corner noise that it measured. The criteria are measured on
    exact new views of the true rig, drawn from ``seed``.
    """
    from binocal.metrics import pose
    from binocal.metrics.held_out import criteria_on_exact_views

    rig, notes = calibration.rig, []
    sigma = calibration.covariance.sigma
    if not rig.is_metric:
        scale = truth.board.pitch_m
        rig = pose.scaled(rig, scale)
        sigma = {name: s * scale if name.startswith("translation.") else s for name, s in sigma.items()}
        notes.append("the rig is in board pitches; it was scaled by the pitch of the truth's board.")
    has_skew = "left.skew" in calibration.covariance.names
    bounded = _bound(calibration, truth, has_skew, notes)
    bound = None if bounded is None else bounded[1]
    comparison = pose.compare_with_truth(rig, truth.rig, sigma=sigma, bound=bound, has_skew=has_skew)
    exact, T_left_board = _held_out_views(truth, EXACT_VIEWS, seed)
    criteria = criteria_on_exact_views(
        rig, exact, T_left_board, _side_m(truth.board), bounded, np.random.default_rng(seed)
    )
    noise_px = calibration.noise_px if bound is not None else float("nan")
    return TruthEvaluation(comparison, noise_px, tuple(notes), criteria)


def evaluate_images(
    rig: StereoRig,
    left: str,
    right: str,
    board: Board,
    *,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
) -> ImageEvaluation:
    """Pixel error, rectified row error and measured lengths of a rig on images of a board.

    Raises:
        DataError: The images cannot be used, their size is not the rig's, or the board lacks the length it needs.
    """
    if rig.is_metric and not board.is_metric:
        raise DataError("the rig is in metres: give the board's length a unit (such as 30mm) to compare with it.")
    found = _detect(left, right, board, False, progress, should_stop)
    notes = list(found.notes)
    detections, side_m = found.detections, _side_m(board)
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
        detections = replace(detections, object_points_m=detections.object_points_m / board.pitch_m, is_metric=False)
        side_m /= board.pitch_m
        notes.append("the rig is in board pitches: lengths are compared as if this board had calibrated it.")
    return _evaluate_detections(rig, detections, side_m, found, notes)


def demo(
    output: str | Path, *, seed: int = 0, n_pairs: int = 20, force: bool = False, progress: Progress | None = None
) -> tuple[DemoCase, ...]:
    """Render the table-2 rig with both of the paper's boards, calibrate each from its images, compare with the truth.

    ``output`` gets a folder per board with images, truth.json and rig.json.

    Raises:
        OutputExistsError: ``output`` holds files and ``force`` is False.
    """
    from binocal.simulation import table2_rig

    output = Path(output)
    check_output_folder(output, force=force)
    cases = []
    for number, square_m in enumerate(DEMO_SQUARES_M):
        name = f"{square_m * 1e3:.0f}mm"
        board = Board.from_spec(f"chessboard:11x8:{name}")
        folder = output / name
        told = _prefixed(f"{name} board: ", progress)
        truth = simulate(
            table2_rig(), board, n_pairs, folder, SimulateOptions(seed=2 * seed + number), force=force, progress=told
        )
        left, right = str(folder / "left_*.png"), str(folder / "right_*.png")
        request = CalibrationRequest("brown4", seed=seed, progress=told)
        run = calibrate_images(left, right, board, request)
        rig_json.write_calibration(folder / "rig.json", run.calibration, force=force)
        cases.append(DemoCase(name, folder, run, evaluate_truth(run.calibration, truth, seed=seed)))
    return tuple(cases)


def check_output_folder(output: str | Path, *, force: bool = False) -> Path:
    """The folder as a :class:`Path`, once it is known that results may be put into it.

    Raises:
        OutputExistsError: It holds files and ``force`` is False.
        DataError: It is a file, or cannot be made.
    """
    output = Path(output)
    if output.exists() and not output.is_dir():
        raise DataError(f"{output} is a file; name a folder for the output.")
    if output.is_dir() and any(output.iterdir()) and not force:
        raise OutputExistsError(output)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{output.parent}: the output's folder cannot be made: {error.strerror}.") from None
    return output


@contextlib.contextmanager
def staged_folder(output: str | Path, *, force: bool = False) -> Iterator[Path]:
    """A temporary folder beside ``output``; its files move there if the block ends well, and vanish if it does not."""
    output = check_output_folder(output, force=force)
    try:
        aside = Path(tempfile.mkdtemp(prefix=f".{output.name}.", suffix=".part", dir=output.parent))
    except OSError as error:
        raise DataError(f"{output.parent}: the output's folder cannot be written to: {error.strerror}.") from None
    try:
        yield aside
        output.mkdir(exist_ok=True)
        if (output / "truth.json").exists():
            with contextlib.suppress(DataError):
                for name in rig_json.read_truth(output / "truth.json").names:
                    for side in ("left", "right"):
                        (output / f"{side}_{Path(name).name}.png").unlink(missing_ok=True)
        for file in sorted(aside.iterdir(), key=lambda path: path.name == "truth.json"):  # the truth last
            os.replace(file, output / file.name)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _load_calibrator(name: str) -> Callable[..., StereoCalibration]:
    """The calibrating function, with the method's own modules in memory."""
    from binocal.calibrators import CALIBRATORS, calibrate_as_requested

    if name in CALIBRATORS:
        CALIBRATORS[name]()
    return calibrate_as_requested


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What two sets of images gave."""

    detections: Detections
    rejected: tuple[RejectedView, ...]
    ignored: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    input_sha256: Mapping[str, str]


def _detect(
    left: str, right: str, board: Board, preprocess: bool, progress: Progress | None, should_stop: ShouldStop | None
) -> _Found:
    from binocal.datasets.folder import list_pairs
    from binocal.detection import detect_pairs

    pairing = list_pairs(left, right)
    ignored = tuple((str(path), reason) for path, reason in pairing.ignored)
    with _explained(ignored, ()):
        found = detect_pairs(
            pairing.pairs,
            board,
            progress=_stage("finding corners", progress),
            should_stop=should_stop,
            preprocess=preprocess,
        )
    return _Found(found.detections, tuple(found.rejected), ignored, tuple(found.notes), found.input_sha256)


def detect_corners(
    left: str, right: str, board: Board, *, progress: Progress | None = None, should_stop: ShouldStop | None = None
) -> Detections:
    """The corners of all pairs in which the board was found.

    Raises:
        DataError: The images cannot be used.
    """
    return _detect(left, right, board, False, progress, should_stop).detections


@contextlib.contextmanager
def _explained(ignored: Sequence[tuple[str, str]], rejected: Sequence[RejectedView]) -> Iterator[None]:
    """An error that leaves the block also carries what was ignored and rejected before it."""
    try:
        yield
    except BinocalError as error:
        if isinstance(error, CalibrationError):
            error.rejected = {view.name: view.reason for view in rejected} | error.rejected
        for path, reason in ignored:
            error.add_note(f"ignored {path}: {reason}")
        raise


def _evaluate_detections(
    rig: StereoRig, detections: Detections, side_m: float, found: _Found, notes: list[str]
) -> ImageEvaluation:
    from binocal.metrics import image
    from binocal.metrics.order import order_corners

    ordered = order_corners(rig, detections)
    detections = ordered.detections
    notes += ordered.notes
    pixel_error = image.pixel_error(rig, detections, ordered.T_left_board)
    usual_px = float(np.nanmedian(pixel_error.view_rms_px))
    for name, rms_px in zip(detections.names, pixel_error.view_rms_px, strict=True):
        if rms_px > SUSPECT_VIEW_FACTOR * usual_px:
            notes.append(
                f"view {name}: {rms_px:.3g} px against {usual_px:.3g} px in the median view: "
                "its images may not belong together, or its corners are wrong."
            )
    try:
        row_error = image.rectified_row_error(rig, detections)
    except CalibrationError as error:
        row_error = None
        notes.append(f"no row error: {error}")
    lengths = image.length_error(rig, detections, side_m=side_m)
    return ImageEvaluation(
        pixel_error, row_error, lengths, detections.names, found.rejected, found.ignored, tuple(notes)
    )


def _bound(
    calibration: StereoCalibration, truth: rig_json.Truth, has_skew: bool, notes: list[str]
) -> tuple[StereoRig, Covariance] | None:
    """The true rig in the camera model that was estimated, and the Cramér-Rao bound there; None, with a note, without one."""
    from binocal.metrics import pose
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
    points = truth.board.object_points_m
    bound = cramer_rao_bound(
        rig,
        points,
        poses,
        calibration.noise_px,
        left_is_seen=_is_inside(rig.left.project(poses.apply(points)), rig.left.size_wh),
        right_is_seen=_is_inside(rig.right.project((rig.T_right_left @ poses).apply(points)), rig.right.size_wh),
        skew=has_skew,
    )
    return rig, bound


def _is_inside(pixels: np.ndarray, size_wh: tuple[int, int]) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return np.all((pixels >= -0.5) & (pixels <= np.array(size_wh) - 0.5), axis=-1)


def _held_out_views(truth: rig_json.Truth, n_views: int, seed: int) -> tuple[Detections, SE3]:
    """Exact corners of new views of the truth's rig and board, and their poses."""
    from binocal.simulation import sample_board_poses

    rig, points = truth.rig, truth.board.object_points_m
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(HELD_OUT_STREAM,)))
    T_left_board = sample_board_poses(rig, truth.board, n_views, rng)
    sides = []
    for camera, poses in ((rig.left, T_left_board), (rig.right, rig.T_right_left @ T_left_board)):
        pixels = camera.project(poses.apply(points))
        pixels[~_is_inside(pixels, camera.size_wh)] = np.nan
        sides.append(pixels)
    exact = Detections.from_arrays(points, sides[0], sides[1], rig.left.size_wh, right_image_size_wh=rig.right.size_wh)
    return exact, T_left_board


def _side_m(board: Board) -> float:
    """Distance of neighbouring points of the board, metres."""
    return board.pitch_m * (np.sqrt(2) if board.kind == "acircles" else 1.0)


def _render(
    truth: rig_json.Truth,
    folder: Path,
    options: SimulateOptions,
    seed: np.random.SeedSequence,
    progress: Progress | None,
) -> None:
    from binocal.simulation import RenderOptions, render_image

    render_options = RenderOptions(blur_px=options.blur_px, noise_dn=options.noise_dn)
    sides = (
        ("left", truth.rig.left, truth.T_left_board),
        ("right", truth.rig.right, truth.rig.T_right_left @ truth.T_left_board),
    )
    seeds = seed.spawn(2 * len(truth.names))

    def work(job: tuple[int, int]) -> None:
        view, index = job
        side, camera, T_camera_board = sides[index]
        rng = np.random.default_rng(seeds[2 * view + index])
        image = render_image(camera, T_camera_board[view], truth.board, render_options, rng)
        (folder / f"{side}_{truth.names[view]}.png").write_bytes(encode_png(image.image))

    jobs = [(view, index) for index in range(2) for view in range(len(truth.names))]
    told = _stage("rendering", progress)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        futures = [pool.submit(work, job) for job in jobs]
        try:
            for done, future in enumerate(as_completed(futures), 1):
                future.result()
                if told:
                    told(done, len(jobs))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _stage(stage: str, progress: Progress | None) -> Callable[[int, int], None] | None:
    return partial(progress, stage) if progress else None


def _prefixed(prefix: str, progress: Progress | None) -> Progress | None:
    return (lambda stage, done, total: progress(prefix + stage, done, total)) if progress else None


def _opencv_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    for package in (
        "opencv-python-headless",
        "opencv-python",
        "opencv-contrib-python-headless",
        "opencv-contrib-python",
    ):
        with contextlib.suppress(PackageNotFoundError):
            return version(package)
    return "unknown"
