"""What the texts of options mean: boards, lengths, needs, numbers of pixels; each refused in the option's own words."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import typer


def parse_board(spec: str) -> Any:
    """The board of a SPEC or a target file."""
    from binocal.boards import load_board

    try:
        return load_board(spec)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def parse_boards(specs: list[str]) -> Any:
    """The board of one ``--board``, or the set of several."""
    from binocal.boards import BoardSet

    boards = tuple(parse_board(spec) for spec in specs)
    if len(boards) == 1:
        return boards[0]
    try:
        return BoardSet(boards)
    except ValueError as error:
        raise typer.BadParameter(f"--board: {error}.") from None


def only_board(parsed: Any, option: str) -> Any:
    """The board, where one is given and an option is about one.

    Raises:
        typer.BadParameter: Several are given.
    """
    from binocal.boards import BoardSet

    if isinstance(parsed, BoardSet):
        raise typer.BadParameter(f"{option} is about one board; give --board once.")
    return parsed


def parse_length(text: str | None) -> float | None:
    """Metres of a length with its unit."""
    if text is None:
        return None
    from binocal.app.natural import LEAST_BASELINE_M, MOST_BASELINE_M
    from binocal.boards.board import parse_length

    try:
        length_m, is_metric = parse_length(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    if not is_metric:
        raise typer.BadParameter(f"--baseline {text} needs a unit: mm, cm, m or in.")
    if not LEAST_BASELINE_M <= length_m <= MOST_BASELINE_M:
        raise typer.BadParameter(f"--baseline {text}: the cameras of a rig stand 1 mm to 100 m apart.")
    return length_m


def parse_measured(text: str | None, board: Any) -> tuple[Any, tuple[float, float] | None]:
    """The board, with a scale if it had none, and the two distances of ``--measured``, metres.

    Distances far from the board's own are refused before its images are read.
    """
    if text is None:
        return board, None
    from binocal.boards import measured

    board = only_board(board, "--measured")
    try:
        measured_m = measured.parse_measured(text)
        if board is not None:
            board, _ = measured.board_as_measured(board, measured_m)
    except ValueError as error:
        raise typer.BadParameter(f"--measured: {error}") from None
    return board, measured_m


def parse_known_length(text: str) -> Any:
    """``PAIR:X1,Y1:X2,Y2=LENGTH``, the length perhaps with what it is uncertain by: ``1.500m+-2mm``."""
    import numpy as np

    from binocal.app.known_lengths import KnownLength
    from binocal.boards.board import parse_length

    places, _, said = text.rpartition("=")
    pair, *parts = places.rsplit(":", 2)
    length, plus, uncertain = said.replace("±", "+-").partition("+-")
    try:
        ends = np.array([[float(value) for value in part.split(",")] for part in parts])
    except ValueError:
        ends = np.empty((0, 2))
    if ends.shape != (2, 2) or not np.isfinite(ends).all() or not pair.strip():
        raise typer.BadParameter(
            f"--known-length {text!r} is not understood: write PAIR:X1,Y1:X2,Y2=LENGTH, such as 0:120.5,300:410,298.7=1.50m"
        )
    try:
        lengths = [parse_length(part) for part in ((length, uncertain) if plus else (length,))]
    except ValueError as error:
        raise typer.BadParameter(f"--known-length {text}: {error}") from None
    if not all(is_metric for _, is_metric in lengths):
        raise typer.BadParameter(f"--known-length {text} needs a unit: mm, cm, m or in.")
    if (ends[0] == ends[1]).all():
        raise typer.BadParameter(f"--known-length {text}: its ends are one point.")
    return KnownLength(pair.strip(), ends, *(value for value, _ in lengths))


def parse_pixels(option: str, text: str) -> float:
    """Pixels with or without their unit."""
    try:
        value = float(text.strip().removesuffix("px"))
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise typer.BadParameter(f"{option} {text!r} is not a number of pixels such as 0.25px.")
    return value


def parse_needs(texts: list[str] | None, *, is_metric: bool | None) -> Any:
    """The requirements of ``--require``; none where it is not given, and then nothing is loaded for it."""
    if not texts:
        return ()
    from binocal.cli.needs import parse_needs

    return parse_needs(texts, is_metric=is_metric)


def one_of(option: str, value: str, known: tuple[str, ...]) -> str:
    """The value itself, where the option knows it."""
    if value not in known:
        raise typer.BadParameter(f"{option} is {value!r}; known: {', '.join(known)}")
    return value


def check_distinct(outputs: dict[str, list[Path]]) -> None:
    """Two options that name one file would write one result over the other."""
    option_of: dict[str, str] = {}
    for option, paths in outputs.items():
        for path in paths:
            other = option_of.setdefault(os.path.normcase(os.path.realpath(path)), option)
            if other != option:
                raise typer.BadParameter(f"{option} and {other} name the same file.")


def check_calibrator(name: str, known: Collection[str], load: Callable[[str], object]) -> None:
    """A calibrator's name is known, or a file of weights that can be loaded: read before any image is."""
    if name in known:
        return
    try:
        load(name)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
