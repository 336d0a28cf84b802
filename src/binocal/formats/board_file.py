"""A board that an earlier calibration measured, from the file which that calibration wrote."""

from __future__ import annotations

from pathlib import Path

from binocal.errors import FormatError
from binocal.formats.detections_npz import is_detections_file, read_board_shape
from binocal.formats.json_document import load_document
from binocal.formats.rig_json import SCHEMA, parse_board_shape
from binocal.result import BoardShape


def read_measured_board(path: str | Path) -> BoardShape:
    """The board's shape in a ``rig.json``, or in the corners that ``--evidence`` kept.

    Raises:
        FormatError: The file cannot be read, or holds no board that was measured.
    """
    path = Path(path)
    shape = read_board_shape(path) if is_detections_file(path) else parse_board_shape(load_document(path, SCHEMA))
    if shape is None:
        raise FormatError(path, "holds no measured board: that calibration found it as drawn; leave out --board-file")
    return shape
