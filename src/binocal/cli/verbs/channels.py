"""The verb ``channels``: corners in each colour, the lens's aberration between colours, and what a channel is worth."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from binocal.cli.arguments import check_calibrator, parse_board
from binocal.cli.exits import FINE
from binocal.cli.options import BoardSpec, Json, Left, Right, Threads, app, present
from binocal.cli.verbs.calibrate import MODELS, Model

if TYPE_CHECKING:
    from binocal.app import ChannelStudy


@app.command()
def channels(
    left: Left,
    right: Right,
    board: BoardSpec,
    model: Annotated[Model, typer.Option("--model", help="Camera model.", metavar=MODELS)] = Model.auto,
    calibrator: Annotated[str, typer.Option("--calibrator", help="What solves.", metavar="NAME")] = "lm",
    threads: Threads = None,
    json: Json = False,
) -> int:
    """Measure corners of colour images in every channel: chromatic aberration, and which channel calibrates best."""
    from binocal import app as verbs
    from binocal.calibrators import CALIBRATORS, load_calibrator
    from binocal.cli.progress import progress_on_terminal
    from binocal.cli.tables import list_left_out

    parsed = parse_board(board)
    check_calibrator(calibrator, CALIBRATORS, load_calibrator)
    with progress_on_terminal() as progress:
        request = verbs.CalibrationRequest(model.value)
        study = verbs.study_channels(left, right, parsed, request, calibrator=calibrator, progress=progress)
    list_left_out(study.ignored, (), ())
    present(_document(study), _text(study), json)
    return FINE


def _document(study: ChannelStudy) -> dict[str, Any]:
    best = study.best
    return {
        "channels": [asdict(row) | {"held_out_px": row.held_out_px} for row in study.rows],
        "aberration": [
            {
                "camera": side,
                "colour": colour,
                "against": "green",
                "fit": None if fit is None else asdict(fit),
                "is_seen": fit is not None and fit.is_seen,
            }
            for (side, colour), fit in study.aberrations.items()
        ],
        "best": None if best is None else best.channel,
    }


def _text(study: ChannelStudy) -> str:
    lines = [
        f"{'channel':8s}{'views':>6s}{'corners':>9s}{'RMS px':>9s}{'noise px':>10s}{'baseline':>11s}{'held-out rows':>15s}"
    ]
    for row in study.rows:
        if not math.isfinite(row.rms_px):
            lines.append(f"{row.channel:8s}{row.n_views:6d}{row.n_corners:9d}  no rig: {row.problem}")
            continue
        figures = f"{row.rms_px:9.4f}{row.noise_px:10.4f}{100 * row.baseline_sigma:9.4f} %"
        held_out = f"{row.held_out_px:12.4f} px" if math.isfinite(row.held_out_px) else f"{'no halves':>15s}"
        lines.append(f"{row.channel:8s}{row.n_views:6d}{row.n_corners:9d}{figures}{held_out}")
    lines += [
        "",
        "Lateral chromatic aberration against green, px (outward; at the farthest corners seen, in the image's corner):",
    ]
    for (side, colour), fit in study.aberrations.items():
        if fit is None:
            lines.append(f"  {side:6s}{colour:6s}too few corners in common")
            continue
        edge = f"{fit.at_edge_px:+.3f} ± {fit.at_edge_sigma_px:.3f} at {fit.edge_px:.0f} px"
        corner = f"{fit.at_corner_px:+.3f} ± {fit.at_corner_sigma_px:.3f} in the corner"
        lines.append(f"  {side:6s}{colour:6s}{edge}, {corner}{'' if fit.is_seen else '; none that is proven'}")
    return "\n".join([*lines, "", _advice(study)])


def _advice(study: ChannelStudy) -> str:
    best = study.best
    if best is None:
        return "No channel gave a rig from each half of the views, so none can be preferred."
    grey = next(row for row in study.rows if row.channel == "grey")
    if best.channel == "grey":
        return "Grey serves as well as any: no colour's rows of views left out are clearly better."
    if not math.isfinite(grey.held_out_px):
        return f"Use --channel {best.channel}: grey gave no rig from each half of the views."
    gain = 100 * (1 - best.held_out_px / grey.held_out_px)
    halves = f"{best.n_better(grey)} of {len(grey.halves_px)} halves"
    return (
        f"Use --channel {best.channel}: its rows of views left out miss by {gain:.0f} % less than grey's, in {halves}."
    )
