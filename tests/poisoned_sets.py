"""Simulated sets, some of them spoiled, as a worker process makes and calibrates them (see test_many_sets.py).

In a module of its own: a worker imports it by name, and a test module has none there.
"""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np

from binocal import app, threads
from binocal.boards import parse_board
from binocal.calibrators import CalibrationRequest
from binocal.cameras import Camera, StereoRig
from binocal.errors import BinocalError
from binocal.geometry import SE3, so3

BOARD = parse_board("chessboard:7x5:30mm")


def rig_of(index: int) -> StereoRig:
    """A rig of its own for each set: baselines of 60 to 99 mm."""
    left = Camera("brown4", (640, 480), np.array([800.0 + index, 801.0, 322.0, 238.0, 0, -0.1, 0.05, 0, 0]))
    right = Camera("brown4", (640, 480), np.array([803.0, 799.0 + index, 318.0, 243.0, 0, -0.1, 0.05, 0, 0]))
    return StereoRig(left, right, SE3(so3.exp(np.array([0.01, -0.03, 0.005])), np.array([-0.06 - 1e-3 * index, 0, 0])))


def tail_of_fill_bytes(folder: Path) -> None:
    for path in folder.glob("left*"):
        jpeg = cv2.imencode(".jpg", cv2.imread(str(path)))[1].tobytes()
        path.write_bytes(jpeg[:-2] + b"\xff" * 300_000)


def pipes(folder: Path) -> None:
    for path in folder.glob("right*"):
        path.unlink()
        os.mkfifo(path)


def huge_claims(folder: Path) -> None:
    for path in folder.glob("left*"):
        path.write_bytes(b"P5 60000 60000 255\n" + bytes(1000))


def same_images(folder: Path) -> None:
    for path in folder.glob("left*"):
        path.with_name(path.name.replace("left", "right")).write_bytes(path.read_bytes())


def no_board(folder: Path) -> None:
    for seed, path in enumerate(sorted(folder.glob("*.png"))):
        cv2.imwrite(str(path), np.random.default_rng(seed).integers(0, 255, (480, 640), np.uint8))


POISONS = {
    3: (tail_of_fill_bytes, "truncated JPEG"),
    8: (pipes, "is a pipe"),
    13: (huge_claims, "truncated PNM|too large"),
    17: (same_images, "same image"),
    22: (no_board, "was found in none"),
}


def work(index: int, root: str) -> tuple[float, str]:
    """The baseline of a set, or what is wrong with it."""
    threads.set_threads(1)
    folder = Path(root) / f"{index:02d}"
    options = app.SimulateOptions(noise_dn=1.0, seed=index)
    app.simulate(rig_of(index), BOARD, 5, folder, options)
    if index in POISONS:
        POISONS[index][0](folder)
    try:
        request = CalibrationRequest("brown4")
        run = app.calibrate_images(str(folder / "left*.png"), str(folder / "right*.png"), BOARD, request)
    except BinocalError as error:
        return float("nan"), str(error)
    return run.calibration.rig.baseline_m, ""
