"""``binocal rectify``: a rig's image pairs brought to common rows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.cameras.epipolar_projection import ProjectionKind
from binocal.datasets.folder import ImagePair, list_pairs
from binocal.errors import FormatError
from binocal.formats.json_document import dump_json, jsonable
from binocal.images.encoding import draw_rows, encode_image
from binocal.images.reading import read_image
from binocal.output import staged_folder, write_part
from binocal.progress import ProgressCallback
from binocal.rectification import Rectification, RectificationMaps, rectify

DOCUMENT = "rectification.json"


@dataclass(frozen=True, slots=True)
class RectifyOptions:
    """How to rectify, see :func:`binocal.rectify`, and whether to draw both images with lines along matching rows."""

    size_wh: tuple[int, int] | None = None
    alpha: float | None = None
    projection: Literal["auto"] | ProjectionKind = "auto"
    draws_rows: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RectifyRun:
    """What was rectified: the names of the pairs, the files that are in no pair, with the reason, and what is odd about the pairs."""

    rectification: Rectification
    names: tuple[str, ...]
    ignored: tuple[tuple[Path, str], ...]
    notes: tuple[str, ...] = ()


def rectify_images(
    rig: StereoRig,
    left: str,
    right: str,
    output: str | Path,
    options: RectifyOptions | None = None,
    *,
    force: bool = False,
    progress: ProgressCallback | None = None,
) -> RectifyRun:
    """Rectify every pair into ``output``: left_NAME.png and right_NAME.png, rows_NAME.png if asked for, and rectification.json.

    Grey and colour images keep their depth. ``output`` appears in full or not at all.

    Raises:
        DegenerateGeometryError: The rig cannot be rectified.
        DataError: There is no pair, an image cannot be read or is not of the rig's size, or ``output`` cannot be written.
    """
    options = options or RectifyOptions()
    rectification = options_applied(rig, options)
    pairing = list_pairs(left, right)
    names = file_names([pair.name for pair in pairing.pairs])
    with staged_folder(output, force=force, last=(DOCUMENT,)) as folder:
        maps = RectificationMaps.of(rig, rectification)
        for name, images in zip(names, rectified_pairs(rig, maps, pairing.pairs, progress), strict=True):
            for side, image in zip(("left", "right"), images, strict=True):
                write_part(folder / f"{side}_{name}.png", encode_image(image))
            if options.draws_rows:
                drawn = draw_rows(*images, is_vertical=rectification.is_vertical)
                write_part(folder / f"rows_{name}.png", encode_image(drawn))
        document = rectification_document(rig, rectification) | {"pairs": list(names)}
        write_part(folder / DOCUMENT, dump_json(jsonable(document)).encode())
    return RectifyRun(rectification, names, pairing.ignored, pairing.notes)


def options_applied(rig: StereoRig, options: RectifyOptions) -> Rectification:
    """The rectification that options ask for. Raises as :func:`binocal.rectify`."""
    return rectify(rig, size_wh=options.size_wh, alpha=options.alpha, projection=options.projection)


def rectified_pairs(
    rig: StereoRig,
    maps: RectificationMaps,
    pairs: Sequence[ImagePair],
    progress: ProgressCallback | None = None,
) -> Iterator[tuple[ndarray, ndarray]]:
    """Both rectified images of each pair, as they are read: one pair in memory at a time.

    Raises:
        FormatError: An image cannot be read, or is not of the rig's size.
    """
    for count, pair in enumerate(pairs):
        images = []
        for side, camera, path in (("left", rig.left, pair.left_path), ("right", rig.right, pair.right_path)):
            image = read_image(path)
            size_wh = image.shape[1], image.shape[0]
            if size_wh != camera.size_wh:
                raise FormatError(
                    path,
                    f"is {size_wh[0]} x {size_wh[1]}, the rig's {side} camera {camera.size_wh[0]} x {camera.size_wh[1]}; give images "
                    "of the size that was calibrated, or the rig of these cameras",
                )
            images.append(image)
        yield maps.rectify(images[0], images[1])
        if progress is not None:
            progress("pairs", count + 1, len(pairs))


def file_names(names: Sequence[str]) -> tuple[str, ...]:
    """Names of pairs as parts of file names, all different."""
    plain = [re.sub(r"[^\w.-]+", "_", name).strip("._") or "pair" for name in names]
    return tuple(f"{name}_{i}" if plain.count(name) > 1 else name for i, name in enumerate(plain))


def rectification_document(rig: StereoRig, rectification: Rectification) -> dict[str, Any]:
    """The rectification as plain data: OpenCV's R1, R2, and P1, P2, Q of a pinhole; what is shown and covered."""
    r = rectification
    document: dict[str, Any] = {
        "schema": "binocal-rectification/1",
        "unit": "m" if rig.is_metric else "board pitch",
        "projection": r.projection,
        "image_size": list(r.size_wh),
        "is_vertical": r.is_vertical,
        "is_swapped": r.is_swapped,
        "baseline": abs(r.offset_m),
        "R1": r.R_rect_left,
        "R2": r.R_rect_right,
        "left": {"focal_px": r.left.focal_px, "centre_px": r.left.centre_px},
        "right": {"focal_px": r.right.focal_px, "centre_px": r.right.centre_px},
        "covered": {"left": r.covered[0], "right": r.covered[1]},
        "kept": r.kept,
    }
    if r.projection == "pinhole":
        document |= {"P1": np.asarray(r.P_left), "P2": np.asarray(r.P_right), "Q": r.Q}
    return document
