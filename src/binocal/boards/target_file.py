"""Board files: one with a SPEC, and Kalibr's targets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from binocal.boards.board import Board, parse_board
from binocal.errors import FormatError
from binocal.input_file import check_ordinary, exists, read_text
from binocal.yaml_text import parse_yaml

MOST_BYTES = 64 << 10  # a target file has ten lines


def load_board(spec_or_path: str) -> Board:
    """Board of a SPEC text, or of a YAML file: Kalibr's target file, or one with a single key ``board: SPEC``.

    Raises:
        ValueError: The text is neither a SPEC nor an existing file.
        FormatError: The file is not a board, or has another suffix.
    """
    path = Path(spec_or_path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        if ":" not in spec_or_path and exists(path):
            check_ordinary(path)
            raise FormatError(path, "is no board file: those end in .yaml or .yml")
        return parse_board(spec_or_path)
    text = read_text(path, most_bytes=MOST_BYTES)
    try:
        content = parse_yaml(text)
    except ValueError as error:
        raise FormatError(path, f"cannot be read as YAML: {error}") from None
    if not isinstance(content, Mapping):
        raise FormatError(path, "is not a board: expected `board: SPEC` or a Kalibr target")
    try:
        return parse_board(str(content["board"])) if "board" in content else _parse_kalibr_target(content)
    except (KeyError, ValueError) as error:
        raise FormatError(
            path, f"is not a board: {error if not isinstance(error, KeyError) else f'{error} is missing'}"
        ) from None


def _parse_kalibr_target(target: Mapping[str, Any]) -> Board:
    """Kalibr's target: lengths are metres; checkerboards count inner corners; ``tagSpacing`` is gap over side."""
    kind = target["target_type"]
    if kind not in ("aprilgrid", "checkerboard", "circlegrid"):
        raise ValueError(f"target_type {str(kind)[:40]!r} is not aprilgrid, checkerboard or circlegrid")
    if kind == "aprilgrid":
        return Board(
            "aprilgrid",
            _count(target, "tagCols"),
            _count(target, "tagRows"),
            _number(target, "tagSize"),
            dictionary=_tag_family(target),
            tag_gap_ratio=_number(target, "tagSpacing"),
            first_tag_id=_first_id(target),
        )
    columns, rows = _count(target, "targetCols"), _count(target, "targetRows")
    if kind == "checkerboard":
        across, along = _number(target, "colSpacingMeters"), _number(target, "rowSpacingMeters")
        if abs(across - along) > 1e-9 * along:
            raise ValueError("rowSpacingMeters and colSpacingMeters differ; only square fields are supported")
        return Board("chessboard", columns, rows, along)
    is_staggered = target.get("asymmetricGrid", False)
    if not isinstance(is_staggered, (bool, int)):
        raise ValueError(f"asymmetricGrid must be true or false; got {_shown(is_staggered)}")
    return Board("acircles" if is_staggered else "circles", columns, rows, _number(target, "spacingMeters"))


def format_kalibr_target(board: Board) -> str:
    """The text of Kalibr's target file for a board; :func:`load_board` reads it back to the same board.

    Raises:
        ValueError: Kalibr has no such boards, or the board has no scale.
    """
    if board.kind == "charuco":
        raise ValueError("Kalibr knows no ChArUco boards")
    if board.kind == "puzzleboard":
        raise ValueError("Kalibr knows no PuzzleBoards")
    if board.kind == "squares":
        raise ValueError("Kalibr knows no square grids")
    if board.is_marked:
        raise ValueError("Kalibr knows no marked chessboards")
    if board.circle_style:
        raise ValueError("Kalibr knows circle grids of plain discs alone")
    if not board.is_metric:
        raise ValueError("a target of Kalibr has its lengths in metres: give the board's a unit, such as 20mm")
    if board.kind == "aprilgrid":
        lines: dict[str, object] = {"tagCols": board.columns, "tagRows": board.rows}
        lines |= {"tagSize": board.pitch_m, "tagSpacing": board.tag_gap_ratio}
        # Kalibr itself knows neither: its tags are of tag36h11, from id 0 on.
        if (family := board.dictionary or "tag36h11") != "tag36h11":
            lines["tagFamily"] = family
        if board.first_tag_id:
            lines["startId"] = board.first_tag_id
    else:
        lines = {"targetCols": board.columns, "targetRows": board.rows}
        if board.kind == "chessboard":
            lines |= {"rowSpacingMeters": board.pitch_m, "colSpacingMeters": board.pitch_m}
        else:
            lines |= {"spacingMeters": board.pitch_m, "asymmetricGrid": board.kind == "acircles"}
    kind = {"aprilgrid": "aprilgrid", "chessboard": "checkerboard"}.get(board.kind, "circlegrid")
    return "".join(f"{key}: {value!r}\n" for key, value in {"target_type": kind, **lines}.items())


def _tag_family(target: Mapping[str, Any]) -> str:
    """``tagFamily``, as 36h11 or tag36h11; Kalibr's own files have none."""
    name = str(target.get("tagFamily", "tag36h11"))
    return name if name.startswith("tag") else f"tag{name}"


def _first_id(target: Mapping[str, Any]) -> int:
    """``startId``; Kalibr's own files have none."""
    value = target.get("startId", 0)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"startId must be a whole number from 0 on; got {str(value)[:40]!r}")
    return value


def _count(target: Mapping[str, Any], key: str) -> int:
    """A whole number of tags, corners or circles."""
    value = target[key]
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{key} must be a whole number; got {_shown(value)}")
    return value


def _number(target: Mapping[str, Any], key: str) -> float:
    """A finite positive number: a length in metres, or a ratio."""
    value = target[key]
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # YAML takes 3e-2 for a text
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not 0 < number < math.inf:
        raise ValueError(f"{key} must be a positive number; got {_shown(value)}")
    return number


def _shown(value: object) -> str:
    """A value as it stands in the file, cut where it is long: a text in quotes, for '6' is none of the numbers."""
    text = str(value)[:40]
    return f"the text {text!r}" if isinstance(value, str) else text
