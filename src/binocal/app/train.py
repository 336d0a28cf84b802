"""Training an agent, on simulated rigs or on images of a real one."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from binocal import __version__
from binocal.app.corners import detect_corners
from binocal.boards import Board, load_board
from binocal.errors import DataError, FormatError, MissingExtraError, TooFewViewsError
from binocal.evidence import Detections
from binocal.formats import rig_json
from binocal.progress import ProgressCallback, ShouldStop
from binocal.result import StereoCalibration

if TYPE_CHECKING:
    from binocal.rl.evaluation import EvaluationSet
    from binocal.rl.history import TrainingHistory
    from binocal.rl.training.run_folder import TrainingRun
    from binocal.rl.training.trainer import TrainingOptions

MIN_VIEWS_PER_HALF = 6  # a half must hold rigs of three views, each a half of it
REAL_RIGS = 256
TUNING_RIGS_OF_REAL_VIEWS = 128  # to tune the classical controllers on that the agent is compared with
MODEL_OF_REAL_RIGS = "brown4"


@dataclass(frozen=True, slots=True)
class TrainRequest:
    """How to train: which agent, targets, steps of single rigs, a time limit, nodes per layer, evaluation rigs, seed.

    Without ``n_steps`` as many as the shipped agent took.
    """

    agent: str = "drl"
    targets: str = "soft"
    n_steps: int | None = None
    seconds: float | None = None
    widths: tuple[int, ...] | None = None
    n_rigs: int = 1000
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class TrainedAgent:
    """A run, and with real images the calibration of their second half by the agent that the first half trained."""

    run: TrainingRun
    test_half: StereoCalibration | None = None
    figure: Path | None = None


def train(
    output: str | Path,
    options: TrainRequest | None = None,
    *,
    data: str | Path | None = None,
    board: Board | None = None,
    beside: Sequence[str | Path] = (),
    force: bool = False,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
) -> TrainedAgent:
    """Train an agent into ``output``; a run that was cut there goes on where it was.

    With ``data``, a folder with left* and right* images of a board (or with folders left and right): the first half of the
    pairs trains, with a reward that needs no truth, the second half evaluates the agent and is calibrated with it (the paper's
    steps 1 and 6). ``board`` may be left out where the folder says which it is, see :func:`board_of_folder`. ``beside`` names
    folders of other runs that the figure shows too: seeds of one kind of targets as a band.

    Raises:
        MissingExtraError: PyTorch is not installed.
        OutputExistsError: ``output`` holds other files than a run's, or a complete run, and ``force`` is False.
        DataError: The images cannot be used, the run in ``output`` had other options, or a folder ``beside`` holds no run.
    """
    options = options or TrainRequest()
    try:
        from binocal.rl.training import run_folder
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise MissingExtraError("training", "train") from None
    run_folder.check_folder(Path(output), force=force)
    others = [run_folder.read_history_of(Path(folder)) for folder in beside]
    chosen, pools, description, evaluation_set, test = _training_options(options), None, "", None, None
    if data is not None:
        board = board or board_of_folder(data)
        left, right = _image_patterns(Path(data))
        detections = detect_corners(left, right, board, progress=progress, should_stop=should_stop)
        half = detections.n_views // 2
        if half < MIN_VIEWS_PER_HALF:
            raise TooFewViewsError(detections.n_views, 2 * MIN_VIEWS_PER_HALF)
        test = detections.select(np.arange(half, detections.n_views))
        chosen, pools, evaluation_set = _on_real_views(detections.select(np.arange(half)), test, chosen, options)
        description = f"{half} pairs of real images, {REAL_RIGS} rigs drawn from them, rewards without truth"
    run = run_folder.train_agent(
        run_folder.prepare_folder(Path(output), force=force),
        chosen,
        pools=pools,
        evaluation_set=evaluation_set,
        description=description,
        n_rigs=options.n_rigs,
        command=_command(options, data is not None),
        version=__version__,
        seconds=options.seconds,
        progress=progress,
        should_stop=should_stop or (lambda: False),
    )
    calibration = None
    if test is not None:
        from binocal.calibrators import CalibrationRequest
        from binocal.calibrators.learned import calibrate_with_policy
        from binocal.calibrators.provenance import with_provenance

        request = CalibrationRequest(MODEL_OF_REAL_RIGS, seed=options.seed)
        calibration = with_provenance(calibrate_with_policy(test, request, run.policy), options.agent, request, {})
    return TrainedAgent(run, calibration, _draw(run, others))


def board_of_folder(folder: str | Path) -> Board:
    """The board of a folder of images: that of its ``truth.json``, or of the one YAML file that is a board's.

    Raises:
        DataError: There is none, or more than one.
    """
    truth, boards = Path(folder) / "truth.json", {}
    if truth.exists():
        board = rig_json.read_truth(truth).board
        if board is None:
            raise DataError(f"{folder}: its images show no board; give a folder of images of one.")
        return board
    for path in sorted([*Path(folder).glob("*.yaml"), *Path(folder).glob("*.yml")]):
        with contextlib.suppress(FormatError):
            boards[path.name] = load_board(str(path))
    if len(boards) != 1:
        found = f"more than one ({', '.join(boards)})" if boards else "none"
        raise DataError(f"{folder}: which board? A YAML file of a board beside the images says it; there is {found}.")
    return next(iter(boards.values()))


def _image_patterns(folder: Path) -> tuple[str, str]:
    if (folder / "left").is_dir() and (folder / "right").is_dir():
        return str(folder / "left"), str(folder / "right")
    return str(folder / "left*"), str(folder / "right*")


def _training_options(options: TrainRequest) -> TrainingOptions:
    from binocal.rl.agent_kind import AgentKind
    from binocal.rl.training.trainer import default_options

    given = default_options(AgentKind(options.agent))
    td3 = replace(given.td3, targets=options.targets)
    if options.widths is not None:
        td3 = replace(td3, actor_widths=options.widths)
    return replace(given, seed=options.seed, n_steps=options.n_steps or given.n_steps, td3=td3)


def _on_real_views(
    half: Detections, test: Detections, chosen: TrainingOptions, options: TrainRequest
) -> tuple[TrainingOptions, Any, EvaluationSet]:
    """Pools drawn from one half of the views, the evaluation_set from the other; networks by the amount unless layers were given."""
    from binocal.calibrators import calibrate
    from binocal.rl.evaluation import EvaluationSet
    from binocal.rl.real_rig_batches import network_widths, rigs_from_calibration, tolerance_sigma
    from binocal.rl.rig_batches import sample_starts

    rng = np.random.default_rng([options.seed, 3])
    known, unseen = (calibrate(views, calibrator="lm", model=MODEL_OF_REAL_RIGS) for views in (half, test))
    rigs, held_out, tuning = (
        rigs_from_calibration(known, n, rng) for n in (REAL_RIGS, REAL_RIGS // 4, TUNING_RIGS_OF_REAL_VIEWS)
    )
    others = rigs_from_calibration(unseen, max(1, min(options.n_rigs, REAL_RIGS)), rng)
    tolerance = tolerance_sigma(rigs.options.n_views)
    evaluation_set = EvaluationSet(
        "second half",
        "rigs drawn from the images of the second half",
        others,
        sample_starts(others, rng),
        tuning,
        sample_starts(tuning, rng),
        tolerance_sigma(others.options.n_views),
    )
    if options.widths is None:
        td3 = replace(chosen.td3, actor_widths=network_widths(half.n_views))
        chosen = replace(chosen, td3=td3)
    pools = [(rigs, tolerance)], [(held_out, tolerance)]
    return replace(chosen, rigs_per_pool=REAL_RIGS), pools, evaluation_set


def _command(options: TrainRequest, is_real: bool) -> str:
    parts = ["binocal train", f"--agent {options.agent}", f"--targets {options.targets}"]
    if options.n_steps is not None:
        parts.append(f"--steps {options.n_steps}")
    if options.widths is not None:
        parts.append(f"--layers {','.join(map(str, options.widths))}")
    parts.append(f"--seed {options.seed}")
    return " ".join([*parts, *(["--data DIR --board SPEC"] if is_real else [])])


def _draw(run: TrainingRun, others: Sequence[TrainingHistory]) -> Path | None:
    """The figure of the run and of those beside it, where matplotlib is installed."""
    from binocal.report.training import draw_training

    path = run.folder / "training.svg"
    try:
        draw_training([run.history, *others], path)
    except MissingExtraError:
        return None
    return path
