"""Sets of rendered images of boards on ground that makes corners hard to find: white, back-lit, before a window, dark, noisy.

Eight pairs of 640x480 of a 9x6 board by a random rig of brown4, brown5 or fisheye4, blur of 0.5 to 1.2 px; the corners are
those that detection finds in the files. Light above 255 saturates.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from binocal.benchmark.scenes import render_scene_pairs
from binocal.boards import parse_board
from binocal.cameras import StereoRig
from binocal.detection import detect_pairs
from binocal.evidence import Detections
from binocal.simulation import RenderOptions, random_rig

BOARD = "chessboard:9x6:30mm"
MODELS = ("brown4", "brown5", "fisheye4")
SIZE_WH, N_PAIRS = (640, 480), 8
BLUR_PX = (0.5, 1.2)
Range = tuple[float, float]

# Grey levels of the ink, the paper, what stands behind, its contrast, and the noise.
GROUNDS: dict[str, tuple[Range, Range, Range, Range, Range]] = {
    "images: on white": ((25, 70), (235, 290), (255, 255), (0, 0), (1, 4)),
    "images: back-lit, paper saturated": ((30, 80), (300, 420), (255, 300), (0, 0), (1, 4)),
    "images: before a window, paper grey": ((8, 20), (70, 140), (255, 300), (0, 0), (1, 4)),
    "images: in the dark": ((4, 10), (40, 90), (2, 15), (0, 8), (1, 3)),
    "images: before clutter, noisy": ((25, 45), (190, 230), (80, 140), (60, 110), (5, 12)),
}


def find_set_on(name: str, rng: np.random.Generator) -> tuple[StereoRig, Detections]:
    """A random rig and the corners found in its images of boards on the ground of that name.

    Raises:
        BinocalError: No pair shows the board to both cameras.
    """
    black, white, behind, clutter, noise = (float(rng.uniform(*limits)) for limits in GROUNDS[name])
    rig = random_rig(rng, MODELS[int(rng.integers(len(MODELS)))], size_wh=SIZE_WH)
    options = RenderOptions(
        blur_px=float(rng.uniform(*BLUR_PX)),
        noise_dn=noise,
        black_dn=black,
        white_dn=white,
        background_dn=behind,
        clutter_dn=clutter,
    )
    with tempfile.TemporaryDirectory(prefix="binocal-bench-") as folder:
        seed = int(rng.integers(2**31))
        _, listed = render_scene_pairs(Path(folder), N_PAIRS, BOARD, SIZE_WH, seed, rig=rig, options=options)
        return rig, detect_pairs(listed, parse_board(BOARD)).detections
