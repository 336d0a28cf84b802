"""The verbs that need no board: ``recalibrate``, ``check`` and ``vanishing-points``."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated, Any

import typer

from binocal.cli.arguments import check_calibrator, parse_known_length, parse_length
from binocal.cli.exits import BELOW_QUALITY, FINE
from binocal.cli.options import Force, Json, Seed, Threads, app, finite, present

Dataset = Annotated[
    str | None,
    typer.Option(
        "--dataset",
        help="Pairs and cameras of a data set as it is unpacked, in place of --left and --right: kitti:PATH, cityscapes:PATH, "
        "euroc:PATH, middlebury:PATH; or folder:PATH with --rig.",
        metavar="KIND:PATH",
    ),
]


RigOf = Annotated[
    str | None,
    typer.Option(
        "--rig-of",
        help="Of a data set with several calibrations, that of this pair (its name, or how that begins); else that of --rig, "
        "or of most pairs.",
        metavar="FRAME",
    ),
]


SomeLeft = Annotated[
    str | None, typer.Option("--left", help="Left images: a glob in quotes, or a folder.", metavar="GLOB")
]


SomeRight = Annotated[
    str | None, typer.Option("--right", help="Right images, paired with the left by name.", metavar="GLOB")
]


OldRig = Annotated[
    Path | None,
    typer.Option(
        "--rig", help="The rig whose cameras took the images: rig.json, or OpenCV's file.", metavar="RIG.JSON"
    ),
]


MaxPairs = Annotated[
    int | None,
    typer.Option(
        "--max-pairs",
        help="Use the N pairs that tell most, of twelve times as many glanced at; 8 unless given.",
        metavar="N",
        min=1,
    ),
]


class Starts(enum.StrEnum):
    """Whether the old rig's pose is known."""

    rig = "rig"
    none = "none"


@app.command()
def recalibrate(
    left: SomeLeft = None,
    right: SomeRight = None,
    dataset: Dataset = None,
    rig_of: RigOf = None,
    rig: OldRig = None,
    output: Annotated[Path, typer.Option("--output", help="Where the rig goes.", metavar="RIG.JSON")] = Path(
        "new.json"
    ),
    start: Annotated[
        Starts,
        typer.Option("--start", help="rig: its pose is nearly right; none: only its cameras are.", metavar="rig|none"),
    ] = Starts.rig,
    baseline: Annotated[
        str | None,
        typer.Option(
            "--baseline", help="Distance of the cameras, such as 120mm; default: the old rig's.", metavar="LENGTH"
        ),
    ] = None,
    known_length: Annotated[
        list[str] | None,
        typer.Option(
            "--known-length",
            help="A length in the scene that gives the cameras' distance: pair (name, or number from 0), both ends in its left image, "
            "and the length, such as 0:120.5,300:410,298.7=1.50m (perhaps +-2mm); may be repeated.",
            metavar="PAIR:X,Y:X,Y=LENGTH",
        ),
    ] = None,
    calibrator: Annotated[
        str,
        typer.Option(
            "--calibrator",
            help="From the old rig: drl (agent and schedules), portfolio (schedules), lm (one schedule), or weights.",
            metavar="NAME",
        ),
    ] = "drl",
    reference: Annotated[
        bool,
        typer.Option("--reference", help="Write the rig as given, with this result as what `check` compares with."),
    ] = False,
    max_pairs: MaxPairs = None,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Find rotation and direction of translation anew from images without a board, intrinsics held."""
    from binocal.app import natural
    from binocal.calibrators.natural_solves import NATURAL_CALIBRATORS, solves_of
    from binocal.cli import natural as texts
    from binocal.cli.progress import progress_on_terminal
    from binocal.formats import rig_json
    from binocal.output import check_output

    length_m, lengths = parse_length(baseline), tuple(parse_known_length(text) for text in known_length or ())
    if lengths and baseline is not None:
        raise typer.BadParameter("--baseline and --known-length both give the length: leave one out.")
    if reference and (lengths or baseline is not None):
        option = "--known-length" if lengths else "--baseline"
        raise typer.BadParameter(f"--reference writes the rig as given, whose length stays: leave out {option}.")
    check_calibrator(calibrator, NATURAL_CALIBRATORS, solves_of)
    check_output(output, force=force)
    given, source = _natural_source(left, right, dataset, rig, rig_of)
    with progress_on_terminal() as progress:
        options = natural.NaturalOptions(
            start is Starts.rig,
            length_m,
            max_pairs or natural.MAX_PAIRS,
            seed,
            progress,
            calibrator=calibrator,
            known_lengths=lengths,
        )
        run = natural.recalibrate(source, options)
    written = run.calibration
    if reference:
        written = natural.with_reference(given or natural.as_given(source.rig, source.length_from), run)
    rig_json.write_calibration(output, written, force=force)
    kept = ", the rig as given with this result as its reference" if reference else ""
    present(texts.run_document(run, output=str(output)), texts.recalibrate_text(run, output, kept), json)
    return FINE


@app.command()
def check(
    left: SomeLeft = None,
    right: SomeRight = None,
    dataset: Dataset = None,
    rig_of: RigOf = None,
    rig: OldRig = None,
    stream: Annotated[
        bool,
        typer.Option(
            "--stream", help="Watch the rig over all pairs, in their order: drift per hour, and jumps by pair."
        ),
    ] = False,
    every: Annotated[
        int | None,
        typer.Option("--every", help="With --stream: N pairs in a row are one measurement.", metavar="N", min=1),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            "--fps",
            help="With --stream: pairs per second, in place of the times that the images have.",
            metavar="F",
            callback=finite,
        ),
    ] = None,
    max_pairs: MaxPairs = None,
    seed: Seed = 0,
    threads: Threads = None,
    json: Json = False,
) -> int:
    """Say from images without a board whether a rig is still calibrated; exit code 4 if it has drifted."""
    from binocal.app import natural
    from binocal.cli import natural as texts
    from binocal.cli.progress import progress_on_terminal

    if not stream and (every is not None or fps is not None):
        raise typer.BadParameter("--every and --fps belong to --stream.")
    if stream and max_pairs is not None:
        raise typer.BadParameter("--stream takes every pair; leave out --max-pairs.")
    if fps is not None and fps <= 0:
        raise typer.BadParameter(f"--fps is {fps:g}; give pairs per second, such as 10.")
    _, source = _natural_source(left, right, dataset, rig, rig_of)
    if stream:
        return _check_stream(source, every or 1, fps, seed, json)
    with progress_on_terminal() as progress:
        run = natural.recalibrate(
            source, natural.NaturalOptions(max_pairs=max_pairs or natural.MAX_PAIRS, seed=seed, progress=progress)
        )
    present(texts.check_document(run), texts.check_text(run), json)
    return BELOW_QUALITY if run.has_drifted else FINE


class Sides(enum.StrEnum):
    """Which camera of a rig."""

    left = "left"
    right = "right"


@app.command("vanishing-points")
def vanishing_points(
    images: Annotated[
        str, typer.Option("--images", help="Images of one camera: a glob in quotes, a folder, a file.", metavar="GLOB")
    ],
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig",
            help="A rig whose camera took them: its lens is taken out, its values are checked.",
            metavar="RIG.JSON",
        ),
    ] = None,
    side: Annotated[
        Sides, typer.Option("--side", help="Which camera of the rig took the images.", metavar="left|right")
    ] = Sides.left,
    right_angles: Annotated[
        bool,
        typer.Option(
            "--right-angles",
            help="Two families of one image are known to be at right angles: a third or a turned view need not check it.",
        ),
    ] = False,
    max_images: Annotated[
        int, typer.Option("--max-images", help="Use at most N images, evenly chosen.", metavar="N", min=1)
    ] = 20,
    seed: Seed = 0,
    threads: Threads = None,
    json: Json = False,
) -> int:
    """Find focal length and principal point from straight lines of streets and rooms, or check a rig's; exit code 4 if they contradict it."""
    from binocal.app import scene_lines
    from binocal.app.natural import load_given_rig
    from binocal.cli import scene_lines as texts
    from binocal.cli.progress import progress_on_terminal
    from binocal.cli.tables import list_left_out

    given = None if rig is None else load_given_rig(rig)
    with progress_on_terminal() as progress:
        options = scene_lines.SceneOptions(right_angles, max_images, seed, progress)
        run = scene_lines.calibrate_scene(images, options, rig=given, side=side.value)
    list_left_out([(str(path), reason) for path, reason in run.ignored], (), ())
    present(texts.scene_document(run), texts.scene_text(run), json)
    return FINE if run.check is None or run.check.agrees else BELOW_QUALITY


def _check_stream(source: Any, every: int, fps: float | None, seed: int, json: bool) -> int:
    from binocal.app.stream import StreamOptions, check_stream
    from binocal.cli import stream as texts
    from binocal.cli.progress import progress_on_terminal

    with progress_on_terminal() as progress:
        run = check_stream(source, StreamOptions(every, fps, seed, progress))
    present(texts.stream_document(run), texts.stream_text(run), json)
    return BELOW_QUALITY if run.has_drifted else FINE


def _natural_source(
    left: str | None, right: str | None, dataset: str | None, rig: Path | None, rig_of: str | None
) -> Any:
    """The calibration of ``--rig``, None where a data set brings its own, and the pairs with their rig."""
    from binocal.app import natural

    if (dataset is None) == (left is None and right is None) or (left is None) != (right is None):
        raise typer.BadParameter("give either --dataset, or --left and --right together.")
    if rig_of is not None and dataset is None:
        raise typer.BadParameter("--rig-of chooses among the calibrations of a --dataset.")
    given = None if rig is None else natural.load_given_rig(rig)
    if dataset is not None:
        return given, natural.source_of_dataset(dataset, given, rig_of)
    if given is None:
        raise typer.BadParameter("images alone do not say what cameras took them: give --rig.")
    return given, natural.source_of_images(str(left), str(right), given)
