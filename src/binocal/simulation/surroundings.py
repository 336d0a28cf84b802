"""What stands around a rig in scenes without a board, as a handful of planes with things in front of them: distances along rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.geometry import so3
from binocal.shapes import Float

Range = tuple[float, float]
ABSENT_M = np.inf


@dataclass(frozen=True, slots=True)
class Surroundings:
    """A family of scenes. Lengths are in metres, in the left camera's frame, each drawn uniformly from its range."""

    baseline_m: Range
    """Of the rigs that are usual in such scenes."""
    floor_m: Range | None = None
    ceiling_m: Range | None = None
    sides_m: Range | None = None
    end_m: Range = (10.0, 10.0)
    """Of the plane ahead, along the optical axis."""
    end_tilt_deg: float = 0.0
    """Up to which the plane ahead is turned, about any axis across the view."""
    object_share: float = 0.0
    """Of the points that lie on things in front of the planes."""
    nearest_share: float = 0.15
    """How near those things come, as a share of the plane's distance."""


SURROUNDINGS: dict[str, Surroundings] = {
    "street": Surroundings((0.2, 0.6), (1.2, 2.0), None, (3.0, 15.0), (30.0, 120.0), object_share=0.3),
    "room": Surroundings((0.06, 0.2), (0.8, 1.6), (1.0, 2.0), (1.5, 4.0), (2.5, 8.0), object_share=0.4),
    "far": Surroundings((0.2, 0.6), end_m=(40.0, 300.0), end_tilt_deg=30.0, object_share=0.5),
    "plane": Surroundings((0.1, 0.6), end_m=(3.0, 15.0), end_tilt_deg=60.0),
}
"""The families by name. ``far`` has no ground: hardly any parallax."""


@dataclass(frozen=True, slots=True, eq=False)
class ScenePlanes:
    """Planes of a batch of scenes: unit normals away from the rig, and distances of the planes from it (inf: none)."""

    normals: Float[ndarray, "scenes planes 3"]
    distances_m: Float[ndarray, "scenes planes"]
    object_share: Float[ndarray, "scenes"]
    nearest_share: Float[ndarray, "scenes"]

    def surface_m(self, scene: ndarray, rays: Float[ndarray, "n 3"]) -> Float[ndarray, "n"]:
        """How far unit rays go in scene number ``scene`` each until they meet a plane; inf where they meet none."""
        toward = np.einsum("npk,nk->np", self.normals[scene], rays)
        with np.errstate(all="ignore"):
            reach = np.where(toward > 1e-6, self.distances_m[scene] / toward, ABSENT_M)
        return reach.min(axis=1)

    def draw_m(self, scene: ndarray, rays: Float[ndarray, "n 3"], rng: np.random.Generator) -> Float[ndarray, "n"]:
        """Distances of points seen along rays: on a plane, or on a thing before it."""
        share = self.nearest_share[scene]
        is_object = rng.random(len(scene)) < self.object_share[scene]
        shorter = np.where(is_object, share + (1 - share) * rng.random(len(scene)), 1.0)
        return self.surface_m(scene, rays) * shorter


def draw_planes(
    families: list[Surroundings], rng: np.random.Generator, length_scale: Float[ndarray, "scenes"] | float = 1.0
) -> ScenePlanes:
    """The planes of one scene of each listed family; all lengths are multiplied by ``length_scale``."""
    n = len(families)

    def lengths(name: str) -> Float[ndarray, "scenes"]:
        ranges = [getattr(family, name) or (ABSENT_M, ABSENT_M) for family in families]
        low, high = np.array(ranges, dtype=float).T
        with np.errstate(invalid="ignore"):
            return np.where(np.isfinite(high), low + (high - low) * rng.random(n), ABSENT_M) * length_scale

    way = rng.uniform(0, 2 * np.pi, n)
    tilt = np.radians([family.end_tilt_deg for family in families]) * rng.random(n)
    ahead = so3.exp(tilt[:, None] * np.stack([np.cos(way), np.sin(way), np.zeros(n)], axis=1))[:, :, 2]
    fixed = np.broadcast_to(np.array([[0, 1, 0], [0, -1, 0], [-1, 0, 0], [1, 0, 0]], dtype=float), (n, 4, 3))
    distances = [lengths(name) for name in ("floor_m", "ceiling_m", "sides_m", "sides_m", "end_m")]
    return ScenePlanes(
        np.concatenate([fixed, ahead[:, None]], axis=1),
        np.stack(distances, axis=1) * np.where(np.arange(5) == 4, np.cos(tilt)[:, None], 1.0),
        np.array([family.object_share for family in families]),
        np.array([family.nearest_share for family in families]),
    )
