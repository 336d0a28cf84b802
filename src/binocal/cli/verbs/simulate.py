"""The verb ``simulate``: images or corners with their exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from binocal.cli.arguments import one_of, parse_board
from binocal.cli.exits import FINE
from binocal.cli.options import BOARD_HELP, Force, Json, Seed, Threads, app, finite, present

MOST_ABERRATION_PX = 20.0
MOST_BLUR_PX = 100.0  # of the lens of a simulation; the filter's length grows with it


TURNING, ZOOM = "turning", "zoom"


@app.command()
def simulate(
    pairs: Annotated[int, typer.Option("--pairs", help="Number of image pairs.", metavar="N", min=1, max=1_000_000)],
    output: Annotated[Path, typer.Option("--output", help="Folder for the images and truth.json.", metavar="DIR")],
    rig: Annotated[
        str,
        typer.Option(
            "--rig",
            help="table2 (the paper's rig), colour-thermal, thermal-180, thermal-210, a rig.json, OpenCV's file; zoom: N pairs at "
            "each of 13 settings; turning: cameras that turn before a rectangle, without --board.",
            metavar="NAME",
        ),
    ] = "table2",
    blur: Annotated[
        float,
        typer.Option(
            "--blur",
            help="Blur of the lens, sigma in pixels.",
            metavar="PX",
            min=0.0,
            max=MOST_BLUR_PX,
            callback=finite,
        ),
    ] = 0.8,
    noise: Annotated[
        float,
        typer.Option(
            "--noise", help="Sensor noise, grey levels of 255.", metavar="DN", min=0.0, max=255.0, callback=finite
        ),
    ] = 3.0,
    board: Annotated[str | None, typer.Option("--board", help=BOARD_HELP, metavar="SPEC")] = None,
    scene: Annotated[
        str | None, typer.Option("--scene", help="In place of a board: street or room.", metavar="NAME")
    ] = None,
    gap: Annotated[
        float,
        typer.Option(
            "--gap",
            help="For scenes: the right camera exposes so many milliseconds later.",
            metavar="MS",
            min=-1e4,
            max=1e4,
            callback=finite,
        ),
    ] = 0.0,
    aberration: Annotated[
        float,
        typer.Option(
            "--aberration",
            help="For boards: colour images in whose corners red lies so far outward, and blue inward.",
            metavar="PX",
            min=-MOST_ABERRATION_PX,
            max=MOST_ABERRATION_PX,
            callback=finite,
        ),
    ] = 0.0,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Render images of a board, a street or a room as a rig sees it, with the exact truth beside them."""
    from binocal import app as verbs
    from binocal.cli.progress import progress_on_terminal
    from binocal.formats import rig_json
    from binocal.output import check_output_folder
    from binocal.values import counted

    if aberration and rig in (ZOOM, TURNING):
        raise typer.BadParameter(f"--aberration does not go with --rig {rig}.")
    if rig == ZOOM:
        return _simulate_zoom(pairs, output, (board, scene), (blur, noise, seed), force, json)
    if rig == TURNING:
        return _simulate_turning(pairs, output, (board, scene), seed, force, json)
    if (board is None) == (scene is None):
        raise typer.BadParameter("give either --board SPEC or --scene street|room.")
    if gap and scene is None:
        raise typer.BadParameter("--gap belongs to --scene: boards stand still.")
    if aberration and board is None:
        raise typer.BadParameter("--aberration belongs to --board: scenes are grey.")
    parsed = None if board is None else parse_board(board)
    if parsed is not None and not parsed.is_metric:
        raise typer.BadParameter("a simulated board needs its size: give the length a unit, such as 20mm.")
    if scene is not None:
        one_of("--scene", scene, ("street", "room"))
    check_output_folder(output, force=force)
    from binocal.formats.rig_file import load_rig
    from binocal.simulation import SETUPS, Setup

    setup = SETUPS[rig]() if rig in SETUPS else Setup(load_rig(rig))
    options = verbs.SimulateOptions(blur, noise, seed, 1e-3 * gap, setup.light, aberration)
    with progress_on_terminal() as progress:
        if parsed is not None:
            truth = verbs.simulate(setup.rig, parsed, pairs, output, options, force=force, progress=progress)
        else:
            truth = verbs.simulate_scene(setup.rig, str(scene), pairs, output, options, force=force, progress=progress)
    text = f"{counted(len(truth.names), 'pair')} and truth.json in {output}"
    present(rig_json.truth_document(truth) | {"output": str(output)}, text, json)
    return FINE


def _simulate_zoom(
    pairs: int,
    output: Path,
    shown: tuple[str | None, str | None],
    look: tuple[float, float, int],
    force: bool,
    json: bool,
) -> int:
    """A pair with zoom lenses at several settings."""
    from binocal import app as verbs
    from binocal.cli.progress import progress_on_terminal
    from binocal.output import check_output_folder

    board, scene = shown
    if board is None or scene is not None:
        raise typer.BadParameter(f"--rig {ZOOM} shows a board: give --board SPEC, and no --scene.")
    parsed = parse_board(board)
    if not parsed.is_metric:
        raise typer.BadParameter("a simulated board needs its size: give the length a unit, such as 20mm.")
    check_output_folder(output, force=force)
    with progress_on_terminal() as progress:
        options = verbs.SimulateOptions(*look)
        settings = verbs.simulate_zoom(parsed, pairs, output, options, force=force, progress=progress)
    text = f"{pairs} pairs at each of {len(settings)} zoom settings and settings.csv in {output}"
    present({"settings": list(settings), "pairs": pairs, "output": str(output)}, text, json)
    return FINE


def _simulate_turning(
    pairs: int, output: Path, shown: tuple[str | None, str | None], seed: int, force: bool, json: bool
) -> int:
    """Cameras that turn before a rectangle."""
    from binocal import app as verbs
    from binocal.formats import rig_json
    from binocal.output import check_output_folder
    from binocal.values import counted

    if shown != (None, None):
        raise typer.BadParameter(f"--rig {TURNING} shows a rectangle; leave out --board and --scene.")
    check_output_folder(output, force=force)
    truth = verbs.simulate_turning_cameras(pairs, output, seed=seed, force=force)
    text = f"corners.npz of {counted(len(truth.names), 'pair')}, rig.json from before the cameras turned, and truth.json in {output}"
    present(rig_json.truth_document(truth) | {"output": str(output)}, text, json)
    return FINE
