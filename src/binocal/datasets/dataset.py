"""What every data set is, whatever its layout: pairs of images, the rig that took them, and where its scale is from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig
from binocal.datasets.frames import name_some
from binocal.findings import Finding, finding, refusal
from binocal.images import read_grey_image, read_image
from binocal.shapes import Float

MOST_OFF_CENTRE = 0.2  # of the image's size, for a principal point: published ones lie within 0.05, those of images of half the size outside


@dataclass(frozen=True, slots=True, eq=False)
class StereoPair:
    """Two images that were taken together; nothing is decoded before it is asked for.

    Times are the cameras' own, in nanoseconds, where the data set has them. ``rig`` is the calibration published for this pair.
    """

    name: str
    left_path: Path
    right_path: Path
    left_time_ns: int | None = None
    right_time_ns: int | None = None
    rig: StereoRig | None = None

    def read_grey(self) -> tuple[ndarray, ndarray]:
        """Left and right as grey images (h, w), uint8 or uint16.

        Raises:
            FormatError: A file is missing, truncated or no image.
            DataError: An image has not the size that the calibration is for (finding ``dataset-image-size-differs``).
        """
        left, right = read_grey_image(self.left_path), read_grey_image(self.right_path)
        self._check_size(left.shape, right.shape)
        return left, right

    def read(self) -> tuple[ndarray, ndarray]:
        """Left and right as stored: (h, w), or (h, w, 3) blue-green-red; uint8 or uint16. Raises as :meth:`read_grey`."""
        left, right = read_image(self.left_path), read_image(self.right_path)
        self._check_size(left.shape, right.shape)
        return left, right

    def _check_size(self, left_shape: Sequence[int], right_shape: Sequence[int]) -> None:
        if self.rig is None:
            return
        for path, shape, camera in (
            (self.left_path, left_shape, self.rig.left),
            (self.right_path, right_shape, self.rig.right),
        ):
            check_size(path, (shape[1], shape[0]), (camera.size_wh,), "the calibration")


@dataclass(frozen=True, slots=True, eq=False)
class Dataset:
    """A data set in its original layout, listed and calibrated, its images unread.

    ``kind`` is the word before the colon in :func:`binocal.datasets.open_dataset`, ``layout`` says which form of it was found.
    ``is_rectified`` is None where nobody says. ``scale_source`` says what the rig's length is known from. ``ignored`` are images
    in no pair, each with the reason; ``findings`` say so in a sentence.
    """

    kind: str
    layout: str
    path: Path
    stereo_pairs: tuple[StereoPair, ...]
    is_rectified: bool | None
    scale_source: str
    ignored: tuple[tuple[Path, str], ...] = ()
    findings: tuple[Finding, ...] = ()

    def __len__(self) -> int:
        return len(self.stereo_pairs)

    def pairs(self) -> Iterator[StereoPair]:
        """The pairs in the order of their names or times."""
        return iter(self.stereo_pairs)

    @property
    def rigs(self) -> tuple[StereoRig, ...]:
        """The different rigs of the pairs, in the pairs' order; empty where the data set has no calibration."""
        return tuple({id(pair.rig): pair.rig for pair in self.stereo_pairs if pair.rig is not None}.values())

    @property
    def rig(self) -> StereoRig | None:
        """The rig as published, metres; cameras are those of the images as they are (rectified ones have no distortion).

        None where the data set has no calibration.

        Raises:
            DataError: The pairs are of several rigs (finding ``dataset-has-several-rigs``): see :meth:`by_rig`.
        """
        rigs = self.rigs
        if len(rigs) > 1:
            raise refusal(finding("dataset-has-several-rigs", path=str(self.path), n_rigs=len(rigs), n_pairs=len(self)))
        return rigs[0] if rigs else None

    @property
    def cameras(self) -> tuple[Camera, Camera] | None:
        """Left and right camera of :attr:`rig`; raises as it does."""
        rig = self.rig
        return None if rig is None else (rig.left, rig.right)

    def by_rig(self) -> tuple[Dataset, ...]:
        """The data set in parts of one rig each, the one with most pairs first."""
        groups: dict[int, list[StereoPair]] = {}
        for pair in self.stereo_pairs:
            groups.setdefault(id(pair.rig), []).append(pair)
        parts = sorted(groups.values(), key=len, reverse=True)
        return tuple(replace(self, stereo_pairs=tuple(part)) for part in parts)

    def of_one_rig(self, *, frame: str | None = None, like: StereoRig | None = None) -> Dataset:
        """The pairs of one rig; what was left out of several is said by the finding ``dataset-rigs-left-out``.

        That is the rig of the pair called ``frame`` (or whose name begins so), else the one whose cameras are those of ``like``, else
        the one of most pairs.

        Raises:
            DataError: No pair is called so (finding ``dataset-frame-unknown``).
        """
        parts, why = self.by_rig(), "which has most pairs"
        if frame is not None:
            parts, why = _with_frame(self, parts, frame), f"that of {frame}"
        elif like is not None and any(_are_same_cameras(part.rig, like) for part in parts):
            parts = tuple(part for part in parts if _are_same_cameras(part.rig, like))
            why = "whose cameras are the rig's"
        part = parts[0]
        if len(part) == len(self):
            return part
        others = [pair for pair in self.stereo_pairs if pair.rig is not part.stereo_pairs[0].rig]
        said = finding(
            "dataset-rigs-left-out",
            n_out=len(others),
            n_pairs=len(self),
            n_rigs=len({id(pair.rig) for pair in others}),
            names=name_some(pair.name for pair in others),
            used=part.stereo_pairs[0].name,
            why=why,
        )
        return replace(part, findings=(*part.findings, said))


def _with_frame(whole: Dataset, parts: Sequence[Dataset], frame: str) -> tuple[Dataset, ...]:
    """The parts that hold the pair of that name, or else pairs whose names begin so, those with most of them first."""
    for is_meant in (frame.__eq__, lambda name: name.startswith(frame)):
        counts = [sum(is_meant(pair.name) for pair in part.stereo_pairs) for part in parts]
        if any(counts):
            order = sorted(range(len(parts)), key=lambda k: -counts[k])
            return tuple(parts[k] for k in order if counts[k])
    names = name_some(pair.name for pair in whole.stereo_pairs)
    raise refusal(finding("dataset-frame-unknown", path=str(whole.path), frame=frame, names=names))


def _are_same_cameras(rig: StereoRig | None, other: StereoRig) -> bool:
    if rig is None:
        return False
    pairs = ((rig.left, other.left), (rig.right, other.right))
    return all(
        a.model == b.model and a.size_wh == b.size_wh and np.allclose(a.parameters, b.parameters, rtol=1e-6, atol=1e-9)
        for a, b in pairs
    )


class SharedRigs:
    """Gives one and the same object for rigs of equal numbers, so that pairs of one calibration can be told."""

    def __init__(self) -> None:
        self._known: dict[bytes, StereoRig] = {}

    def share(self, rig: StereoRig) -> StereoRig:
        """The first rig given that has these numbers."""
        numbers = [rig.T_right_left.R.ravel(), rig.T_right_left.t]
        for camera in (rig.left, rig.right):
            numbers += [np.array(camera.size_wh, dtype=float), camera.parameters]
        key = f"{rig.left.model} {rig.right.model} ".encode() + np.concatenate(numbers).tobytes()
        return self._known.setdefault(key, rig)


def check_size(path: Path, size_wh: tuple[int, int], allowed_wh: Sequence[tuple[int, int]], source: str) -> None:
    """Refuse an image whose size is none of those that its calibration is for.

    Raises:
        DataError: It is none of them (finding ``dataset-image-size-differs``).
    """
    if size_wh not in allowed_wh:
        sizes = " or ".join(f"{width}x{height}" for width, height in allowed_wh)
        raise refusal(
            finding(
                "dataset-image-size-differs",
                path=str(path),
                width_px=size_wh[0],
                height_px=size_wh[1],
                calibrated=sizes,
                source=source,
            )
        )


def check_centre(path: Path, size_wh: tuple[int, int], centre_px: Float[ndarray, "2"], file: Path) -> None:
    """Refuse an image that is of another size than the camera whose principal point a file has, where the file has no size.

    Raises:
        DataError: That lies far from the image's middle (finding ``dataset-image-size-differs``).
    """
    off = np.abs(centre_px / size_wh - 0.5)
    if off.max() > MOST_OFF_CENTRE:
        about = f"about {2 * centre_px[0]:.0f}x{2 * centre_px[1]:.0f}"
        raise refusal(
            finding(
                "dataset-image-size-differs",
                path=str(path),
                width_px=size_wh[0],
                height_px=size_wh[1],
                calibrated=about,
                source=str(file),
            )
        )
