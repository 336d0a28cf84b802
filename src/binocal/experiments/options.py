"""How large the paper's experiment is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

QUICK_IMAGES, QUICK_SEEDS = 32, 2


LEAST_PAIRS = 8  # of a sample, both halves
LEAST_IMAGES = 2 * LEAST_PAIRS  # of one seed
MOST_IMAGES = 20_000  # table 4's measured set takes 1 MB for each


@dataclass(frozen=True, slots=True)
class ExperimentOptions:
    """How large the experiment is: images of a set over all seeds, seeds, and the first of them.

    ``is_quick`` leaves out what takes long: Cityscapes' street is not simulated, and of KITTI's fewer pairs are looked at. The others are
    folders of real data: of KITTI's and of Cityscapes' layout, and of recordings of boards.
    """

    n_images: int = 1000
    n_seeds: int = 10
    seed: int = 0
    is_quick: bool = False
    kitti: str | None = None
    cityscapes: str | None = None
    measured: str | None = None

    def __post_init__(self) -> None:
        if self.n_seeds < 1:
            raise ValueError(f"at least one seed is needed; got {self.n_seeds}")
        if self.n_images > MOST_IMAGES:
            raise ValueError(
                f"{self.n_images} images are more than {MOST_IMAGES}, which take 20 GB and a day: fewer images"
            )
        if self.n_pairs < LEAST_PAIRS:
            raise ValueError(
                f"{self.n_images} images over {self.n_seeds} seeds are {self.n_pairs} pairs each; at least {LEAST_PAIRS} are needed: "
                "more images or fewer seeds"
            )

    @property
    def n_pairs(self) -> int:
        """Pairs of one sample: half of them calibrate, half test."""
        return self.n_images // (2 * self.n_seeds)

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds in order."""
        return tuple(range(self.seed, self.seed + self.n_seeds))

    def document(self) -> dict[str, Any]:
        """What the journal is recognised by."""
        given = {"kitti": self.kitti, "cityscapes": self.cityscapes, "measured": self.measured}
        return {"images": self.n_images, "seeds": self.n_seeds, "seed": self.seed, "quick": self.is_quick} | given
