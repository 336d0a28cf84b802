"""Rectangles that turning cameras saw, in a file: a NumPy archive that anybody can write with ``numpy.savez``.

Arrays ``left_px`` and ``right_px`` (pairs, 4, 2), ``left_attitude_deg`` and ``right_attitude_deg`` (pairs, 2) as yaw and pitch,
``attitude_sigma_deg`` (one number, or one per pair; 0 where the cameras stand as in the initial rig), and, if pairs show more than one
rectangle, ``rectangle`` (pairs,): whole numbers, one per rectangle. See :class:`binocal.evidence.rectangles.RectanglePairs`.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
from numpy import ndarray

from binocal.errors import DataError, FormatError
from binocal.evidence.rectangles import RectanglePairs
from binocal.input_file import read_file
from binocal.output import write_aside

ARRAYS = ("left_px", "right_px", "left_attitude_deg", "right_attitude_deg", "attitude_sigma_deg")
MOST_BYTES = 1 << 28
REMEDY = f"write it with numpy.savez: {', '.join(ARRAYS)}, and rectangle where there are several"


def write_rectangles(path: str | Path, pairs: RectanglePairs, *, force: bool = False) -> None:
    """Write the pairs, aside and then renamed.

    Raises:
        OutputExistsError: Something is there and ``force`` is False.
    """
    content = io.BytesIO()
    np.savez(
        content,
        left_px=pairs.left_px,
        right_px=pairs.right_px,
        left_attitude_deg=np.degrees(pairs.left_attitude_rad),
        right_attitude_deg=np.degrees(pairs.right_attitude_rad),
        attitude_sigma_deg=np.degrees(pairs.attitude_sigma_rad),
        rectangle=pairs.rectangle,
    )
    write_aside(path, content.getvalue(), force=force)


def read_rectangles(path: str | Path) -> RectanglePairs:
    """The pairs of a file.

    Raises:
        FormatError: The file is missing, damaged, or lacks an array; the text says which, and what to do.
    """
    path = Path(path)
    arrays = _arrays(path)
    missing = [name for name in ARRAYS if name not in arrays]
    if missing:
        raise FormatError(path, f"has no array {missing[0]!r}: these are no rectangles of turning cameras; {REMEDY}.")
    n = len(arrays["left_px"]) if arrays["left_px"].ndim else 0
    width = len(str(max(n - 1, 0)))
    sigma = np.radians(arrays["attitude_sigma_deg"])
    rectangle = arrays.get("rectangle", np.zeros(n))
    try:
        if not np.array_equal(rectangle, np.round(rectangle)):
            raise ValueError("rectangle must hold whole numbers")
        return RectanglePairs(
            arrays["left_px"],
            arrays["right_px"],
            np.radians(arrays["left_attitude_deg"]),
            np.radians(arrays["right_attitude_deg"]),
            np.full(n, sigma) if sigma.ndim == 0 else sigma,
            rectangle.astype(int),
            tuple(f"{i:0{width}d}" for i in range(n)),
        )
    except DataError as error:
        raise FormatError(path, f"holds no usable rectangles: {_in_words_of_the_file(error)}.") from None
    except ValueError as error:
        raise FormatError(path, f"holds no usable rectangles: {_in_words_of_the_file(error)}; {REMEDY}.") from None


def _in_words_of_the_file(error: Exception) -> str:
    """What is wrong, by the names that the arrays have in the file."""
    text = " ".join(str(error).split()).rstrip(".")
    for name in ARRAYS:
        text = text.replace(name.replace("_deg", "_rad"), name)
    return text


def _arrays(path: Path) -> dict[str, ndarray]:
    content = read_file(path)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > MOST_BYTES:
                raise ValueError("its arrays would fill more than 256 MB")
        with np.load(io.BytesIO(content), allow_pickle=False) as loaded:
            return {name: np.asarray(loaded[name], dtype=float) for name in (*ARRAYS, "rectangle") if name in loaded}
    except (OSError, ValueError, TypeError, LookupError, EOFError, zipfile.BadZipFile, NotImplementedError) as error:
        words = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(path, f"is not a whole NumPy archive of numbers ({words[:100]}); {REMEDY}.") from None
