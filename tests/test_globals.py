"""What belongs to the caller's process is as it was when a function of binocal returns."""

from __future__ import annotations

import gc
import locale
import os
import random
import sys
import warnings

import cv2
import numpy as np
import pytest
from cv2.utils import logging as cv2_log

from binocal import app
from binocal.boards import parse_board
from binocal.detection import detect
from binocal.errors import BinocalError
from binocal.simulation import table2_rig

BOARD = parse_board("chessboard:7x5:32mm")


def umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def globals_of_the_process(torch) -> dict[str, object]:
    return {
        "OpenCV's threads": cv2.getNumThreads(),
        "OpenCV's log level": cv2_log.getLogLevel(),
        "PyTorch's random state": torch.get_rng_state().tolist(),
        "PyTorch's threads": torch.get_num_threads(),
        "NumPy's random state": [str(part) for part in np.random.get_state()],  # noqa: NPY002 - it is what is asked
        "NumPy's handling of errors": np.geterr(),
        "Python's random state": random.getstate(),
        "umask": umask(),
        "warning filters": list(warnings.filters),
        "finders": list(sys.meta_path),
        "environment": dict(os.environ),
        "garbage collection": (gc.isenabled(), gc.get_threshold()),
        "locale": locale.setlocale(locale.LC_ALL),
        "working folder": os.getcwd(),
    }


@pytest.mark.usefixtures("unchecked_types")  # the checker draws random numbers
def test_everything_is_left_as_it_was_found(tmp_path):
    pytest.importorskip("scipy.special")  # its import adds a filter of warnings
    torch = pytest.importorskip("torch", reason="PyTorch is an extra: pip install binocal[train]")
    from binocal.rl.rig_batches import RIG_SETS, sample_rigs
    from binocal.rl.training.imitation import Imitation
    from binocal.rl.training.td3 import TD3Options
    from binocal.rl.training.trainer import Training, TrainingOptions, run_training

    weight = torch.nn.Parameter(torch.zeros(1))
    optimiser = torch.optim.Adam([weight])
    weight.sum().backward()
    optimiser.step()  # the first one imports packages of PyTorch's that have effects of their own
    cv2.setNumThreads(3)
    torch.manual_seed(123)
    cv2_log.setLogLevel(cv2_log.LOG_LEVEL_ERROR)
    before = globals_of_the_process(torch)

    app.simulate(table2_rig(), BOARD, 4, tmp_path / "images")
    run = app.calibrate_images(str(tmp_path / "images" / "left*"), str(tmp_path / "images" / "right*"), BOARD)
    assert len(run.calibration.views) == 4
    assert not detect(np.full((480, 640), 128, np.uint8), BOARD).is_found
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(BinocalError):
        app.calibrate_images(str(tmp_path / "broken*"), str(tmp_path / "broken*"), BOARD)

    rng = np.random.default_rng(0)
    pools = [(sample_rigs(RIG_SETS["weak"], 4, rng), 0.1)], [(sample_rigs(RIG_SETS["weak"], 2, rng), 0.1)]
    small = TD3Options(actor_widths=(8,), critic_widths=(8,))
    options = TrainingOptions(n_steps=20, td3=small, rigs_per_generation=4, capacity=500, batch_size=8, n_checks=1)
    run_training(Training(options, *pools), on_check=lambda *_: None)
    Imitation(options, pools[0]).generation()

    after = globals_of_the_process(torch)
    changed = [name for name, value in after.items() if value != before[name]]
    assert not changed
