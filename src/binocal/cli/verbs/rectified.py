"""The verbs ``rectify`` and ``depth``: from a rig to rectified images and to distances."""

from __future__ import annotations

import enum
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from binocal.cli.exits import FINE
from binocal.cli.options import Force, Json, Left, Right, Threads, app, finite, parse_range, present

if TYPE_CHECKING:
    from binocal.app.rectify import RectifyOptions
    from binocal.rectification.disparity import DepthRange


class Projections(enum.StrEnum):
    """How rectified images are projected; those of :data:`binocal.cameras.epipolar_projection.PROJECTIONS`, and auto."""

    auto = "auto"
    pinhole = "pinhole"
    cylindrical = "cylindrical"
    equirectangular = "equirectangular"


Rig = Annotated[Path, typer.Argument(help="The rig: rig.json, or OpenCV's file.", metavar="RIG.JSON")]
Output = Annotated[Path, typer.Option("--output", help="Folder for the results.", metavar="DIR")]
Size = Annotated[
    str | None,
    typer.Option(
        "--size", help="Size of the rectified images (default: the left image's, or one that fits).", metavar="WxH"
    ),
]
Alpha = Annotated[
    float | None,
    typer.Option(
        "--alpha",
        help="0 zooms to where both images are covered all over, 1 shows every pixel of both.",
        metavar="A",
        min=0.0,
        max=1.0,
        callback=finite,
    ),
]
ProjectionOption = Annotated[
    Projections,
    typer.Option(
        "--projection",
        help="auto is a pinhole as long as that shows what both cameras see.",
        metavar="|".join(Projections),
    ),
]
Rows = Annotated[bool, typer.Option("--rows", help="Also draw both images with lines along matching rows.")]


@app.command()
def rectify(
    rig: Rig,
    left: Left,
    right: Right,
    output: Output,
    size: Size = None,
    alpha: Alpha = None,
    projection: ProjectionOption = Projections.auto,
    rows: Rows = False,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Rectify a rig's images: matching points come to share a row (a column, if one camera stands above the other)."""
    from binocal.app.rectify import rectify_images
    from binocal.cli import rectified as texts
    from binocal.cli.progress import progress_on_terminal
    from binocal.cli.tables import list_left_out
    from binocal.formats.rig_file import load_rig
    from binocal.output import check_output_folder

    options = _rectify_options(size, alpha, projection, rows)
    check_output_folder(output, force=force)
    given = load_rig(rig)
    with progress_on_terminal() as progress:
        run = rectify_images(given, left, right, output, options, force=force, progress=progress)
    list_left_out([(str(path), reason) for path, reason in run.ignored], (), run.notes)
    present(texts.rectify_document(given, run, output), texts.rectify_text(given, run, output), json)
    return FINE


@app.command()
def depth(
    rig: Rig,
    left: Left,
    right: Right,
    output: Output,
    range_: Annotated[
        str | None,
        typer.Option(
            "--range",
            help="Nearest and farthest distance, such as 0.5-5m (default: what a fifth of the image's width as disparity reaches).",
            metavar="NEAR-FAR",
        ),
    ] = None,
    matching_noise: Annotated[
        float | None,
        typer.Option(
            "--matching-noise",
            help="Standard deviation of a disparity, pixels (default: 0.3).",
            metavar="PX",
            min=0.0,
            callback=finite,
        ),
    ] = None,
    png_units: Annotated[
        float,
        typer.Option(
            "--png-units",
            help="Steps of the 16-bit PNG in a metre: 1000 are millimetres, up to 65 m.",
            metavar="N",
            min=1e-3,
            callback=finite,
        ),
    ] = 1000.0,
    size: Size = None,
    alpha: Alpha = None,
    projection: ProjectionOption = Projections.auto,
    rows: Rows = False,
    threads: Threads = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Measure depth: distances as 16-bit PNG and TIFF, their standard deviations, and coloured point clouds (PLY)."""
    from binocal.app.depth import MATCHING_NOISE_PX, DepthOptions, depth_document, measure_depth
    from binocal.app.natural import load_given_rig
    from binocal.cli import rectified as texts
    from binocal.cli.progress import progress_on_terminal
    from binocal.cli.tables import list_left_out
    from binocal.output import check_output_folder

    rectifying = _rectify_options(size, alpha, projection, rows)
    check_output_folder(output, force=force)
    given = load_given_rig(rig)
    distances = _parse_range(range_, given.rig.is_metric)
    noise_px = MATCHING_NOISE_PX if matching_noise is None else matching_noise
    options = DepthOptions(rectifying, distances, None, noise_px, png_units)
    with progress_on_terminal() as progress:
        run = measure_depth(given, left, right, output, options, force=force, progress=progress)
    list_left_out([(str(path), reason) for path, reason in run.ignored], (), run.notes)
    document = depth_document(given, run, options) | {"output": str(output)}
    present(document, texts.depth_text(given.rig, run, options, output), json)
    return FINE


def _rectify_options(size: str | None, alpha: float | None, projection: Projections, rows: bool) -> RectifyOptions:
    from binocal.app.rectify import RectifyOptions

    size_wh = None
    if size is not None:
        found = re.fullmatch(r"([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", size)
        if found is None:
            raise typer.BadParameter(f"--size is {size!r}; give width and height in pixels, such as 1280x720.")
        size_wh = int(found[1]), int(found[2])
    kind: Any = projection.value
    return RectifyOptions(size_wh, alpha, kind, rows)


def _parse_range(text: str | None, is_metric: bool) -> DepthRange | None:
    """The range that ``--range`` names, metres; board pitches, and without a unit, of a rig without a scale."""
    from binocal.rectification.disparity import DepthRange

    if text is None:
        return None
    near, far, has_unit = parse_range(text)
    if near == far:
        raise typer.BadParameter(f"--range {text!r}: give nearest and farthest, such as 0.5-5m.")
    if is_metric and not has_unit:
        raise typer.BadParameter(f"--range {text} needs a unit: mm, cm, m or in, such as {text}m.")
    if not is_metric and has_unit:
        raise typer.BadParameter(
            f"--range {text}: the rig has no scale; give board squares, without a unit, or calibrate with the board's size."
        )
    return DepthRange(near, far)
