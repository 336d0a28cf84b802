"""Real recordings for `binocal bench real`: where they are looked for, and their corners.

A recording is a folder of images that a description tells of, or an archive of corners (``.npz``): what ``binocal calibrate
--evidence`` wrote, or plain arrays ``object_points_m``, ``left_px``, ``right_px``, ``left_size_wh`` and ``right_size_wh``.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy import ndarray

from binocal.boards import Board, load_board
from binocal.cameras import CAMERA_MODELS
from binocal.datasets.folder import ImagePair, Pairing, list_pairs
from binocal.detection import detect_pairs
from binocal.detection.opencv_finder import find_corners_with_opencv, read_grey
from binocal.errors import BinocalError, DataError, FormatError
from binocal.evidence import Detections
from binocal.formats.detections_npz import is_detections_file, read_detections
from binocal.images import CHANNELS, read_image
from binocal.images.png import encode_png
from binocal.images.preprocessing import Preparation
from binocal.shapes import Float

ENVIRONMENT = "BINOCAL_DATA"
DESCRIPTION = "set.json"
_DESCRIBED = {"board": "", "left": "left*", "right": "right*", "side_by_side": "", "model": "brown5"}


@dataclass(frozen=True, slots=True)
class SetSource:
    """Where a recording lies and what it shows.

    ``path`` is its folder, or its corners' file. ``left`` and ``right`` are globs within the folder; where ``side_by_side`` is one,
    each of its images holds the left camera's in its left half. ``model`` is the camera model for every method that is told one.
    """

    name: str
    path: Path
    board: str = ""
    left: str = "left*"
    right: str = "right*"
    side_by_side: str = ""
    model: str = "brown5"


@dataclass(frozen=True, slots=True, eq=False)
class RealSet:
    """A recording's corners by binocal, and by OpenCV where it can find its boards; both with all views.

    OpenCV's are None for boards that it has no classic finder for, and for files of corners. They have the points' order as it looks
    in the image; :func:`same_points` brings them into another's.
    """

    source: SetSource
    detections: Detections
    opencv_detections: Detections | None


KNOWN_SETS = (
    SetSource("opencv_bouguet", Path(), "chessboard:9x6:30mm"),
    SetSource("boof_bumblebee2_chess", Path(), "chessboard:6x4:30mm"),
    SetSource("presentcjn_cb11x8", Path(), "chessboard:11x8:12mm"),
    SetSource("barry_swapped", Path(), "chessboard:9x6"),
    SetSource("sourishg_webcam_640", Path(), "chessboard:9x6:24.23mm"),
    SetSource("sourishg_webcam_270x180", Path(), "chessboard:9x6:24.23mm"),
    SetSource("stereopi_fisheye", Path(), "chessboard:9x6:25mm", model="fisheye4"),
    SetSource("rursprung_charuco", Path(), "charuco:11x8:30mm:22mm:DICT_5X5_50", "left", "right"),
    SetSource("aix_sidebyside", Path(), "chessboard:10x7:20mm", side_by_side="image*.png"),
)
"""Public recordings by the name of their folder; ``benchmarks/fetch_data.py`` fetches those whose licence allows it."""


def data_folder() -> Path:
    """Where recordings are looked for: ``BINOCAL_DATA``, else ``../shared/data`` from the root of a source checkout."""
    given = os.environ.get(ENVIRONMENT)
    return Path(given) if given else Path(__file__).resolve().parents[4] / "shared" / "data"


def find_sets(wanted: Sequence[str] = ()) -> list[SetSource]:
    """The recordings named (a folder, a file of corners, or a name within the data folder); by default all of the data folder.

    Raises:
        DataError: There is none, or one that was named is missing or lacks its description; the text says what was looked for.
    """
    folder = data_folder()
    if wanted:
        return [_find(text, folder) for text in wanted]
    found = [source for known in KNOWN_SETS if (source := _at(known, folder / known.name)) is not None]
    if folder.is_dir():
        known_names = {known.name for known in KNOWN_SETS}
        described = (entry for entry in sorted(folder.iterdir()) if (entry / DESCRIPTION).is_file())
        found += [read_description(entry) for entry in described if entry.name not in known_names]
    if not found:
        raise DataError(
            f"no recording to measure with: {folder} ({ENVIRONMENT}, which is "
            f"{'set' if os.environ.get(ENVIRONMENT) else 'not set'}) holds neither a folder with a {DESCRIPTION} nor one of "
            f"{', '.join(known.name for known in KNOWN_SETS)}; name folders or .npz files of corners after `binocal bench real`."
        )
    return found


def sets_in(folder: Path) -> list[SetSource]:
    """The recording that a folder is, or every one that it holds.

    Raises:
        DataError: There is none.
    """
    if not folder.is_dir():
        raise DataError(f"{folder} is no folder; name one with recordings.")
    names = {known.name for known in KNOWN_SETS}
    if (folder / DESCRIPTION).is_file() or folder.name in names:
        return [_find(str(folder), folder.parent)]
    entries = sorted(entry for entry in folder.iterdir() if entry.is_dir())
    found = [_find(str(e), folder) for e in entries if (e / DESCRIPTION).is_file() or e.name in names]
    if not found:
        raise DataError(
            f"{folder} holds no recording: no folder with a {DESCRIPTION}, and none of {', '.join(sorted(names))}."
        )
    return found


def _find(text: str, folder: Path) -> SetSource:
    places = [Path(text).expanduser(), folder / text]
    for place in places:
        if place.is_file() and place.suffix == ".npz":
            return SetSource(place.parent.name if place.stem == "corners" else place.stem, place)
        if (place / DESCRIPTION).is_file():
            return read_description(place)
        for known in KNOWN_SETS:
            if place.name == known.name and (source := _at(known, place)) is not None:
                return source
    raise DataError(
        f"{text}: neither an .npz file of corners, nor a folder with a {DESCRIPTION}, nor the folder of a known recording; "
        f"looked for {' and '.join(str(place) for place in places)}."
    )


def _at(known: SetSource, folder: Path) -> SetSource | None:
    if not folder.is_dir():
        return None
    return SetSource(known.name, folder, known.board, known.left, known.right, known.side_by_side, known.model)


def read_description(folder: Path) -> SetSource:
    """The recording of a folder with a ``set.json``.

    That is an object with ``board`` (its SPEC) and, where they differ from the default, ``left`` and ``right``, or
    ``side_by_side`` (globs within the folder), and ``model``.

    Raises:
        FormatError: The description is not that.
    """
    path = folder / DESCRIPTION
    try:
        described = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FormatError(path, f"cannot be read as JSON: {error}") from None
    if not isinstance(described, dict) or not all(isinstance(value, str) for value in described.values()):
        raise FormatError(path, "is not an object of texts")
    unknown = sorted(set(described) - set(_DESCRIBED))
    if unknown or "board" not in described:
        problem = f"has no use for {', '.join(unknown)}" if unknown else "does not say the board"
        raise FormatError(path, f"{problem}; it may hold {', '.join(_DESCRIBED)}")
    if described.get("model", "brown5") not in CAMERA_MODELS:
        raise FormatError(path, f"names the model {described['model']}; the models are {', '.join(CAMERA_MODELS)}")
    return SetSource(folder.resolve().name, folder, **(_DESCRIBED | described))


def load_set(source: SetSource) -> RealSet:
    """Corners of a recording, detected in all of its images by binocal and, for a chessboard, by OpenCV too.

    Raises:
        BinocalError: The images or corners cannot be used; the text says why.
    """
    if source.path.is_file():
        return RealSet(source, read_corners(source.path), None)
    try:
        board = load_board(source.board)
    except ValueError as error:
        raise DataError(f"{source.name}: {error}") from None
    with tempfile.TemporaryDirectory(prefix="binocal-bench-") as aside:
        pairs = _list(source, Path(aside)).pairs
        detections = detect_pairs(pairs, board).detections
        own = None
        if board.kind == "chessboard":
            by_name = {pair.name: pair for pair in pairs}
            kept = [by_name[name] for name in detections.names]
            sides = [
                [_opencv_corners(getattr(pair, side), board) for pair in kept] for side in ("left_path", "right_path")
            ]
            left, right = (np.stack(side) for side in sides)
            own = replace(detections, left_px=left, right_px=right, left_covariance_px2=None, right_covariance_px2=None)
    return RealSet(source, detections, own)


def load_channels(source: SetSource) -> dict[str, Detections] | None:
    """Corners of a recording in grey and in each colour; None where its images have no colours, or both cameras share them.

    Raises:
        BinocalError: The images cannot be used; the text says why.
    """
    if source.path.is_file() or source.side_by_side:
        return None
    pairs = list_pairs(str(source.path / source.left), str(source.path / source.right)).pairs
    first = read_image(pairs[0].left_path) if pairs else np.zeros((1, 1))
    if first.ndim != 3 or all(np.array_equal(first[..., 1], first[..., plane]) for plane in (0, 2)):
        return None
    board = load_board(source.board)
    return {channel: detect_pairs(pairs, board, preparation=Preparation(channel)).detections for channel in CHANNELS}


def _list(source: SetSource, aside: Path) -> Pairing:
    """The pairs of a recording; images that hold both cameras are split into files in the folder ``aside``."""
    if not source.side_by_side:
        return list_pairs(str(source.path / source.left), str(source.path / source.right))
    pairs = []
    for path in sorted(source.path.glob(source.side_by_side)):
        grey = read_grey(path)
        middle = grey.shape[1] // 2
        halves = aside / f"{path.stem}_left.png", aside / f"{path.stem}_right.png"
        for half, image in zip(halves, (grey[:, :middle], grey[:, middle : 2 * middle]), strict=True):
            half.write_bytes(encode_png(np.ascontiguousarray(image)))
        pairs.append(ImagePair(path.stem, *halves))
    if not pairs:
        raise DataError(f"{source.path} holds no {source.side_by_side}")
    return Pairing(tuple(pairs))


def _opencv_corners(path: Path, board: Board) -> Float[ndarray, "n 2"]:
    found = find_corners_with_opencv(read_grey(path), board)
    return np.full((board.n_points, 2), np.nan) if found is None else found.reshape(-1, 2).astype(float)


def read_corners(path: Path) -> Detections:
    """Corners of an archive: binocal's own, or plain arrays under the names of :class:`binocal.Detections`.

    Raises:
        FormatError: It holds neither.
    """
    if is_detections_file(path):
        return read_detections(path)
    try:
        with np.load(path, allow_pickle=False) as arrays:
            points, left, right = (arrays[name] for name in ("object_points_m", "left_px", "right_px"))
            (w, h), right_size = arrays["left_size_wh"].tolist(), tuple(arrays["right_size_wh"].tolist())
            return Detections.from_arrays(points, left, right, (w, h), right_image_size_wh=right_size)
    except (OSError, ValueError, KeyError, BinocalError) as error:
        raise FormatError(path, f"holds no corners that can be used: {error}") from None


def same_points(own: Detections, detections: Detections) -> Detections:
    """``own`` corners of the views of ``detections``, in the order that these have in each image.

    A corner of ``detections`` is the nearest own one, if within half the least spacing; an image in which not each finds one, and only
    one, has none. So orders that were repaired serve the peer too.
    """
    place = {name: i for i, name in enumerate(own.names)}
    views = own.select(np.array([place[name] for name in detections.names], dtype=int))
    left, right = (
        np.stack([_nearest(a, b) for a, b in zip(getattr(views, side), getattr(detections, side), strict=True)])
        for side in ("left_px", "right_px")
    )
    return replace(detections, left_px=left, right_px=right, left_covariance_px2=None, right_covariance_px2=None)


def _nearest(own_px: Float[ndarray, "n 2"], px: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
    """``own_px`` in the order of ``px``, NaN where that is; NaN throughout where they are not the same points."""
    found = np.full(px.shape, np.nan)
    seen = np.flatnonzero(~np.isnan(px).any(axis=1))
    if np.isnan(own_px).any() or len(seen) < 2:
        return found
    px = px[seen]
    between = np.linalg.norm(px[:, None] - px[None], axis=-1)
    reach = 0.5 * between[~np.eye(len(px), dtype=bool)].min()
    distance = np.linalg.norm(px[:, None] - own_px[None], axis=-1)
    nearest = distance.argmin(axis=1)
    if len(set(nearest.tolist())) == len(px) and distance.min(axis=1).max() <= reach:
        found[seen] = own_px[nearest]
    return found
