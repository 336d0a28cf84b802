"""``binocal demo``: both boards of the paper, rendered, calibrated and compared with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from binocal.app.calibrate import CalibrationRun, calibrate_images
from binocal.app.evaluate import TruthEvaluation, evaluate_truth
from binocal.app.simulate import SimulateOptions, simulate
from binocal.boards import Board
from binocal.calibrators.base import CalibrationRequest
from binocal.formats import rig_json
from binocal.output import check_output_folder
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

    ``output`` gets a folder per board with images, truth.json and rig.json.

    Raises:
        OutputExistsError: ``output`` holds files and ``force`` is False.
    """
    from binocal.simulation import table2_rig

    output = Path(output)
    check_output_folder(output, force=force)
    cases = []
    for number, square_m in enumerate(DEMO_SQUARES_M):
        name = f"{square_m * 1e3:.0f}mm"
        board = Board.from_spec(f"chessboard:11x8:{name}")
        folder = output / name
        of_board = prefixed(progress, f"{name} board: ")
        truth = simulate(
            table2_rig(),
            board,
            n_pairs,
            folder,
            SimulateOptions(seed=2 * seed + number),
            force=force,
            progress=of_board,
        )
        left, right = str(folder / "left_*.png"), str(folder / "right_*.png")
        request = CalibrationRequest("brown4", seed=seed, progress=of_board)
        run = calibrate_images(left, right, board, request)
        rig_json.write_calibration(folder / "rig.json", run.calibration, force=force)
        cases.append(DemoCase(name, folder, run, evaluate_truth(run.calibration, truth, seed=seed)))
    return tuple(cases)
