"""binocal's own files, schema ``binocal/1``: ``rig.json`` (a calibration), ``truth.json`` (a simulated rig, its views).

Full precision (the shortest text that reads back to the same number), no NaN: an unknown number is ``null``. What a
``rig.json`` says beyond the keys that are known here is kept, and written back.
Lengths are in the file's ``unit``: metres, or board pitches where the board's size was not known.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from binocal.boards import Board, format_board, parse_board
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.errors import FormatError
from binocal.findings import UNCODED, Finding, Severity, finding_document
from binocal.geometry import SE3
from binocal.output import write_aside
from binocal.result import Covariance, OutlierCorner, RejectedView, ResidualSummary, StereoCalibration, ViewResult

SCHEMA = "binocal/1"
UNITS = {True: "m", False: "board pitch"}
_LARGEST = sys.float_info.max
_SURROGATE = re.compile("[\ud800-\udfff]")


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a simulation knows of its images: the rig, the board, and where the board stood in every view.

    ``noise_dn`` (grey levels) and ``blur_px`` say how the images were rendered; NaN where there are none.
    """

    rig: StereoRig
    board: Board
    names: tuple[str, ...]
    T_left_board: SE3
    noise_dn: float = math.nan
    blur_px: float = math.nan

    def __post_init__(self) -> None:
        if self.T_left_board.t.shape != (len(self.names), 3):
            raise ValueError(f"{len(self.names)} names for board poses of shape {self.T_left_board.t.shape}")


def rig_document(rig: StereoRig) -> dict[str, Any]:
    """The keys that every binocal file shares: cameras, R, T, baseline, the paper's angles in degrees."""
    gamma, lambda_, mu = np.degrees(rig.euler_rad).tolist()
    return {
        "schema": SCHEMA,
        "unit": UNITS[rig.is_metric],
        "left": _camera_document(rig.left),
        "right": _camera_document(rig.right),
        "R": rig.T_right_left.R.tolist(),
        "T": rig.T_right_left.t.tolist(),
        "baseline_m": rig.baseline_m,
        "euler_deg": {"gamma": gamma, "lambda": lambda_, "mu": mu},
    }


def calibration_document(calibration: StereoCalibration) -> dict[str, Any]:
    """``rig.json`` as a dictionary that holds only what JSON can say.

    ``views`` hold the board's pose in the left camera (R, T) where the calibration knows it; the corners stay out: they would
    make the file fifty times larger (:mod:`binocal.formats.detections_npz` holds them).
    """
    poses = calibration.T_left_board
    document = jsonable(
        rig_document(calibration.rig)
        | {
            "rms_px": {
                "left": calibration.rms.left_px,
                "right": calibration.rms.right_px,
                "all": calibration.rms.all_px,
            },
            "noise_px": calibration.noise_px,
            "sigma": calibration.covariance.sigma,
            "euler_sigma_deg": dict(
                zip(("gamma", "lambda", "mu"), np.degrees(calibration.euler_sigma_rad).tolist(), strict=True)
            ),
            "baseline_sigma_m": calibration.baseline_sigma_m,
            "covariance": {"names": calibration.covariance.names, "matrix": calibration.covariance.matrix},
            "views": [
                _view_document(view) | ({} if poses is None else {"R": poses.R[index], "T": poses.t[index]})
                for index, view in enumerate(calibration.views)
            ],
            "rejected": [
                {"name": view.name, "reason": view.reason} | ({"code": view.code} if view.code else {})
                for view in calibration.rejected
            ],
            **_findings_document(calibration.findings),
            "n_iterations": calibration.n_iterations,
            "provenance": calibration.provenance,
        }
        | ({} if calibration.misfit_px is None else {"misfit_px": calibration.misfit_px})
    )
    return with_unknown_keys(document, calibration.extra)


def _findings_document(findings: tuple[Finding, ...]) -> dict[str, Any]:
    """``findings``, or ``warnings`` as release 0.1 wrote them where the sentences come from one of its files."""
    if findings and all(found.code == UNCODED for found in findings):
        return {"warnings": [found.text for found in findings]}
    return {"findings": [finding_document(found) for found in findings]}


def _parse_findings(top: _Node) -> tuple[Finding, ...]:
    if "findings" not in top.value and "warnings" in top.value:
        return tuple(Finding(UNCODED, Severity.WARNING, text) for text in top.texts("warnings"))
    return tuple(
        Finding(
            found.text("code"),
            Severity(found.choice("severity", tuple(Severity))),
            found.text("text"),
            found.text("remedy"),
            found.mapping("figures").value,
        )
        for found in top.mappings("findings")
    )


def _view_document(view: ViewResult) -> dict[str, Any]:
    document = {
        "name": view.name,
        "rms_px": view.rms_px,
        "left_rms_px": view.left_rms_px,
        "right_rms_px": view.right_rms_px,
        "n_corners": view.n_corners,
        "n_outliers": view.n_outliers,
        "outliers": view.outliers,
        "note": view.note,
    }
    orders = {"left_order": view.left_order, "right_order": view.right_order}
    return document | {key: order for key, order in orders.items() if order}


def unknown_keys(document: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """What ``document`` says beyond ``known``, its own rewriting: keys at any depth, records of a list by their labels."""
    unknown: dict[str, Any] = {}
    for key, value in document.items():
        if key not in known:
            unknown[key] = value
        elif isinstance(value, dict) and isinstance(known[key], dict):
            if inner := unknown_keys(value, known[key]):
                unknown[key] = inner
        elif (
            (records := _records(value)) is not None
            and (others := _records(known[key])) is not None
            and (inner := unknown_keys(records, others))
        ):
            unknown[key] = inner
    return unknown


def with_unknown_keys(document: dict[str, Any], unknown: Mapping[str, Any]) -> dict[str, Any]:
    """The document with what :func:`unknown_keys` kept; records that are gone take theirs with them."""
    merged = dict(document)
    for key, value in unknown.items():
        if key not in document:
            merged[key] = jsonable(value)
        elif isinstance(document[key], dict) and isinstance(value, Mapping):
            merged[key] = with_unknown_keys(document[key], value)
        elif (records := _records(document[key])) is not None and isinstance(value, Mapping):
            merged[key] = [with_unknown_keys(record, value.get(label, {})) for label, record in records.items()]
    return merged


def _records(value: Any) -> dict[str, dict[str, Any]] | None:
    """Records of a list by their names, or by their places where those are missing or not unique; None: no records."""
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        return None
    names = [item.get("name") for item in value]
    is_named = all(isinstance(name, str) for name in names) and len(set(names)) == len(names)
    return dict(zip(names if is_named else map(str, range(len(value))), value, strict=True))


def truth_document(truth: Truth) -> dict[str, Any]:
    """``truth.json`` as a dictionary that holds only what JSON can say."""
    return jsonable(
        rig_document(truth.rig)
        | {
            "board": format_board(truth.board),
            "views": [
                {"name": name, "R": R, "T": t}
                for name, R, t in zip(truth.names, truth.T_left_board.R, truth.T_left_board.t, strict=True)
            ],
            "noise_dn": truth.noise_dn,
            "blur_px": truth.blur_px,
        }
    )


def write_calibration(path: str | Path, calibration: StereoCalibration, *, force: bool = False) -> None:
    """Write ``rig.json``, aside and then renamed.

    Raises:
        OutputExistsError: The file is there and ``force`` is False.
        DataError: The file cannot be written.
    """
    write_aside(path, dump_json(calibration_document(calibration)), force=force)


def write_rig(path: str | Path, rig: StereoRig, *, force: bool = False) -> None:
    """Write the rig alone, as :func:`read_rig` reads it. Raises as :func:`write_calibration`."""
    write_aside(path, dump_json(jsonable(rig_document(rig))), force=force)


def is_rig_file(path: str | Path) -> bool:
    """Whether the file is binocal's by what it says of itself: a JSON object with the key ``schema`` and a known start."""
    try:
        value = json.loads(Path(path).read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(value, dict) and str(value.get("schema", "")).startswith(SCHEMA.partition("/")[0] + "/")


def write_truth(path: str | Path, truth: Truth, *, force: bool = False) -> None:
    """Write ``truth.json``, aside and then renamed. Raises as :func:`write_calibration`."""
    write_aside(path, dump_json(truth_document(truth)), force=force)


def read_rig(path: str | Path) -> StereoRig:
    """The rig of a ``rig.json`` or ``truth.json``; nothing but the rig's own keys is looked at.

    Raises:
        FormatError: The file cannot be read, or a key is missing or not what it should be; the text names file and key.
    """
    return _parse_rig(_load(path))


def read_calibration(path: str | Path) -> StereoCalibration:
    """The calibration of a ``rig.json``; ``null`` becomes NaN. Raises as :func:`read_rig`.

    Without evidence, which the file does not hold: :meth:`binocal.StereoCalibration.with_evidence` brings it back.
    """
    top = _load(path)
    rms = top.mapping("rms_px")
    covariance = top.mapping("covariance")
    names = tuple(covariance.texts("names"))
    matrix = covariance.array("matrix", (len(names), len(names)), allow_null=True)
    views = top.mappings("views")
    calibration = StereoCalibration(
        rig=_parse_rig(top),
        covariance=Covariance(names, matrix),
        rms=ResidualSummary(*(rms.number(key, allow_null=True) for key in ("left", "right", "all"))),
        noise_px=top.number("noise_px", allow_null=True),
        views=tuple(
            ViewResult(
                name=view.text("name"),
                rms_px=view.number("rms_px", allow_null=True),
                left_rms_px=view.number("left_rms_px", allow_null=True),
                right_rms_px=view.number("right_rms_px", allow_null=True),
                n_corners=view.integer("n_corners"),
                outliers=tuple(
                    OutlierCorner(
                        corner.text("camera"), corner.integer("corner"), corner.number("distance_px", allow_null=True)
                    )
                    for corner in view.mappings("outliers")
                ),
                note=view.text("note"),
                left_order=view.order("left_order"),
                right_order=view.order("right_order"),
            )
            for view in views
        ),
        rejected=tuple(
            RejectedView(view.text("name"), view.text("reason"), view.text("code") if "code" in view.value else "")
            for view in top.mappings("rejected")
        ),
        findings=_parse_findings(top),
        n_iterations=top.integer("n_iterations"),
        provenance=top.mapping("provenance").value,
        T_left_board=_parse_poses(views) if any("R" in view.value for view in views) else None,
        misfit_px=top.number("misfit_px", allow_null=True) if "misfit_px" in top.value else None,
    )
    return replace(calibration, extra=unknown_keys(top.value, calibration_document(calibration)))


def read_truth(path: str | Path) -> Truth:
    """The truth that a simulation wrote. Raises as :func:`read_rig`."""
    top = _load(path)
    views = top.mappings("views")
    try:
        board = parse_board(top.text("board"))
    except ValueError as error:
        raise FormatError(path, f"key 'board': {error}") from None
    return Truth(
        rig=_parse_rig(top),
        board=board,
        names=tuple(view.text("name") for view in views),
        T_left_board=_parse_poses(views),
        noise_dn=top.number("noise_dn", allow_null=True),
        blur_px=top.number("blur_px", allow_null=True),
    )


def dump_json(document: Mapping[str, Any]) -> str:
    """JSON text of a document, one line per top-level key and per item of a list of records; NaN is an error."""
    lines = []
    for key, value in document.items():
        if isinstance(value, Sequence) and value and isinstance(value[0], Mapping):
            items = ",\n".join(f"    {json.dumps(item, allow_nan=False, ensure_ascii=False)}" for item in value)
            text = f"[\n{items}\n  ]"
        else:
            text = json.dumps(value, allow_nan=False, ensure_ascii=False)
        lines.append(f"  {json.dumps(key, ensure_ascii=False)}: {text}")
    text = "{\n" + ",\n".join(lines) + "\n}\n"
    # names of files may hold bytes that are no UTF-8; Python keeps them as lone surrogates
    return _SURROGATE.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def _camera_document(camera: Camera) -> dict[str, Any]:
    fx, fy, cx, cy, skew = camera.parameters[:5].tolist()
    return {
        "model": camera.model,
        "image_size": list(camera.size_wh),
        "fx": fx,
        "fy": fy,
        "cx": cx,
        "cy": cy,
        "skew": skew,
        "distortion": camera.distortion.tolist(),
    }


def jsonable(value: Any) -> Any:
    """The value in JSON's own types; what is not finite becomes None, a dataclass a dictionary."""
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: jsonable(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, np.ndarray):
        return jsonable(value.tolist())
    if isinstance(value, np.generic):
        return jsonable(value.item())
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Sequence | set | frozenset):
        return [jsonable(item) for item in value]
    return str(value)


@dataclass(frozen=True, slots=True)
class _Node:
    """A JSON object that knows its file and its place in it, so that every complaint can name them."""

    path: Path
    place: str
    value: Mapping[str, Any]

    def _get(self, key: str, expected: str) -> Any:
        if key not in self.value:
            raise FormatError(self.path, f"key '{self.place}{key}' is missing; expected {expected}")
        return self.value[key]

    def fail(self, key: str, expected: str) -> FormatError:
        shown = json.dumps(self.value.get(key))
        return FormatError(self.path, f"key '{self.place}{key}': expected {expected}, got {shown[:60]}")

    def number(self, key: str, *, allow_null: bool = False) -> float:
        expected = "a number or null" if allow_null else "a number"
        value = self._get(key, expected)
        if value is None and allow_null:
            return math.nan
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _LARGEST:
            raise self.fail(key, expected)
        return float(value)

    def integer(self, key: str) -> int:
        value = self._get(key, "a whole number")
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.fail(key, "a whole number")
        return value

    def order(self, key: str) -> tuple[int, ...]:
        """A permutation of 0, 1, ...; empty where there is none."""
        value = self.value.get(key, [])
        if not isinstance(value, list) or not all(type(item) is int for item in value):
            raise self.fail(key, "a list of whole numbers")
        if sorted(value) != list(range(len(value))):
            raise self.fail(key, "each of 0 to n - 1 once")
        return tuple(value)

    def text(self, key: str) -> str:
        value = self._get(key, "a text")
        if not isinstance(value, str):
            raise self.fail(key, "a text")
        return value

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        value = self.text(key)
        if value not in choices:
            raise self.fail(key, f"one of {', '.join(choices)}")
        return value

    def texts(self, key: str) -> list[str]:
        value = self._get(key, "a list of texts")
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self.fail(key, "a list of texts")
        return value

    def mapping(self, key: str) -> _Node:
        value = self._get(key, "an object")
        if not isinstance(value, dict):
            raise self.fail(key, "an object")
        return _Node(self.path, f"{self.place}{key}.", value)

    def mappings(self, key: str) -> list[_Node]:
        value = self._get(key, "a list of objects")
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.fail(key, "a list of objects")
        return [_Node(self.path, f"{self.place}{key}[{i}].", item) for i, item in enumerate(value)]

    def array(self, key: str, shape: tuple[int, ...], *, allow_null: bool = False) -> np.ndarray:
        """Numbers of that shape; -1 is any length."""
        words = f"{'x'.join('n' if n < 0 else str(n) for n in shape)} numbers"
        value = self._get(key, words)
        if allow_null:
            value = _null_to_nan(value)
        try:
            array = np.array(value)
        except ValueError:
            raise self.fail(key, words) from None
        if array.size == 0 and 0 in shape:
            return np.zeros(shape)
        is_numeric = array.dtype.kind in "if" and (allow_null or np.all(np.isfinite(array)))
        has_shape = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
        if not (is_numeric and has_shape):
            raise self.fail(key, words)
        return array.astype(float)


def _null_to_nan(value: Any) -> Any:
    if isinstance(value, list):
        return [_null_to_nan(item) for item in value]
    return math.nan if value is None else value


def _refuse_constant(word: str) -> Any:
    raise ValueError(f"it holds {word}; an unknown number is null")


def _load(path: str | Path) -> _Node:
    path = Path(path)
    try:
        value = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except FileNotFoundError:
        raise FormatError(path, "no such file") from None
    except OSError as error:
        raise FormatError(path, f"cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise FormatError(path, f"is not JSON: {error}") from None
    if not isinstance(value, dict) or "schema" not in value:
        raise FormatError(path, f"is not a binocal file: key 'schema' is missing; expected \"{SCHEMA}\"")
    if value["schema"] != SCHEMA:
        raise FormatError(path, f"key 'schema': expected \"{SCHEMA}\", got {json.dumps(value['schema'])[:60]}")
    return _Node(path, "", value)


def _parse_camera(node: _Node) -> Camera:
    model = node.text("model")
    try:
        n_distortion = len(camera_model(model).distortion_names)
    except ValueError as error:
        raise FormatError(node.path, f"key '{node.place}model': {error}") from None
    size = node.array("image_size", (2,))
    linear = [node.number(key) for key in ("fx", "fy", "cx", "cy", "skew")]
    distortion = node.array("distortion", (n_distortion,))
    try:
        return Camera(model, (int(size[0]), int(size[1])), np.r_[linear, distortion])
    except ValueError as error:
        raise FormatError(node.path, f"key '{node.place.rstrip('.')}': {error}") from None


def _parse_poses(views: list[_Node]) -> SE3:
    """T_left_board of every view."""
    R = np.array([view.array("R", (3, 3)) for view in views]).reshape(-1, 3, 3)
    t = np.array([view.array("T", (3,)) for view in views]).reshape(-1, 3)
    for view, R_view in zip(views, R, strict=True):
        try:
            SE3(R_view, np.zeros(3))
        except ValueError:
            raise view.fail("R", "a rotation matrix") from None
    return SE3(R, t)


def _parse_rig(top: _Node) -> StereoRig:
    left, right = _parse_camera(top.mapping("left")), _parse_camera(top.mapping("right"))
    R, t = top.array("R", (3, 3)), top.array("T", (3,))
    unit = top.value.get("unit", "m")
    if unit not in UNITS.values():
        raise top.fail("unit", '"m" or "board pitch"')
    try:
        T_right_left = SE3(R, t)
    except ValueError:
        raise top.fail("R", "a rotation matrix") from None
    return StereoRig(left, right, T_right_left, unit == "m")
