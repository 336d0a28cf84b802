"""KITTI in its original layouts: raw (rectified and not), stereo 2012 and 2015, object, odometry.

calib_cam_to_cam.txt: ``x_i = R_0i x_0 + T_0i``, S = width height, D = k1 k2 p1 p2 k3; rectified cameras are P = K [I | t] with
rectified camera 0 as the origin, so t = inv(K) P[:, 3] (Geiger et al. 2013, "Vision meets robotics: the KITTI dataset"). Metres.
Cameras 0 and 1 are the gray pair, 2 and 3 the colour one.
"""

from __future__ import annotations

import calendar
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binocal.cameras import StereoRig
from binocal.datasets.calibration_text import Entries, broken, make_camera, make_rig, read_entries, read_text
from binocal.datasets.dataset import Dataset, SharedRigs, StereoPair, check_centre, check_size
from binocal.datasets.frames import list_images, match_by_name, name_some
from binocal.errors import BinocalError
from binocal.findings import finding, refusal
from binocal.geometry import SE3
from binocal.images.reading import read_image_size

COLOURS = {"gray": (0, 1), "grey": (0, 1), "colour": (2, 3), "color": (2, 3)}
SCALE_SOURCE = "KITTI's calibration boards (squares of 99.5 mm)"
AGREEMENT = 1e-4  # of R_rect_j R_j with R_rect_i R_i: the files' 7 digits leave 1e-6
_TIME = re.compile(r"(\d{4})-(\d\d)-(\d\d) (\d\d):(\d\d):(\d\d)\.(\d{1,9})$")


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where one form of KITTI has the images of camera i, and the calibration of an image."""

    name: str
    folders: tuple[tuple[str, str], ...]  # gray, colour
    calibration: str  # {frame}: the image's number

    def pair(self, root: Path, wanted: tuple[int, int] | None) -> tuple[tuple[int, int], tuple[Path, Path]]:
        """Camera numbers and image folders: the wanted ones, else gray where it is there, else colour."""
        there = [
            pair
            for pair, names in zip(((0, 1), (2, 3)), self.folders, strict=True)
            if any((root / n).is_dir() for n in names)
        ]
        numbers = wanted or there[0]
        left, right = self.folders[numbers[0] // 2]
        return numbers, (root / left, root / right)


_RAW = _Layout("raw", (("image_00", "image_01"), ("image_02", "image_03")), "")
_STEREO_2012 = _Layout("stereo 2012", (("image_0", "image_1"), ("colored_0", "colored_1")), "calib/{frame}.txt")
_STEREO_2015 = _Layout("stereo 2015", (("image_0", "image_1"), ("image_2", "image_3")), "calib_cam_to_cam/{frame}.txt")
_OBJECT = _Layout("object", (("image_0", "image_1"), ("image_2", "image_3")), "calib/{frame}.txt")
_ODOMETRY = _Layout("odometry", (("image_0", "image_1"), ("image_2", "image_3")), "calib.txt")


def open_kitti(path: Path, choice: str = "") -> Dataset:
    """The pairs and rigs of KITTI data: a raw drive, a training or testing folder, or an odometry sequence.

    The form is recognised by the folders. ``choice`` is ``gray`` or ``colour``; without it the gray pair is taken where it is
    there. A folder that holds a single drive (or a single part) may stand for it.

    Raises:
        DataError: The layout is none of KITTI's, a side or a calibration file is missing or broken, images have no
            partner, or a size is not the calibration's; each with its finding.
    """
    if choice and choice not in COLOURS:
        remedy = f"write kitti:{path}:gray or kitti:{path}:colour"
        raise _unknown(path, f"the pair is gray or colour, not {choice!r}", remedy)
    root, layout = _find_root(path)
    numbers, folders = layout.pair(root, COLOURS.get(choice))
    sides = [folder / "data" if layout is _RAW else folder for folder in folders]
    left, right = list_images(sides[0], "left"), list_images(sides[1], "right")
    matches = match_by_name(left, right, (sides[0], sides[1]))
    what = f"{layout.name}, {'gray' if numbers == (0, 1) else 'colour'} pair (cameras {numbers[0]} and {numbers[1]})"
    if layout is _RAW:
        return _open_raw(path, root, matches, numbers, what)
    times = _read_seconds(root / "times.txt") if layout is _ODOMETRY else {}
    rigs = _ListedRigs(root, layout, numbers)
    pairs = tuple(
        StereoPair(name, a, b, times.get(name), times.get(name), rigs.of_image(name, a, b)) for name, a, b in matches
    )
    return Dataset("kitti", f"KITTI {what}, rectified", path, pairs, True, SCALE_SOURCE)


def _unknown(path: Path, problem: str, remedy: str | None = None) -> BinocalError:
    return refusal(finding("dataset-layout-unknown", remedy=remedy, path=str(path), kind="kitti", problem=problem))


def _find_root(path: Path) -> tuple[Path, _Layout]:
    """The folder that holds the image folders, and its form; looks down into a folder that has a single such folder."""
    layout = _layout_of(path)
    if layout:
        return path, layout
    found = []
    for pattern in ("*", "*/*", "*/*/*"):
        found = [
            (folder, inner)
            for folder in sorted(path.glob(pattern))
            if folder.is_dir() and (inner := _layout_of(folder))
        ]
        if found:
            break
    if not found:
        raise _unknown(
            path, "there is neither image_00 .. image_03 (raw) nor image_0 .. image_3 or colored_0 and colored_1"
        )
    if len(found) > 1:
        names = name_some(str(folder.relative_to(path)) for folder, _ in found)
        raise refusal(finding("dataset-part-not-chosen", path=str(path), n_parts=len(found), names=names))
    return found[0]


def _layout_of(path: Path) -> _Layout | None:
    names = {entry.name for entry in path.iterdir() if entry.is_dir()}
    if names & {"image_00", "image_01", "image_02", "image_03"}:
        return _RAW
    if names & {"colored_0", "colored_1"}:
        return _STEREO_2012
    if not names & {"image_0", "image_1", "image_2", "image_3"}:
        return None
    if "calib_cam_to_cam" in names:
        return _STEREO_2015
    if "calib" in names:
        return _OBJECT if names & {"image_2", "image_3"} else _STEREO_2012
    if (path / "calib.txt").is_file() or (path / "times.txt").is_file() or path.parent.name == "sequences":
        return _ODOMETRY
    return _STEREO_2015 if _is_named_by_moment(path) else _OBJECT


def _is_named_by_moment(path: Path) -> bool:
    """Stereo 2012 and 2015 number their images 000000_10: the frame, and the moment."""
    return any(re.fullmatch(r"\d{6}_\d\d", file.stem) for file in path.glob("image_[0-3]/*.png"))


# --- raw


def _open_raw(
    path: Path, root: Path, matches: list[tuple[str, Path, Path]], numbers: tuple[int, int], what: str
) -> Dataset:
    """A drive: its calibration stands in the date's folder, and the images' size says whether they are rectified."""
    places = (root.parent / "calib_cam_to_cam.txt", root / "calib_cam_to_cam.txt")
    file = next((place for place in places if place.is_file()), places[0])
    entries = read_entries(file)
    images = matches[0][1:]
    sizes = [read_image_size(image) for image in images]
    rectified = [entries.size(f"S_rect_{number:02d}") for number in numbers]
    raw = [entries.size(f"S_{number:02d}") for number in numbers]
    check_size(images[0], sizes[0], (rectified[0], raw[0]), str(file))
    is_rectified = sizes[0] == rectified[0] and not (sizes[0] == raw[0] and root.name.endswith("_extract"))
    check_size(images[1], sizes[1], ((rectified if is_rectified else raw)[1],), str(file))
    rig = _read_rectified(entries, numbers, images) if is_rectified else read_raw_rig(file, numbers)
    times = [_read_dates(root / f"image_{number:02d}" / "timestamps.txt") for number in numbers]
    pairs = tuple(
        StereoPair(name, a, b, _time_at(times[0], name), _time_at(times[1], name), rig) for name, a, b in matches
    )
    form = "rectified" if is_rectified else "unrectified"
    return Dataset("kitti", f"KITTI {what}, {form}", path, pairs, is_rectified, SCALE_SOURCE)


def read_raw_rig(path: Path, numbers: tuple[int, int] = (0, 1)) -> StereoRig:
    """The unrectified rig of two cameras of a calib_cam_to_cam.txt: K, D, S of each, R = R_j R_i', T = T_j - R T_i.

    Raises:
        DataError: The file is missing or broken, or its rotations contradict its rectification.
    """
    entries = read_entries(path)
    cameras, poses, common = [], [], []
    for number in numbers:
        key = f"{number:02d}"
        K, D = entries.matrix(f"K_{key}", 3, 3), entries.numbers(f"D_{key}", 5)
        cameras.append(make_camera(path, K, D, entries.size(f"S_{key}")))
        poses.append(SE3(entries.rotation(f"R_{key}"), entries.numbers(f"T_{key}", 3)))
        if f"R_rect_{key}" in entries:
            common.append(entries.rotation(f"R_rect_{key}") @ poses[-1].R)
    if len(common) == 2 and np.abs(common[0] - common[1]).max() > AGREEMENT:
        line = entries.texts[f"R_{numbers[1]:02d}"][0]
        raise broken(path, f"R_{numbers[1]:02d} and R_rect_{numbers[1]:02d} contradict those of the other camera", line)
    return make_rig(path, cameras[0], cameras[1], poses[1] @ poses[0].inverse())


def _read_dates(path: Path) -> list[int | None]:
    """Times of a timestamps.txt (UTC), nanoseconds since 1970, by the image's number; empty where there is no such file."""
    if not path.is_file():
        return []
    times: list[int | None] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        match = _TIME.match(line.strip())
        if line.strip() and not match:
            raise broken(path, f"{line.strip()[:40]!r} is not a date and time", number)
        if match:
            seconds = calendar.timegm(tuple(int(part) for part in match.groups()[:6]))
            times.append(seconds * 10**9 + int(match[7].ljust(9, "0")))
        else:
            times.append(None)
    return times


def _time_at(times: list[int | None], name: str) -> int | None:
    return times[int(name)] if name.isdecimal() and int(name) < len(times) else None


# --- stereo, object, odometry: rectified, P0 .. P3


def _read_seconds(path: Path) -> dict[str, int]:
    """Times of an odometry sequence in nanoseconds, by the image's name (000000)."""
    if not path.is_file():
        return {}
    times = {}
    for number, line in enumerate(read_text(path).split()):
        try:
            times[f"{number:06d}"] = round(float(line) * 1e9)
        except (ValueError, OverflowError):
            raise broken(path, f"{line[:40]!r} is not a time in seconds", number + 1) from None
    return times


class _ListedRigs:
    """The rig of each image of a folder with calibrations per image (or one for all), equal ones shared."""

    def __init__(self, root: Path, layout: _Layout, numbers: tuple[int, int]) -> None:
        self._root, self._layout, self._numbers = root, layout, numbers
        self._entries: dict[Path, Entries] = {}
        self._shared = SharedRigs()

    def of_image(self, name: str, left: Path, right: Path) -> StereoRig:
        """The rig of the two images."""
        file = self._root / self._layout.calibration.format(frame=name.partition("_")[0])
        if file not in self._entries:
            self._entries = {file: read_entries(file)}
        return self._shared.share(_read_rectified(self._entries[file], self._numbers, (left, right)))


def _read_rectified(entries: Entries, numbers: tuple[int, int], images: tuple[Path, ...]) -> StereoRig:
    """The rig of two rectified images from P_rect_0i, or P0 .. P3; the files of the latter do not say what size they are for."""
    cameras, origins = [], []
    sizes = [read_image_size(image) for image in images]
    check_size(images[1], sizes[1], (sizes[0],), "the calibration of the left image")
    for number, image, size in zip(numbers, images, sizes, strict=True):
        short, long = f"P{number}", f"P_rect_{number:02d}"
        key = short if short in entries else long
        if key not in entries:
            raise broken(entries.path, f"has neither {short} nor {long}")
        P = entries.matrix(key, 3, 4)
        line = entries.texts[key][0]
        if f"S_rect_{number:02d}" in entries:
            check_size(image, size, (entries.size(f"S_rect_{number:02d}"),), str(entries.path))
        check_centre(image, size, P[:2, 2], entries.path)
        if np.abs(P[2, :3] - (0, 0, 1)).max() > 1e-9 or not (P[0, 0] > 0 and P[1, 1] > 0):
            raise broken(entries.path, f"{key} is no projection of a rectified camera", line)
        cameras.append(make_camera(entries.path, P[:, :3], np.zeros(4), size))
        origins.append(np.linalg.solve(P[:, :3], P[:, 3]))
    return make_rig(entries.path, cameras[0], cameras[1], SE3(np.eye(3), origins[1] - origins[0]))
