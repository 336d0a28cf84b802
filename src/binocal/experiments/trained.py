"""The paper's steps 1 to 6 with an agent of its own: the first half of the views trains it, on the second it finds the rig."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cameras import StereoRig
from binocal.experiments.case import Case, Made, Sample
from binocal.experiments.guesses import GUESSES, NOISE_PX, Leads, as_said, led_from_guesses
from binocal.rl.agent_kind import AgentKind
from binocal.rl.history import TrainingHistory, load_history, write_history
from binocal.rl.policy import Policy
from binocal.rl.real_rig_batches import network_widths, rigs_from_calibration, tolerance_sigma
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

if TYPE_CHECKING:
    from binocal.rl.training.trainer import Training

TABLE = "training"
TARGETS = ("soft", "hard")
N_STEPS = 60_000  # twenty seconds of a free core; the shipped agent took 2,000,000
N_VIEWS = 40
N_RIGS = 256  # drawn from the half that trains, and a quarter of it to check on
CASE = "trained on the first half"
GUESS = "up to 20 deg, 30 % off"


def can_train() -> bool:
    """Whether PyTorch is installed."""
    return importlib.util.find_spec("torch") is not None


@dataclass(frozen=True, slots=True)
class CornersInHalves:
    """Simulated corners of the paper's rig, as real images would give them: nothing but corners is told."""

    prior: StereoRig

    def __call__(self, seed: int) -> Sample:
        """See :class:`binocal.experiments.case.Case`."""
        rng, rig, board = np.random.default_rng([seed, 10]), table2_rig(), parse_board("chessboard:11x8:20mm")
        scene = StereoScene(rig, board, sample_board_poses(rig, board, N_VIEWS, rng))
        corners = simulate_detections(scene, rng, noise_px=NOISE_PX)
        first, second = (corners.select(part) for part in np.split(np.arange(N_VIEWS), 2))
        return Sample((second, seed), rig, board, choices={"model": "brown4"}, prior=self.prior, training=first)


@dataclass(frozen=True, slots=True)
class TrainsFirst:
    """An agent that is trained on the sample's first half, then leads on the second; its history is left in ``folder``."""

    label: str
    targets: str
    folder: str
    n_steps: int = N_STEPS

    def __call__(self, sample: Sample) -> tuple[Made, ...]:
        """See :class:`binocal.experiments.case.Method`."""
        _, seed = sample.evidence
        policy, history = train_on(sample, self.targets, self.n_steps, seed)
        write_history(history, history_path(Path(self.folder), self.targets, seed))
        made = led_from_guesses(sample, policy, GUESSES[GUESS])
        return (replace(made, said={**made.said, **_figures(history)}),)


def history_path(folder: Path, targets: str, seed: int) -> Path:
    """Where the history of a training run lies."""
    return folder / f"training-{targets}-{seed}.npz"


def histories_in(folder: Path, seeds: tuple[int, ...]) -> list[TrainingHistory]:
    """Those that are there."""
    paths = [history_path(folder, targets, seed) for targets in TARGETS for seed in seeds]
    return [load_history(path) for path in paths if path.exists()]


def train_on(sample: Sample, targets: str, n_steps: int, seed: int) -> tuple[Policy, TrainingHistory]:
    """The agent at the end of its training: rewards look at no truth, layers and nodes follow the number of views."""
    from binocal.rl.training.trainer import run_training

    training = _training(sample, targets, n_steps, seed)
    run_training(training, on_check=lambda *_: None)
    return training.policy({}), training.history()


def _training(sample: Sample, targets: str, n_steps: int, seed: int) -> Training:
    from binocal.rl.training.trainer import Training, default_options

    views = sample.training
    assert views is not None  # given by the case
    known, rng = calibrate(views, calibrator="lm", **sample.choices), np.random.default_rng([seed, 11])
    rigs, held_out = (rigs_from_calibration(known, n, rng) for n in (N_RIGS, N_RIGS // 4))
    tolerance = tolerance_sigma(rigs.options.n_views)
    options = default_options(AgentKind.DRL)
    td3 = replace(options.td3, targets=targets, actor_widths=network_widths(views.n_views))
    options = replace(options, seed=seed, n_steps=n_steps, td3=td3, rigs_per_pool=N_RIGS)
    return Training(options, [(rigs, tolerance)], [(held_out, tolerance)])


@dataclass(frozen=True, slots=True)
class BeforeTraining:
    """The agent as a training run begins: its action is near the one that every actor starts from."""

    label: str = "drl, before training"

    def __call__(self, sample: Sample) -> tuple[Made, ...]:
        """See :class:`binocal.experiments.case.Method`."""
        training = _training(sample, TARGETS[0], N_STEPS, sample.evidence[1])
        training.warm_up()
        return (led_from_guesses(sample, training.policy({}), GUESSES[GUESS]),)


def _figures(history: TrainingHistory) -> Mapping[str, tuple[float, str]]:
    """The paper's convergence of the loss, and what it does not prove: the critic's values beside the returns that followed."""
    best = int(np.argmin(history.held_out_iterations))
    off = history.value_predicted - history.value_monte_carlo
    figures = {
        "critic's loss at the end": (
            float(np.mean(history.critic_loss[-max(1, len(history.critic_loss) // 50) :])),
            "reward²",
        ),
        "its value less the return, mean": (float(off.mean()), "reward"),
        "its value less the return, RMS": (float(np.sqrt(np.mean(off**2))), "reward"),
        "held-out iterations before training": (float(history.held_out_iterations[0]), ""),
        "held-out iterations at the end": (float(history.held_out_iterations[-1]), ""),
        "the best check came after": (
            100 * float(history.held_out_step[best]) / float(history.step[-1]),
            "% of the run",
        ),
    }
    if history.converged_step is not None:
        share = 100 * history.converged_step / history.step[-1]
        figures["loss converged (5 % rule), of the run"] = (float(share), "%")
    return figures


def trained_cases(prior: StereoRig, folder: Path) -> list[Case]:
    """Both kinds of targets, and on the same second halves the shipped agent and no agent."""
    own = tuple(TrainsFirst(f"drl, {targets} targets, trained here", targets, str(folder)) for targets in TARGETS)
    others = (Leads("drl, as shipped", "drl", GUESSES[GUESS]), Leads("lm", "lm", GUESSES[GUESS]))
    return [Case(CASE, CornersInHalves(prior), as_said, (*own, BeforeTraining(), *others), table=TABLE)]
