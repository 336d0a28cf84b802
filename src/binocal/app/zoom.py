"""Zoom lenses: from images at several settings to a rig at any setting, and images to try it with."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from binocal.app.calibrate import CalibrationRun
from binocal.app.corners import explained, find_corners
from binocal.app.simulate import SimulateOptions, simulate
from binocal.boards import Board
from binocal.calibrators.base import MIN_VIEWS, CalibrationRequest
from binocal.formats import rig_json
from binocal.output import staged_folder, write_part
from binocal.progress import ProgressCallback
from binocal.result import RejectedView

N_SETTINGS = 13  # the rows between settings err 0.7 times as much as at one; with 9 settings 1.3 times


def calibrate_zoom_images(
    settings_csv: str | Path,
    board: Board,
    request: CalibrationRequest | None = None,
    *,
    calibrator: str = "zoom",
    setting: float | None = None,
    preprocess: bool = False,
    channel: str = "grey",
) -> CalibrationRun:
    """Calibrate from the images that a CSV file lists by zoom setting; the rig is that at ``setting``, or in the middle.

    Raises:
        FormatError: The file is no such list.
        DataError: The images of a setting cannot be used.
        CalibrationError: No trustworthy rig follows from those of a setting.
        ValueError: ``setting`` is outside of those listed.
    """
    from binocal.calibrators import calibrate_as_requested
    from binocal.evidence.zoom_settings import ZoomSettings
    from binocal.formats.zoom_csv import read_zoom_settings
    from binocal.images.preprocessing import Preparation

    request = request or CalibrationRequest()
    started = time.perf_counter()
    rows = read_zoom_settings(settings_csv)
    preparation = Preparation(channel, preprocess)
    found = []
    for row in rows:
        at = find_corners(
            row.left, row.right, board, preparation, request.progress, request.should_stop, least_pairs=MIN_VIEWS
        )
        found.append(at)
    names = [f"{row.setting:g}" for row in rows]
    rejected = tuple(
        RejectedView(f"{name}/{view.name}", view.reason, view.code)
        for name, at in zip(names, found, strict=True)
        for view in at.rejected
    )
    ignored = tuple(item for at in found for item in at.ignored)
    notes = tuple(f"zoom setting {name}: {note}" for name, at in zip(names, found, strict=True) for note in at.notes)
    evidence = ZoomSettings(
        np.array([row.setting for row in rows]),
        tuple(replace(at.detections, board_spec=rig_json.format_board(board)) for at in found),
    )
    detected = time.perf_counter()
    inputs = {
        "board": rig_json.format_board(board),
        "preprocess": preprocess,
        "channel": channel,
        "input_sha256": {name: dict(at.input_sha256) for name, at in zip(names, found, strict=True)},
    }
    if setting is not None:
        request = replace(request, options={**request.options, "setting": setting})
    with explained(ignored, rejected, notes):
        calibration = calibrate_as_requested(evidence, request, calibrator=calibrator, inputs=inputs)
    solved = time.perf_counter()
    calibration = replace(calibration, rejected=rejected + calibration.rejected)
    elapsed_s = {"images": detected - started, "solve": solved - detected, "all": solved - started}
    return CalibrationRun(calibration, None, ignored, notes, elapsed_s)


def simulate_zoom(
    board: Board,
    n_pairs: int,
    output: str | Path,
    options: SimulateOptions | None = None,
    *,
    n_settings: int = N_SETTINGS,
    force: bool = False,
    progress: ProgressCallback | None = None,
) -> tuple[float, ...]:
    """Render ``n_pairs`` pairs of a board at each of some settings from 0 to 1, and ``settings.csv``; the settings.

    Each setting has a folder of its own with its images and its ``truth.json``. Raises as :func:`binocal.app.simulate`.
    """
    from binocal.simulation.zoom import zoom_rig_at

    options = options or SimulateOptions()
    settings = tuple(np.linspace(0, 1, n_settings).round(6).tolist())
    with staged_folder(output, force=force, last=("settings.csv",)) as folder:
        lines = ["setting,left,right"]
        for number, setting in enumerate(settings):
            name = f"setting_{number:02d}"
            simulate(
                zoom_rig_at(setting), board, n_pairs, folder / name, replace(options, seed=options.seed + number),
                progress=progress,
            )  # fmt: skip
            lines.append(f"{setting:g},{name}/left_*.png,{name}/right_*.png")
        write_part(folder / "settings.csv", ("\n".join(lines) + "\n").encode())
    return settings
