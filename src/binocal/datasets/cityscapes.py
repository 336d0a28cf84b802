"""Cityscapes: leftImg8bit, rightImg8bit and camera, each with splits and cities; rectified, a calibration per image.

``baseline`` and ``fx fy u0 v0`` of <city>_<sequence>_<frame>_camera.json are of the rectified pair: R = I, T = (-baseline, 0, 0),
the same K on both sides (Cordts et al. 2016; cityscapesScripts, csCalibration.pdf). Metres.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from binocal.cameras import StereoRig
from binocal.datasets.calibration_text import broken, make_camera, make_rig, read_text
from binocal.datasets.dataset import Dataset, SharedRigs, StereoPair, check_centre, check_size
from binocal.datasets.frames import list_images, match_by_name, side_missing
from binocal.datasets.naming import natural_key
from binocal.findings import finding, refusal
from binocal.geometry import SE3
from binocal.images.reading import read_image_size

LEFT, RIGHT, CAMERA = "leftImg8bit", "rightImg8bit", "camera"
SCALE_SOURCE = "baseline in the camera files"


def open_cityscapes(path: Path, choice: str = "") -> Dataset:
    """The pairs of the folder that holds leftImg8bit, rightImg8bit and camera.

    ``choice`` is a split or a city of it (``train``, ``train/aachen``); without one all are taken. A split's or city's folder
    under leftImg8bit may be given as ``path``, too.

    Raises:
        DataError: A side or a camera file is missing or broken, or images have no partner; each with its finding.
    """
    root, part = path, choice
    if LEFT in path.parts:
        at = len(path.parts) - 1 - path.parts[::-1].index(LEFT)
        root = Path(*path.parts[:at])
        part = "/".join((*path.parts[at + 1 :], *([choice] if choice else [])))
    if not any((root / name).is_dir() for name in (LEFT, RIGHT)):
        problem = f"there is neither {LEFT} nor {RIGHT}"
        raise refusal(finding("dataset-layout-unknown", path=str(path), kind="cityscapes", problem=problem))
    for name, side in ((LEFT, "left"), (RIGHT, "right")):
        if not (root / name / part).is_dir():
            raise side_missing(root / name / part, side, "there is no such folder")
    if not (root / CAMERA).is_dir():
        raise refusal(finding("dataset-calibration-missing", path=str(root / CAMERA)))
    shared = SharedRigs()
    pairs = tuple(pair for city in _list_cities(root, part) for pair in _open_city(root, city, shared))
    return Dataset("cityscapes", "Cityscapes, rectified", path, pairs, True, SCALE_SOURCE)


def _list_cities(root: Path, part: str) -> list[str]:
    """Cities with images on either side, as split/city."""
    cities = set()
    for name in (LEFT, RIGHT):
        base = root / name
        for file in (base / part).rglob(f"*_{name}.*"):
            cities.add(file.parent.relative_to(base).as_posix())
    if not cities:
        raise side_missing(root / LEFT / part, "left", f"it holds no *_{LEFT} image")
    return sorted(cities, key=natural_key)


def _open_city(root: Path, city: str, shared: SharedRigs) -> list[StereoPair]:
    folders = (root / LEFT / city, root / RIGHT / city)
    sides = [
        {
            stem.removesuffix(f"_{name}"): path
            for stem, path in list_images(folder, side).items()
            if stem.endswith(f"_{name}")
        }
        for folder, name, side in zip(folders, (LEFT, RIGHT), ("left", "right"), strict=True)
    ]
    pairs = []
    for name, left, right in match_by_name(sides[0], sides[1], folders):
        file = root / CAMERA / city / f"{name}_camera.json"
        rig = shared.share(_read_camera(file, (left, right)))
        pairs.append(StereoPair(name, left, right, rig=rig))
    return pairs


def _read_camera(path: Path, images: tuple[Path, Path]) -> StereoRig:
    """The rig of the two images; the file does not say what size they have."""
    try:
        document = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise broken(path, f"is not JSON ({error.msg})", error.lineno) from None
    fx, fy, cx, cy = (_number(path, document, "intrinsic", key) for key in ("fx", "fy", "u0", "v0"))
    baseline_m = _number(path, document, "extrinsic", "baseline")
    if baseline_m <= 0:
        raise broken(path, "extrinsic.baseline is not positive")
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    left_wh, right_wh = (read_image_size(image) for image in images)
    check_size(images[1], right_wh, (left_wh,), "the calibration of the left image")
    check_centre(images[0], left_wh, K[:2, 2], path)
    left, right = (make_camera(path, K, np.zeros(4), size) for size in (left_wh, right_wh))
    return make_rig(path, left, right, SE3(np.eye(3), np.array([-baseline_m, 0.0, 0.0])))


def _number(path: Path, document: Any, group: str, key: str) -> float:
    entry = document.get(group) if isinstance(document, dict) else None
    value = entry.get(key) if isinstance(entry, dict) else None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise broken(path, f"has no number {group}.{key}")
    return float(value)
