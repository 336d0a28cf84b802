"""``binocal simulate --rig turning``: cameras that turn before a rectangle, as files that ``calibrate --corners`` takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from binocal.formats import rig_json
from binocal.geometry import SE3
from binocal.output import staged_folder

BOARD, BOARD_VIEWS, BOARD_NOISE_PX = (
    "chessboard:11x8:60mm",
    20,
    0.1,
)  # that the cameras were calibrated with before they turned


def simulate_turning_cameras(
    n_pairs: int, output: str | Path, *, noise_px: float = 0.3, seed: int = 0, force: bool = False
) -> rig_json.Truth:
    """Write ``corners.npz``, ``rig.json`` (a calibration from before the cameras turned) and ``truth.json`` of the last pair.

    Raises:
        OutputExistsError: ``output`` holds files and ``force`` is False.
        OutputError: The disk is full, or the folder cannot be written to.
    """
    from binocal.boards import parse_board
    from binocal.calibrators import calibrate
    from binocal.formats.rectangles_npz import write_rectangles
    from binocal.simulation import StereoScene, sample_board_poses, simulate_detections
    from binocal.simulation.turning import TurningOptions, simulate_turning, turning_rig

    rig, board = turning_rig(), parse_board(BOARD)
    pairs_rng, board_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    scene = simulate_turning(rig, n_pairs, pairs_rng, TurningOptions(noise_px=noise_px))
    shown = StereoScene(rig, board, sample_board_poses(rig, board, BOARD_VIEWS, board_rng))
    before = calibrate(
        simulate_detections(shown, board_rng, noise_px=BOARD_NOISE_PX), calibrator="lm", model=rig.left.model
    )
    at_end = type(rig)(rig.left, rig.right, scene.T_right_left[-1], rig.is_metric)
    n = len(scene.pairs.names)
    still = SE3(np.repeat(np.eye(3)[None], n, axis=0), np.zeros((n, 3)))
    truth = rig_json.Truth(at_end, None, scene.pairs.names, still, scene="turning")
    with staged_folder(output, force=force, last=("truth.json",)) as folder:
        write_rectangles(folder / "corners.npz", scene.pairs)
        rig_json.write_calibration(folder / "rig.json", before)
        rig_json.write_truth(folder / "truth.json", truth)
    return truth
