"""Matches of pairs of image files, a pair a thread in memory at a time; pairs that show nothing are named and left out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import TypeVar

from numpy import ndarray

from binocal.calibrators.natural_checks import MIN_MATCHES, named
from binocal.cameras import Camera
from binocal.datasets import StereoPair
from binocal.errors import CancelledError, DataError
from binocal.evidence.point_matches import PointMatches
from binocal.findings import Finding, finding, refusal
from binocal.images.opencv_settings import single_threaded_opencv
from binocal.images.reading import read_grey_image
from binocal.matching.pairs import PairMatches, match_pair
from binocal.progress import ProgressCallback, ShouldStop
from binocal.threads import n_threads

T = TypeVar("T")

MIN_FEATURES = 2 * MIN_MATCHES  # of an image; half of them and more have no partner in the other
MOST_MIRRORED, MOST_MIRRORED_TIMES = 100, 3.0
"""Matches with one image mirrored, and over those without: a mirrored KITTI pair has 68 as it is."""
MOST_SPREAD_RATIO = 1.25
"""Of edges in one image over the other's: 0.99 to 1.02 in 25 sound real pairs, 1.27 to 1.40 with a blur of 1.5 px in one."""
MOST_SPREAD_PX = 2.5  # in both; 0.9 to 1.2 in sharp images


def matches_of(
    pairs: Sequence[StereoPair],
    cameras: tuple[Camera, Camera],
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
) -> tuple[PointMatches, list[Finding]]:
    """Matches of the pairs that show something, and what is said of the others.

    Raises:
        DataError: An image cannot be read or is not of these cameras' size.
        DegenerateGeometryError: No pair shows anything; the text says it of the first.
        CancelledError: ``should_stop`` said so.
    """
    found: list[PointMatches] = []
    unfit: list[tuple[StereoPair, Finding]] = []
    seen_pairs = for_each_pair(lambda pair: match_files(pair, cameras), pairs, "pairs", progress, should_stop)
    for pair, seen in zip(pairs, seen_pairs, strict=True):
        why = what_is_wrong(pair, seen)
        if why is None:
            found.append(seen.matches)
        else:
            unfit.append((pair, why))
    if not found:
        raise refusal(unfit[0][1])
    if not unfit:
        return PointMatches.joined(found), []
    what = named([_of_pair(pair, why) for pair, why in unfit])
    left_out = finding("pairs-left-out", n_odd=len(unfit), n_pairs=len(pairs), what=what)
    return PointMatches.joined(found), [left_out]


def _of_pair(pair: StereoPair, why: Finding) -> str:
    """What is wrong with a pair of several: by its name, unless the image is named already."""
    text = why.text.removesuffix(f"; {why.remedy}.")
    names_image = any(str(path) in text for path in (pair.left_path, pair.right_path))
    return text if names_image else f"{pair.name} ({text})"


def for_each_pair(
    look: Callable[[StereoPair], T],
    pairs: Sequence[StereoPair],
    stage: str,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
) -> Iterator[T]:
    """What a function says of each pair, in the pairs' order; in threads, each with the images of one pair in memory.

    OpenCV's own threads are switched off meanwhile, but for a single pair.

    Raises:
        CancelledError: ``should_stop`` said so.
    """
    alone = len(pairs) == 1 or n_threads() == 1
    with nullcontext() if alone else single_threaded_opencv(), ThreadPoolExecutor(n_threads()) as pool:
        results = map(look, pairs) if alone else pool.map(look, pairs)
        try:
            for count in range(len(pairs)):
                if should_stop is not None and should_stop():
                    raise CancelledError(f"cancelled at pair {count + 1} of {len(pairs)}.")
                yield next(results)
                if progress is not None:
                    progress(stage, count + 1, len(pairs))
        finally:
            pool.shutdown(cancel_futures=True)


def match_files(pair: StereoPair, cameras: tuple[Camera, Camera]) -> PairMatches:
    """The matches of a pair of files.

    Raises:
        DataError: An image cannot be read or is not of these cameras' size.
    """
    return match_pair(*read_pair(pair, cameras), pair.name)


def read_pair(pair: StereoPair, cameras: tuple[Camera, Camera]) -> tuple[ndarray, ndarray]:
    """Both images of a pair of files.

    Raises:
        DataError: An image cannot be read or is not of these cameras' size.
    """
    paths = pair.left_path, pair.right_path
    images = read_grey_image(paths[0]), read_grey_image(paths[1])
    for side, image, camera, path in zip(("left", "right"), images, cameras, paths, strict=True):
        size = image.shape[1], image.shape[0]
        if size != camera.size_wh:
            raise DataError(
                f"{path}: {size[0]}x{size[1]} pixels, the rig's {side} camera has {camera.size_wh[0]}x{camera.size_wh[1]}; "
                "give images as this rig's cameras take them."
            )
    return images


def what_is_wrong(pair: StereoPair, seen: PairMatches) -> Finding | None:
    """Why a pair has no part in a calibration, or None."""
    paths = pair.left_path, pair.right_path
    for path, n_features in zip(paths, seen.n_features, strict=True):
        if n_features < MIN_FEATURES:
            return finding("image-shows-nothing", image=path, n_features=n_features, n_needed=MIN_FEATURES)
    if seen.n_mirrored > max(MOST_MIRRORED_TIMES * len(seen.matches), MOST_MIRRORED):
        counts = seen.n_mirrored, len(seen.matches)
        return finding("image-mirrored", left=paths[0], right=paths[1], n_mirrored=counts[0], n_matches=counts[1])
    spread = seen.edge_spread_px
    worse = int(spread[1] > spread[0])
    if spread[worse] > MOST_SPREAD_RATIO * spread[1 - worse] or min(spread) > MOST_SPREAD_PX:
        return finding("image-blurred", image=paths[worse], blur_px=spread[worse], other_px=spread[1 - worse])
    if len(seen.matches) < MIN_MATCHES:
        return finding("matches-too-few", n_matches=len(seen.matches), n_pairs=1, n_needed=MIN_MATCHES)
    return None
