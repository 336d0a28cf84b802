"""binocal's own files, schema ``binocal/1``: ``rig.json`` (a calibration), ``truth.json`` (a simulated rig, its views).

Full precision (the shortest text that reads back to the same number), no NaN: an unknown number is ``null``. What a
``rig.json`` says beyond the keys that are known here is kept, and written back.
Lengths are in the file's ``unit``: metres, or board pitches where the board's size was not known.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from binocal.boards import Board, format_board, parse_board
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.cameras.camera import MOST_SIDE_PX
from binocal.errors import FormatError
from binocal.findings import UNCODED, Finding, Severity, finding_document
from binocal.formats.json_document import (
    Node,
    dump_json,
    jsonable,
    load_document,
    parse_whole,
    unknown_keys,
    with_unknown_keys,
)
from binocal.geometry import SE3
from binocal.input_file import MOST_TEXT_BYTES, read_file
from binocal.output import write_aside
from binocal.result import (
    BoardShape,
    Covariance,
    ExposureFit,
    OutlierCorner,
    RejectedView,
    ResidualSummary,
    StereoCalibration,
    ViewResult,
)
from binocal.uncertainty import MeanBoardPose

SCHEMA = "binocal/1"
UNITS = {True: "m", False: "board pitch"}


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a simulation knows of its images: the rig, the board, and where the board stood in every view.

    Without a board, ``scene`` says what was shown, and the poses are those of the scene's world. ``noise_dn`` (grey levels) and
    ``blur_px`` say how the images were rendered; NaN where there are none. ``gap_s``: by which the right exposures came later.
    """

    rig: StereoRig
    board: Board | None
    names: tuple[str, ...]
    T_left_board: SE3
    noise_dn: float = math.nan
    blur_px: float = math.nan
    scene: str = ""
    gap_s: float = 0.0
    aberration_px: float = 0.0
    """Lateral chromatic aberration in the images' corners; 0 is a grey image."""

    def __post_init__(self) -> None:
        if self.T_left_board.t.shape != (len(self.names), 3):
            raise ValueError(f"{len(self.names)} names for board poses of shape {self.T_left_board.t.shape}")
        if (self.board is None) == (not self.scene):
            raise ValueError("the truth is of a board or of a scene")


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

    ``views`` hold the board's pose in the left camera (R, T) where the calibration knows it, and in the right one (R_right,
    T_right) where the exposures were apart; the corners stay out: they would
    make the file fifty times larger (:mod:`binocal.formats.detections_npz` holds them).
    """
    poses, right = calibration.T_left_board, calibration.T_right_board
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
                _view_document(view)
                | ({} if poses is None else {"R": poses.R[index], "T": poses.t[index]})
                | ({} if right is None else {"R_right": right.R[index], "T_right": right.t[index]})
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
        | ({} if calibration.nominal_noise_px is None else {"nominal_noise_px": calibration.nominal_noise_px})
        | ({} if calibration.board_shape is None else {"board_shape": calibration.board_shape})
        | ({} if calibration.exposure is None else {"exposure": calibration.exposure})
        | ({} if calibration.mean_board_pose is None else {"mean_board_pose": calibration.mean_board_pose})
    )
    return with_unknown_keys(document, calibration.extra)


def _findings_document(findings: tuple[Finding, ...]) -> dict[str, Any]:
    """``findings``, or ``warnings`` as release 0.1 wrote them where the sentences come from one of its files."""
    if findings and all(found.code == UNCODED for found in findings):
        return {"warnings": [found.text for found in findings]}
    return {"findings": [finding_document(found) for found in findings]}


def _parse_findings(top: Node) -> tuple[Finding, ...]:
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


def truth_document(truth: Truth) -> dict[str, Any]:
    """``truth.json`` as a dictionary that holds only what JSON can say."""
    return jsonable(
        rig_document(truth.rig)
        | (
            {"scene": truth.scene, "gap_s": truth.gap_s}
            if truth.board is None
            else {"board": format_board(truth.board)}
        )
        | {
            "views": [
                {"name": name, "R": R, "T": t}
                for name, R, t in zip(truth.names, truth.T_left_board.R, truth.T_left_board.t, strict=True)
            ],
            "noise_dn": truth.noise_dn,
            "blur_px": truth.blur_px,
        }
        | ({"aberration_px": truth.aberration_px} if truth.aberration_px else {})
    )


def write_calibration(path: str | Path, calibration: StereoCalibration, *, force: bool = False) -> None:
    """Write ``rig.json``, aside and then renamed.

    Raises:
        OutputExistsError: The file is there and ``force`` is False.
        DataError: The file cannot be written.
    """
    write_aside(path, calibration_text(calibration), force=force)


def calibration_text(calibration: StereoCalibration) -> str:
    """What :func:`write_calibration` writes."""
    return dump_json(calibration_document(calibration))


def write_rig(path: str | Path, rig: StereoRig, *, force: bool = False) -> None:
    """Write the rig alone, as :func:`read_rig` reads it. Raises as :func:`write_calibration`."""
    write_aside(path, dump_json(jsonable(rig_document(rig))), force=force)


def is_rig_file(path: str | Path) -> bool:
    """Whether the file is binocal's by what it says of itself: a JSON object with the key ``schema`` and a known start."""
    value = _peek(path)
    return str(value.get("schema", "")).startswith(SCHEMA.partition("/")[0] + "/")


def holds_calibration(path: str | Path) -> bool:
    """Whether a file of binocal's says how the rig was calibrated, not only what it is."""
    return is_rig_file(path) and "sigma" in _peek(path)


def require_calibration(path: str | Path, purpose: str) -> None:
    """The file is a ``rig.json`` with a calibration, which ``purpose`` (such as "a report") needs; a damaged one its reader names.

    Raises:
        FormatError: It is missing, of another kind (such as OpenCV's), or a rig alone.
    """
    if holds_calibration(path):
        return
    is_object = bytes(read_file(path, most_bytes=MOST_TEXT_BYTES)).lstrip()[:1] == b"{"
    if not is_object or _peek(path):
        raise FormatError(
            path, f"holds no calibration of binocal's; {purpose} needs the rig.json that `binocal calibrate` wrote"
        )


def _peek(path: str | Path) -> dict[str, Any]:
    """The file's JSON object, empty where it is none."""
    try:
        value = json.loads(read_file(path, most_bytes=MOST_TEXT_BYTES), parse_int=parse_whole)
    except (FormatError, ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}


def write_truth(path: str | Path, truth: Truth, *, force: bool = False) -> None:
    """Write ``truth.json``, aside and then renamed. Raises as :func:`write_calibration`."""
    write_aside(path, dump_json(truth_document(truth)), force=force)


def read_rig(path: str | Path) -> StereoRig:
    """The rig of a ``rig.json`` or ``truth.json``; nothing but the rig's own keys is looked at.

    Raises:
        FormatError: The file cannot be read, or a key is missing or not what it should be; the text names file and key.
    """
    return _parse_rig(load_document(path, SCHEMA))


def read_calibration(path: str | Path) -> StereoCalibration:
    """The calibration of a ``rig.json``; ``null`` becomes NaN. Raises as :func:`read_rig`.

    Without evidence, which the file does not hold: :meth:`binocal.StereoCalibration.with_evidence` brings it back.
    """
    top = load_document(path, SCHEMA)
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
        T_right_board=_parse_poses(views, "R_right", "T_right") if any("R_right" in v.value for v in views) else None,
        nominal_noise_px=top.number("nominal_noise_px") if "nominal_noise_px" in top.value else None,
        board_shape=parse_board_shape(top),
        exposure=_parse_exposure(top),
        misfit_px=top.number("misfit_px", allow_null=True) if "misfit_px" in top.value else None,
        mean_board_pose=_parse_mean_board_pose(top, len(names)),
    )
    return replace(calibration, extra=unknown_keys(top.value, calibration_document(calibration)))


def read_truth(path: str | Path) -> Truth:
    """The truth that a simulation wrote. Raises as :func:`read_rig`."""
    top = load_document(path, SCHEMA)
    views = top.mappings("views")
    scene, gap_s, board = "", 0.0, None
    if "scene" in top.value:
        scene, gap_s = top.text("scene"), top.number("gap_s")
        if not scene:
            raise top.fail("scene", "the name of a scene")
    else:
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
        scene=scene,
        gap_s=gap_s,
        aberration_px=top.number("aberration_px") if "aberration_px" in top.value else 0.0,
    )


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


def _parse_camera(node: Node) -> Camera:
    model = node.text("model")
    try:
        n_distortion = len(camera_model(model).distortion_names)
    except ValueError as error:
        raise FormatError(node.path, f"key '{node.place}model': {error}") from None
    size = node.array("image_size", (2,))
    if not all(1 <= side <= MOST_SIDE_PX and side == int(side) for side in size):
        raise node.fail("image_size", "two whole numbers of pixels")
    linear = [node.number(key) for key in ("fx", "fy", "cx", "cy", "skew")]
    distortion = node.array("distortion", (n_distortion,))
    try:
        return Camera(model, (int(size[0]), int(size[1])), np.r_[linear, distortion])
    except ValueError as error:
        raise FormatError(node.path, f"key '{node.place.rstrip('.')}': {error}") from None


def _parse_poses(views: list[Node], rotation: str = "R", translation: str = "T") -> SE3:
    """The board's pose in a camera of every view."""
    R = np.array([view.array(rotation, (3, 3)) for view in views]).reshape(-1, 3, 3)
    t = np.array([view.array(translation, (3,)) for view in views]).reshape(-1, 3)
    for view, R_view in zip(views, R, strict=True):
        try:
            SE3(R_view, np.zeros(3))
        except ValueError:
            raise view.fail(rotation, "a rotation matrix") from None
    return SE3(R, t)


def parse_board_shape(top: Node) -> BoardShape | None:
    """The board's shape where the file holds one."""
    if "board_shape" not in top.value:
        return None
    node = top.mapping("board_shape")
    points_m, sigma_m = (node.array(name, (-1, 3)) for name in ("points_m", "sigma_m"))
    if len(points_m) != len(sigma_m):
        raise node.fail("sigma_m", "a row for each of points_m")
    names = [field.name for field in fields(BoardShape) if field.name not in ("points_m", "sigma_m")]
    figures = {name: node.number(name) for name in names}
    return BoardShape(points_m, sigma_m, **figures)


def _parse_exposure(top: Node) -> ExposureFit | None:
    if "exposure" not in top.value:
        return None
    node = top.mapping("exposure")
    figures = {name: node.number(name) for name in ("alone_px", "pair_px", "turn_sigma_rad", "shift_sigma_m")}
    return ExposureFit(**figures, are_apart=node.boolean("are_apart"))


def _parse_mean_board_pose(top: Node, n_parameters: int) -> MeanBoardPose | None:
    if "mean_board_pose" not in top.value:
        return None
    node = top.mapping("mean_board_pose")
    return MeanBoardPose(node.array("covariance", (6, 6)), node.array("with_rig", (6, n_parameters)))


def _parse_rig(top: Node) -> StereoRig:
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
