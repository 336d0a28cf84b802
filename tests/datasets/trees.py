"""Small data sets in the original layouts, written to a folder: tiny calibrations, images of one grey value."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from binocal.geometry import SE3, so3
from binocal.images.png import encode_png

SIZE, RAW_SIZE = (62, 20), (70, 26)
R_1, T_1 = so3.exp(np.array([0.01, -0.02, 0.005])), np.array([-0.5, 0.01, -0.02])
T_BODY_LEFT = SE3(so3.exp(np.array([0.1, 1.2, -0.4])), np.array([0.1, -0.2, 0.3]))
T_RIGHT_LEFT = SE3(R_1, T_1)


def write_image(path: Path, size_wh: tuple[int, int] = SIZE, grey: int = 90) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode_png(np.full(size_wh[::-1], grey, np.uint8)))


def write_text(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def numbers(values) -> str:
    return " ".join(f"{value:.9e}" for value in np.ravel(values))


def projection(t_m: tuple[float, float, float], focal_px: float = 50.0) -> np.ndarray:
    K = np.array([[focal_px, 0, 30.0], [0, focal_px, 9.0], [0, 0, 1]])
    return K @ np.c_[np.eye(3), t_m]


def cam_to_cam() -> str:
    lines = ["calib_time: 09-Jan-2012 13:57:47"]
    for number in range(4):
        R, t = (np.eye(3), np.zeros(3)) if number in (0, 2) else (R_1, T_1)
        lines += [
            f"S_0{number}: {numbers(RAW_SIZE)}",
            f"K_0{number}: {numbers([[60 + number, 0, 34], [0, 60, 12], [0, 0, 1]])}",
            f"D_0{number}: -0.3 0.2 0.001 0.002 -0.07",
            f"R_0{number}: {numbers(R)}",
            f"T_0{number}: {numbers(t)}",
            f"S_rect_0{number}: {numbers(SIZE)}",
            f"R_rect_0{number}: {numbers(R.T)}",
            f"P_rect_0{number}: {numbers(projection((-0.5 * (number % 2) + 0.06 * (number > 1), 0.001 * number, 0)))}",
        ]
    return "\n".join(lines) + "\n"


def kitti_raw(root: Path, *, is_rectified: bool = True) -> Path:
    drive = root / "2011_09_26" / f"2011_09_26_drive_0001_{'sync' if is_rectified else 'extract'}"
    write_text(root / "2011_09_26" / "calib_cam_to_cam.txt", cam_to_cam())
    for number in range(4):
        folder = drive / f"image_0{number}"
        for frame in (0, 1, 3):
            write_image(folder / "data" / f"{frame:010d}.png", SIZE if is_rectified else RAW_SIZE)
        times = "".join(f"2011-09-26 13:02:4{frame}.33412659{number}\n" for frame in range(4))
        write_text(folder / "timestamps.txt", times)
    return drive


def kitti_listed(root: Path, form: str) -> Path:
    """stereo2012, stereo2015, object or odometry."""
    names = ("000000_10", "000000_11", "000001_10") if "stereo" in form else ("000000", "000001", "000002")
    for number in range(4):
        folder = f"colored_{number - 2}" if form == "stereo2012" and number > 1 else f"image_{number}"
        if form not in ("stereo2015", "object") or number > 1:
            for name in names:
                write_image(root / folder / f"{name}.png")

    def listed(focal_px):
        return "".join(
            f"P{n}: {numbers(projection((-0.5 * (n % 2) + 0.06 * (n > 1), 0, 0), focal_px))}\n" for n in range(4)
        )

    for frame in sorted({name[:6] for name in names}):
        focal_px = 50.0 + (frame == "000001") * (form != "odometry")
        if form == "stereo2015":
            write_text(root / "calib_cam_to_cam" / f"{frame}.txt", cam_to_cam())
        elif form != "odometry":
            write_text(root / "calib" / f"{frame}.txt", listed(focal_px) + f"R0_rect: {numbers(np.eye(3))}\n")
    if form == "odometry":
        write_text(root / "calib.txt", listed(50.0))
        write_text(root / "times.txt", "0.0\n1.037359e-01\n2.0\n")
    return root


def cityscapes(root: Path) -> Path:
    for part, baseline_m in (("train/aachen", 0.2), ("train/bochum", 0.2), ("val/lindau", 0.3)):
        city = part.rpartition("/")[2]
        for frame in ("000000_000019", "000001_000019"):
            for side in ("leftImg8bit", "rightImg8bit"):
                write_image(root / side / part / f"{city}_{frame}_{side}.png")
            camera = {
                "extrinsic": {"baseline": baseline_m, "pitch": 0.038, "roll": 0.0, "x": 1.7, "y": 0.1, "yaw": -0.02, "z": 1.2},
                "intrinsic": {"fx": 50.0, "fy": 51.0, "u0": 30.0, "v0": 9.0},
            }  # fmt: skip
            write_text(root / "camera" / part / f"{city}_{frame}_camera.json", json.dumps(camera))
    return root


def euroc(root: Path, offset_ns: int = 0) -> Path:
    T_body_right = T_BODY_LEFT @ T_RIGHT_LEFT.inverse()
    for name, T in (("cam0", T_BODY_LEFT), ("cam1", T_body_right)):
        shift = offset_ns if name == "cam1" else 0
        for index in range(4):
            write_image(root / "mav0" / name / "data" / f"{1403715273262142976 + index * 50_000_000 + shift}.png")
        data = ", ".join(f"{x:.12f}" for x in np.r_[np.c_[T.R, T.t], [[0, 0, 0, 1]]].ravel())
        write_text(
            root / "mav0" / name / "sensor.yaml",
            "%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
            f"  data: [{data}]\nrate_hz: 20\nresolution: [62, 20]\ncamera_model: pinhole\n"
            "intrinsics: [50.0, 51.0, 30.0, 9.0] #fu, fv, cu, cv\ndistortion_model: radial-tangential\n"
            "distortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]\n",
        )
    return root


def middlebury(root: Path) -> Path:
    for stem in ("im0", "im1"):
        write_image(root / "curule" / f"{stem}.png")
    write_text(
        root / "curule" / "calib.txt",
        "cam0=[50 0 28.5; 0 50 9; 0 0 1]\ncam1=[50 0 30.25; 0 50 9; 0 0 1]\ndoffs=1.75\nbaseline=193.001\n"
        "width=62\nheight=20\nndisp=28\n",
    )
    return root
