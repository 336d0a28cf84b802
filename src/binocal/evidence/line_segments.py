"""Straight segments seen in images of one camera: the evidence that vanishing points come from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float, Int
from binocal.values import ArrayValue, frozen_array


@dataclass(frozen=True, slots=True, eq=False)
class LineSegments(ArrayValue):
    """Segments of all images in a row. Some may belong to nothing that is parallel to anything.

    ``ends_px`` are the ends of the fitted lines, pixels as a pinhole camera with square pixels would see them: as in the image
    where no lens is known, else with the lens taken out, and then perhaps outside of it. ``covariance_px2`` is that of both ends'
    displacements at right angles to the segment. ``bend_per_px`` is the curvature of the edge towards the normal, which is the
    segment's direction turned from x to y, with its standard deviation; infinite where it was not measured. ``image`` is an index
    into ``names``.
    """

    ends_px: Float[ndarray, "n 2 2"]
    covariance_px2: Float[ndarray, "n 2 2"]
    bend_per_px: Float[ndarray, "n 2"]
    image: Int[ndarray, "n"]
    names: tuple[str, ...]
    size_wh: tuple[int, int]

    def __post_init__(self) -> None:
        ends, covariance = frozen_array(self.ends_px), frozen_array(self.covariance_px2)
        bend, image = frozen_array(self.bend_per_px), frozen_array(self.image, int)
        n = len(ends)
        shapes = ends.shape, covariance.shape, bend.shape, image.shape
        if shapes != ((n, 2, 2), (n, 2, 2), (n, 2), (n,)):
            raise ValueError(f"segments are two (n, 2, 2) arrays, an (n, 2) one and n indices; got {shapes}")
        if not (np.isfinite(ends).all() and np.isfinite(covariance).all()):
            raise ValueError("segments must be finite")
        if n and not (image.min() >= 0 and image.max() < len(self.names)):
            raise ValueError(f"image indices must lie within the {len(self.names)} names")
        if n and not np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).min() > 0:
            raise ValueError("the two ends of a segment must differ")
        for name, value in (("ends_px", ends), ("covariance_px2", covariance), ("bend_per_px", bend), ("image", image)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "names", tuple(self.names))

    def __repr__(self) -> str:
        return f"<LineSegments: {len(self)} of {len(self.names)} images>"

    def __len__(self) -> int:
        """How many segments."""
        return len(self.ends_px)

    @property
    def lengths_px(self) -> Float[ndarray, "n"]:
        """From end to end."""
        return np.linalg.norm(self.ends_px[:, 1] - self.ends_px[:, 0], axis=1)

    @property
    def middles_px(self) -> Float[ndarray, "n 2"]:
        """Half way between the ends."""
        return self.ends_px.mean(axis=1)

    def select(self, index: Int[ndarray, "k"] | Bool[ndarray, "n"]) -> LineSegments:
        """Some of the segments; the images stay as they are numbered."""
        arrays = self.ends_px[index], self.covariance_px2[index], self.bend_per_px[index], self.image[index]
        return LineSegments(*arrays, self.names, self.size_wh)

    @staticmethod
    def joined(parts: Sequence[LineSegments]) -> LineSegments:
        """The segments of several sets of images of one camera.

        Raises:
            ValueError: There are none, or image sizes differ.
        """
        if len({part.size_wh for part in parts}) != 1:
            raise ValueError(f"segments of images of one size are joined; got {sorted({p.size_wh for p in parts})}")
        first = np.cumsum([0, *(len(part.names) for part in parts)])
        return LineSegments(
            np.concatenate([part.ends_px for part in parts]),
            np.concatenate([part.covariance_px2 for part in parts]),
            np.concatenate([part.bend_per_px for part in parts]),
            np.concatenate([part.image + start for part, start in zip(parts, first[:-1], strict=True)]),
            tuple(name for part in parts for name in part.names),
            parts[0].size_wh,
        )
