"""``binocal vanishing-points``: what streets and rooms say of one camera's focal length and principal point, and of its calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy import ndarray

from binocal.calibrators.scene_lines import NAMES, SceneIntrinsics, SceneRequest, calibrate_from_segments
from binocal.cameras import Camera
from binocal.datasets.folder import list_images
from binocal.detection.line_segments import find_line_segments
from binocal.errors import CancelledError, DataError
from binocal.evidence.line_segments import LineSegments
from binocal.findings import finding
from binocal.images.reading import GreyImage, read_grey_image
from binocal.progress import ProgressCallback, ShouldStop
from binocal.result import Covariance, StereoCalibration
from binocal.shapes import Float
from binocal.solvers.lens_bend import estimate_bend

MAX_IMAGES = 20  # evenly; more of one street say the same again
CONTRADICTING_SIGMAS = 4.0  # regions of a few images leave heavier tails than a normal's 3
PARAMETER_OF = {"f": "fx", "cx": "cx", "cy": "cy"}


@dataclass(frozen=True, slots=True, eq=False)
class SceneOptions:
    """``are_right_angles``: two families of one image are at right angles though nothing checks it."""

    are_right_angles: bool = False
    max_images: int = MAX_IMAGES
    seed: int = 0
    progress: ProgressCallback | None = None
    should_stop: ShouldStop | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CameraCheck:
    """A calibrated camera against the lines: its values of f, cx, cy, and by how many standard deviations the lines differ.

    NaN where the lines do not tell. ``sigma`` holds the lines' and the camera's own uncertainty.
    """

    values: Float[ndarray, "3"]
    sigma: Float[ndarray, "3"]
    z: Float[ndarray, "3"]

    @property
    def agrees(self) -> bool:
        """Whether no told figure contradicts the camera."""
        return bool(np.nanmax(np.abs(self.z)) <= CONTRADICTING_SIGMAS)


@dataclass(frozen=True, slots=True, eq=False)
class SceneRun:
    """What the lines tell; the check of a camera that was given; files that were left out, and why."""

    intrinsics: SceneIntrinsics
    n_segments: int
    lens: str
    check: CameraCheck | None = None
    ignored: Sequence[tuple[Path, str]] = ()


def calibrate_scene(
    images: str,
    options: SceneOptions | None = None,
    *,
    rig: StereoCalibration | None = None,
    side: Literal["left", "right"] = "left",
) -> SceneRun:
    """Focal length and principal point of one camera from images of streets or rooms: a glob, a folder or a file.

    With a ``rig`` the lens of its camera is taken out first, and its values are checked. Without one, a lens that visibly bends lines
    is taken out by one coefficient.

    Raises:
        DataError: An image cannot be read, or sizes differ.
        CalibrationError: The lines tell nothing; the text says why.
        CancelledError: ``should_stop`` said so.
    """
    options = options or SceneOptions()
    paths, ignored = list_images(images)
    place = np.unique(np.linspace(0, len(paths) - 1, min(len(paths), options.max_images)).round().astype(int))
    chosen = [paths[i] for i in place]
    camera = None if rig is None else (rig.rig.left if side == "left" else rig.rig.right)
    greys = _read(chosen, camera, side)
    segments = _segments(greys, chosen, camera, options)
    findings, lens = (), "none" if camera is None else f"the rig's {side} camera"
    bend = None if camera is not None else estimate_bend(segments)
    if bend is not None and bend.is_sure:
        segments = _segments(greys, chosen, bend.camera, options)
        findings = (finding("lens-from-bent-lines", corner_px=bend.corner_px, sigma_px=bend.sigma_px),)
        lens = "one coefficient, from bent lines"
    request = SceneRequest(_middle(camera), None, are_right_angles=options.are_right_angles, seed=options.seed)
    found = calibrate_from_segments(segments, request)
    if camera is not None:
        found = _in_rows_of(found, camera)
    found = replace(found, findings=(*findings, *found.findings))
    check = None if rig is None or camera is None else _check(found, camera, rig.covariance, side)
    return SceneRun(found, len(segments), lens, check, ignored)


def _read(paths: Sequence[Path], camera: Camera | None, side: str) -> list[GreyImage]:
    greys = [read_grey_image(path) for path in paths]
    first = greys[0].shape[::-1] if camera is None else camera.size_wh
    for path, grey in zip(paths, greys, strict=True):
        if grey.shape[::-1] != first:
            whose = f"{paths[0]} has" if camera is None else f"the rig's {side} camera has"
            raise DataError(
                f"{path}: {grey.shape[1]}x{grey.shape[0]} pixels, {whose} {first[0]}x{first[1]}; give images of one camera."
            )
    return greys


def _segments(
    greys: Sequence[GreyImage], paths: Sequence[Path], camera: Camera | None, options: SceneOptions
) -> LineSegments:
    parts = []
    for count, (grey, path) in enumerate(zip(greys, paths, strict=True)):
        if options.should_stop is not None and options.should_stop():
            raise CancelledError("cancelled while finding lines.")
        parts.append(find_line_segments(grey, path.name, camera))
        if options.progress is not None:
            options.progress("images", count + 1, len(greys))
    return LineSegments.joined(parts)


def _middle(camera: Camera | None) -> tuple[float, float] | None:
    """The image's middle where segments have fx both ways about the camera's principal point."""
    if camera is None:
        return None
    fx, fy, _, cy = camera.parameters[:4]
    return 0.5 * (camera.size_wh[0] - 1), float(cy + (0.5 * (camera.size_wh[1] - 1) - cy) * fx / fy)


def _in_rows_of(found: SceneIntrinsics, camera: Camera) -> SceneIntrinsics:
    """With cy in the image's own rows, where pixels are not square."""
    fx, fy, _, cy = camera.parameters[:4]
    scale = np.array([1.0, 1.0, fy / fx])
    names = found.covariance.names
    grow = np.array([scale[NAMES.index(name)] for name in names])
    values = np.array([*found.values[:2], cy + (found.values[2] - cy) * fy / fx])
    x, y = found.assumed_centre_px
    return replace(
        found,
        values=values,
        covariance=Covariance(names, found.covariance.matrix * np.outer(grow, grow)),
        assumed_centre_px=(x, float(cy + (y - cy) * fy / fx)),
    )


def _check(found: SceneIntrinsics, camera: Camera, known: Covariance, side: str) -> CameraCheck:
    values = camera.parameters[[0, 2, 3]]
    own = [known.sigma.get(f"{side}.{PARAMETER_OF[name]}", 0.0) for name in NAMES]
    sigma = np.hypot([found.covariance.sigma.get(name, np.nan) for name in NAMES], own)
    return CameraCheck(values, sigma, (found.values - values) / sigma)
