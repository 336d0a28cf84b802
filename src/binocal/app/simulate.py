"""``binocal simulate``: images of a board, a street or a room as a rig sees it, and the truth beside them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.cameras import StereoRig
from binocal.errors import DataError
from binocal.formats import rig_json
from binocal.images.containers import MOST_PIXELS
from binocal.images.encoding import encode_image
from binocal.output import staged_folder, write_part
from binocal.progress import ProgressCallback, stage_of

Images = Iterator[tuple[int, str, ndarray]]


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """How to render: Gaussian blur of the lens (sigma, pixels), sensor noise (grey levels), seed, time between a pair's exposures.

    ``light`` is what the cameras see of a board: ``visible``, ``colour-thermal`` or ``thermal`` (:mod:`binocal.simulation.setups`).
    With ``aberration_px`` images are in colour, and red lies so far outward in their corners, blue so far inward.
    """

    blur_px: float = 0.8
    noise_dn: float = 3.0
    seed: int = 0
    gap_s: float = 0.0
    light: str = "visible"
    aberration_px: float = 0.0


def simulate(
    rig: StereoRig,
    board: Board,
    n_pairs: int,
    output: str | Path,
    options: SimulateOptions | None = None,
    *,
    force: bool = False,
    progress: ProgressCallback | None = None,
) -> rig_json.Truth:
    """Render ``n_pairs`` images of a board into ``output``: left_00.png, right_00.png, …, and truth.json.

    The same seed gives the same images, whatever the number of threads. ``output`` appears in full or not at all.
    With ``force``, an earlier simulation's images in it are replaced and every other file is left alone.

    Raises:
        ValueError: The board has no length unit, or there are no pairs to render.
        OutputExistsError: ``output`` holds files and ``force`` is False.
        DataError: The rig's images are too large to be rendered.
        OutputError: The disk is full, or the folder cannot be written to.
    """
    from binocal.simulation import Setup, StereoScene, render_pairs, sample_board_poses

    options = options or SimulateOptions()
    if not board.is_metric:
        raise ValueError(f"a simulated board needs its size: give the length a unit, such as {board.kind}:…:20mm")
    _check(rig, n_pairs)
    pose_seed, image_seed = np.random.SeedSequence(options.seed).spawn(2)
    T_left_board = sample_board_poses(rig, board, n_pairs, np.random.default_rng(pose_seed))
    truth = rig_json.Truth(
        rig,
        board,
        _names(n_pairs),
        T_left_board,
        options.noise_dn,
        options.blur_px,
        aberration_px=options.aberration_px,
    )
    rendering = Setup(rig, options.light).with_lens_and_noise(options.blur_px, options.noise_dn)
    shown = StereoScene(rig, board, T_left_board)
    images = render_pairs(
        shown, rendering, image_seed, stage_of(progress, "rendering"), aberration_px=options.aberration_px or None
    )
    _write(images, truth, output, force)
    return truth


def simulate_scene(
    rig: StereoRig,
    scene: str,
    n_pairs: int,
    output: str | Path,
    options: SimulateOptions | None = None,
    *,
    force: bool = False,
    progress: ProgressCallback | None = None,
) -> rig_json.Truth:
    """The same of a ``street`` or a ``room`` in place of a board, for what works from natural images.

    Things move from pair to pair, and by ``options.gap_s`` between the exposures of a pair.

    Raises:
        ValueError: No such scene, or there are no pairs to render. The other errors are those of :func:`simulate`.
    """
    from binocal.simulation import SceneOptions, draw_textured_scene, render_scene_pairs

    options = options or SimulateOptions()
    _check(rig, n_pairs)
    scene_seed, image_seed = np.random.SeedSequence(options.seed).spawn(2)
    shown = draw_textured_scene(scene, rig, n_pairs, np.random.default_rng(scene_seed))
    rendering = SceneOptions(options.blur_px, options.noise_dn, options.gap_s)
    truth = rig_json.Truth(
        rig, None, _names(n_pairs), shown.T_left_world, options.noise_dn, options.blur_px, scene, options.gap_s
    )
    images = render_scene_pairs(rig, shown, rendering, image_seed, stage_of(progress, "rendering"))
    _write(images, truth, output, force)
    return truth


def _check(rig: StereoRig, n_pairs: int) -> None:
    if n_pairs < 1:
        raise ValueError(f"there is nothing to render: {n_pairs} pairs")
    for camera in (rig.left, rig.right):
        if math.prod(camera.size_wh) > MOST_PIXELS:
            width, height = camera.size_wh
            raise DataError(f"the rig's images of {width} x {height} pixels are too large to be rendered.")


def _names(n_pairs: int) -> tuple[str, ...]:
    width = max(2, len(str(n_pairs - 1)))
    return tuple(f"{view:0{width}d}" for view in range(n_pairs))


def _write(images: Images, truth: rig_json.Truth, output: str | Path, force: bool) -> None:
    """All images and the truth, or nothing."""
    with staged_folder(output, force=force, former=_former_images, last=("truth.json",)) as folder:
        for view, side, image in images:
            write_part(folder / f"{side}_{truth.names[view]}.png", encode_image(image))
        rig_json.write_truth(folder / "truth.json", truth)


def _former_images(output: Path) -> set[str]:
    """Names of the files of the simulation that ``output`` holds, if any; every other file is somebody else's."""
    if not (output / "truth.json").exists():
        return set()
    try:
        names = rig_json.read_truth(output / "truth.json").names
    except DataError:
        return set()
    return {f"{side}_{Path(name).name}.png" for name in names for side in ("left", "right")}
