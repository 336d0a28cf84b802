"""The verb ``experiment``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from binocal.cli.exits import FINE
from binocal.cli.options import Force, Json, Seed, Threads, app, present


@app.command()
def experiment(
    output: Annotated[
        Path, typer.Option("--output", help="Folder for the page, its figures and rows.", metavar="DIR")
    ] = Path("binocal-experiment"),
    quick: Annotated[bool, typer.Option("--quick", help="Few images and seeds, for a minute.")] = False,
    images: Annotated[
        int | None,
        typer.Option(
            "--images",
            help="Images of each set, all seeds together, 16 to 20000 and at least 16 a seed (default 1000).",
            metavar="N",
            min=16,
            max=20_000,
        ),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option("--seeds", help="Seeds, each with images of its own (default 10).", metavar="N", min=1)
    ] = None,
    kitti: Annotated[
        Path | None, typer.Option("--kitti", help="Real streets in KITTI's layout.", metavar="DIR", exists=True)
    ] = None,
    cityscapes: Annotated[
        Path | None,
        typer.Option("--cityscapes", help="Real streets in Cityscapes' layout.", metavar="DIR", exists=True),
    ] = None,
    measured: Annotated[
        Path | None,
        typer.Option("--measured", help="Real recordings of boards, as for `bench real`.", metavar="DIR", exists=True),
    ] = None,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """The paper's tables and figures by every calibrator, as a page; cut off, the same command goes on."""
    from binocal import app as verbs
    from binocal.cli.progress import progress_on_terminal
    from binocal.experiments.options import QUICK_IMAGES, QUICK_SEEDS, ExperimentOptions

    default = (QUICK_IMAGES, QUICK_SEEDS) if quick else (1000, 10)
    given = (None if folder is None else str(folder) for folder in (kitti, cityscapes, measured))
    try:
        options = ExperimentOptions(images or default[0], seeds or default[1], seed, quick, *given)
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None
    verbs.check_experiment_folder(output, force=force)
    with progress_on_terminal() as progress:
        run = verbs.experiment(output, options, force=force, progress=progress)
    went_on = "Went on with the experiment that was cut here.\n" if run.was_resumed else ""
    present(
        run.document(), f"{went_on}Wrote {output / 'page.html'}, page.md, times.md, rows.csv and results.json", json
    )
    return FINE
