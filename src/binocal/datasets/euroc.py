"""EuRoC and other data in ASL's layout: mav0/cam0, mav0/cam1, each with data/ and sensor.yaml.

``T_BS`` takes a camera's coordinates to the body's, so the rig is T_right_left = inv(T_BS1) T_BS0; metres. Images as the sensors
gave them: distorted, named by their time in nanoseconds (Burri et al. 2016, "The EuRoC micro aerial vehicle datasets").
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from binocal.cameras import Camera
from binocal.datasets.calibration_text import broken, make_camera, make_rig, nearest_rotation, read_text
from binocal.datasets.dataset import Dataset, StereoPair, check_size
from binocal.datasets.frames import list_images, match_by_time, name_some
from binocal.findings import finding, refusal
from binocal.geometry import SE3
from binocal.images.reading import read_image_size

_BRING_A_RIG = "give the images with --left and --right, and with --rig a rig that binocal reads"
_DISTORTIONS = {"radial-tangential": 4, "radtan": 4, "plumb_bob": 4, "equidistant": 4, "none": 0}


def open_euroc(path: Path, choice: str = "") -> Dataset:
    """The pairs and the rig of a sequence; ``path`` is the folder that holds mav0, or mav0.

    Images are paired with the nearest in time, within half the period that sensor.yaml states; others are left out and
    named (finding ``dataset-frames-left-out``).

    Raises:
        DataError: A camera or its sensor.yaml is missing or broken, no times match, or a size differs.
    """
    root = path / "mav0" if (path / "mav0").is_dir() else path
    if choice or not any((root / name).is_dir() for name in ("cam0", "cam1")):
        problem = f"the choice {choice!r} means nothing here" if choice else "there is no mav0/cam0"
        remedy = "leave it out" if choice else None
        raise refusal(finding("dataset-layout-unknown", remedy=remedy, path=str(path), kind="euroc", problem=problem))
    images = [list_images(root / name / "data", side) for name, side in (("cam0", "left"), ("cam1", "right"))]
    files = [root / name / "sensor.yaml" for name in ("cam0", "cam1")]
    (left, T_body_left, left_hz), (right, T_body_right, right_hz) = (_read_sensor(file) for file in files)
    rig = make_rig(files[1], left, right, T_body_right.inverse() @ T_body_left)
    for paths, camera, file in zip(images, (left, right), files, strict=True):
        first = next(iter(paths.values()))
        check_size(first, read_image_size(first), (camera.size_wh,), str(file))
    times = [_times(paths) for paths in images]
    lefts, rights = (sorted(side) for side in times)
    matches = match_by_time(lefts, rights, 0.5e9 / max(left_hz, right_hz))
    if not matches:
        raise refusal(
            finding(
                "dataset-frames-unmatched",
                n_unmatched=len(lefts) + len(rights),
                n_left=len(lefts),
                n_right=len(rights),
                first=str(times[0][lefts[0]]),
                place=str(root / "cam1" / "data"),
                names=name_some(path.stem for path in times[0].values()),
            )
        )
    pairs = tuple(
        StereoPair(times[0][lefts[i]].stem, times[0][lefts[i]], times[1][rights[j]], lefts[i], rights[j], rig)
        for i, j in matches
    )
    used = {path for pair in pairs for path in (pair.left_path, pair.right_path)}
    alone = tuple(
        (path, f"has no {other} partner within half the period")
        for side, other in zip(times, ("right", "left"), strict=True)
        for _, path in sorted(side.items())
        if path not in used
    )
    findings = ()
    if alone:
        names = name_some(f"{path.parent.parent.name}/{path.name}" for path, _ in alone)
        findings = (finding("dataset-frames-left-out", n_out=len(alone), n_pairs=len(pairs), names=names),)
    return Dataset("euroc", "EuRoC (mav0)", path, pairs, False, "T_BS in sensor.yaml", alone, findings)


def _times(paths: dict[str, Path]) -> dict[int, Path]:
    """Images by their time, nanoseconds."""
    times = {}
    for stem, path in paths.items():
        if not stem.isdecimal():
            problem = f"{path.name} is not named by its time in nanoseconds"
            raise refusal(finding("dataset-layout-unknown", path=str(path.parent), kind="euroc", problem=problem))
        times[int(stem)] = path
    return times


def _read_sensor(path: Path) -> tuple[Camera, SE3, float]:
    """Camera, T_body_camera and rate in Hz of a sensor.yaml."""
    document = _parse_yaml(path)
    size = _numbers(path, document, "resolution", 2)
    if min(size) < 1 or not np.array_equal(size, np.floor(size)):
        raise broken(path, "resolution is no image size", _line_of(path, "resolution"))
    if document.get("camera_model") != "pinhole":
        raise broken(
            path,
            f"camera_model is {document.get('camera_model')!r}, only pinhole can be read",
            _line_of(path, "camera_model"),
            _BRING_A_RIG,
        )
    model = document.get("distortion_model")
    if model not in _DISTORTIONS:
        known = ", ".join(_DISTORTIONS)
        problem = f"distortion_model is {model!r}; known are {known}"
        raise broken(path, problem, _line_of(path, "distortion_model"), _BRING_A_RIG)
    fx, fy, cx, cy = _numbers(path, document, "intrinsics", 4)
    distortion = (
        _numbers(path, document, "distortion_coefficients", _DISTORTIONS[model]) if model != "none" else np.zeros(4)
    )
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    camera = make_camera(path, K, distortion, (int(size[0]), int(size[1])), is_fisheye=model == "equidistant")
    entry = document.get("T_BS")
    if not isinstance(entry, dict):
        raise broken(path, "has no T_BS with data")
    T = _numbers(path, entry, "data", 16, "T_BS").reshape(4, 4)
    line = _line_of(path, "T_BS")
    if not np.allclose(T[3], (0, 0, 0, 1)):
        raise broken(path, "the last row of T_BS is not 0 0 0 1", line)
    (rate_hz,) = _numbers(path, {"rate_hz": [document.get("rate_hz")]}, "rate_hz", 1)
    if rate_hz <= 0:
        raise broken(path, "rate_hz is not positive", _line_of(path, "rate_hz"))
    return camera, SE3(nearest_rotation(T[:3, :3], path, "T_BS", line), T[:3, 3]), float(rate_hz)


def _parse_yaml(path: Path) -> dict[str, Any]:
    import yaml

    text = read_text(path)
    if text.startswith("%YAML"):  # OpenCV's header is no YAML directive; a blank line keeps the numbers of the others
        text = "\n" + text.partition("\n")[2]
    try:
        document = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        raise broken(
            path, f"is not YAML ({getattr(error, 'problem', error)})", mark.line + 1 if mark else None
        ) from None
    if not isinstance(document, dict):
        raise broken(path, "is not a list of names and values")
    return document


def _numbers(path: Path, document: dict[str, Any], key: str, count: int, name: str = "") -> np.ndarray:
    """A list of numbers under a key."""
    name = name or key
    values = document.get(key)
    if values is None:
        raise broken(path, f"has no {name}")
    try:
        numbers = [float(value) for value in values]
    except (TypeError, ValueError):
        raise broken(path, f"{name} holds something that is not a number", _line_of(path, name)) from None
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise broken(path, f"{name} has {len(numbers)} numbers, {count} finite ones needed", _line_of(path, name))
    return np.array(numbers)


def _line_of(path: Path, key: str) -> int | None:
    """The line where a top-level key stands."""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.startswith(f"{key}:"):
            return number
    return None
