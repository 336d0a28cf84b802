"""Middlebury 2014 and 2021 (and ETH3D two-view): a folder per scene with im0, im1 and calib.txt; rectified.

``cam0``, ``cam1`` are the pinhole matrices, ``doffs`` = cx1 - cx0, ``baseline`` in millimetres (Scharstein et al. 2014,
"High-resolution stereo datasets with subpixel-accurate ground truth").
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from binocal.cameras import StereoRig
from binocal.datasets.calibration_text import Entries, broken, make_camera, make_rig, read_entries
from binocal.datasets.dataset import Dataset, SharedRigs, StereoPair, check_size
from binocal.datasets.frames import list_images, side_missing
from binocal.datasets.naming import natural_key
from binocal.findings import finding, refusal
from binocal.geometry import SE3
from binocal.images.reading import read_image_size

DOFFS_TOLERANCE_PX = 0.01  # the files print three decimals


def open_middlebury(path: Path, choice: str = "") -> Dataset:
    """The pair of a scene's folder, or of every scene in a folder; ``choice`` is a scene of it.

    Raises:
        DataError: An image or calib.txt is missing or broken, or a size differs; each with its finding.
    """
    root = path / choice
    scenes = [root] if _is_scene(root) else []
    if not scenes and root.is_dir():
        scenes = sorted(
            (entry for entry in root.iterdir() if entry.is_dir() and _is_scene(entry)),
            key=lambda p: natural_key(p.name),
        )
    if not scenes:
        problem = "there is no calib.txt, im0 or im1, neither here nor one folder below"
        raise refusal(finding("dataset-layout-unknown", path=str(root), kind="middlebury", problem=problem))
    shared = SharedRigs()
    pairs = tuple(_open_scene(scene, shared) for scene in scenes)
    return Dataset("middlebury", "Middlebury, rectified", path, pairs, True, "baseline in calib.txt")


def _is_scene(path: Path) -> bool:
    return (path / "calib.txt").is_file() or any(path.glob("im[01].*"))


def _open_scene(scene: Path, shared: SharedRigs) -> StereoPair:
    found = list_images(scene, "left") if any(scene.glob("im[01].*")) else {}
    for stem, side in (("im0", "left"), ("im1", "right")):
        if stem not in found:
            raise side_missing(scene, side, f"there is no {stem}")
    file = scene / "calib.txt"
    entries = read_entries(file, "=")
    rig = _read_rig(entries)
    for stem in ("im0", "im1"):
        check_size(found[stem], read_image_size(found[stem]), (rig.left.size_wh,), str(file))
    return StereoPair(scene.name, found["im0"], found["im1"], rig=shared.share(rig))


def _read_rig(entries: Entries) -> StereoRig:
    path = entries.path
    width, height = (float(entries.numbers(key, 1)[0]) for key in ("width", "height"))
    if min(width, height) < 1 or width != int(width) or height != int(height):
        raise broken(path, "width and height are no image size", entries.texts["width"][0])
    size = (int(width), int(height))
    matrices = [_read_matrix(entries, key) for key in ("cam0", "cam1")]
    left, right = (make_camera(path, K, np.zeros(4), size) for K in matrices)
    doffs_px = float(entries.numbers("doffs", 1)[0])
    if abs(matrices[1][0, 2] - matrices[0][0, 2] - doffs_px) > DOFFS_TOLERANCE_PX:
        raise broken(
            path, "doffs is not the difference of the principal points of cam1 and cam0", entries.texts["doffs"][0]
        )
    baseline_mm = float(entries.numbers("baseline", 1)[0])
    if baseline_mm <= 0:
        raise broken(path, "baseline is not positive", entries.texts["baseline"][0])
    return make_rig(path, left, right, SE3(np.eye(3), np.array([-1e-3 * baseline_mm, 0.0, 0.0])))


def _read_matrix(entries: Entries, key: str) -> np.ndarray:
    """A matrix written as [a b c; d e f; g h i]."""
    if key not in entries:
        raise broken(entries.path, f"has no {key}")
    line, text = entries.texts[key]
    match = re.fullmatch(r"\s*\[([^\[\];]*;[^\[\];]*;[^\[\];]*)\]\s*", text)
    if not match:
        raise broken(entries.path, f"{key} is not a matrix of three rows in brackets", line)
    return Entries(entries.path, {key: (line, match[1].replace(";", " "))}).matrix(key, 3, 3)
