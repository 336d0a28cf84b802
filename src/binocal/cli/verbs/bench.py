"""The verb ``bench``."""

from __future__ import annotations

from typing import Annotated

import typer

from binocal.cli.exits import FINE
from binocal.cli.options import Json, Seed, Threads, app, present


@app.command()
def bench(
    name: Annotated[str, typer.Argument(help="Which benchmark, such as solver.", metavar="NAME")],
    sets: Annotated[
        list[str] | None, typer.Argument(help="For real: folders, files of corners or names.", metavar="[SET]...")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="For real: three recordings, three splits.")] = False,
    seed: Seed = 0,
    threads: Threads = None,
    json: Json = False,
) -> int:
    """Measure binocal against the peers that are installed on this machine."""
    from binocal.benchmark import run

    if name != "real" and (sets or quick):
        raise typer.BadParameter(f"recordings and --quick belong to `bench real`, not to `bench {name}`.")
    try:
        table = run(name, seed=seed, **({"sets": sets or (), "quick": quick} if name == "real" else {}))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    present({key: value for key, value in table.items() if key != "text"}, table["text"], json)
    return FINE
