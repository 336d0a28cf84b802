"""A training run as a user starts it: a folder that receives checkpoints, weights, history, logs, and the model card."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from binocal.errors import DataError
from binocal.output import check_output_folder, write_aside
from binocal.rl.agent_kind import AgentKind
from binocal.rl.cases import Cases
from binocal.rl.evaluation import EvaluationSet, Row, compare_on, format_rows, simulated_evaluation_set
from binocal.rl.history import TrainingHistory, load_history, write_history
from binocal.rl.match_batches import MATCH_SETS
from binocal.rl.policy import Policy, load_policy, save_policy, shipped_policy
from binocal.rl.rig_batches import RIG_SETS
from binocal.rl.street_evaluation import FoundRow, compare_on_matches, street_case
from binocal.rl.training.checkpoint import load_checkpoint, save_checkpoint
from binocal.rl.training.trainer import Check, Training, TrainingOptions, run_training, simulated_pools

CHECKPOINT, WEIGHTS, HISTORY = "checkpoint.pt", "weights.safetensors", "history.npz"
CHECKS, CARD, TABLE = "checks.json", "card.md", "table.json"
SECONDS_PER_CHECKPOINT = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class TrainingRun:
    """A finished or cut run: the policy at its best check, the checks, the evaluation table, and where all of it lies."""

    folder: Path
    policy: Policy
    checks: tuple[Check, ...]
    rows: tuple[Row, ...] | tuple[FoundRow, ...]
    n_steps: int
    elapsed_s: float
    is_complete: bool
    was_resumed: bool
    history: TrainingHistory


def check_folder(folder: Path, *, force: bool = False) -> None:
    """Whether a run may go there, before anything is done for it; nothing is changed but the folder's parent, made if missing.

    Raises:
        OutputExistsError: It holds other files than a run that was cut, and ``force`` is False.
        DataError: It is a file, or cannot be made.
    """
    check_output_folder(folder, force=force or (folder.is_dir() and _holds_a_cut_run(folder)))


def prepare_folder(folder: Path, *, force: bool = False) -> Path:
    """The folder, made if need be: empty, or with a run that was cut; with ``force`` a complete run is begun anew.

    Raises:
        OutputExistsError: It holds other files, or a complete run, and ``force`` is False.
        DataError: It is a file, or cannot be made.
    """
    check_folder(folder, force=force)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: the output's folder cannot be made: {error.strerror}.") from None
    if not _holds_a_cut_run(folder):
        (folder / CHECKPOINT).unlink(missing_ok=True)
    return folder


def read_history_of(folder: Path) -> TrainingHistory:
    """The history of the run in a folder.

    Raises:
        DataError: There is none, or it cannot be read.
    """
    try:
        return load_history(folder / HISTORY)
    except OSError:
        raise DataError(f"{folder} holds no training run ({HISTORY}); name a folder that train wrote.") from None


def _holds_a_cut_run(folder: Path) -> bool:
    weights = folder / WEIGHTS
    is_complete = weights.exists() and load_policy(weights).card.get("is_complete", True)
    return (folder / CHECKPOINT).exists() and not is_complete


def train_agent(
    folder: Path,
    options: TrainingOptions,
    *,
    pools: tuple[list[tuple[Cases, float]], list[tuple[Cases, float]]] | None = None,
    evaluation_set: EvaluationSet | None = None,
    description: str = "",
    n_rigs: int = 1000,
    command: str = "",
    version: str = "",
    seconds: float | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    should_stop: Callable[[], bool] = lambda: False,
) -> TrainingRun:
    """Trains in ``folder``, going on from its checkpoint if there is one, and evaluates beside the shipped agent.

    ``pools`` are training and validation rigs (simulated ones if None), ``description`` says in the card what they are. Without
    an ``evaluation_set`` the agent is evaluated on ``n_rigs`` rigs of each of ``RIG_SETS``; 0 leaves that out.
    ``seconds`` limits the time spent in episodes and gradient steps; a run that it cuts can be gone on with.

    Raises:
        DataError: The folder's checkpoint is of a run with other options.
    """
    report = progress or (lambda *_: None)
    if pools is None:
        report("rigs", 0, 1)
        pools = simulated_pools(options)
        report("rigs", 1, 1)
    training = Training(options, *pools)
    path = folder / CHECKPOINT
    was_resumed = path.exists()
    if was_resumed:
        try:
            training.restore(load_checkpoint(path))
        except ValueError as error:
            raise DataError(f"{path}: {error}; name another --output, or give the options of that run.") from None
    with _scalar_log(folder / "tensorboard") as log:

        def on_check(current: Training, check: Check) -> None:
            log(check)
            save_checkpoint(current, path)

        saved_at_s = [training.elapsed_s]

        def on_generation(current: Training) -> None:
            report("training", min(current.n_steps, options.n_steps), options.n_steps)
            if current.elapsed_s - saved_at_s[0] >= SECONDS_PER_CHECKPOINT:
                save_checkpoint(current, path)
                saved_at_s[0] = current.elapsed_s

        def is_cancelled() -> bool:
            return should_stop() or (seconds is not None and training.elapsed_s >= seconds)

        run_training(training, on_check=on_check, on_generation=on_generation, is_cancelled=is_cancelled)
        if not training.checks or training.checks[-1].n_steps < training.n_steps:
            on_check(training, training.check())
    save_checkpoint(training, path)
    card = _facts(training, description, command, version)
    policy = training.policy(card, best=True)
    rows: list[Row] | list[FoundRow] = []
    if n_rigs:
        name = str(options.kind)
        policies = {name: policy, f"{name}, as shipped": shipped_policy(options.kind)}
        comparisons = _comparisons(options.kind, policies, n_rigs, options.seed + 1, evaluation_set)
        for index, compare in enumerate(comparisons):
            report("evaluation", index, len(comparisons))
            rows = [*rows, *compare()]
        report("evaluation", len(comparisons), len(comparisons))
        card |= {"table": [asdict(row) for row in rows]}
    policy = replace(policy, card={key: value for key, value in card.items() if key != "table"})
    save_policy(policy, folder / WEIGHTS)
    write_history(training.history(), folder / HISTORY)
    write_aside(folder / CHECKS, json.dumps([asdict(check) for check in training.checks], indent=1), force=True)
    write_aside(folder / TABLE, json.dumps([asdict(row) for row in rows], indent=1), force=True)
    evaluated_on = "rigs never trained on" if evaluation_set is None else evaluation_set.description
    write_aside(folder / CARD, model_card(card, rows, evaluated_on), force=True)
    return TrainingRun(
        folder,
        policy,
        tuple(training.checks),
        tuple(rows),  # pyright: ignore - of one kind
        training.n_steps,
        training.elapsed_s,
        training.is_done,
        was_resumed,
        training.history(),
    )


def _comparisons(
    kind: AgentKind, policies: Mapping[str, Policy], n_rigs: int, seed: int, evaluation_set: EvaluationSet | None
) -> list[Callable[[], Any]]:
    """What makes the evaluation's rows, set by set."""
    if kind == AgentKind.DRL_STREETS:
        return [lambda name=name: compare_on_matches(street_case(name, n_rigs, seed), policies) for name in MATCH_SETS]
    if evaluation_set is not None:
        return [lambda: compare_on(evaluation_set, policies)]
    return [lambda name=name: compare_on(simulated_evaluation_set(name, n_rigs, seed), policies) for name in RIG_SETS]


def _facts(training: Training, description: str, command: str, version: str) -> dict[str, Any]:
    """What the card says of a run, as plain data."""
    options = training.options
    best = min(training.checks, key=lambda check: check.score)
    return {
        "agent": str(options.kind),
        "binocal": version,
        "command": command,
        "seed": options.seed,
        "targets": options.td3.targets,
        "is_complete": training.is_done,
        "steps": training.n_steps,
        "updates": training.td3.n_updates,
        "seconds": round(training.elapsed_s),
        "steps_per_s": round(training.n_steps / max(training.elapsed_s, 1e-9)),
        "best_check_at_step": best.n_steps,
        "rigs": description or f"{len(training.pools)} simulated distributions, {options.rigs_per_pool} rigs each",
        "options": options.document(),
    }


def model_card(facts: dict[str, Any], rows: Sequence[Row] | Sequence[FoundRow], evaluated_on: str) -> str:
    """The card as Markdown."""
    td3 = facts["options"]["td3"]
    lines = [
        f"# {facts['agent']}",
        "",
        f"Trained by `{facts['command'] or 'binocal train'}` with binocal {facts['binocal']}, seed {facts['seed']}.",
        "",
        f"- Rigs: {facts['rigs']}.",
        f"- {facts['steps']:,} steps of single rigs, {facts['updates']:,} gradient steps, {facts['seconds']} s "
        f"({facts['steps_per_s']:,} steps/s, gradient steps included); weights of the check at step {facts['best_check_at_step']:,}.",
        f"- TD3, {facts['targets']} targets (rate {td3['target_rate']:g}), discount {td3['discount']:g}, "
        f"actor {list(td3['actor_widths'])}, critics {list(td3['critic_widths'])}.",
        "",
    ]
    if rows:
        counted = "one iteration is one candidate evaluated, failures count 25"
        if isinstance(rows[0], FoundRow):
            counted = "found: within 3 standard deviations of the truth by the Cramér-Rao bound, once polished"
        lines += [
            f"On {evaluated_on} ({rows[0].n_rigs} each); {counted}.",
            "",
            format_rows(rows),
            "",
        ]
    return "\n".join(lines)


@contextmanager
def _scalar_log(folder: Path) -> Iterator[Callable[[Check], None]]:
    """A function that logs a check for TensorBoard; without the tensorboard package it does nothing."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        yield lambda _: None
        return
    writer = SummaryWriter(str(folder))

    def log(check: Check) -> None:
        writer.add_scalar("critic/loss", check.critic_loss, check.n_steps)
        writer.add_scalar("critic/predicted", check.value_predicted, check.n_steps)
        writer.add_scalar("critic/returned", check.value_returned, check.n_steps)
        writer.add_scalar("targets/lag", check.target_lag, check.n_steps)
        for index, (iterations, success) in enumerate(zip(check.iterations, check.success, strict=True)):
            writer.add_scalar(f"held_out/iterations_{index}", iterations, check.n_steps)
            writer.add_scalar(f"held_out/success_{index}", success, check.n_steps)

    try:
        yield log
    finally:
        writer.close()
