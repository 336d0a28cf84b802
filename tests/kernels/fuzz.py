"""Every function of the kernel with shapes, sizes and contents that nobody should give it: an answer or a ValueError, never a crash.

Not collected by a plain pytest run: ``make sanitize`` runs it under AddressSanitizer and UndefinedBehaviorSanitizer, where reading
one value beyond an array ends the run. ``BINOCAL_FUZZ_ROUNDS`` makes it longer, ``BINOCAL_FUZZ_SEED`` another one.
"""

from __future__ import annotations

import os

import numpy as np
import pytest

from binocal import kernels
from binocal.kernels import (
    _kernel,
    corner_fits,
    ellipse_fits,
    image_lens,
    images,
    library_words,
    marker_grids,
    point_lattices,
    rectified_maps,
    spots,
    square_fits,
    template_match,
)

ROUNDS = int(os.environ.get("BINOCAL_FUZZ_ROUNDS", "300"))
SEED = int(os.environ.get("BINOCAL_FUZZ_SEED", "0"))
ODD_VALUES = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    np.nan,
    np.inf,
    -np.inf,
    1e-310,
    1e300,
    -1e300,
    1e19,
    2.0**31,
    -(2.0**63),
    640.0,
    1e-9,
]
MODELS = {"brown4": 9, "brown5": 10, "brown8": 13, "fisheye4": 9}
KERNELS = ["squared", "cauchy", "hampel"]


class Fuzz:
    """Random arrays: mostly of the right shape, with contents from ordinary to absurd."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([SEED, seed])
        self.madness = self.rng.choice([0.0, 0.02, 0.3, 1.0])
        self.misfit = self.rng.random() < 0.25

    def size(self, most: int = 9) -> int:
        return int(self.rng.choice([0, 1, 2, 3, most, int(self.rng.integers(0, most + 1))]))

    def floats(self, *shape: int, scale: float = 1.0, dtype: type = float) -> np.ndarray:
        if self.misfit and self.rng.random() < 0.2 and shape:
            shape = (*shape[:-1], max(0, shape[-1] + int(self.rng.choice([-1, 1]))))
        values = scale * self.rng.standard_normal(shape)
        odd = self.rng.random(shape) < self.madness
        with np.errstate(all="ignore"):
            return np.where(odd, self.rng.choice(ODD_VALUES, shape), values).astype(dtype)

    def bools(self, *shape: int) -> np.ndarray:
        return self.rng.random(shape) < 0.7

    def image(self, dtypes: tuple[type, ...] = (np.uint8, np.float32)) -> np.ndarray:
        height, width = (int(self.rng.choice([0, 1, 2, 3, 5, 17, 40])) for _ in range(2))
        dtype = self.rng.choice(dtypes)
        if dtype == np.float32:
            return self.floats(height, width, scale=100.0, dtype=np.float32)
        return self.rng.integers(0, np.iinfo(dtype).max, (height, width), dtype=dtype, endpoint=True)

    def places(self, n: int) -> np.ndarray:
        return self.floats(n, 2, scale=30.0)


def accumulate(f: Fuzz) -> None:
    kernels.accumulate(*corners(f), f.floats(*f.batch, scale=2.0), f.rng.choice(KERNELS), whitening=whitening(f))


def corners(f: Fuzz) -> tuple:
    model = f.rng.choice(list(MODELS))
    f.batch, f.views, f.n = tuple(f.size(2) for _ in range(f.rng.integers(0, 2))), f.size(4), f.size(12)
    parameters = f.floats(*f.batch, MODELS[model]) + np.r_[600, 600, 320, 240, np.zeros(MODELS[model] - 4)]
    pixels = f.floats(*f.batch, f.views, 2, f.n, scale=300.0)
    poses = f.floats(*f.batch, f.views, 3, 3), f.floats(*f.batch, f.views, 3)
    return str(model), parameters, *poses, f.floats(3, f.n), pixels, f.bools(*f.batch, f.views, f.n)


def whitening(f: Fuzz) -> np.ndarray | None:
    return f.floats(*f.batch, f.views, 3, f.n) if f.rng.random() < 0.5 else None


def squared_lengths(f: Fuzz) -> None:
    given = corners(f)
    kernels.squared_lengths(*given, whitening(f))


def unweighted_columns(f: Fuzz) -> None:
    model, parameters, R, t, points, pixels, is_seen = corners(f)
    if not f.batch:
        kernels.unweighted_columns(model, parameters, R, t, points, pixels, is_seen)


def robust_costs(f: Fuzz) -> None:
    rigs = f.size()
    kernels.robust_costs(f.floats(rigs, f.size(20)) ** 2, f.floats(rigs), f.rng.choice(KERNELS))


def median_lengths2(f: Fuzz) -> None:
    shape = (f.size(3), f.size(4), f.size(20))
    kernels.median_lengths2((f.floats(*shape), f.floats(*shape)), (f.bools(*shape), f.bools(*shape)))


def grams(f: Fuzz) -> tuple:
    f.batch, f.views, q = (f.size(2),), f.size(4), 7 + f.size(6)
    n_cameras = int(f.rng.integers(1, 3))
    sides = []
    for _ in range(n_cameras):
        J = f.floats(*f.batch, f.views, 2 * q, q)
        sides.append(J.swapaxes(-1, -2) @ J)
    T = (f.floats(*f.batch, 3, 3), f.floats(*f.batch, 3)) if n_cameras == 2 else None
    return tuple(sides), T


def solve_steps(f: Fuzz) -> None:
    with np.errstate(all="ignore"):
        sides, T = grams(f)
    kernels.solve_steps(sides, T, 1 + np.abs(f.floats(*f.batch)), is_rig_free=bool(f.rng.random() < 0.7))


def reduced_information(f: Fuzz) -> None:
    with np.errstate(all="ignore"):
        kernels.reduced_information(*grams(f))


def step_poses(f: Fuzz) -> None:
    n = f.size()
    kernels.step_poses(f.floats(n, 3, 3), f.floats(n, 3), f.floats(n, 6))


def compose_poses(f: Fuzz) -> None:
    rigs, views = f.size(3), f.size(4)
    kernels.compose_poses(
        f.floats(rigs, 3, 3), f.floats(rigs, 3), f.floats(rigs, views, 3, 3), f.floats(rigs, views, 3)
    )


def pixels_behind(f: Fuzz) -> None:
    model, parameters, R, t, points, pixels, _ = corners(f)
    if not f.batch:
        return
    rig = None if f.rng.random() < 0.5 else (f.floats(*f.batch, 3, 3), f.floats(*f.batch, 3), f.floats(*f.batch, 6))
    step = f.floats(*f.batch, f.views, 6)
    kernels.pixels_behind(
        model, (parameters, f.floats(*parameters.shape)), (R, t, step), rig, points, pixels, f.floats(*f.batch)
    )


def fit_planes(f: Fuzz) -> None:
    views, n = f.size(4), f.size(30)
    kernels.fit_planes(f.floats(n, 2), f.floats(views, n), f.floats(views, n), np.abs(f.floats(views, n)), f.size(3))


def observe(f: Fuzz) -> None:
    rigs, views, n, s = f.size(3), f.size(4), f.size(12), 6 + f.size(4)
    shape = (rigs, views, n)
    steps, before = (
        kernels.Steps(f.floats(rigs, s), f.floats(rigs, views, 6), f.floats(rigs), f.floats(rigs, s), f.floats(rigs))
        for _ in range(2)
    )
    last = kernels.LastIteration(f.floats(rigs), f.floats(rigs), f.bools(rigs), f.floats(rigs), before)
    kernels.observe(
        (np.abs(f.floats(*shape)), np.abs(f.floats(*shape))),
        (f.bools(*shape), f.bools(*shape)),
        f.floats(rigs),
        steps,
        f.floats(rigs, 3),
        f.floats(rigs, views, 3),
        last,
    )


def saddle_response(f: Fuzz) -> None:
    images.saddle_response(f.image((np.float32,)))


def find_peaks(f: Fuzz) -> None:
    reach, margin = (int(f.rng.integers(-1, 9)) for _ in range(2))
    images.find_peaks(f.image((np.float32,)), reach, margin, float(f.rng.normal()), f.size(50))


def find_spots(f: Fuzz) -> None:
    image = f.image((np.uint8,))
    around = f.image((np.uint8,)) if f.misfit else np.roll(image, 1, axis=0)
    spots.find_components(image, around, int(f.rng.integers(-300, 300)), f.size(9), float(f.floats(1, scale=30.0)[0]))


def find_nearest(f: Fuzz) -> None:
    point_lattices.find_nearest(f.places(f.size(40)), f.size(9))


def grow_point_lattice(f: Fuzz) -> None:
    n = f.size(60)
    points = 10.0 * f.rng.permutation(np.argwhere(np.ones((6, 10))))[:n] + 0.1 * f.places(n)[:n]
    limits = point_lattices.GrowthLimits(*np.abs(f.floats(3, scale=2.0)))
    basis = f.floats(2, 2) if f.misfit else 10.0 * np.eye(2)
    seed = int(f.rng.integers(-1, n + 1))
    point_lattices.grow_lattice(points, np.abs(f.floats(n)), f.bools(n), seed, basis, limits)


def sample(f: Fuzz) -> None:
    images.sample(f.image(), f.places(f.size(50)))


def read_rings(f: Fuzz) -> None:
    radius, contrast, unlike = f.floats(3, scale=5.0)[:3] if not f.misfit else (3.0, 1.0, 1.0)
    images.read_rings(f.image(), f.places(f.size(50)), float(radius), float(contrast), float(unlike))


def localize_saddles(f: Fuzz) -> None:
    reach = int(f.rng.integers(-2, 5))
    images.localize_saddles(f.image(), f.places(f.size(20)), f.floats(5, max(0, (2 * reach + 1) ** 2)), reach)


def follow_edges(f: Fuzz) -> None:
    n = f.size(20)
    images.follow_edges(f.image(), f.places(n), f.places(n), f.floats(n), f.floats(n))


def link_corners(f: Fuzz) -> None:
    n = f.size(40)
    images.link_corners(
        f.image(), f.places(n), f.floats(n, 4, scale=3.0), f.floats(n, scale=50.0), float(f.rng.normal()),
        has_markers=bool(f.rng.random() < 0.7), is_oblique=bool(f.rng.random() < 0.5), has_dots=bool(f.rng.random() < 0.5),
    )  # fmt: skip


def find_faces(f: Fuzz) -> None:
    n = f.size(20)
    neighbour = f.rng.integers(-2, n + (1 if f.misfit else 0), (n, 4)) if n else np.empty((0, 4), np.int64)
    back = f.rng.integers(-1 if f.misfit else 0, 4, (n, 4))
    marker_grids.find_faces(neighbour.astype(np.int64), back.astype(np.int64))


def field_lens(f: Fuzz) -> marker_grids.FieldLens:
    cx, cy, f_px = f.floats(3, scale=300.0)[:3] if not f.misfit else (319.5, 239.5, 300.0)
    return marker_grids.FieldLens(float(cx), float(cy), abs(float(f_px)))


def lines(f: Fuzz) -> marker_grids.Lines:
    x, y = (np.cumsum(np.abs(f.floats(f.size(6)))) for _ in range(2))
    return marker_grids.Lines(x, y, abs(float(f.floats(1)[0])) if not f.misfit else 1.0)


def read_cells(f: Fuzz) -> None:
    marker_grids.read_cells(
        f.image(), f.places(4 * f.size(5)).reshape(-1, 4, 2), f.floats(f.size(6), 2, 2), field_lens(f)
    )


def vote_on_tags(f: Fuzz) -> None:
    n = f.size(9)
    marker_grids.vote_on_tags(f.places(4 * n).reshape(-1, 4, 2), f.floats(n, 4, 2, scale=3.0), field_lens(f), 1.0)


def predict_places(f: Fuzz) -> None:
    on = lines(f)
    known = f.places(len(on.x) * len(on.y)).reshape(len(on.y), len(on.x), 2)
    marker_grids.predict_places(on, known, field_lens(f), f.floats(f.size(5), 2, scale=3.0))


def predict_each(f: Fuzz) -> None:
    on = lines(f)
    shape = len(on.y), len(on.x)
    marker_grids.predict_each(
        on, f.places(shape[0] * shape[1]).reshape(*shape, 2), field_lens(f), np.abs(f.floats(*shape))
    )


def predict_steps(f: Fuzz) -> None:
    on = lines(f)
    known = f.places(len(on.x) * len(on.y)).reshape(len(on.y), len(on.x), 2)
    marker_grids.predict_steps(on, known, field_lens(f), 0.2)


def grow_lattice(f: Fuzz) -> None:
    on = lines(f)
    known = f.places(len(on.x) * len(on.y)).reshape(len(on.y), len(on.x), 2)
    known[f.rng.random(known.shape[:2]) < 0.3] = np.nan
    marker_grids.grow_lattice(
        f.image(), on, 1.0, abs(float(f.rng.normal())), known, f.places(f.size(30)), field_lens(f),
        has_dots=bool(f.rng.random() < 0.5),
    )  # fmt: skip


def grow_groups(f: Fuzz) -> None:
    n = f.size(20)
    neighbour = f.rng.integers(-2, n + (1 if f.misfit else 0), (n, 4)) if n else np.empty((0, 4), np.int64)
    back = f.rng.integers(-1 if f.misfit else 0, 4, (n, 4))
    images.grow_groups(f.places(n), neighbour.astype(np.int64), back.astype(np.int64))


def fit_corners(f: Fuzz) -> None:
    n = f.size(9)
    image = f.image((np.uint8, np.uint16, np.float32))
    reach, strip = np.abs(f.floats(n, scale=8.0)), np.abs(f.floats(n, scale=8.0))
    board = corner_fits.BoardPlaces(f.floats(n, 2), abs(float(f.floats(1)[0]))) if f.rng.random() < 0.5 else None
    corner_fits.fit_corners(image, f.places(n), reach, strip, board=board)


def fit_ellipses(f: Fuzz) -> None:
    n = f.size(9)
    image = f.image((np.uint8, np.uint16, np.float32))
    axes, room = np.abs(f.floats(n, 2, scale=6.0)), [np.abs(f.floats(n, scale=8.0)) for _ in range(2)]
    ellipse_fits.fit_ellipses(image, f.places(n), axes, f.floats(n), *room)


def fit_squares(f: Fuzz) -> None:
    n = f.size(9)
    image = f.image((np.uint8, np.uint16, np.float32))
    square = 12 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) + 3 * f.rng.standard_normal((4, 2))
    corners = f.places(n)[:, None] + square
    sides = f.floats(n, 4, 3), np.abs(f.floats(n, 4, scale=5.0)), np.abs(f.floats(n, scale=30.0))
    blur_px = float(np.abs(f.floats(2))[0])
    square_fits.fit_squares(image, corners, *sides, blur_px=blur_px, is_rough=bool(f.rng.random() < 0.5))


def fit_image_lens(f: Fuzz) -> None:
    n, kind = f.size(20), f.rng.random(2) < 0.5
    options = image_lens.LensFitOptions(abs(float(f.floats(1)[0])), bool(kind[0]), bool(kind[1]))
    points = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)[:n].astype(float)
    board = points if f.rng.random() < 0.5 else f.floats(n, 2)
    image = 40 * points + 3 * f.floats(len(points), 2) if f.rng.random() < 0.5 else f.places(n)
    image_lens.fit_image_lens(board, image, (640, 480), options, places_xy=f.floats(f.size(5), 2))


def pool_corners(f: Fuzz) -> None:
    n = f.size(12)
    fits = corner_fits.CornerFits(
        f.floats(n, corner_fits.CORNER_FIT.itemsize // 8, scale=5.0).view(corner_fits.CORNER_FIT)[:, 0]
    )
    corner_fits.pool_corners(fits, are_corners=bool(f.rng.random() < 0.5))


def rectified_map(f: Fuzz) -> None:
    model = f.rng.choice(list(MODELS))
    height, width = f.size(20), f.size(20)
    given = [np.empty((2, height, width), np.float32), np.empty((height, width), bool)]
    if f.misfit:
        given[int(f.rng.integers(2))] = np.empty((2, f.size(), f.size()), np.float32)[
            0 if f.rng.random() < 0.5 else ...
        ]
    rectified_maps.rectified_map(
        model, f.floats(MODELS[model]), f.floats(height, 3), f.floats(width, 3), (640, 480),
        least_cosine=float(f.floats(1)[0]), outside=float(f.rng.choice([np.nan, -16.0, 3.0])), out=given[0], is_inside=given[1],
    )  # fmt: skip


def reduce_stereo(f: Fuzz) -> None:
    views, sizes = f.size(4), 7 + f.rng.integers(0, 6, 2)
    with np.errstate(all="ignore"):
        roots = [f.floats(views, 2 * q, q) for q in sizes]
        sides = tuple(J.swapaxes(-1, -2) @ J for J in roots)
    deviation = f.floats(views, 6, 6) if f.rng.random() < 0.5 else None
    prior = (None, None) if deviation is None else (np.abs(f.floats(6)), f.floats(views, 6))
    steps = kernels.PoseSteps(f.floats(views, 6, 6), f.floats(views, 6, 6), deviation, *prior)
    points = None
    if f.rng.random() < 0.5:
        n = f.size(9)
        points = tuple(kernels.PointEquations(f.floats(views, q, 3, n), f.floats(views, 6, n)) for q in sizes)
    kernels.reduce_stereo(sides, steps, points, 1 + abs(float(f.rng.normal())), of_views=bool(f.rng.random() < 0.5))


def solve_definite(f: Fuzz) -> None:
    n = f.size(9)
    J = f.floats(n + 2, n)
    with np.errstate(all="ignore"):
        kernels.solve_definite(J.T @ J, f.floats(f.size(40), n))


def caught_words(f: Fuzz) -> None:
    with library_words.caught_words() as outer, library_words.caught_words():
        pass
    assert not outer


def match_templates(f: Fuzz) -> None:
    n, images_ = f.size(20), (f.image((np.float32,)), f.image((np.float32,)))
    start = None if f.rng.random() < 0.5 else np.eye(2) + f.floats(n, 2, 2, scale=0.3)
    places = [np.abs(f.places(n)) if f.rng.random() < 0.7 else f.places(n) for _ in range(2)]
    shares = f.floats(2, scale=0.5)
    template_match.match_templates(
        *images_, *places, start, half=int(f.rng.integers(0, 17)), max_iterations=f.size(15), tolerance_px=float(shares[0]),
        sigma_share=float(shares[-1]),
    )  # fmt: skip


FUNCTIONS = [
    accumulate, squared_lengths, unweighted_columns, robust_costs, median_lengths2, solve_steps, reduced_information, step_poses,
    compose_poses, pixels_behind, fit_planes, observe, saddle_response, find_peaks, find_spots, find_nearest, grow_point_lattice,
    sample, read_rings, localize_saddles,
    follow_edges, link_corners, find_faces, read_cells, vote_on_tags, predict_places, predict_each, predict_steps,
    grow_lattice, grow_groups, fit_corners, fit_ellipses, fit_squares, fit_image_lens, pool_corners, rectified_map,
    reduce_stereo, solve_definite, caught_words, match_templates,
]  # fmt: skip


def test_every_function_of_the_extension_is_fuzzed():
    called = {name for function in FUNCTIONS for name in (function.__name__,)}
    other_names = {"robust_costs": "costs", "median_lengths2": "medians", "reduced_information": "solve_steps"}
    other_names["caught_words"] = "begin_catching_words"
    exported = {
        name
        for name in dir(_kernel)
        if callable(function := getattr(_kernel, name)) and not isinstance(function, type) and not name.startswith("_")
    }
    assert exported - {"end_catching_words"} == {other_names.get(name, name) for name in called}


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__name__)
def test_nothing_crashes(function):
    n_answers = 0
    for seed in range(ROUNDS):
        with np.errstate(all="ignore"):
            try:
                function(Fuzz(seed))
                n_answers += 1
            except (ValueError, TypeError, IndexError):  # named, by the kernel or by NumPy on the way to it
                pass
    assert n_answers > ROUNDS / 20
