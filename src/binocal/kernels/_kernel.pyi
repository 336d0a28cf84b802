"""The compiled extension as type checkers see it. Arrays are C-contiguous doubles unless another type is named.

Arrays are checked where they enter, and a wrong shape is a ValueError. What is not given or not wanted is an empty array. Shapes:
the functions of binocal.kernels, and the sources in cpp/.
"""

from collections.abc import Sequence
from typing import TypeAlias, final

from numpy import dtype, float32, float64, int64, ndarray

Floats: TypeAlias = ndarray[tuple[int, ...], dtype[float64]]
Indices: TypeAlias = ndarray[tuple[int, ...], dtype[int64]]
Plane: TypeAlias = ndarray[tuple[int, ...], dtype[float32]]

N_OBSERVED: int
SPOT_SIZE: int
RECORD_LAYOUTS: dict[str, tuple[int, dict[str, int]]]
ELLIPSE_LAYOUTS: dict[str, tuple[int, dict[str, int]]]
SQUARE_LAYOUTS: dict[str, tuple[int, dict[str, int]]]

# residuals
@final
class Views:
    def __init__(
        self,
        *,
        parameters: Floats,
        R: Floats,
        t: Floats,
        points: Floats,
        pixels: Floats,
        is_seen: ndarray,
        whitening: Floats,
    ) -> None: ...

@final
class Sums:
    def __init__(self, *, gram: Floats, r2: Floats, cost: Floats, coupling: Floats, information: Floats) -> None: ...

def accumulate(
    model: str, views: Views, is_free: ndarray, scale: Floats, kernel: str, out: Sums, n_threads: int, /
) -> None: ...
def squared_lengths(model: str, views: Views, r2: Floats, n_threads: int, /) -> None: ...
def unweighted_columns(model: str, views: Views, columns: Floats, /) -> None: ...
def costs(r2: Floats, scale: Floats, kernel: str, cost: Floats, /) -> None: ...
def medians(r2: Sequence[ndarray], is_seen: Sequence[ndarray], out: Floats, /) -> None: ...

# the step
@final
class JointEquations:
    def __init__(
        self,
        *,
        grams: Sequence[ndarray],
        R: Floats,
        t: Floats,
        is_rig_free: bool,
        prior_information: Floats,
        prior_gradient: Floats,
    ) -> None: ...

@final
class Damping:
    def __init__(self, *, growth: Floats, pose_growth: Floats, stretch: Floats, shift: Floats) -> None: ...

@final
class StepArrays:
    def __init__(
        self, *, shared: Floats, views: Floats, predicted: Floats, reduced: Floats, gradient: Floats, pivot: Floats
    ) -> None: ...

def solve_steps(equations: JointEquations, damping: Damping, out: StepArrays, n_threads: int, /) -> None: ...

# two cameras with board points and exposures free
@final
class StereoViews:
    def __init__(
        self,
        *,
        left: Floats,
        right: Floats,
        T_rig: Floats,
        T_pose: Floats,
        T_deviation: Floats,
        left_coupling: Floats,
        right_coupling: Floats,
        left_points: Floats,
        right_points: Floats,
        precision: Floats,
        pull: Floats,
        growth: float,
    ) -> None: ...

@final
class ReducedViews:
    def __init__(
        self,
        *,
        inverse_L: Floats,
        Y: Floats,
        own: Floats,
        determined: Floats,
        information: Floats,
        gradient: Floats,
        h: Floats,
        scores: Floats,
    ) -> None: ...

def reduce_stereo(views: StereoViews, out: ReducedViews, n_threads: int, /) -> None: ...
def solve_definite(A: Floats, b: Floats, n_threads: int, /) -> bool: ...

# what a controller sees
@final
class NextStep:
    def __init__(
        self, *, shared: Floats, views: Floats, predicted: Floats, gradient: Floats, pivot: Floats
    ) -> None: ...

@final
class Previous:
    def __init__(
        self, *, scale_px: Floats, gain: Floats, is_kept: ndarray, mad: Floats, predicted: Floats, shared: Floats
    ) -> None: ...

def observe(
    r2: Sequence[ndarray],
    is_seen: Sequence[ndarray],
    mad: Floats,
    step: NextStep,
    t_rig: Floats,
    t: Floats,
    last: Previous,
    out: Floats,
    /,
) -> None: ...

# rigid transforms
def step_poses(R: Floats, t: Floats, xi: Floats, R_out: Floats, t_out: Floats, /) -> None: ...
def compose_poses(R_rig: Floats, t_rig: Floats, R: Floats, t: Floats, R_out: Floats, t_out: Floats, /) -> None: ...

@final
class Movement:
    def __init__(
        self,
        *,
        parameters: Floats,
        parameter_step: Floats,
        R: Floats,
        t: Floats,
        view_step: Floats,
        R_rig: Floats,
        t_rig: Floats,
        rig_step: Floats,
    ) -> None: ...

def pixels_behind(
    model: str, movement: Movement, bend: Floats, points: Floats, pixels: Floats, out: Floats, n_threads: int, /
) -> None: ...

# homographies
@final
class PlaneFits:
    def __init__(
        self, *, rows: Floats, S_inverse: Floats, P: Floats, D_inverse: Floats, du: Floats, dv: Floats
    ) -> None: ...

def fit_planes(
    xy: Floats, u: Floats, v: Floats, w: Floats, n_passes: int, out: PlaneFits, n_threads: int, /
) -> None: ...

# images
def saddle_response(smooth: ndarray, response: ndarray, /) -> None: ...
def find_peaks(response: ndarray, reach: int, margin: int, least: float, points: Floats, /) -> int: ...
def find_spots(
    image: ndarray, around: ndarray, below: int, least_area: int, most_side: float, records: Floats, /
) -> int: ...
def find_nearest(points: Floats, near: Indices, distance: Floats, unlike: Floats, /) -> None: ...
def grow_point_lattice(
    points: Floats,
    log_sizes: Floats,
    is_free: ndarray,
    seed: int,
    basis: Floats,
    most_error: float,
    sure_error: float,
    most_log_ratio: float,
    members: Indices,
    cells: Indices,
    /,
) -> int: ...
def sample(image: ndarray, points: Floats, values: Plane, /) -> None: ...
def read_rings(
    image: ndarray,
    points: Floats,
    radius: float,
    min_contrast: float,
    max_unlikeness: float,
    is_corner: ndarray,
    rays: Floats,
    contrast: Floats,
    /,
) -> None: ...
def localize_saddles(image: ndarray, fit: Floats, reach: int, points: Floats, /) -> None: ...
def follow_edges(
    image: ndarray, start: Floats, way: Floats, sign: Floats, contrast: Floats, is_seen: ndarray, /
) -> None: ...
def link_corners(
    image: ndarray,
    points: Floats,
    rays: Floats,
    contrast: Floats,
    max_turn: float,
    has_markers: bool,
    is_oblique: bool,
    has_dots: bool,
    neighbour: Indices,
    back_ray: Indices,
    /,
) -> None: ...
def find_faces(neighbour: Indices, back_ray: Indices, faces: Indices, parity: Indices, /) -> int: ...
def read_cells(
    image: ndarray, quads: Floats, places: Floats, per_cell: int, cx: float, cy: float, f: float, values: ndarray, /
) -> None: ...
def vote_on_tags(
    quads: Floats,
    places: Floats,
    cx: float,
    cy: float,
    f: float,
    pitch: float,
    reach: float,
    groups: Indices,
    agreeing: Indices,
    disagreeing: Indices,
    /,
) -> None: ...
def predict_places(
    x: Floats, y: Floats, pitch: float, known: Floats, cx: float, cy: float, f: float, places: Floats, points: Floats, /
) -> None: ...
def predict_each(
    x: Floats, y: Floats, pitch: float, known: Floats, weight: Floats, cx: float, cy: float, f: float, points: Floats, /
) -> None: ...
def predict_steps(
    x: Floats, y: Floats, pitch: float, known: Floats, cx: float, cy: float, f: float, probe: float, steps: Floats, /
) -> None: ...
def grow_lattice(
    image: ndarray,
    x: Floats,
    y: Floats,
    pitch: float,
    sign: float,
    free: float,
    has_dots: bool,
    known: Floats,
    candidates: Floats,
    cx: float,
    cy: float,
    f: float,
    is_new: ndarray,
    /,
) -> None: ...
def grow_groups(
    points: Floats,
    neighbour: Indices,
    back_ray: Indices,
    members: Indices,
    cells: Indices,
    turns: Indices,
    groups: Indices,
    /,
) -> int: ...
def fit_corners(
    image: ndarray, bottom: float, top: float, inputs: Floats, board_xy: Floats, pitch: float, results: Floats, /
) -> None: ...
def pool_corners(fits: Floats, are_corners: bool, pooled: Floats, /) -> float: ...
def fit_ellipses(image: ndarray, bottom: float, top: float, inputs: Floats, results: Floats, /) -> None: ...
def fit_squares(
    image: ndarray, bottom: float, top: float, inputs: Floats, is_rough: bool, results: Floats, /
) -> None: ...
def fit_image_lens(
    board_xy: Floats,
    points: Floats,
    width: float,
    height: float,
    tolerance: float,
    n_unknowns: int,
    is_robust: bool,
    places: Floats,
    lens: Floats,
    lengths: Floats,
    images: Floats,
    /,
) -> bool: ...
def match_templates(
    from_image: ndarray,
    to_image: ndarray,
    start_from: Floats,
    start_to: Floats,
    start_warp: Floats,
    half: int,
    max_iterations: int,
    tolerance_px: float,
    sigma_share: float,
    place: Floats,
    warp: Floats,
    likeness: Floats,
    spread: Floats,
    is_converged: ndarray,
    n_threads: int,
    /,
) -> None: ...
def rectified_map(
    model: str,
    parameters: Floats,
    rows: Floats,
    columns: Floats,
    size: Floats,
    least_cosine: float,
    outside: float,
    map: Plane,
    is_inside: ndarray,
    n_threads: int,
    /,
) -> None: ...

# library_words
def begin_catching_words() -> None: ...
def end_catching_words() -> bytes: ...
