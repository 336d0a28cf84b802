"""``binocal demo``: both boards of the paper, rendered, calibrated and compared with the truth."""

from __future__ import annotations

import glob
import os
from dataclasses import dataclass, replace
from pathlib import Path

from binocal.app.calibrate import CalibrationRun, calibrate_images
from binocal.app.evaluate import TruthEvaluation, evaluate_truth
from binocal.app.simulate import SimulateOptions, simulate
from binocal.boards import Board
from binocal.calibrators.base import CalibrationRequest
from binocal.formats import rig_json
from binocal.output import staged_folder
from binocal.progress import ProgressCallback, prefixed

DEMO_SQUARES_M = (0.010, 0.020)  # the two boards of the paper's table 3


@dataclass(frozen=True, slots=True, eq=False)
class DemoCase:
    """One board of the demonstration: the folder with its files, the calibration, and how near the truth it came."""

    name: str
    folder: Path
    run: CalibrationRun
    evaluation: TruthEvaluation


def demo(
    output: str | Path,
    *,
    seed: int = 0,
    n_pairs: int = 20,
    force: bool = False,
    progress: ProgressCallback | None = None,
) -> tuple[DemoCase, ...]:
    """Render the table-2 rig with both of the paper's boards, calibrate each from its images, compare with the truth.

    ``output`` gets a folder per board with images, truth.json and rig.json, all at once at the end.

    Raises:
        OutputExistsError: ``output`` holds files and ``force`` is False.
    """
    output, cases = Path(output), []
    with staged_folder(output, force=force, last=("truth.json", "rig.json")) as folder:
        for number, square_m in enumerate(DEMO_SQUARES_M):
            case = _demonstrate(folder, number, square_m, n_pairs, seed, progress)
            cases.append(replace(case, folder=output / case.name))
    return tuple(cases)


def _demonstrate(
    output: Path, number: int, square_m: float, n_pairs: int, seed: int, progress: ProgressCallback | None
) -> DemoCase:
    """One board, in a new folder of ``output``."""
    from binocal.simulation import table2_rig

    name = f"{square_m * 1e3:.0f}mm"
    board = Board.from_spec(f"chessboard:11x8:{name}")
    folder = output / name
    of_board = prefixed(progress, f"{name} board: ")
    options = SimulateOptions(seed=2 * seed + number)
    truth = simulate(table2_rig(), board, n_pairs, folder, options, progress=of_board)
    left, right = (os.path.join(glob.escape(str(folder)), f"{side}_*.png") for side in ("left", "right"))
    run = calibrate_images(left, right, board, CalibrationRequest("brown4", seed=seed, progress=of_board))
    rig_json.write_calibration(folder / "rig.json", run.calibration)
    return DemoCase(name, folder, run, evaluate_truth(run.calibration, truth, seed=seed))
