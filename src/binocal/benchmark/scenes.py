"""Rendered pairs for the benchmarks that start from images."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from binocal.boards import parse_board
from binocal.cameras import StereoRig
from binocal.datasets.folder import ImagePair
from binocal.images.png import encode_png
from binocal.simulation import RenderOptions, random_rig, render_image, sample_board_poses


def render_scene_pairs(
    folder: Path,
    n_pairs: int,
    board_spec: str,
    size_wh: tuple[int, int],
    seed: int,
    *,
    rig: StereoRig | None = None,
    options: RenderOptions | None = None,
) -> tuple[StereoRig, list[ImagePair]]:
    """``n_pairs`` pairs as left_000.png and right_000.png in a folder, and the rig that took them.

    Blur 0.8 px and noise 3 grey levels unless ``options`` say otherwise. Without ``rig``, one of that image size is drawn.
    """
    pose_seed, rig_seed, image_seed = np.random.SeedSequence(seed).spawn(3)
    board = parse_board(board_spec)
    if rig is None:
        rig = random_rig(np.random.default_rng(rig_seed), model="brown5", size_wh=size_wh)
    T_left_board = sample_board_poses(rig, board, n_pairs, np.random.default_rng(pose_seed))
    sides = (("left", rig.left, T_left_board), ("right", rig.right, rig.T_right_left @ T_left_board))
    options = options or RenderOptions(blur_px=0.8, noise_dn=3.0)
    seeds = image_seed.spawn(2 * n_pairs)

    def render(job: tuple[int, int]) -> Path:
        view, index = job
        side, camera, T_camera_board = sides[index]
        image = render_image(
            camera, T_camera_board[view], board, options, np.random.default_rng(seeds[2 * view + index])
        )
        path = folder / f"{side}_{view:03d}.png"
        path.write_bytes(encode_png(image.image))
        return path

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # One side after the other: the renderer keeps the rays of the last two cameras.
        lefts, rights = (list(pool.map(render, [(view, index) for view in range(n_pairs)])) for index in range(2))
    pairs = [ImagePair(f"{view:03d}", *both) for view, both in enumerate(zip(lefts, rights, strict=True))]
    return rig, pairs
