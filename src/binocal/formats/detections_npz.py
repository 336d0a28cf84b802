"""Detections in a file: the corners that a calibration was made from, so that every later step runs without the images.

A NumPy archive (``.npz``, readable with ``numpy.load``, nothing pickled) with the arrays of
:class:`binocal.evidence.Detections` under their own names, as 64-bit floats, and ``header``: UTF-8 bytes of a JSON object with
``schema``, ``version``, the views' names, image sizes (width, height), whether object points are metres, the board's SPEC where it is
known, and ``shots``, the number of each view's pair, where a pair shows several boards. Where the calibration measured the board's
shape, ``board_points_m`` and ``board_sigma_m`` hold it, and the header's ``board_shape`` its figures. The same detections give the
same bytes.
"""

from __future__ import annotations

import ast
import io
import json
import math
import operator
import struct
import warnings
import zipfile
import zlib
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.errors import DataError, FormatError
from binocal.evidence import Detections
from binocal.evidence.detections import COVARIANCES
from binocal.formats.json_document import parse_whole, shown
from binocal.input_file import check_ordinary, read_file
from binocal.output import write_aside
from binocal.result import BoardShape

SCHEMA, VERSION = "binocal/detections", 1
HEADER = "header"
ARRAYS = ("object_points_m", "left_px", "right_px")
OBJECT_SIGMA = "object_sigma_m"
SHAPE_ARRAYS = ("points_m", "sigma_m")
SHAPE_FIGURES = tuple(field.name for field in fields(BoardShape) if field.name not in SHAPE_ARRAYS)
REMEDY = "write it anew with `binocal calibrate --evidence` or binocal.write_detections"
LEAST_LIMIT_BYTES, MOST_EXPANSION = 16 << 20, 20  # corners compress by 2 at most, NaN of unseen ones by more
_ZIP_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    OSError,
    ValueError,
    OverflowError,
    LookupError,
    struct.error,
    NotImplementedError,  # a compression or a zip version that Python does not know
    RuntimeError,  # encrypted
    MemoryError,
)
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest that a zip archive can say: bytes must not depend on the clock


def write_detections(
    path: str | Path, detections: Detections, *, board_shape: BoardShape | None = None, force: bool = False
) -> None:
    """Write detections at full precision, aside and then renamed, with the board's measured shape if given.

    Raises:
        OutputExistsError: Something is there and ``force`` is False.
        DataError: The file cannot be written.
    """
    write_aside(path, detections_content(detections, board_shape), force=force)


def detections_content(detections: Detections, board_shape: BoardShape | None = None) -> bytes:
    """What :func:`write_detections` writes."""
    header = {
        "schema": SCHEMA,
        "version": VERSION,
        "names": detections.names,
        "left_size_wh": detections.left_size_wh,
        "right_size_wh": detections.right_size_wh,
        "is_metric": detections.is_metric,
        "board": detections.board_spec,
    }
    if detections.shots is not None:
        header["shots"] = detections.shots
    if board_shape is not None:
        header["board_shape"] = {name: getattr(board_shape, name) for name in SHAPE_FIGURES}
    arrays = {HEADER: np.frombuffer(json.dumps(header).encode("ascii"), dtype=np.uint8)}
    arrays |= {name: getattr(detections, name) for name in ARRAYS}
    if detections.object_sigma_m is not None:
        arrays[OBJECT_SIGMA] = detections.object_sigma_m
    arrays |= {name: value for name in COVARIANCES if (value := getattr(detections, name)) is not None}
    if board_shape is not None:
        arrays |= {f"board_{name}": getattr(board_shape, name) for name in SHAPE_ARRAYS}
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            little_endian = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
            np.lib.format.write_array(member, little_endian, version=(1, 0), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", _EPOCH), member.getvalue())
    return content.getvalue()


def read_detections(path: str | Path) -> Detections:
    """The detections that :func:`write_detections` wrote, to the last bit.

    Raises:
        FormatError: The file is missing, damaged or foreign; the text says what is wrong where, and what to do.
    """
    path = Path(path)
    members = _load(path)
    header = _parse_header(path, members)
    arrays = {name: _parse_floats(path, members, name) for name in ARRAYS}
    covariances = {name: _parse_floats(path, members, name) for name in COVARIANCES if name in members}
    try:
        return Detections(
            **arrays,
            **covariances,
            left_size_wh=_size(header, "left_size_wh"),
            right_size_wh=_size(header, "right_size_wh"),
            names=tuple(header["names"]),
            is_metric=header["is_metric"],
            board_spec=header["board"],
            object_sigma_m=_parse_floats(path, members, OBJECT_SIGMA) if OBJECT_SIGMA in members else None,
            shots=None if header.get("shots") is None else tuple(header["shots"]),
        )
    except (ValueError, DataError) as error:
        raise FormatError(path, f"holds no usable detections: {error}; {REMEDY}") from None


def read_board_shape(path: str | Path) -> BoardShape | None:
    """The board's shape that :func:`write_detections` was given; None where there is none. Raises as :func:`read_detections`."""
    path = Path(path)
    members = _load(path)
    figures = _parse_header(path, members).get("board_shape")
    if figures is None:
        return None
    if not isinstance(figures, dict) or not all(type(figures.get(name)) is float for name in SHAPE_FIGURES):
        raise FormatError(
            path, f"array '{HEADER}', key 'board_shape': expected the figures of a board's shape; {REMEDY}"
        )
    arrays = {name: _parse_floats(path, members, f"board_{name}") for name in SHAPE_ARRAYS}
    try:
        return BoardShape(**arrays, **{name: figures[name] for name in SHAPE_FIGURES})
    except ValueError as error:
        raise FormatError(path, f"holds no usable board shape: {error}; {REMEDY}") from None


def is_detections_file(path: str | Path) -> bool:
    """Whether the file says that it holds detections, of whichever version."""
    try:
        check_ordinary(path)
        with zipfile.ZipFile(path) as archive, archive.open(f"{HEADER}.npy") as member:
            return f'"{SCHEMA}"'.encode() in member.read(LEAST_LIMIT_BYTES)
    except (FormatError, *_ZIP_ERRORS):
        return False


def _load(path: Path) -> dict[str, bytes]:
    """The archive's members by the arrays' names; their checksums are checked."""
    content = read_file(path)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            if sum(entry.file_size for entry in entries) > max(LEAST_LIMIT_BYTES, MOST_EXPANSION * len(content)):
                raise ValueError(f"its arrays would fill more than {MOST_EXPANSION} times the file")
            return {entry.filename.removesuffix(".npy"): archive.read(entry) for entry in entries}
    except _ZIP_ERRORS as error:
        words = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(
            path, f"is not a whole NumPy archive ({words[:100]}); it is truncated, damaged or another file: {REMEDY}"
        ) from None


def _parse_header(path: Path, members: dict[str, bytes]) -> dict[str, Any]:
    if HEADER not in members:
        raise FormatError(path, f"array '{HEADER}' is missing: these are not binocal's detections; {REMEDY}")
    try:
        header = json.loads(bytes(_parse_array(path, members, HEADER, np.uint8)), parse_int=parse_whole)
    except (ValueError, RecursionError) as error:
        raise FormatError(path, f"array '{HEADER}' is not JSON ({str(error)[:100]}); {REMEDY}") from None
    if not isinstance(header, dict) or header.get("schema") != SCHEMA:
        raise FormatError(path, f"array '{HEADER}': expected the schema \"{SCHEMA}\"; {REMEDY}")
    if header.get("version") != VERSION:
        raise FormatError(
            path,
            f"its version is {shown(header.get('version'))}, this binocal reads {VERSION}; update binocal, or {REMEDY}",
        )
    for key, is_right, expected in (
        ("names", _is_texts(header.get("names")), "a list of texts"),
        ("left_size_wh", _is_size(header.get("left_size_wh")), "two whole numbers"),
        ("right_size_wh", _is_size(header.get("right_size_wh")), "two whole numbers"),
        ("is_metric", isinstance(header.get("is_metric"), bool), "true or false"),
        ("board", isinstance(header.get("board", 0), str | None), "a text or null"),
        ("shots", _is_wholes(header.get("shots", [])), "a list of whole numbers"),
    ):
        if not is_right:
            got = shown(header.get(key))
            raise FormatError(path, f"array '{HEADER}', key '{key}': expected {expected}, got {got}; {REMEDY}")
    return header


def _is_texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _is_wholes(value: Any) -> bool:
    return isinstance(value, list) and all(type(item) is int for item in value)


def _is_size(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(type(item) is int for item in value)


def _size(header: dict[str, Any], key: str) -> tuple[int, int]:
    width, height = header[key]
    return width, height


def _parse_floats(path: Path, members: dict[str, bytes], name: str) -> ndarray:
    return _parse_array(path, members, name, np.float64)


def _parse_array(path: Path, members: dict[str, bytes], name: str, dtype: type) -> ndarray:
    """One array of the archive; nothing is allocated that its bytes do not fill."""
    if name not in members:
        raise FormatError(path, f"array '{name}' is missing; {REMEDY}")
    member = members[name]
    length = int.from_bytes(member[8:10], "little")
    try:
        if member[:8] != b"\x93NUMPY\x01\x00":
            raise ValueError("it does not begin as one of version 1.0")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of odd escapes in a damaged header
            described = ast.literal_eval(member[10 : 10 + length].decode("latin1"))
        shape, is_fortran, found = (described[key] for key in ("shape", "fortran_order", "descr"))
        n_numbers = math.prod(operator.index(size) for size in shape)
    except (ValueError, TypeError, LookupError, SyntaxError, MemoryError, RecursionError) as error:
        words = " ".join(str(error).split())
        raise FormatError(path, f"array '{name}' is not a NumPy array ({words[:100]}); {REMEDY}") from None
    expected = np.dtype(dtype).newbyteorder("<")
    data = member[10 + length :]
    if found != expected.str or is_fortran or min(shape, default=0) < 0 or len(data) != n_numbers * expected.itemsize:
        raise FormatError(
            path,
            f"array '{name}': expected {expected.name} in C order that fills its shape {shape}, got {found} in "
            f"{len(data)} bytes; {REMEDY}",
        )
    return np.frombuffer(data, dtype=expected).reshape(shape)
