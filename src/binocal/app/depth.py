"""``binocal depth``: depth images and point clouds of a rig's image pairs, with their standard deviations."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.app.rectify import (
    RectifyOptions,
    file_names,
    options_applied,
    rectification_document,
    rectified_pairs,
)
from binocal.datasets.folder import list_pairs
from binocal.errors import DataError
from binocal.formats.json_document import dump_json, jsonable
from binocal.formats.ply import ply_content
from binocal.images.encoding import draw_depth, draw_rows, encode_float_tiff, encode_image, to_8_bit
from binocal.images.png import encode_png
from binocal.images.reading import to_grey
from binocal.output import staged_folder, write_part
from binocal.progress import ProgressCallback
from binocal.rectification import Rectification, RectificationMaps
from binocal.rectification.disparity import (
    DepthRange,
    Matcher,
    disparity_range,
    distance_per_pixel,
    distances_of,
    match_rectified,
    points_from_disparity,
    usual_range,
    without_uncovered,
)
from binocal.result import StereoCalibration
from binocal.shapes import Float, Float32
from binocal.uncertainty.lattice import DepthSigmaLattice, depth_sigma_lattice

DOCUMENT = "depth.json"
MATCHING_NOISE_PX = 0.3  # of a disparity; block matching of real images is usually given as 0.2 to 0.5
MOST_SIGMA_SHARE = 0.25  # of a distance: beyond it, it is no measurement
LEAST_DISPARITY_PX = 0.5  # the farthest that the calibration's share is computed for
UINT16_MOST = 65535


@dataclass(frozen=True, slots=True, eq=False)
class DepthOptions:
    """How to measure depth.

    ``distances`` are those to search, by default :func:`binocal.rectification.disparity.usual_range`. ``matcher`` is OpenCV's
    semi-global matching unless another is given. ``matching_noise_px`` is the standard deviation of a disparity.
    ``png_units`` are the steps of the 16-bit PNG in a metre (in a board pitch, without a scale).
    """

    rectify: RectifyOptions = field(default_factory=RectifyOptions)
    distances: DepthRange | None = None
    matcher: Matcher | None = None
    matching_noise_px: float = MATCHING_NOISE_PX
    png_units: float = 1000.0


@dataclass(frozen=True, slots=True)
class PairDepth:
    """One pair's depth in figures: shares of the rectified left image, medians of distance and of standard deviations.

    ``measured`` have a distance, ``uncertain`` had one of which the standard deviation is more than a quarter of it and were dropped,
    ``beyond_png`` do not fit into the 16-bit image.
    """

    name: str
    measured: float
    uncertain: float
    beyond_png: float
    median: float
    median_sigma: float
    median_sigma_calibration: float
    median_sigma_matching: float


@dataclass(frozen=True, slots=True, eq=False)
class DepthRun:
    """What was measured, and how."""

    rectification: Rectification
    distances: DepthRange
    search_px: tuple[int, int]
    pairs: tuple[PairDepth, ...]
    knows_covariance: bool
    ignored: tuple[tuple[Path, str], ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class DepthImages:
    """One pair's depth, NaN where there is none.

    Distances and standard deviations of the rectified left image's pixels, and their points in the frame ``rect_left``.
    """

    distance: Float32[ndarray, "h w"]
    sigma: Float32[ndarray, "h w"]
    points: Float32[ndarray, "h w 3"]
    summary: PairDepth


def measure_depth(
    calibration: StereoCalibration,
    left: str,
    right: str,
    output: str | Path,
    options: DepthOptions | None = None,
    *,
    force: bool = False,
    progress: ProgressCallback | None = None,
) -> DepthRun:
    """Depth of every pair into ``output``.

    For each pair depth_NAME.png (16 bit), depth_NAME.tiff and sigma_NAME.tiff (floating point), view_NAME.png for the eye,
    left_NAME.png, cloud_NAME.ply, rows_NAME.png if asked for; and depth.json, which says what they hold.

    Raises:
        DegenerateGeometryError: The rig cannot be rectified.
        DataError: There is no pair, an image cannot be read or is not of the rig's size, the range holds nothing that both cameras see,
            or ``output`` cannot be written.
    """
    options = options or DepthOptions()
    rig = calibration.rig
    rectification = options_applied(rig, options.rectify)
    distances = options.distances or usual_range(rectification)
    search = disparity_range(rectification, distances)
    if search[1] - search[0] <= 1:
        unit = "m" if rig.is_metric else "board squares"
        length = rectification.size_wh[rectification.left.along]
        is_too_near = min(abs(search[0]), abs(search[1])) >= length - 1  # the search never goes beyond the image
        raise DataError(
            f"from {distances.near:g} to {distances.far:g} {unit} "
            + (
                f"disparities are beyond the image of {length} px: too near for this rig; give a range of farther distances."
                if is_too_near
                else "the disparity does not change by a pixel in these images: give a range of nearer distances."
            )
        )
    lattice = _lattice(calibration, rectification, distances)
    pairing = list_pairs(left, right)
    names = file_names([pair.name for pair in pairing.pairs])
    found = []
    with staged_folder(output, force=force, last=(DOCUMENT,)) as folder:
        maps = RectificationMaps.of(rig, rectification)
        for name, images in zip(names, rectified_pairs(rig, maps, pairing.pairs, progress), strict=True):
            depth = depth_images(name, images, (rectification, maps), distances, lattice, options)
            _write(folder, images, rectification, depth, options)
            found.append(depth.summary)
        told = lattice is not None, pairing.ignored, pairing.notes
        run = DepthRun(rectification, distances, search, tuple(found), *told)
        write_part(folder / DOCUMENT, dump_json(jsonable(depth_document(calibration, run, options))).encode())
    return run


def depth_document(calibration: StereoCalibration, run: DepthRun, options: DepthOptions) -> dict[str, Any]:
    """What the files hold, and the figures of every pair."""
    r = run.rectification
    is_pinhole = r.projection == "pinhole"
    return {
        "schema": "binocal-depth/1",
        "unit": "m" if calibration.rig.is_metric else "board pitch",
        "distance": "z of the rectified left frame" if is_pinhole else "distance from the left camera",
        "png_units": options.png_units,
        "png_nothing": 0,
        "range": [run.distances.near, run.distances.far],
        "search_px": list(run.search_px),
        "matching_noise_px": options.matching_noise_px,
        "knows_calibration_sigma": run.knows_covariance,
        "most_sigma_share": MOST_SIGMA_SHARE,
        "cloud_frame": "left camera: x right, y down, z forward",
        "rectification": rectification_document(calibration.rig, r),
        "pairs": [asdict(pair) for pair in run.pairs],
    }


def _lattice(
    calibration: StereoCalibration, rectification: Rectification, distances: DepthRange
) -> DepthSigmaLattice | None:
    """What the calibration leaves uncertain; None where the rig's file does not say it."""
    covariance = calibration.covariance
    if not covariance.names or not np.isfinite(covariance.matrix).all():
        return None
    along = rectification.left.along
    farthest = abs(rectification.offset_m) * rectification.left.focal_px[along] / LEAST_DISPARITY_PX
    far = min(distances.far, max(farthest, 2 * distances.near))
    return depth_sigma_lattice(calibration.rig, covariance, rectification, distances.near, far)


def depth_images(
    name: str,
    images: tuple[ndarray, ndarray],
    rectified: tuple[Rectification, RectificationMaps],
    distances: DepthRange,
    lattice: DepthSigmaLattice | None,
    options: DepthOptions,
) -> DepthImages:
    """Depth of one rectified pair. ``lattice`` holds what the calibration leaves uncertain; None where that is not known."""
    rectification, maps = rectified
    grey = [to_8_bit(to_grey(image)) for image in images]
    disparity = match_rectified(rectification, grey[0], grey[1], distances, options.matcher)
    points = points_from_disparity(rectification, without_uncovered(rectification, maps, disparity))
    distance = np.ascontiguousarray(distances_of(rectification, points))
    with np.errstate(invalid="ignore"):
        outside = (distance < distances.near) | (distance > distances.far)
    distance[outside] = np.nan
    matching = distance_per_pixel(rectification, points) * np.float32(options.matching_noise_px)
    calibrated = np.zeros_like(distance) if lattice is None else lattice.at(distance)
    sigma = np.hypot(matching, calibrated)
    with np.errstate(invalid="ignore"):
        uncertain = np.isfinite(distance) & ~(sigma <= MOST_SIGMA_SHARE * distance)
    distance[uncertain] = np.nan
    nothing = np.isnan(distance)
    sigma[nothing], points[nothing] = np.nan, np.nan
    beyond = np.zeros_like(nothing)
    beyond[~nothing] = distance[~nothing] * options.png_units > UINT16_MOST

    def median(values: Float[ndarray, "h w"] | Float32[ndarray, "h w"]) -> float:
        return float("nan") if nothing.all() else float(np.median(values[~nothing]))

    summary = PairDepth(
        name,
        float(1 - nothing.mean()),
        float(uncertain.mean()),
        float(beyond.mean()),
        median(distance),
        median(sigma),
        median(calibrated) if lattice is not None else float("nan"),
        median(matching),
    )
    return DepthImages(distance, sigma, points, summary)


def _write(
    folder: Path,
    images: tuple[ndarray, ndarray],
    rectification: Rectification,
    depth: DepthImages,
    options: DepthOptions,
) -> None:
    name = depth.summary.name
    is_known = np.isfinite(depth.distance)
    steps = np.zeros(depth.distance.shape, np.uint16)
    scaled = depth.distance[is_known] * options.png_units
    steps[is_known] = np.where(scaled <= UINT16_MOST, np.round(scaled), 0)
    left = to_8_bit(images[0])
    grey_or_rgb = left[is_known]
    colours = (
        np.repeat(grey_or_rgb[:, None], 3, axis=1) if left.ndim == 2 else np.ascontiguousarray(grey_or_rgb[:, ::-1])
    )
    cloud = ply_content(
        depth.points[is_known] @ rectification.R_rect_left.astype(np.float32),
        colours,
        depth.sigma[is_known],
        ("frame: left camera, x right, y down, z forward", "sigma: standard deviation of the distance"),
    )
    for file, content in (
        (f"depth_{name}.png", encode_png(steps)),
        (f"depth_{name}.tiff", encode_float_tiff(depth.distance)),
        (f"sigma_{name}.tiff", encode_float_tiff(depth.sigma)),
        (f"view_{name}.png", encode_image(draw_depth(depth.distance))),
        (f"left_{name}.png", encode_image(images[0])),
        (f"cloud_{name}.ply", cloud),
    ):
        write_part(folder / file, content)
    if options.rectify.draws_rows:
        write_part(folder / f"rows_{name}.png", encode_image(draw_rows(*images, is_vertical=rectification.is_vertical)))
