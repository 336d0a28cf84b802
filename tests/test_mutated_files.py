"""Whatever is wrong with a file: one line that names it, the right exit code, no hang, no great memory.

The fast tests take a few damaged copies of each kind of file that is read, the slow ones 200.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocal.cameras import StereoRig
from binocal.cli import main
from binocal.formats import detections_npz, opencv_yaml, rig_json
from binocal.result import BoardShape
from binocal.rl.agent_kind import AgentKind
from binocal.rl.policy import save_policy, shipped_policy
from binocal.simulation import sample_board_poses
from mutation import mutations
from rigs import make_calibration, make_detections, make_poses, make_rig

N_FAST, N_SLOW = 6, 200
MOST_S, MOST_BYTES = 2.0, 500 << 20  # of work: a busy machine makes no command wrong
BOARD = "chessboard:9x6:30mm"
NO_BOARD = ["calibrate", "--left", "none/l*.png", "--right", "none/r*.png", "--output", "out.json"]
NO_IMAGES = [*NO_BOARD, "--board", BOARD]


@dataclass(frozen=True)
class Kind:
    """A kind of file: how to make a sound one, and a command that reads it (FILE stands for its name)."""

    name: str
    make: Callable[[Path], None]
    command: tuple[str, ...]
    is_text: bool = False
    codes: tuple[int, ...] = (3,)


def _image(suffix: str, *, colour: bool = False, dtype: type = np.uint8, flags: tuple[int, ...] = ()) -> Kind:
    def make(path: Path) -> None:
        rng = np.random.default_rng(1)
        image = cv2.GaussianBlur(rng.uniform(0, np.iinfo(dtype).max, (96, 128, 3 if colour else 1)), (0, 0), 3)
        path.write_bytes(cv2.imencode(suffix, image.astype(dtype), flags)[1].tobytes())

    command = ["calibrate", "--left", "FILE", "--right", "right.png", "--board", BOARD, "--output", "out.json"]
    name = (
        f"image-{suffix[1:]}-{'colour' if colour else 'grey'}-{np.dtype(dtype).name}{''.join(f'-{f}' for f in flags)}"
    )
    return Kind(f"{name}{suffix}", make, tuple(command))


def _rig() -> StereoRig:
    return make_rig(t=(-0.06, 0.001, 0.002))


def _truth(path: Path) -> None:
    from binocal.boards import parse_board

    board = parse_board(BOARD)
    poses = sample_board_poses(_rig(), board, 3, np.random.default_rng(0))
    rig_json.write_truth(path, rig_json.Truth(_rig(), board, ("00", "01", "02"), poses, 3.0, 0.8), force=True)


def _opencv_json(path: Path) -> None:
    rig = _rig()
    matrices = {"M1": rig.left.K, "M2": rig.right.K, "R": rig.T_right_left.R, "T": rig.T_right_left.t[:, None]}
    matrices |= {"D1": rig.left.distortion[None], "D2": rig.right.distortion[None]}
    as_json = {
        key: {"type_id": "opencv-matrix", "rows": len(m), "cols": m.shape[1], "dt": "d", "data": m.ravel().tolist()}
        for key, m in matrices.items()
    }
    path.write_text(json.dumps({"imageSize": list(rig.left.size_wh)} | as_json, indent=1))


def _opencv_xml(path: Path) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    rig = _rig()
    storage.write("M1", rig.left.K), storage.write("M2", rig.right.K)
    storage.write("R", rig.T_right_left.R), storage.write("T", rig.T_right_left.t[:, None])
    storage.write("imageSize", np.array([rig.left.size_wh], float))
    storage.release()


def _kalibr(path: Path) -> None:
    path.write_text("target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n")


def _corners(path: Path) -> None:
    detections = make_detections(make_rig(), make_poses(3, np.random.default_rng(0)))
    points = detections.object_points_m
    n_figures = len(detections_npz.SHAPE_FIGURES)
    shape = BoardShape(points, np.full_like(points, 1e-5), *([0.0] * n_figures))
    detections_npz.write_detections(path, detections, board_shape=shape, force=True)


ON_RIG = ("evaluate", "FILE", "--left", "none/l*", "--right", "none/r*", "--board", BOARD)
KINDS = [
    _image(".png"),
    _image(".png", colour=True, dtype=np.uint16),
    _image(".jpg"),
    _image(".jpg", colour=True, flags=(cv2.IMWRITE_JPEG_PROGRESSIVE, 1)),
    _image(".tif", flags=(cv2.IMWRITE_TIFF_COMPRESSION, 1)),
    _image(".tif", colour=True, dtype=np.uint16),
    _image(".bmp", colour=True),
    _image(".pgm"),
    _image(".ppm", colour=True, flags=(cv2.IMWRITE_PXM_BINARY, 0)),
    Kind(
        "rig.json",
        lambda path: rig_json.write_calibration(path, make_calibration(), force=True),
        ("evaluate", "FILE", "--truth", "truth.json"),
        True,
        (0, 3),
    ),
    Kind(
        "prior.json",
        lambda path: rig_json.write_calibration(path, make_calibration(), force=True),
        (*NO_IMAGES, "--prior", "FILE"),
        True,
    ),
    Kind("truth-of.json", _truth, ("evaluate", "rig.json", "--truth", "FILE"), True, (0, 3)),
    Kind("board.yaml", lambda path: path.write_text(f"board: {BOARD}\n"), (*NO_BOARD, "--board", "FILE"), True),
    Kind("kalibr.yaml", _kalibr, (*NO_BOARD, "--board", "FILE"), True),
    Kind("opencv.yml", lambda path: opencv_yaml.write_opencv(path, _rig(), force=True), ON_RIG, True),
    Kind("opencv.json", _opencv_json, ON_RIG, True),
    Kind("opencv.xml", _opencv_xml, ON_RIG, True),
    Kind(
        "agent.safetensors",
        lambda path: save_policy(shipped_policy(AgentKind.DRL), path),
        (*NO_IMAGES, "--calibrator", "FILE"),
    ),
    Kind(
        "corners.npz",
        _corners,
        (*NO_IMAGES, "--board-file", "FILE"),
    ),
]


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """A limit on time, which even a loop in C cannot ignore, and on memory beyond what there is now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MOST_BYTES, before[1]))
    signal.alarm(30)
    try:
        yield
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, before)


def check_one(kind: Kind, content: bytes, folder: Path, name: str) -> None:
    path = folder / kind.name
    path.write_bytes(content)
    arguments = [kind.name if argument == "FILE" else argument for argument in kind.command]
    out, err = io.StringIO(), io.StringIO()
    began = time.process_time()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), limited():
        code = main([*arguments, "--json"])
    elapsed_s = time.process_time() - began
    said = [line for line in err.getvalue().splitlines() if line.startswith("binocal: ")]
    where = f"{name}, kept as {path}: exit code {code}, {elapsed_s:.1f} s, {err.getvalue()[:500]}"
    assert code in kind.codes, where
    assert len(said) == (code != 0) and len(err.getvalue()) < 6000, where
    assert elapsed_s < MOST_S, where
    document = json.loads(out.getvalue(), parse_constant=lambda word: pytest.fail(f"{word} on stdout: {where}"))
    assert ("error" in document) == (code != 0), where
    assert not (folder / "out.json").exists(), where


def check_many(kind: Kind, n: int, seed: int, folder: Path) -> None:
    kind.make(folder / kind.name)
    sound = (folder / kind.name).read_bytes()
    check_one(kind, sound, folder, "the sound file")
    for index, content in enumerate(mutations(sound, n, seed, is_text=kind.is_text)):
        check_one(kind, content, folder, f"copy {index} of seed {seed}")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("right.png", np.full((96, 128), 200, np.uint8))
    rig_json.write_calibration("rig.json", make_calibration())
    _truth(Path("truth.json"))
    return tmp_path


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_damaged_files_are_one_line(kind, folder):
    check_many(kind, N_FAST, 1, folder)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_200_damaged_files_are_one_line(kind, folder):
    check_many(kind, N_SLOW, 2, folder)


if __name__ == "__main__":  # python tests/test_mutated_files.py KIND N SEED: more of them, by hand
    wanted, n, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    os.chdir(sys.argv[4])
    for one in KINDS:
        if wanted in one.name:
            check_many(one, n, seed, Path.cwd())
