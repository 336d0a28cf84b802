"""The verb ``demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from binocal.cli.exits import FINE
from binocal.cli.options import Force, Json, Seed, Threads, app, present


@app.command()
def demo(
    output: Annotated[
        Path, typer.Option("--output", help="Folder for images, rig.json and truth.json.", metavar="DIR")
    ] = Path("binocal-demo"),
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Render the paper's rig with two boards, calibrate it from the images, and compare with the truth."""
    from binocal import app as verbs
    from binocal.cli import documents, tables
    from binocal.cli.progress import progress_on_terminal
    from binocal.output import check_output_folder

    check_output_folder(output, force=force)
    with progress_on_terminal() as progress:
        cases = verbs.demo(output, seed=seed, force=force, progress=progress)
    present(documents.demo_document(cases), tables.demo_text(cases, output), json)
    return FINE
