"""Calibration files of data sets as text: ``name: numbers`` lines and matrices, refused by file and line where broken."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig
from binocal.errors import BinocalError
from binocal.findings import finding, refusal
from binocal.geometry import SE3
from binocal.shapes import Float

ROTATION_TOLERANCE = 1e-4  # published matrices have 7 digits, and stay within 1e-6; what is further off is no rotation
SHORTEST_BASELINE_M, LONGEST_BASELINE_M = 0.005, 5.0  # outside, a unit was mistaken


def broken(path: Path, problem: str, line: int | None = None, remedy: str | None = None) -> BinocalError:
    """The refusal of a calibration file, with the line where it is broken (counted from 1); ``remedy`` in place of unpacking it again."""
    where = f"{path}, line {line}" if line else str(path)
    return refusal(finding("dataset-calibration-broken", remedy=remedy, path=str(path), where=where, problem=problem))


def read_text(path: Path) -> str:
    """The text of a calibration file.

    Raises:
        DataError: It is missing (finding ``dataset-calibration-missing``), or no text.
    """
    if not path.is_file():
        raise refusal(finding("dataset-calibration-missing", path=str(path)))
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise broken(path, "is not text") from None
    except OSError as error:
        raise broken(path, f"cannot be read ({error.strerror or error})") from None


@dataclass(frozen=True, slots=True)
class Entries:
    """Values by name as they stand in a file, with the lines where they stand."""

    path: Path
    texts: dict[str, tuple[int, str]]

    def __contains__(self, key: str) -> bool:
        return key in self.texts

    def numbers(self, key: str, count: int | tuple[int, ...]) -> Float[ndarray, "n"]:
        """The numbers of an entry, as many as asked for (or as one of several counts)."""
        counts = (count,) if isinstance(count, int) else count
        if key not in self.texts:
            raise broken(self.path, f"has no {key}")
        line, text = self.texts[key]
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            raise broken(
                self.path, f"{key} holds something that is not a number ({text.strip()[:40]!r})", line
            ) from None
        if len(values) not in counts:
            needed = " or ".join(str(n) for n in counts)
            raise broken(self.path, f"{key} has {len(values)} numbers, {needed} needed", line)
        if not all(math.isfinite(value) for value in values):
            raise broken(self.path, f"{key} holds a number that is not finite", line)
        return np.array(values)

    def matrix(self, key: str, rows: int, columns: int) -> Float[ndarray, "r c"]:
        """An entry of rows x columns numbers, row by row."""
        return self.numbers(key, rows * columns).reshape(rows, columns)

    def size(self, key: str) -> tuple[int, int]:
        """An entry of width and height, pixels."""
        width, height = self.numbers(key, 2)
        if width < 1 or height < 1 or width != int(width) or height != int(height):
            raise broken(self.path, f"{key} is no image size", self.texts[key][0])
        return int(width), int(height)

    def rotation(self, key: str) -> Float[ndarray, "3 3"]:
        """An entry of nine numbers that is a rotation but for the digits it was printed with; the nearest rotation."""
        return nearest_rotation(self.matrix(key, 3, 3), self.path, key, self.texts[key][0])


def read_entries(path: Path, separator: str = ":") -> Entries:
    """The entries of a file of lines ``name: values``; names are parted at the first separator, as times hold colons too.

    Raises:
        DataError: The file is missing, or a line has no separator or a name stands twice.
    """
    texts: dict[str, tuple[int, str]] = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        key, found, value = line.partition(separator)
        if not found:
            raise broken(path, f"has no {separator!r} after a name ({line.strip()[:40]!r})", number)
        if key.strip() in texts:
            raise broken(path, f"{key.strip()} stands twice", number)
        texts[key.strip()] = (number, value)
    if not texts:
        raise broken(path, "is empty")
    return Entries(path, texts)


def nearest_rotation(matrix: Float[ndarray, "3 3"], path: Path, name: str, line: int | None = None) -> ndarray:
    """The rotation nearest to a matrix that is one but for rounding; refused where it is none."""
    U, _, Vt = np.linalg.svd(matrix)
    R = U @ Vt
    if np.linalg.det(R) < 0 or np.abs(R - matrix).max() > ROTATION_TOLERANCE:
        raise broken(path, f"{name} is not a rotation", line)
    return R


def make_camera(
    path: Path,
    K: Float[ndarray, "3 3"],
    distortion: Float[ndarray, "d"],
    size_wh: tuple[int, int],
    *,
    is_fisheye: bool = False,
) -> Camera:
    """The camera of a file's numbers, refused where no camera has such ones."""
    width, height = size_wh
    if not (0.2 * width < K[0, 0] < 10 * width and 0.2 * width < K[1, 1] < 10 * width):
        raise broken(path, f"the focal length {K[0, 0]:g}, {K[1, 1]:g} does not belong to images {width} px wide")
    if not (0 < K[0, 2] < width and 0 < K[1, 2] < height):
        raise broken(path, f"the principal point ({K[0, 2]:g}, {K[1, 2]:g}) lies outside of the {width}x{height} image")
    return Camera.from_opencv(K, distortion, size_wh, is_fisheye=is_fisheye)


def make_rig(path: Path, left: Camera, right: Camera, T_right_left: SE3) -> StereoRig:
    """The rig of a file's numbers, refused where its baseline (metres) is none that a stereo camera has."""
    rig = StereoRig(left, right, T_right_left)
    if not SHORTEST_BASELINE_M < rig.baseline_m < LONGEST_BASELINE_M:
        raise broken(
            path, f"the baseline comes out as {rig.baseline_m:g} m, a unit is wrong or the cameras are the same"
        )
    return rig
