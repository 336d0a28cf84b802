"""``binocal simulate``: images of a board as a rig sees it, and the truth beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binocal.boards import Board
from binocal.cameras import StereoRig
from binocal.errors import DataError
from binocal.formats import rig_json
from binocal.images.containers import MOST_PIXELS
from binocal.images.png import encode_png
from binocal.output import staged_folder, write_part
from binocal.progress import ProgressCallback, stage_of


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """How to render: Gaussian blur of the lens (sigma, pixels), sensor noise (grey levels), seed."""

    blur_px: float = 0.8
    noise_dn: float = 3.0
    seed: int = 0


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
    from binocal.simulation import RenderOptions, StereoScene, render_pairs, sample_board_poses

    options = options or SimulateOptions()
    if not board.is_metric:
        raise ValueError(f"a simulated board needs its size: give the length a unit, such as {board.kind}:…:20mm")
    if n_pairs < 1:
        raise ValueError(f"there is nothing to render: {n_pairs} pairs")
    for camera in (rig.left, rig.right):
        if math.prod(camera.size_wh) > MOST_PIXELS:
            width, height = camera.size_wh
            raise DataError(f"the rig's images of {width} x {height} pixels are too large to be rendered.")
    pose_seed, image_seed = np.random.SeedSequence(options.seed).spawn(2)
    T_left_board = sample_board_poses(rig, board, n_pairs, np.random.default_rng(pose_seed))
    width = max(2, len(str(n_pairs - 1)))
    names = tuple(f"{view:0{width}d}" for view in range(n_pairs))
    truth = rig_json.Truth(rig, board, names, T_left_board, options.noise_dn, options.blur_px)
    rendering = RenderOptions(blur_px=options.blur_px, noise_dn=options.noise_dn)
    with staged_folder(output, force=force, former=_former_images, last=("truth.json",)) as folder:
        images = render_pairs(
            StereoScene(rig, board, T_left_board), rendering, image_seed, stage_of(progress, "rendering")
        )
        for view, side, image in images:
            write_part(folder / f"{side}_{names[view]}.png", encode_png(image))
        rig_json.write_truth(folder / "truth.json", truth)
    return truth


def _former_images(output: Path) -> set[str]:
    """Names of the files of the simulation that ``output`` holds, if any; every other file is somebody else's."""
    if not (output / "truth.json").exists():
        return set()
    try:
        names = rig_json.read_truth(output / "truth.json").names
    except DataError:
        return set()
    return {f"{side}_{Path(name).name}.png" for name in names for side in ("left", "right")}
