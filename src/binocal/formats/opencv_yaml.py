"""OpenCV's FileStorage files (YAML, JSON, XML): read and written without OpenCV.

R, T take left to right, as in binocal. Two layouts: ``intrinsics.yml`` + ``extrinsics.yml`` (the stereo sample's), or
one file. OpenCV stores neither image size nor length unit nor lens model; binocal writes them beside (``imageSize``,
``unit``, ``distortion_model``; other readers pass over them) and asks for what it cannot know when it reads.
"""

from __future__ import annotations

import json
import math
import re
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig
from binocal.errors import DataError, DegenerateGeometryError, FormatError
from binocal.formats.json_document import parse_whole, unique_keys
from binocal.geometry import SE3
from binocal.input_file import exists, read_text
from binocal.output import check_output, write_together
from binocal.rectification import rectify
from binocal.shapes import Float
from binocal.yaml_text import parse_yaml

MOST_BYTES = 16 << 20  # of text; a rig has 4 kB
MATRIX_TAGS = ("opencv-matrix", "opencv-nd-matrix")
MOST_DIMENSIONS = 32
UNITS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "board pitch": 1.0}

OPENCV_MODELS = frozenset(("brown4", "brown5", "brown8", "fisheye4"))

# Names seen in the wild, compared in lower case without "_" and "-".
_ALIASES = {
    "K_left": "m1 k1 cameramatrix1 cameramatrixleft leftcameramatrix intrinsicmatrix1 kleft kl m1left leftk",
    "K_right": "m2 k2 cameramatrix2 cameramatrixright rightcameramatrix intrinsicmatrix2 kright kr rightk",
    "D_left": "d1 distcoeffs1 distcoeffsleft leftdistcoeffs distortioncoefficients1 distortioncoefficientsleft dleft "
    "dl leftd leftdistortioncoefficients distcoeff1 distleft",
    "D_right": "d2 distcoeffs2 distcoeffsright rightdistcoeffs distortioncoefficients2 distortioncoefficientsright "
    "dr rightd rightdistortioncoefficients distcoeff2 distright",
    "R": "r rot rotation rotationmatrix",
    "T": "t trans translation translationvector",
    "R1": "r1 rectl rectificationleft",
    "R2": "r2 rectr rectificationright",
    "P1": "p1 projl projectionleft",
    "P2": "p2 projr projectionright",
    "Q": "q disparitytodepth",
    "size_left": "imagesize imgsize size imagesize1 imagesizeleft",
    "size_right": "imagesize2 imagesizeright",
    "width": "imagewidth width",
    "height": "imageheight height",
    "unit": "unit lengthunit",
    "distortion_model": "distortionmodel cameramodel",
}
_NAME_OF = {alias: name for name, aliases in _ALIASES.items() for alias in aliases.split()}
# KITTI-like capitals (CAMERA_MATRIX_LEFT) fall under the same names once lower-cased.


def write_opencv(path: str | Path, rig: StereoRig, *, force: bool = False) -> None:
    """Write a rig for OpenCV: one .yml (.yaml) file, or a folder with intrinsics.yml and extrinsics.yml.

    ``%YAML:1.0`` with 17 significant digits and a decimal point in every number, which every OpenCV reads; M1 D1 M2 D2
    R T, the rectification R1 R2 P1 P2 Q, and imageSize.

    Raises:
        DataError: The rig has skew, which OpenCV's functions ignore; or a file cannot be written.
        OutputExistsError: A file is there and ``force`` is False.

    Warns:
        UserWarning: A fisheye lens: readers must use ``cv2.fisheye`` by themselves, the matrices look the same. Or a rig that no
            pinhole rectifies, such as one camera behind the other: the file is without R1 to Q.
    """
    write_together(opencv_texts(path, rig, force=force), force=force)


def opencv_texts(path: str | Path, rig: StereoRig, *, force: bool = False) -> dict[str | Path, str]:
    """The files that :func:`write_opencv` writes, by their paths. Raises and warns as it does."""
    path = Path(path)
    check_writable_for_opencv(rig)
    camera_keys: list[tuple[str, Any]] = [("imageSize", list(rig.left.size_wh))]
    if rig.right.size_wh != rig.left.size_wh:
        camera_keys.append(("imageSize2", list(rig.right.size_wh)))
    models = {"fisheye" if camera.model == "fisheye4" else "brown_conrady" for camera in (rig.left, rig.right)}
    camera_keys.append(("distortion_model", models.pop()))
    camera_keys += [
        ("M1", rig.left.K),
        ("D1", rig.left.distortion[None]),
        ("M2", rig.right.K),
        ("D2", rig.right.distortion[None]),
    ]
    pair_keys: list[tuple[str, Any]] = [
        ("unit", "m" if rig.is_metric else "board pitch"),
        ("R", rig.T_right_left.R),
        ("T", rig.T_right_left.t[:, None]),
        *_rectification_keys(rig),
    ]
    targets = check_opencv_output(path, force=force)
    parts = [camera_keys + pair_keys] if len(targets) == 1 else [camera_keys, pair_keys]
    return {target: _format_storage(keys) for target, keys in zip(targets, parts, strict=True)}


def _rectification_keys(rig: StereoRig) -> list[tuple[str, Any]]:
    """R1 to Q of a pinhole; none, and a warning, where the rig has no such rectification: the cameras are good without it."""
    try:
        rectification = rectify(rig, size_wh=rig.left.size_wh, projection="pinhole")
    except DegenerateGeometryError as error:
        warnings.warn(f"the OpenCV file is without R1, R2, P1, P2 and Q: {error}", stacklevel=5)
        return []
    return [
        ("R1", rectification.R_rect_left),
        ("R2", rectification.R_rect_right),
        ("P1", rectification.P_left),
        ("P2", rectification.P_right),
        ("Q", rectification.Q),
    ]


def check_opencv_output(path: str | Path, *, force: bool = False) -> list[Path]:
    """The file, or the two files, that :func:`write_opencv` would write, once it is known that they may be.

    Raises:
        DataError: The path is neither a .yml file nor a folder, or cannot be written to.
        OutputExistsError: A file is there and ``force`` is False.
    """
    path = Path(path)
    if path.suffix.lower() in (".yml", ".yaml"):
        return [check_output(path, force=force)]
    if path.suffix:
        raise DataError(f"{path}: OpenCV output is a .yml file, or a folder for intrinsics.yml and extrinsics.yml.")
    return [check_output(path / name, force=force) for name in ("intrinsics.yml", "extrinsics.yml")]


def check_writable_for_opencv(rig: StereoRig) -> None:
    """What :func:`write_opencv` would refuse or warn of, before any work is lost. Raises and warns as it does."""
    for side, camera in (("left", rig.left), ("right", rig.right)):
        if camera.parameters[4] != 0:
            raise DataError(
                f"the {side} camera has skew {camera.parameters[4]:.6g} px, which OpenCV's functions ignore; "
                "calibrate without skew for an OpenCV file."
            )
        if camera.model not in OPENCV_MODELS:
            raise DataError(
                f"OpenCV has no camera model {camera.model}, which the {side} camera is of; "
                f"calibrate with one of {', '.join(sorted(OPENCV_MODELS))}."
            )
    is_fisheye = [camera.model == "fisheye4" for camera in (rig.left, rig.right)]
    if is_fisheye[0] != is_fisheye[1]:
        raise DataError("OpenCV cannot combine a fisheye with an ordinary lens; calibrate both with one model.")
    if all(is_fisheye):
        warnings.warn(
            "the OpenCV file holds a fisheye rig: read it with cv2.fisheye, "
            "the ordinary functions would take its numbers for another lens.",
            stacklevel=4,
        )


def opencv_losses(rig: StereoRig) -> tuple[str, ...]:
    """What of a rig OpenCV's files cannot hold; :func:`write_opencv` refuses such a rig."""
    losses = []
    if any(camera.parameters[4] != 0 for camera in (rig.left, rig.right)):
        losses.append("skew")
    models = {camera.model for camera in (rig.left, rig.right)}
    if not models <= OPENCV_MODELS or ("fisheye4" in models and len(models) > 1):
        losses.append("camera model")
    return tuple(losses)


def is_opencv_file(path: str | Path) -> bool:
    """Whether the file, or the folder of two, holds matrices under the names of OpenCV's stereo calibrations."""
    try:
        _, values = _load_stereo(Path(path))
    except FormatError:
        return False
    return {"K_left", "K_right", "R", "T"} <= values.keys()


def read_opencv(
    path: str | Path,
    *,
    size_wh: tuple[int, int] | None = None,
    unit: str | None = None,
    is_fisheye: bool | None = None,
) -> StereoRig:
    """The rig of an OpenCV file, or of a folder (or either file) of the two-file layout.

    What the file does not say must be said here: ``size_wh``, the images' size; ``unit`` of T (m, cm, mm, in, board
    pitch; metres if nobody says); ``is_fisheye`` for four coefficients of ``cv2.fisheye``. The arguments win over the
    file.

    Raises:
        FormatError: Not an OpenCV file, a matrix is missing or malformed, R is not a rotation, or the image size is
            unknown.

    Warns:
        UserWarning: The numbers contradict each other or are unlikely (see :func:`suspicions`).
    """
    path, values = _load_stereo(Path(path))
    for key, meaning in (("K_left", "M1"), ("K_right", "M2"), ("R", "R"), ("T", "T")):
        if key not in values:
            raise FormatError(
                path, f"matrix {meaning} is missing; expected M1 D1 M2 D2 R T (or a known other name of each)"
            )
    size_left = size_wh or _size(path, values, "size_left")
    if size_left is None:
        raise FormatError(path, "has no image size (OpenCV does not store it); give it: size_wh=(width, height)")
    size_right = size_wh or _size(path, values, "size_right") or size_left
    if is_fisheye is None:
        is_fisheye = str(values.get("distortion_model", "")).lower() in ("fisheye", "equidistant", "kannala_brandt")
    unit = str(values.get("unit", "m")) if unit is None else unit
    if unit not in UNITS_M:
        raise FormatError(path, f"unit {unit[:40]!r} is not one of {', '.join(UNITS_M)}")
    cameras = [
        _camera(path, _matrix(path, values, f"K_{side}", (3, 3)), _distortion(path, values, side), size, is_fisheye)
        for side, size in (("left", size_left), ("right", size_right))
    ]
    is_vector = _numbers(path, values, "R").size == 3
    R = _rotation_of_vector(path, values) if is_vector else _matrix(path, values, "R", (3, 3))
    t = _matrix(path, values, "T", (3,)) * UNITS_M[unit]
    try:
        T_right_left = SE3(R, t)
    except ValueError:
        raise FormatError(path, "matrix R is not a rotation (R Rᵀ = 1 within 1e-6, det R = +1)") from None
    rig = StereoRig(cameras[0], cameras[1], T_right_left, unit != "board pitch")
    stored = {key: _numbers(path, values, key) for key in ("R1", "R2", "P1", "P2") if key in values}
    for sentence in suspicions(rig, stored, UNITS_M[unit]):
        warnings.warn(f"{path}: {sentence}", stacklevel=2)
    return rig


def suspicions(rig: StereoRig, stored: Mapping[str, ndarray], unit_m: float = 1.0) -> list[str]:
    """Sentences on what is contradictory or unlikely in a rig that was read; ``stored``: the file's R1, R2, P1, P2."""
    found = []
    T = rig.T_right_left
    if {"R1", "R2"} <= stored.keys() and stored["R1"].shape == stored["R2"].shape == (3, 3):
        gap = np.abs(stored["R2"] @ T.R - stored["R1"]).max()
        if gap > 1e-6:
            found.append(
                f"R, R1 and R2 contradict each other (R2 R differs from R1 by {gap:.2g}): "
                "they come from different calibrations."
            )
        elif "P2" in stored and stored["P2"].shape == (3, 4) and stored["P2"][0, 0] > 0:
            expected = stored["P2"][:2, 3] / np.diag(stored["P2"])[:2] * unit_m
            gap = np.abs((stored["R2"] @ T.t)[:2] - expected).max() / rig.baseline_m
            if gap > 1e-5:
                found.append(f"T and P2 contradict each other by {gap:.2g} of the baseline.")
    if "P1" in stored and not stored["P1"].flat[0] > 0:
        found.append("P1 has a negative focal length: the calibration behind this file went wrong.")
    if rig.is_swapped:
        found.append(
            "T points to the left (T.x > 0): left and right cameras are exchanged; "
            "swap the images or the file's cameras."
        )
    if rig.is_metric and not 0.01 <= rig.baseline_m <= 5:
        found.append(
            f"the baseline is {rig.baseline_m:.6g} m, which is unlikely: T may be in another unit; give it (unit='mm')."
        )
    for side, camera in (("left", rig.left), ("right", rig.right)):
        fx, fy, cx, cy, skew = camera.parameters[:5]
        width, height = camera.size_wh
        if not all(0.2 * width <= f <= 10 * width for f in (fx, fy)):
            found.append(
                f"the {side} focal lengths {fx:.6g}, {fy:.6g} px are unlikely for images {width} px wide: "
                "wrong image size?"
            )
        if not (0 <= cx < width and 0 <= cy < height):
            found.append(
                f"the {side} principal point ({cx:.6g}, {cy:.6g}) is outside the {width}x{height} image: "
                "wrong image size?"
            )
        if skew != 0:
            found.append(f"the {side} matrix has skew {skew:.6g} px, which OpenCV's functions ignore and binocal uses.")
    return found


def _load_stereo(path: Path) -> tuple[Path, dict[str, Any]]:
    """The values by our names, of one file or of the two-file layout."""
    if exists(path) and path.is_dir():
        for suffix in (".yml", ".yaml", ".json", ".xml"):
            if (path / f"intrinsics{suffix}").exists() and (path / f"extrinsics{suffix}").exists():
                return path, _named(path / f"intrinsics{suffix}") | _named(path / f"extrinsics{suffix}")
        raise FormatError(path, "holds no intrinsics.yml and extrinsics.yml; name the file itself")
    values = _named(path)
    for one, other in (("intrinsics", "extrinsics"), ("extrinsics", "intrinsics")):
        partner = path.with_name(path.name.replace(one, other))
        if partner != path and exists(partner) and not {"K_left", "R"} <= values.keys():
            values = _named(partner) | values
    return path, values


def _named(path: Path) -> dict[str, Any]:
    """Values of one file by our names; a single level of nesting is looked through."""
    content = load_storage(path)
    found = _rename(content.items())
    if "K_left" not in found and "R" not in found:
        for value in content.values():
            if isinstance(value, Mapping):
                inner = _rename(value.items())
                if "K_left" in inner or "R" in inner:
                    return inner
    return found


def _rename(items: Iterable[tuple[Any, Any]]) -> dict[str, Any]:
    return {
        _NAME_OF[key]: value for name, value in items if (key := re.sub(r"[_\-\s]", "", str(name).lower())) in _NAME_OF
    }


def load_storage(path: str | Path) -> dict[str, Any]:
    """Content of a FileStorage file; matrices are float arrays (rows, columns) or (rows, columns, channels).

    Raises:
        FormatError: The file cannot be read or is not of that kind.
    """
    path = Path(path)
    text = read_text(path, most_bytes=MOST_BYTES)
    start = text.lstrip()[:1]
    parse = _parse_json if start == "{" else _parse_xml if start == "<" else _parse_yaml
    try:
        content = parse(path, text)
    except RecursionError:
        raise FormatError(path, "is nested too deeply for an OpenCV file") from None
    if not isinstance(content, dict) or not content:
        raise FormatError(path, "is not an OpenCV file: expected keys with values")
    return content


def _parse_yaml(path: Path, text: str) -> Any:
    lines = text.split("\n")
    n_before = 0
    while n_before < len(lines) and (not lines[n_before].strip() or lines[n_before].startswith("%YAML")):
        n_before += 1  # PyYAML rejects OpenCV's "%YAML:1.0"
    try:
        return parse_yaml(
            "\n".join(lines[n_before:]),
            {f"tag:yaml.org,2002:{tag}": lambda fields: _array(path, fields) for tag in MATRIX_TAGS},
        )
    except ValueError as error:
        raise FormatError(path, f"is not OpenCV YAML: {error}") from None


def _parse_json(path: Path, text: str) -> Any:
    try:
        return _with_arrays(path, json.loads(text, parse_int=parse_whole, object_pairs_hook=unique_keys))
    except ValueError as error:
        raise FormatError(path, f"is not JSON: {error}") from None


def _parse_xml(path: Path, text: str) -> Any:
    from xml.etree import ElementTree

    if "<!ENTITY" in text:
        raise FormatError(path, "holds XML entities, which an OpenCV file has no use for")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # an encoding that Python lacks or refuses
        raise FormatError(path, f"is not XML: {error}") from None
    return _with_arrays(path, _element(root))


def _element(element: Any) -> Any:
    children = list(element)
    if not children:
        words = (element.text or "").split()
        return [_scalar(word) for word in words] if len(words) > 1 else _scalar(words[0]) if words else ""
    value: dict[str, Any] = {child.tag: _element(child) for child in children}
    return value | ({"type_id": element.get("type_id")} if element.get("type_id") else {})


def _scalar(word: str) -> Any:
    word = word.strip('"')
    try:
        return parse_whole(word)
    except ValueError:
        try:
            return _number(word)
        except ValueError:
            return word


def _with_arrays(path: Path, value: Any) -> Any:
    if isinstance(value, dict):
        if str(value.get("type_id", "")) in MATRIX_TAGS:
            return _array(path, value)
        return {key: _with_arrays(path, item) for key, item in value.items()}
    return value


def _number(value: Any) -> float:
    """A number as FileStorage writes it: ``1.``, ``.Nan``, ``-.Inf``, and exponents that YAML takes for text."""
    if isinstance(value, str):
        special = value.strip().lower().lstrip("+-").lstrip(".")
        if special in ("nan", "inf"):
            return math.nan if special == "nan" else math.copysign(math.inf, -1 if value.strip().startswith("-") else 1)
    if isinstance(value, bool):
        raise ValueError("a truth value is not a number")
    try:
        return float(value)
    except OverflowError:
        raise ValueError("a number is larger than any double") from None


def _array(path: Path, fields: Mapping[str, Any]) -> Float[ndarray, "..."]:
    try:
        sizes = fields["sizes"] if "sizes" in fields else [fields["rows"], fields["cols"]]
        shape = [_count(n) for n in (sizes if isinstance(sizes, list) else [sizes])]
        dt = str(fields.get("dt", "d")).strip().strip('"')
        match = re.fullmatch(r"([0-9]{0,3})([ucwsifdh])", dt)
        if not match:
            raise FormatError(
                path, f"matrix type {dt[:40]!r} is not one of u c w s i f d h with an optional channel count"
            )
        channels = int(match[1] or 1)
        shape += [channels] if channels > 1 else []
        data = fields["data"]
        numbers = np.array([_number(item) for item in (data if isinstance(data, list) else [data])])
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(
            path, f"a matrix is malformed ({type(error).__name__}: {str(error)[:80]}); expected rows, cols, dt, data"
        ) from None
    if numbers.size != math.prod(shape) or len(shape) > MOST_DIMENSIONS:
        raise FormatError(path, f"a matrix of {'x'.join(map(str, shape))[:80]} holds {numbers.size} numbers")
    return numbers.reshape(shape)


def _count(value: Any) -> int:
    """A whole number of rows or columns."""
    number = _number(value)
    if not (0 <= number < 2**31 and number == int(number)):
        raise ValueError(f"{str(value)[:40]!r} is no number of rows or columns")
    return int(number)


def _numbers(path: Path, values: Mapping[str, Any], key: str) -> ndarray:
    """What stands under a key, as finite numbers of whatever shape."""
    try:
        array = np.array(values[key], dtype=float)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise FormatError(path, f"{key} is not a matrix") from None
    if not np.all(np.isfinite(array)):
        raise FormatError(path, f"{key} must hold finite numbers")
    return array


def _matrix(path: Path, values: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> ndarray:
    array = _numbers(path, values, key)
    if array.size != math.prod(shape):
        raise FormatError(path, f"{key} must hold {'x'.join(map(str, shape))} finite numbers; got {array.shape}")
    return array.reshape(shape)


def _rotation_of_vector(path: Path, values: Mapping[str, Any]) -> ndarray:
    from binocal.geometry import so3

    return so3.exp(_matrix(path, values, "R", (3,)))


def _size(path: Path, values: Mapping[str, Any], key: str) -> tuple[int, int] | None:
    value = values.get(key)
    if value is None and key == "size_left" and {"width", "height"} <= values.keys():
        value = [values["width"], values["height"]]
    if value is None:
        return None
    try:
        width, height = (int(_number(n)) for n in np.ravel(value).tolist())
    except (TypeError, ValueError, OverflowError):
        raise FormatError(path, f"image size {str(value)[:80]!r} is not [width, height]") from None
    if width < 1 or height < 1:
        raise FormatError(path, f"image size {width}x{height} is not positive")
    return width, height


def _distortion(path: Path, values: Mapping[str, Any], side: str) -> ndarray:
    key = f"D_{side}"
    return np.zeros(4) if values.get(key) is None else _numbers(path, values, key).ravel()


def _camera(path: Path, K: ndarray, d: ndarray, size_wh: tuple[int, int], is_fisheye: bool) -> Camera:
    try:
        if is_fisheye and d.size != 4:
            raise ValueError(f"a fisheye lens has 4 coefficients; got {d.size}")
        if np.abs(K[2] - [0, 0, 1]).max() > 1e-9 or abs(K[1, 0]) > 1e-9:
            raise ValueError("a camera matrix is not [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]")
        return Camera.from_opencv(K, d, size_wh, is_fisheye=is_fisheye)
    except (TypeError, ValueError) as error:
        raise FormatError(path, f"camera: {error}") from None


def _format_storage(keys: Iterable[tuple[str, Any]]) -> str:
    lines = ["%YAML:1.0", "---"]
    for key, value in keys:
        if isinstance(value, ndarray):
            rows, columns = value.shape
            lines += [f"{key}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d"]
            lines += _wrapped("   data: [ ", [_format_number(x) for x in value.ravel()])
        elif isinstance(value, list):
            lines.append(f"{key}: [ {', '.join(str(int(n)) for n in value)} ]")
        else:
            lines.append(f'{key}: "{value}"')
    return "\n".join(lines) + "\n"


def _wrapped(start: str, words: list[str]) -> list[str]:
    lines, line = [], start
    for i, word in enumerate(words):
        piece = word + (", " if i < len(words) - 1 else " ]")
        if len(line) + len(piece) > 80 and line.strip():
            lines.append(line.rstrip())
            line = " " * 7
        line += piece
    return [*lines, line]


def _format_number(x: float) -> str:
    """17 significant digits with a decimal point: OpenCV 4.11 corrupts whole numbers in a matrix of doubles."""
    if x == 0 or (abs(x) < 1e6 and x == int(x)):
        return f"{int(x)}."
    return f"{x:.16e}"
