"""Board files: one with a SPEC, and Kalibr's targets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from binocal.boards.board import Board, parse_board
from binocal.errors import FormatError


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
