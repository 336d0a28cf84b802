"""Board specifications: the one-line SPEC and YAML files (Kalibr's target files among them)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from binocal.boards.board import Board
from binocal.errors import FormatError

_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
_EXAMPLES = (
    "chessboard:9x6:30mm (inner corners), charuco:11x8:30mm:22mm:DICT_5X5_50 (squares), aprilgrid:6x6:88mm:0.3, "
    "circles:10x10:30mm, acircles:4x11:20mm"
)


def parse_length(text: str) -> tuple[float, bool]:
    """Metres and True, or the bare number and False where no unit (mm, cm, m, in) is given."""
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(mm|cm|m|in)?\s*", text)
    if not match or float(match[1]) <= 0:
        raise ValueError(
            f"{text!r} is not a length; write a positive number with its unit (mm, cm, m, in), such as 30mm"
        )
    return float(match[1]) * _METRES.get(match[2] or "m", 1.0), match[2] is not None


def parse_board(spec: str) -> Board:
    """Board of a SPEC text; a length without a unit, or none at all, leaves the scale unknown.

    Raises:
        ValueError: The text is not a SPEC; the message shows examples.
    """
    kind, _, rest = spec.strip().partition(":")
    fields = rest.split(":") if rest else []
    size = re.fullmatch(r"(\d+)x(\d+)", fields[0]) if fields else None
    if kind not in ("chessboard", "charuco", "aprilgrid", "circles", "acircles") or not size:
        raise ValueError(f"board {spec!r} is not understood; examples: {_EXAMPLES}")
    columns, rows = int(size[1]), int(size[2])
    most = {"charuco": 4, "aprilgrid": 3}.get(kind, 2)
    if len(fields) > most:
        raise ValueError(f"board {spec!r} has too many fields; examples: {_EXAMPLES}")
    pitch_m, is_metric = parse_length(fields[1]) if len(fields) > 1 else (1.0, False)
    scale = 1.0 if is_metric else pitch_m
    pitch_m = pitch_m if is_metric else 1.0
    if kind == "charuco":
        if len(fields) != 4:
            raise ValueError(f"board {spec!r} needs square, marker and dictionary: charuco:11x8:30mm:22mm:DICT_5X5_50")
        marker_m, marker_is_metric = parse_length(fields[2])
        if marker_is_metric != is_metric:
            raise ValueError(f"board {spec!r}: give both lengths a unit, or neither")
        if not re.fullmatch(r"DICT_\w+", fields[3]):
            raise ValueError(f"board {spec!r}: {fields[3]!r} is not an ArUco dictionary such as DICT_5X5_50")
        return Board(kind, columns, rows, pitch_m, is_metric, marker_m / scale, fields[3])
    if kind == "aprilgrid":
        gap = float(fields[2]) if len(fields) > 2 else 0.3
        return Board(kind, columns, rows, pitch_m, is_metric, dictionary="tag36h11", tag_gap_ratio=gap)
    return Board(kind, columns, rows, pitch_m, is_metric)  # type: ignore[arg-type]


def format_length(length_m: float) -> str:
    """Text of a length that :func:`parse_length` reads back to the same number: millimetres where they are exact."""
    text = f"{round(length_m * 1e3, 9):g}mm"
    return text if parse_length(text)[0] == length_m else f"{length_m!r}m"


def format_board(board: Board) -> str:
    """SPEC text of a board, the inverse of :func:`parse_board`.

    Not carried, because rendering alone needs it: the circles' diameter.

    Raises:
        ValueError: The board has a first tag id or tag family that a SPEC cannot say.
    """
    spec = f"{board.kind}:{board.columns}x{board.rows}"
    if board.kind == "aprilgrid" and (board.first_tag_id != 0 or board.dictionary != "tag36h11"):
        raise ValueError("a SPEC has no place for a first tag id other than 0 or a family other than tag36h11")
    needs_length = board.is_metric or board.kind in ("charuco", "aprilgrid") or board.pitch_m != 1.0
    if needs_length:
        spec += f":{format_length(board.pitch_m) if board.is_metric else repr(board.pitch_m)}"
    if board.kind == "charuco":
        spec += f":{format_length(board.marker_m) if board.is_metric else repr(board.marker_m)}:{board.dictionary}"
    if board.kind == "aprilgrid":
        spec += f":{board.tag_gap_ratio!r}"
    return spec


def load_board(spec_or_path: str) -> Board:
    """Board of a SPEC text, or of a YAML file: Kalibr's target file, or one with a single key ``board: SPEC``.

    Raises:
        ValueError: The text is neither a SPEC nor an existing file.
        FormatError: The file is not a board.
    """
    path = Path(spec_or_path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        return parse_board(spec_or_path)
    import yaml

    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FormatError(path, "no such board file") from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise FormatError(path, f"cannot be read as YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, Mapping):
        raise FormatError(path, "is not a board: expected `board: SPEC` or a Kalibr target")
    try:
        return parse_board(str(content["board"])) if "board" in content else _parse_kalibr_target(content)
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(
            path, f"is not a board: {error if not isinstance(error, KeyError) else f'{error} is missing'}"
        ) from None


def _parse_kalibr_target(target: Mapping[str, Any]) -> Board:
    """Kalibr's target: lengths are metres; checkerboards count inner corners; ``tagSpacing`` is gap over side."""
    kind = target["target_type"]
    if kind == "aprilgrid":
        return Board(
            "aprilgrid",
            int(target["tagCols"]),
            int(target["tagRows"]),
            float(target["tagSize"]),
            dictionary="tag36h11",
            tag_gap_ratio=float(target["tagSpacing"]),
        )
    columns, rows = int(target["targetCols"]), int(target["targetRows"])
    if kind == "checkerboard":
        across, along = float(target["colSpacingMeters"]), float(target["rowSpacingMeters"])
        if abs(across - along) > 1e-9 * along:
            raise ValueError("rowSpacingMeters and colSpacingMeters differ; only square fields are supported")
        return Board("chessboard", columns, rows, along)
    if kind == "circlegrid":
        is_staggered = bool(target.get("asymmetricGrid", False))
        return Board("acircles" if is_staggered else "circles", columns, rows, float(target["spacingMeters"]))
    raise ValueError(f"target_type {kind!r} is not aprilgrid, checkerboard or circlegrid")
