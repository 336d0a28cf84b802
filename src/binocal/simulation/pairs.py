"""Rendering all images of a scene on several threads, the same whatever their number."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.shapes import Float, UInt
from binocal.simulation.aberration import render_colour_image
from binocal.simulation.renderer import RenderOptions, render_image
from binocal.simulation.scene_renderer import SceneOptions, render_scene_image
from binocal.simulation.scenes import StereoScene
from binocal.simulation.textured_scenes import TexturedScene
from binocal.threads import n_threads

RenderOne = Callable[[int, int, np.random.Generator], ndarray]
"""The image of a view by camera 0 (left) or 1."""


def render_pairs(
    scene: StereoScene,
    options: RenderOptions | tuple[RenderOptions, RenderOptions],
    seed: np.random.SeedSequence,
    progress: Callable[[int, int], None] | None = None,
    *,
    aberration_px: float | None = None,
    behind: Callable[[int, int], Float[ndarray, "h w"]] | None = None,
) -> Iterator[tuple[int, str, UInt[ndarray, "h w"] | UInt[ndarray, "h w 3"]]]:
    """(view, ``left`` or ``right``, image) of every view of a board, in the order in which they get done.

    Two options are those of the left and of the right camera. With ``aberration_px`` images are in colour, red and blue displaced by
    so much in their corners (:mod:`binocal.simulation.aberration`). ``behind`` gives what stands behind the board in a view's left (0)
    or right (1) image, see :class:`binocal.simulation.RenderOptions`.
    """
    looks = options if isinstance(options, tuple) else (options, options)
    rig, T_left_board = scene.rig, scene.T_left_board
    sides = ((rig.left, T_left_board), (rig.right, rig.T_right_left @ T_left_board))

    def render(view: int, side: int, rng: np.random.Generator) -> ndarray:
        camera, T_camera_board = sides[side]
        look = looks[side] if behind is None else replace(looks[side], behind=behind(view, side))
        if aberration_px is not None:
            return render_colour_image(camera, T_camera_board[view], scene.board, look, aberration_px, rng)
        return render_image(camera, T_camera_board[view], scene.board, look, rng).image

    return _render_all(render, len(T_left_board.t), seed, progress)


def render_scene_pairs(
    rig: StereoRig,
    scene: TexturedScene,
    options: SceneOptions,
    seed: np.random.SeedSequence,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[tuple[int, str, UInt[ndarray, "h w"]]]:
    """The same of a scene without a board, the right images ``options.gap_s`` after the left ones."""
    T_left_world = scene.T_left_world
    sides = ((rig.left, T_left_world, 0.0), (rig.right, rig.T_right_left @ T_left_world, options.gap_s))

    def render(pair: int, side: int, rng: np.random.Generator) -> UInt[ndarray, "h w"]:
        camera, T_camera_world, elapsed_s = sides[side]
        return render_scene_image(scene, pair, camera, T_camera_world[pair], options, rng, elapsed_s)

    return _render_all(render, scene.n_pairs, seed, progress)


def _render_all(
    render: RenderOne, n_views: int, seed: np.random.SeedSequence, progress: Callable[[int, int], None] | None
) -> Iterator[tuple[int, str, ndarray]]:
    """Each image has a random stream of its own. A consumer that stops early ends the rendering."""
    seeds = seed.spawn(2 * n_views)

    def one(job: tuple[int, int]) -> tuple[int, str, ndarray]:
        view, side = job
        return view, ("left", "right")[side], render(view, side, np.random.default_rng(seeds[2 * view + side]))

    jobs = [(view, side) for side in range(2) for view in range(n_views)]
    with ThreadPoolExecutor(n_threads()) as pool:
        futures = [pool.submit(one, job) for job in jobs]
        try:
            for done, future in enumerate(as_completed(futures), 1):
                yield future.result()
                if progress:
                    progress(done, len(jobs))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
