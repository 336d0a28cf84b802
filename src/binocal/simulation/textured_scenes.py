"""Streets and rooms of textured rectangles, which a rig goes through pair by pair; some things in them move."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.geometry import SE3, so3
from binocal.shapes import Float
from binocal.simulation.surroundings import SURROUNDINGS
from binocal.simulation.textures import Texture, grain, shelves, slats, tiles, windows


@dataclass(frozen=True, slots=True, eq=False)
class TexturedPatch:
    """A rectangle in the world (x right, y down, z ahead; metres), seen from both sides.

    ``axes`` are two unit vectors at right angles along its sides, ``half_m`` half its sides. ``pattern`` repeats without end; the grain
    is that of the whole scene, from another place on each patch.
    """

    centre_m: Float[ndarray, "3"]
    axes: Float[ndarray, "2 3"]
    half_m: tuple[float, float]
    level_dn: float = 120.0
    grain_dn: float = 30.0
    pattern: Texture | None = None
    pattern_dn: float = 0.0
    grain_offset_m: tuple[float, float] = (0.0, 0.0)
    velocity_m_s: Float[ndarray, "3"] = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class TexturedScene:
    """Patches that stand, patches that move (those of each pair), and where the left camera stands at each pair."""

    patches: tuple[TexturedPatch, ...]
    movers: tuple[tuple[TexturedPatch, ...], ...]
    T_left_world: SE3
    grain: Texture

    @property
    def n_pairs(self) -> int:
        """How many pairs are taken."""
        return len(self.movers)

    def patches_at(self, pair: int, elapsed_s: float) -> list[TexturedPatch]:
        """All patches of a pair, the moving ones so long after the left exposure."""
        moved = [_shifted(patch, elapsed_s * patch.velocity_m_s) for patch in self.movers[pair]]
        return [*self.patches, *moved]


TEXTURED_SCENES = ("street", "room")
LEAST_YAW_DEG = (
    18.0  # of views of a room against its walls, to either side in turn: face on, lines tell no focal length
)


def draw_textured_scene(kind: str, rig: StereoRig, n_pairs: int, rng: np.random.Generator) -> TexturedScene:
    """A street driven along, or a room looked around in.

    In metres; lengths follow the usual baseline of such scenes where the rig is not metric.

    Raises:
        ValueError: No such kind of scene.
    """
    if kind not in TEXTURED_SCENES:
        raise ValueError(f"unknown scene {kind!r}; known: {', '.join(TEXTURED_SCENES)}")
    scene = (_street if kind == "street" else _room)(n_pairs, rng)
    scale = 1.0 if rig.is_metric else rig.baseline_m / float(np.mean(SURROUNDINGS[kind].baseline_m))
    return scene if scale == 1 else _scaled(scene, scale)


RIGHT, DOWN, AHEAD = np.eye(3)


def _street(n_pairs: int, rng: np.random.Generator) -> TexturedScene:
    """Two rows of houses set back differently, a fence, things at the roadside, a hill at the end; cars."""
    step_m, floor_m = 1.5, rng.uniform(1.3, 1.9)
    length_m = 70.0 + step_m * n_pairs
    make = _Maker(rng)
    patches = [
        make.patch([0, floor_m, length_m / 2 - 10], (RIGHT, AHEAD), (60, length_m / 2 + 20), 100, 30),
        make.patch([0, floor_m - 30, length_m + 20], (RIGHT, DOWN), (250, 40), 150, 40),
    ]
    for side in (-1.0, 1.0):
        start = -20.0
        while start < length_m:
            width, height = rng.uniform(7, 16), rng.uniform(6, 14)
            away = side * rng.uniform(6.0, 10.0)
            front = make.patch([away, floor_m - height / 2, start + width / 2], (AHEAD, DOWN), (width / 2, height / 2))
            gable = make.patch(
                [away + side * 5, floor_m - height / 2, start + 0.02], (RIGHT, DOWN), (5, height / 2), 90, 30
            )
            patches += [make.patterned(front, windows(rng.uniform(2.2, 3.5)), 60), gable]
            start += width
    fence = make.patch([-4.5, floor_m - 0.5, length_m / 2], (AHEAD, DOWN), (length_m / 3, 0.5), 130, 15)
    patches.append(make.patterned(fence, slats(0.25), 50))
    for z in np.arange(5.0, length_m, 4.0):  # things at the roadside, at several depths
        half = rng.uniform(0.3, 0.9, 2)
        x = rng.choice([-1.0, 1.0]) * rng.uniform(2.2, 4.3)
        turn = so3.exp(np.array([0, rng.uniform(-0.7, 0.7), 0]))
        patches.append(make.patch([x, floor_m - half[1], z + rng.uniform(-1, 1)], (turn @ RIGHT, DOWN), half))
    poses, movers = [], []
    for pair in range(n_pairs):
        z = pair * step_m
        turn = so3.exp(np.radians([rng.normal(0, 0.7), rng.normal(0, 3.0), rng.normal(0, 0.7)]))
        poses.append(SE3(turn, -turn @ np.array([rng.normal(0, 0.2), rng.normal(0, 0.02), z])))
        cars = []
        for lane in (-1.3, 1.4):
            centre = [lane, floor_m - 0.7, z + rng.uniform(6, 30)]
            car = make.patch(centre, (RIGHT, DOWN), (0.9, 0.6), rng.uniform(60, 180), 40)
            speed = np.array([rng.normal(0, 1.5), 0.0, rng.choice([-1.0, 1.0]) * rng.uniform(4, 14)])
            cars.append(_moving(car, speed))
        movers.append(tuple(cars))
    return TexturedScene(tuple(patches), tuple(movers), _batch(poses), grain(rng, 8.0))


def _room(n_pairs: int, rng: np.random.Generator) -> TexturedScene:
    """Walls with shelves and windows, tiles above and below, furniture at several depths; somebody walks.

    Edges run in three directions at right angles, so that vanishing points tell the camera.
    """
    floor_m, ceiling_m = rng.uniform(1.0, 1.5), rng.uniform(1.0, 1.6)
    left_m, right_m, ahead_m, behind_m = rng.uniform(2, 3.5), rng.uniform(2, 3.5), rng.uniform(4, 7), 3.0
    make = _Maker(rng)
    middle_y, half_y = (floor_m - ceiling_m) / 2, (floor_m + ceiling_m) / 2
    middle_z, half_z = (ahead_m - behind_m) / 2, (ahead_m + behind_m) / 2
    middle_x, half_x = (right_m - left_m) / 2, (right_m + left_m) / 2
    floor = make.patch([middle_x, floor_m, middle_z], (RIGHT, AHEAD), (half_x, half_z), 110, 25)
    end = make.patch([middle_x, middle_y, ahead_m], (RIGHT, DOWN), (half_x, half_y), 150, 25)
    ceiling = make.patch([middle_x, -ceiling_m, middle_z], (RIGHT, AHEAD), (half_x, half_z), 190, 15)
    sides = [
        make.patch([x, middle_y, middle_z], (AHEAD, DOWN), (half_z, half_y), level, 30)
        for x, level in ((-left_m, 140), (right_m, 120))
    ]
    patches = [
        make.patterned(floor, tiles(0.4), 50),
        make.patterned(ceiling, tiles(0.62), 60),
        *(make.patterned(side, shelves(period), 45) for side, period in zip(sides, (0.72, 0.86), strict=True)),
        make.patterned(end, windows(0.9), 55),
        make.patch([middle_x, middle_y, -behind_m], (RIGHT, DOWN), (half_x, half_y), 130, 30),
    ]
    for _ in range(12):
        half = rng.uniform(0.15, 0.5, 2)
        x, z = rng.uniform(-left_m + 0.3, right_m - 0.3), rng.uniform(1.4, ahead_m - 0.3)
        turn = so3.exp(np.array([0, rng.uniform(-0.9, 0.9), 0]))
        y = floor_m - half[1] if rng.random() < 0.6 else rng.uniform(-ceiling_m + half[1], floor_m - half[1])
        patches.append(make.patch([x, y, z], (turn @ RIGHT, DOWN), half, rng.uniform(60, 190), 40))
    poses, movers, side = [], [], 1.0
    for _ in range(n_pairs):
        pitch, yaw, roll = rng.normal(0, 4), rng.uniform(-20, 20), rng.normal(0, 2)
        side = -side if poses else np.copysign(1.0, yaw)
        turn = so3.exp(np.radians([pitch, side * (LEAST_YAW_DEG + abs(yaw)), roll]))
        poses.append(SE3(turn, -turn @ rng.uniform(-0.25, 0.25, 3)))
        place = [rng.uniform(-1, 1), floor_m - 0.8, rng.uniform(2.0, ahead_m - 0.5)]
        walker = make.patch(place, (RIGHT, DOWN), (0.25, 0.8), rng.uniform(60, 180), 40)
        movers.append((_moving(walker, np.array([rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5), 0.0, 0.0])),))
    return TexturedScene(tuple(patches), tuple(movers), _batch(poses), grain(rng, 2.5))


class _Maker:
    """Draws what differs from patch to patch."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def patch(
        self,
        centre: list[float],
        axes: tuple[ndarray, ndarray],
        half: tuple[float, float] | ndarray,
        level_dn: float = 130.0,
        grain_dn: float = 35.0,
    ) -> TexturedPatch:
        """A patch with grain from a place of its own."""
        level = float(np.clip(level_dn + self.rng.normal(0, 15), 40, 200))
        u, v = self.rng.uniform(0, 100, 2)
        sides = (float(half[0]), float(half[1]))
        return TexturedPatch(
            np.array(centre, dtype=float), np.stack(axes), sides, level, grain_dn, grain_offset_m=(u, v)
        )

    def patterned(self, patch: TexturedPatch, pattern: Texture, contrast_dn: float) -> TexturedPatch:
        """The patch with something that repeats, and less grain, so that its periods look alike."""
        return replace(patch, pattern=pattern, pattern_dn=contrast_dn, grain_dn=0.5 * patch.grain_dn)


def _moving(patch: TexturedPatch, velocity_m_s: Float[ndarray, "3"]) -> TexturedPatch:
    return replace(patch, velocity_m_s=velocity_m_s)


def _shifted(patch: TexturedPatch, by_m: Float[ndarray, "3"]) -> TexturedPatch:
    return replace(patch, centre_m=patch.centre_m + by_m)


def _batch(poses: list[SE3]) -> SE3:
    return SE3(np.stack([pose.R for pose in poses]), np.stack([pose.t for pose in poses]))


def _scaled(scene: TexturedScene, factor: float) -> TexturedScene:
    """The scene with every length multiplied."""

    def texture(given: Texture) -> Texture:
        return replace(given, texel_m=given.texel_m * factor)

    def patch(given: TexturedPatch) -> TexturedPatch:
        return replace(
            given,
            centre_m=factor * given.centre_m,
            half_m=(factor * given.half_m[0], factor * given.half_m[1]),
            pattern=None if given.pattern is None else texture(given.pattern),
            grain_offset_m=(factor * given.grain_offset_m[0], factor * given.grain_offset_m[1]),
            velocity_m_s=factor * given.velocity_m_s,
        )

    return TexturedScene(
        tuple(patch(p) for p in scene.patches),
        tuple(tuple(patch(p) for p in pair) for pair in scene.movers),
        SE3(scene.T_left_world.R, factor * scene.T_left_world.t),
        texture(scene.grain),
    )
