"""The Typer application, the options that several verbs share, and how their results are printed."""

from __future__ import annotations

import math
import re
from typing import Annotated, Any

import typer

from binocal import __version__
from binocal.cli.streams import print_document
from binocal.threads import n_threads, set_threads

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Stereo-camera calibration that measures depth and says how far the depth can be trusted.",
    epilog="Exit codes: 0 fine, 1 failure while running, 2 usage, 3 input unusable, 4 finished but below the quality "
    "asked for or the rig has changed, 130 interrupted.",
)

BOARD_HELP = (
    "The board: chessboard:9x6:30mm (inner corners), charuco:11x8:30mm:22mm:DICT_5X5_50 (squares), "
    "aprilgrid:6x6:88mm:0.3, circles:10x10:30mm, acircles:4x11:20mm, squares:4x3:30mm:30mm, puzzleboard:11x8:30mm, or a YAML file. "
    "A length without mm, cm, m or in leaves the scale unknown."
)
Left = Annotated[str, typer.Option("--left", help="Left images: a glob in quotes, or a folder.", metavar="GLOB")]
Right = Annotated[str, typer.Option("--right", help="Right images, paired with the left by name.", metavar="GLOB")]
Boards = Annotated[
    list[str] | None,
    typer.Option(
        "--board",
        help=f"{BOARD_HELP} Given again for images that show several boards, of different sizes or ids.",
        metavar="SPEC",
        show_default=False,
    ),
]
BoardSpec = Annotated[str, typer.Option("--board", help=BOARD_HELP, metavar="SPEC")]
Measured = Annotated[
    str | None,
    typer.Option(
        "--measured",
        help="What the ruler says of the printed board: A-B along its rows and A-C along its columns, such as 199.4mm,139.9mm. "
        "Chessboard, ChArUco: over all squares; AprilGrid: over all tags; circles: from centre to centre.",
        metavar="A-B,A-C",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Exactly one JSON document on stdout, on errors too.")]
Needs = Annotated[
    list[str] | None,
    typer.Option(
        "--require",
        help="A need, repeatable: 'depth 1% at 5m' (also 'with 0.25px' of matching), 'row 0.1px', 'baseline 0.02%', 'focal 0.05%', "
        "'reprojection 0.3px'. Exit with 4 unless all are proven to be met; what is not gets a plan of views that help.",
        metavar="NEED",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]


def finite(value: float | None) -> float | None:
    """A number that an option can use: typer's own limits let ``inf`` and ``nan`` pass."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is not a finite number.")
    return value


Seed = Annotated[int, typer.Option("--seed", help="Seed of everything random.", metavar="N", min=0)]


def _use_threads(n: int | None) -> None:
    """Sees to the number of threads before any work, whoever stated it."""
    if n is not None:
        set_threads(n)
    try:
        n_threads()
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None


Threads = Annotated[
    int | None,
    typer.Option(
        "--threads",
        help="Threads to use (default: BINOCAL_THREADS, or all processors that the process may use).",
        metavar="N",
        min=1,
        max=4096,
        callback=_use_threads,
        show_default=False,
    ),
]


def _print_version(is_asked: bool) -> None:
    if is_asked:
        print(f"binocal {__version__}")
        raise typer.Exit()


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and leave.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass


def present(document: dict[str, Any], text: str, as_json: bool) -> None:
    """A result on stdout, as text or as one JSON document."""
    if as_json:
        from binocal.formats.json_document import dump_json, jsonable

        print_document(dump_json(jsonable(document)))
    else:
        print(text)


def parse_range(text: str) -> tuple[float, float, bool]:
    """Nearest and farthest of a range such as 0.5-5m, and whether it has a unit; one distance is both.

    Raises:
        typer.BadParameter: It is none.
    """
    from binocal.boards.board import parse_length

    first, dash, last = text.strip().partition("-")
    unit = re.search(r"[a-z]+$", last)
    if unit and not re.search(r"[a-z]", first):
        first += unit[0]  # it stands once, at the end
    try:
        near, has_unit = parse_length(first)
        far, is_same = parse_length(last) if dash else (near, has_unit)
    except ValueError as error:
        raise typer.BadParameter(f"--range {text!r} is no range such as 0.5-5m: {error}.") from None
    if is_same != has_unit:
        raise typer.BadParameter(f"--range {text!r}: give both ends a unit, or neither.")
    if not 0 < near <= far < math.inf:
        raise typer.BadParameter(f"--range {text!r} must run from near to far, above 0.")
    return near, far, has_unit
