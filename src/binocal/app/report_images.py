"""Images of a report: small ones of every view, and one pair rectified, with its depth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from binocal.app.depth import DepthOptions, depth_images
from binocal.app.rectify import rectified_pairs
from binocal.boards import Board
from binocal.datasets.folder import ImagePair, list_pairs
from binocal.detection import detect_pairs
from binocal.errors import CalibrationError, DataError, FormatError
from binocal.images.encoding import draw_depth, draw_rows, encode_jpeg, shrunk
from binocal.images.preprocessing import Preparation
from binocal.images.reading import read_image
from binocal.progress import ProgressCallback
from binocal.rectification import DepthRange, RectificationMaps, rectify
from binocal.report.contents import RectifiedImages, ViewImages
from binocal.requirements.figures import usual_range
from binocal.result import StereoCalibration

MOST_REJECTED, MOST_USED = 10, 30  # pairs that are shown; of more used ones, those of the largest RMS
THUMBNAIL_WIDTH, PREVIEW_WIDTH = 280, 640  # pixels of one image
MOST_COMPARED = 3  # pairs in which the corners are found again
SAME_CORNER_PX = 1.5  # farther from every corner that is found again, a corner is not of this image
NEAREST = 0.5  # times the boards' distance: where the search for depth begins


def report_images(
    calibration: StereoCalibration, left: str, right: str, progress: ProgressCallback | None = None
) -> tuple[tuple[ViewImages, ...], RectifiedImages | None, tuple[str, ...]]:
    """Small images of the views, one pair rectified, and what is to be said of what is not shown.

    Raises:
        DataError: There is no pair, none is of the calibration, or an image of a used view cannot be read or is not of the rig's size.
    """
    pairs = {pair.name: pair for pair in list_pairs(left, right).pairs}
    used = [view for view in calibration.views if view.name in pairs]
    if not used and (of_boards := _pairs_of_boards(calibration, pairs)):
        rectified, notes = _rectified_or_why(calibration, of_boards[0])
        return (), rectified, ("each image shows several views, one for each board: no small images are shown", *notes)
    if not used:
        such = f" (such as {calibration.views[0].name})" if calibration.views else ""
        raise DataError(f"none of the images is of a view of this calibration{such}; give those that it was made from.")
    worst = sorted(used, key=lambda view: -np.nan_to_num(view.rms_px))[:MOST_USED]
    rejected = [view.name for view in calibration.rejected if view.name in pairs][:MOST_REJECTED]
    wanted = {view.name for view in worst}
    names = [*rejected, *(view.name for view in used if view.name in wanted)]
    shown = []
    for count, name in enumerate(names, start=1):
        shown.append(_thumbnails(calibration, pairs[name], is_used=name in wanted))
        if progress is not None:
            progress("images", count, len(names))
    notes = []
    if len(used) > len(worst):
        notes.append(f"images of the {len(worst)} views of the largest RMS are shown, of {len(used)}")
    best = min(used, key=lambda view: view.rms_px if np.isfinite(view.rms_px) else np.inf)
    rectified, why = _rectified_or_why(calibration, pairs[best.name])
    return tuple(shown), rectified, (*notes, *why)


def _pairs_of_boards(calibration: StereoCalibration, pairs: Mapping[str, ImagePair]) -> list[ImagePair]:
    """The pairs of a calibration whose views are boards, several to a pair: those are called after the pair, then the board."""
    if calibration.evidence is None or calibration.evidence.detections.shots is None:
        return []
    names = dict.fromkeys(view.name.rpartition(" board ")[0] for view in calibration.views)
    return [pairs[name] for name in names if name in pairs]


def _rectified_or_why(
    calibration: StereoCalibration, pair: ImagePair
) -> tuple[RectifiedImages | None, tuple[str, ...]]:
    """One pair rectified, or the note that says why it is not."""
    try:
        return _rectified(calibration, pair), ()
    except CalibrationError as error:
        return None, (f"no rectified images: {str(error).rstrip('.')}",)


def require_same_images(
    calibration: StereoCalibration, left: str, right: str, board: Board, preparation: Preparation
) -> None:
    """The images are those in which the evidence's corners were found: the board is found again in a few of them, at the same places.

    Of a calibration from corners that others found, images in which the board is not found say nothing.

    Raises:
        DataError: They are others; the text names the view that differs most.
    """
    pairs = {pair.name: pair for pair in list_pairs(left, right).pairs}
    used = sorted(
        (view for view in calibration.views if view.name in pairs), key=lambda view: np.nan_to_num(view.rms_px)
    )
    if not used or calibration.evidence is None:
        return
    corners = calibration.evidence.detections
    names = [view.name for view in used[:MOST_COMPARED]]
    try:
        again = detect_pairs([pairs[name] for name in names], board, preparation=preparation).detections
    except DataError:
        if "left" in calibration.provenance.get("input_sha256", {}):
            raise DataError(
                f"{pairs[names[0]].left_path}: the board of the calibration is not found in the images of its best views "
                f"({', '.join(names)}); give the images that it was made from."
            ) from None
        return
    worst, at = 0.0, names[0]
    for i, name in enumerate(again.names):
        j = corners.names.index(name)
        for found, expected in ((again.left_px[i], corners.left_px[j]), (again.right_px[i], corners.right_px[j])):
            apart = np.linalg.norm(expected[:, None] - found[np.isfinite(found).all(axis=-1)], axis=-1)
            apart = apart[np.isfinite(expected).all(axis=-1)]
            if apart.size and (far := float(np.median(apart.min(axis=1)))) > worst:
                worst, at = far, name
    if worst > SAME_CORNER_PX:
        raise DataError(
            f"{pairs[at].left_path}: the corners of view {at} lie {worst:.3g} px off the board in its images; give those that the "
            "calibration was made from."
        )


def _thumbnails(calibration: StereoCalibration, pair: ImagePair, *, is_used: bool) -> ViewImages:
    jpegs, sizes = [], []
    for side, path in (("left", pair.left_path), ("right", pair.right_path)):
        image = read_image(path)
        size_wh, expected = (image.shape[1], image.shape[0]), getattr(calibration.rig, side).size_wh
        if is_used and size_wh != expected:
            raise FormatError(
                path,
                f"is {size_wh[0]} x {size_wh[1]}, the rig's {side} camera {expected[0]} x {expected[1]}; give the images that "
                "were calibrated",
            )
        jpegs.append(encode_jpeg(shrunk(image, THUMBNAIL_WIDTH)))
        sizes.append(size_wh)
    return ViewImages(pair.name, jpegs[0], jpegs[1], (sizes[0], sizes[1]))


def _rectified(calibration: StereoCalibration, pair: ImagePair) -> RectifiedImages:
    """One pair before and after, and its depth from half the boards' distance on; small images are matched faster."""
    rig = calibration.rig
    found = rectify(rig)
    width = min(found.size_wh[0], PREVIEW_WIDTH)
    if width < found.size_wh[0]:
        found = rectify(rig, size_wh=(width, max(1, round(found.size_wh[1] * width / found.size_wh[0]))))
    maps = RectificationMaps.of(rig, found)
    (images,) = rectified_pairs(rig, maps, [pair])
    raw = [shrunk(read_image(path), PREVIEW_WIDTH) for path in (pair.left_path, pair.right_path)]
    height, most_wide = max(image.shape[0] for image in raw), max(image.shape[1] for image in raw)
    raw = [_padded(image, (most_wide, height)) for image in raw]
    range_m = usual_range(calibration)
    near = NEAREST * range_m if np.isfinite(range_m) else 5 * rig.baseline_m
    depth = depth_images(pair.name, images, (found, maps), DepthRange(near, np.inf), None, DepthOptions())
    known = depth.distance[np.isfinite(depth.distance)]
    low, high = np.quantile(known, (0.02, 0.98)).tolist() if known.size else (float("nan"), float("nan"))
    return RectifiedImages(
        pair.name,
        encode_jpeg(draw_rows(raw[0], raw[1], is_vertical=found.is_vertical)),
        encode_jpeg(draw_rows(*images, is_vertical=found.is_vertical)),
        encode_jpeg(draw_depth(depth.distance)),
        found.projection,
        found.is_vertical,
        depth.summary.measured,
        low,
        high,
    )


def _padded(image: np.ndarray, size_wh: tuple[int, int]) -> np.ndarray:
    """An image with black below and to the right, so that two of unlike cameras can stand side by side."""
    missing = (0, size_wh[1] - image.shape[0]), (0, size_wh[0] - image.shape[1])
    return np.pad(image, (*missing, (0, 0))[: image.ndim])
