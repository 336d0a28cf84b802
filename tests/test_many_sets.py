"""Many sets in many worker processes: what is wrong with some of them is named and does not touch the others."""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocal import app, threads
from binocal.boards import parse_board
from binocal.calibrators import CalibrationRequest
from binocal.cameras import Camera, StereoRig
from binocal.errors import BinocalError
from binocal.geometry import SE3, so3

N_SETS, N_WORKERS = 40, 8
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
    11: (pipes, "is a pipe"),
    17: (huge_claims, "truncated PNM|too large"),
    26: (same_images, "same image"),
    38: (no_board, "was found in none"),
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


@pytest.mark.slow
def test_poisoned_sets_are_named_and_the_others_are_right(tmp_path):
    with ProcessPoolExecutor(N_WORKERS, multiprocessing.get_context("spawn")) as pool:
        results = list(pool.map(work, range(N_SETS), [str(tmp_path)] * N_SETS, timeout=500))
    for index, (baseline_m, problem) in enumerate(results):
        if index in POISONS:
            assert any(words in problem for words in POISONS[index][1].split("|")), (index, problem)
        else:
            assert not problem and baseline_m == pytest.approx(rig_of(index).baseline_m, rel=0.01), (index, problem)
