"""Points that both cameras of a rig saw, without a board: the evidence of natural images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float, Int
from binocal.values import ArrayValue, frozen_array


@dataclass(frozen=True, slots=True, eq=False)
class PointMatches(ArrayValue):
    """Matches of all image pairs in a row: where each was seen, and in which pair. Some may be wrong.

    Pixel (0, 0) is the centre of the top-left pixel, and images are as the cameras gave them: distorted, not rectified. ``pair`` is
    an index into ``names``.
    """

    left_px: Float[ndarray, "n 2"]
    right_px: Float[ndarray, "n 2"]
    pair: Int[ndarray, "n"]
    names: tuple[str, ...]
    left_size_wh: tuple[int, int]
    right_size_wh: tuple[int, int]

    def __post_init__(self) -> None:
        left, right = frozen_array(self.left_px), frozen_array(self.right_px)
        pair = np.array(self.pair, dtype=np.int64)
        if left.shape != right.shape or left.ndim != 2 or left.shape[1] != 2 or pair.shape != (len(left),):
            raise ValueError(
                f"matches are two (n, 2) arrays and n indices; got {left.shape}, {right.shape}, {pair.shape}"
            )
        if not (np.isfinite(left).all() and np.isfinite(right).all()):
            raise ValueError("matches must be finite")
        if len(pair) and not (pair.min() >= 0 and pair.max() < len(self.names)):
            raise ValueError(f"pair indices must lie within the {len(self.names)} names")
        pair.setflags(write=False)
        for name, value in (("left_px", left), ("right_px", right), ("pair", pair), ("names", tuple(self.names))):
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        return f"<PointMatches: {len(self)} of {self.n_pairs} pairs>"

    def __len__(self) -> int:
        """How many matches."""
        return len(self.left_px)

    @property
    def n_pairs(self) -> int:
        """How many pairs of images."""
        return len(self.names)

    def select(self, index: Int[ndarray, "k"] | Bool[ndarray, "n"]) -> PointMatches:
        """Some of the matches, of all pairs."""
        return PointMatches(
            self.left_px[index],
            self.right_px[index],
            self.pair[index],
            self.names,
            self.left_size_wh,
            self.right_size_wh,
        )

    def of_pairs(self, pairs: Sequence[int]) -> PointMatches:
        """All matches of some pairs."""
        place = np.full(self.n_pairs, -1)
        place[list(pairs)] = np.arange(len(pairs))
        kept = place[self.pair] >= 0
        names = tuple(self.names[i] for i in pairs)
        sizes = self.left_size_wh, self.right_size_wh
        return PointMatches(self.left_px[kept], self.right_px[kept], place[self.pair[kept]], names, *sizes)

    @staticmethod
    def joined(parts: Sequence[PointMatches]) -> PointMatches:
        """The matches of several sets of pairs of one rig.

        Raises:
            ValueError: There are none, or image sizes differ.
        """
        if not parts:
            raise ValueError("no matches to join")
        sizes = {(part.left_size_wh, part.right_size_wh) for part in parts}
        if len(sizes) > 1:
            raise ValueError(f"matches of images of different sizes: {sorted(sizes)}")
        first = np.cumsum([0, *(part.n_pairs for part in parts)])
        return PointMatches(
            np.concatenate([part.left_px for part in parts]),
            np.concatenate([part.right_px for part in parts]),
            np.concatenate([part.pair + start for part, start in zip(parts, first[:-1], strict=True)]),
            tuple(name for part in parts for name in part.names),
            parts[0].left_size_wh,
            parts[0].right_size_wh,
        )
