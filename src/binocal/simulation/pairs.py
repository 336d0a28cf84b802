"""Rendering all images of a scene on several threads, the same whatever their number."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed

import numpy as np
from numpy import ndarray

from binocal.shapes import UInt
from binocal.simulation.renderer import RenderOptions, render_image
from binocal.simulation.scenes import StereoScene
from binocal.threads import n_threads


def render_pairs(
    scene: StereoScene,
    options: RenderOptions,
    seed: np.random.SeedSequence,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[tuple[int, str, UInt[ndarray, "h w"]]]:
    """(view, ``left`` or ``right``, image) of every view of a scene, in the order in which they get done.

    Each image has a random stream of its own. A consumer that stops early ends the rendering.
    """
    rig, T_left_board = scene.rig, scene.T_left_board
    n_views = len(T_left_board.t)
    sides = (("left", rig.left, T_left_board), ("right", rig.right, rig.T_right_left @ T_left_board))
    seeds = seed.spawn(2 * n_views)

    def render(job: tuple[int, int]) -> tuple[int, str, UInt[ndarray, "h w"]]:
        view, index = job
        side, camera, T_camera_board = sides[index]
        rng = np.random.default_rng(seeds[2 * view + index])
        return view, side, render_image(camera, T_camera_board[view], scene.board, options, rng).image

    jobs = [(view, index) for index in range(2) for view in range(n_views)]
    with ThreadPoolExecutor(n_threads()) as pool:
        futures = [pool.submit(render, job) for job in jobs]
        try:
            for done, future in enumerate(as_completed(futures), 1):
                yield future.result()
                if progress:
                    progress(done, len(jobs))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
