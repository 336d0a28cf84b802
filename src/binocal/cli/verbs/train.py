"""The verb ``train``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from binocal.cli.arguments import one_of, parse_board
from binocal.cli.exits import FINE
from binocal.cli.options import BOARD_HELP, Force, Json, Seed, Threads, app, finite, present


@app.command()
def train(
    output: Annotated[
        Path, typer.Option("--output", help="Folder for checkpoints, weights, card.", metavar="DIR")
    ] = Path("binocal-agent"),
    agent: Annotated[
        str,
        typer.Option(
            "--agent",
            help="drl steers the solver, drl-increments changes R, T itself, drl-streets steers `recalibrate`.",
            metavar="NAME",
        ),
    ] = "drl",
    targets: Annotated[
        str,
        typer.Option("--targets", help="How target networks follow: soft (Polyak) or hard (copies).", metavar="MODE"),
    ] = "soft",
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            help="Steps of single rigs (default: as the shipped agent); so many give the same weights.",
            metavar="N",
            min=1,
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            "--seconds",
            help="Stop training after so long; the same command goes on.",
            metavar="S",
            min=0.0,
            callback=finite,
        ),
    ] = None,
    layers: Annotated[
        str | None, typer.Option("--layers", help="Nodes of the actor's hidden layers, such as 64,64.", metavar="N,N")
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option("--data", help="Train on real images: left* and right* in a folder.", metavar="DIR"),
    ] = None,
    board: Annotated[str | None, typer.Option("--board", help=BOARD_HELP, metavar="SPEC")] = None,
    beside: Annotated[
        list[Path] | None,
        typer.Option(
            "--beside", help="Another run's folder to draw beside this one; seeds make a band.", metavar="DIR"
        ),
    ] = None,
    rigs: Annotated[
        int,
        typer.Option("--rigs", help="Unseen rigs of each evaluation set; 0 leaves the table out.", metavar="N", min=0),
    ] = 1000,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Train an agent on simulated rigs or real images; started again in the same folder, it goes on where it was."""
    from binocal import app as verbs
    from binocal.cli import documents, tables
    from binocal.cli.progress import progress_on_terminal

    if data is None and board is not None:
        raise typer.BadParameter("--board is that of the images in --data DIR; simulated rigs have theirs.")
    options = verbs.TrainRequest(
        one_of("--agent", agent, ("drl", "drl-increments", "drl-streets")),
        one_of("--targets", targets, ("soft", "hard")),
        steps,
        seconds,
        _parse_layers(layers),
        rigs,
        seed,
    )
    parsed = None if board is None else parse_board(board)
    with progress_on_terminal() as progress:
        trained = verbs.train(
            output, options, data=data, board=parsed, beside=beside or (), force=force, progress=progress
        )
    present(documents.training_document(trained), tables.training_text(trained), json)
    return FINE


def _parse_layers(text: str | None) -> tuple[int, ...] | None:
    if text is None:
        return None
    try:
        widths = tuple(int(part) for part in text.split(","))
    except ValueError:
        widths = ()
    if not widths or min(widths) < 1:
        raise typer.BadParameter(f"--layers is {text!r}; give whole numbers with commas, such as 64,64")
    return widths
