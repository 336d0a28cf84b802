"""Images of boards with exactly known corners.

Light is followed in the order in which a camera meets it: print and illumination, the lens's blur, integration over
pixels, the sensor. The blur is applied on a grid of 4 x 4 points per pixel; blurring pixel values instead would
shift corners by up to 0.006 px. The ray of every pixel goes through the full camera model to the board's plane, and
its second-order expansion carries it to the 16 points. Only pixels at an edge of the print are treated so; all
others are constant.

The first 0.14 px of the blur act on the print analytically (:mod:`binocal.simulation.coverage`): what is sampled on
the fine grid is then band-limited (2e-3 of an edge's light at the sampling frequency; cells' means, the obvious
other way, leave errors of 0.5 grey levels and 0.001 px at a blur of 0.4 px). The Gaussian that is left to do is
sigma² - 0.14² + (1/4)²/12, the last term because the mean of four points is narrower than a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.cameras import Camera
from binocal.geometry import SE3
from binocal.shapes import Bool, Float, UInt
from binocal.simulation.background import draw_background
from binocal.simulation.coverage import Footprint, Sheet, sheet_of
from binocal.simulation.imaging import rays_of_pixels, read_out, through_lens
from binocal.simulation.layout import printed_extent_m, sheet_margin
from binocal.simulation.optics import BlurKernel, blur_image, blur_kernel
from binocal.simulation.printed_shape import PrintedShape
from binocal.simulation.visibility import field_angle_rad, visible_px

_FINE = 4  # points per pixel and axis
_SPREAD_PX = 0.14  # less: the fine grid aliases; more: more pixels count as edges
_SPREAD_REACH = 4.0  # beyond 4 sigma a Gaussian holds 3e-5 of an edge's contrast, 0.006 grey levels
_BEND_ROUNDS = 3  # to where a ray meets a bent sheet: a bow of 1 % leaves 1e-6 pitches
_OFFSETS_PX = (np.arange(_FINE) + 0.5) / _FINE - 0.5


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Light, lens and sensor. Grey levels are those of an 8-bit image (0-255) whatever the bit depth."""

    blur_px: float = 0.8
    """Gaussian: standard deviation, at least 0.14 px (less is rendered as 0.14: no lens is sharper).
    Disc: radius, with that same Gaussian of 0.14 px on top. Pixel integration comes on top of both."""
    blur_kind: Literal["gaussian", "disc"] = "gaussian"
    motion_px: tuple[float, float] = (0.0, 0.0)
    """How far the image moves during the exposure, x and y; corners are those of its middle."""
    noise_dn: float = 2.0
    """Standard deviation of the sensor's noise, Gaussian, independent per pixel."""
    black_dn: float = 30.0
    """Grey level of ink in full light."""
    white_dn: float = 210.0
    """Grey level of paper in full light."""
    shading: tuple[float, float] = (0.0, 0.0)
    """Change of the light across the print, along the board's x and y, as a share of its value in the middle."""
    vignetting: float = 0.0
    """Share of the light that is lost in the image's corner; grows with the square of the radius."""
    gamma: float = 1.0
    """Encoding: grey = 255 (light / 255)^(1 / gamma); 2.2 for a consumer camera."""
    clutter_dn: float = 35.0
    """Contrast of what stands behind the board; 0 is a plain wall."""
    background_dn: float = 110.0
    """Mean grey level behind the board."""
    bit_depth: Literal[8, 16] = 8
    is_legacy_charuco: bool = False
    """ChArUco layout of OpenCV before 4.6."""
    border_bits: int | None = None
    """Black border cells of markers; None: one of ChArUco boards, two of AprilGrids as on Kalibr's sheets."""
    shape: PrintedShape | None = None
    """How the sheet is bent and where its print lies; None: a plane, printed as drawn."""
    behind: Float[ndarray, "h w"] | None = field(default=None, compare=False)
    """What stands behind the board, as the lens shows it (grey levels of every pixel); None: clutter."""

    def __post_init__(self) -> None:
        if self.blur_px < 0 or self.noise_dn < 0 or self.gamma <= 0 or not 0 <= self.vignetting < 1:
            raise ValueError(f"blur_px and noise_dn must be >= 0, gamma > 0, vignetting in [0, 1); got {self}")
        if self.blur_kind not in ("gaussian", "disc"):
            raise ValueError(f"blur_kind must be 'gaussian' or 'disc'; got {self.blur_kind!r}")
        if self.bit_depth not in (8, 16):
            raise ValueError(f"bit_depth must be 8 or 16; got {self.bit_depth}")
        if self.border_bits is not None and self.border_bits < 1:
            raise ValueError(f"border_bits must be at least 1; got {self.border_bits}")


@dataclass(frozen=True, slots=True, eq=False)
class RenderedImage:
    """An image and the truth about it: ``corners_px`` in the board's order, NaN where outside the image, or not printed.

    For circles the truth is the projected centre, not the centroid of the ellipse.
    """

    image: UInt[ndarray, "h w"]
    corners_px: Float[ndarray, "n 2"]


def render_image(
    camera: Camera, T_camera_board: SE3, board: Board, options: RenderOptions, rng: np.random.Generator
) -> RenderedImage:
    """An image of the board. The rays of the last two cameras are kept for the next images.

    Raises:
        ValueError: The camera looks at the back of the board, the board cannot be printed, or ``behind`` is of another size.
    """
    light = render_light(camera, T_camera_board, board, options, rng)
    image = read_out(light, rng, noise_dn=options.noise_dn, gamma=options.gamma, bit_depth=options.bit_depth)
    points = board.object_points_m if options.shape is None else options.shape.points_m(board)
    corners = visible_px(camera, T_camera_board.apply(points))
    return RenderedImage(image, np.where(board.is_printed[:, None], corners, np.nan))


def render_light(
    camera: Camera, T_camera_board: SE3, board: Board, options: RenderOptions, rng: np.random.Generator
) -> Float[ndarray, "h w"]:
    """What the pixels receive, in grey levels, before gamma, noise and rounding (float32).

    Raises:
        ValueError: The camera looks at the back of the board, the board cannot be printed, or ``behind`` is of another size.
    """
    return render_lights(camera, ((board, T_camera_board),), options, rng)


def render_lights(
    camera: Camera, boards: Sequence[tuple[Board, SE3]], options: RenderOptions, rng: np.random.Generator
) -> Float[ndarray, "h w"]:
    """As :func:`render_light`, of several boards with their ``T_camera_board``; a later one hides those before it.

    Raises:
        ValueError: The camera looks at the back of a board, or a board cannot be printed.
    """
    for _, T_camera_board in boards:
        if T_camera_board.t.shape != (3,):
            raise ValueError(f"T_camera_board must be one pose, t (3,); got {T_camera_board.t.shape}")
        if not T_camera_board.inverse().t[2] < 0:
            raise ValueError("the camera looks at the back of the board; its z axis must point away from the camera")
    kernel = blur_kernel(options.blur_px, options.blur_kind, options.motion_px, least_px=_SPREAD_PX)
    apron = 8 * (kernel.reach_px // 8 + 1)  # steps of 8, so that the rays serve other blurs too
    rays = rays_of_pixels(camera, apron)
    light = _behind(camera, options, rng, kernel)
    for board, T_camera_board in boards:
        window = _sheet_window(camera, T_camera_board, board, apron, kernel.reach_px)
        if window is not None:
            _lay_sheet(light, rays, window, apron, (camera, T_camera_board, board), options, kernel)
    return through_lens(light, camera, rays[2, apron + 1 : -apron - 1, apron + 1 : -apron - 1], options.vignetting)


def _lay_sheet(
    light: Float[ndarray, "h w"],
    rays: Float[ndarray, "3 h2 w2"],
    window: tuple[slice, slice],
    apron: int,
    seen: tuple[Camera, SE3, Board],
    options: RenderOptions,
    kernel: BlurKernel,
) -> None:
    """A board's sheet over what the pixels receive, in place."""
    camera, T_camera_board, board = seen
    rest = kernel.without(_SPREAD_PX**2 - 1 / (12 * _FINE**2))
    rows, columns = window
    patch = rays[:, rows.start - 1 : rows.stop + 1, columns.start - 1 : columns.stop + 1]
    sheet = _cached_sheet(board, options.is_legacy_charuco, options.border_bits)
    board_light, coverage = _sample_board(patch, T_camera_board, board, sheet, options)
    board_light = blur_image(board_light, rest, scale=_FINE)
    height, width = coverage.shape
    import cv2

    board_light = cv2.resize(board_light, (width, height), interpolation=cv2.INTER_AREA)
    coverage = blur_image(coverage, kernel, scale=1)
    # the apron is the part of the scene beyond the image that the blur carries in
    first_row, first_column = rows.start - 1 - apron, columns.start - 1 - apron
    inside = np.s_[
        max(-first_row, 0) : camera.size_wh[1] - first_row, max(-first_column, 0) : camera.size_wh[0] - first_column
    ]
    board_light, coverage = board_light[inside], coverage[inside]
    target = np.s_[
        max(first_row, 0) : max(first_row, 0) + coverage.shape[0],
        max(first_column, 0) : max(first_column, 0) + coverage.shape[1],
    ]
    light[target] = board_light + (1 - coverage) * light[target]


def _behind(
    camera: Camera, options: RenderOptions, rng: np.random.Generator, kernel: BlurKernel
) -> Float[ndarray, "h w"]:
    if options.behind is None:
        clutter = draw_background(camera.size_wh, rng, level=options.background_dn, contrast=options.clutter_dn)
        return blur_image(clutter, kernel, scale=1)
    if options.behind.shape != camera.size_wh[::-1]:
        raise ValueError(
            f"behind must have the image's rows and columns, {camera.size_wh[::-1]}; got {options.behind.shape}"
        )
    return options.behind.astype(np.float32)


@lru_cache(maxsize=8)
def _cached_sheet(board: Board, is_legacy_charuco: bool, border_bits: int | None) -> Sheet:
    return sheet_of(board, is_legacy_charuco=is_legacy_charuco, border_bits=border_bits)


def _sheet_window(
    camera: Camera, T_camera_board: SE3, board: Board, apron: int, reach_px: int
) -> tuple[slice, slice] | None:
    """Rows and columns of the ray map around the sheet, blur included; None where it lies outside the image.

    The whole map where the outline leaves the camera's field and cannot be followed.
    """
    width, height = camera.size_wh
    rim = apron + 1
    x0, y0, x1, y1 = np.array(printed_extent_m(board)) + sheet_margin(board) * board.pitch_m * np.array([-1, -1, 1, 1])
    s = np.linspace(0, 1, 33)
    edges = [np.stack([x0 + s * (x1 - x0), np.full_like(s, y)], -1) for y in (y0, y1)]
    edges += [np.stack([np.full_like(s, x), y0 + s * (y1 - y0)], -1) for x in (x0, x1)]
    outline = T_camera_board.apply(np.c_[np.concatenate(edges), np.zeros(4 * len(s))])
    angle = np.arctan2(np.hypot(outline[:, 0], outline[:, 1]), outline[:, 2])
    limits = np.array([0, 0, width + 2 * apron, height + 2 * apron]) + 1
    if angle.max() < field_angle_rad(camera):
        pixels = camera.project(outline)
        low = np.floor(pixels.min(axis=0)) - reach_px - 2 + rim
        high = np.ceil(pixels.max(axis=0)) + reach_px + 3 + rim
        limits = np.r_[np.maximum(low, limits[:2]), np.minimum(high, limits[2:])].astype(int)
    if limits[0] >= limits[2] or limits[1] >= limits[3]:
        return None
    return slice(int(limits[1]), int(limits[3])), slice(int(limits[0]), int(limits[2]))


def _sample_board(
    rays: Float[ndarray, "3 h w"], T_camera_board: SE3, board: Board, sheet: Sheet, options: RenderOptions
) -> tuple[Float[ndarray, "4*(h-2) 4*(w-2)"], Float[ndarray, "h-2 w-2"]]:
    """Light of the sheet on the fine grid (0 where no sheet is), and the sheet's coverage of each pixel."""
    import cv2

    x, y, is_off = _board_coordinates(rays, T_camera_board, board.pitch_m, options.shape)
    at = Footprint(
        x[1:-1, 1:-1], y[1:-1, 1:-1],
        (x[1:-1, 2:] - x[1:-1, :-2]) / 2, (x[2:, 1:-1] - x[:-2, 1:-1]) / 2,
        (y[1:-1, 2:] - y[1:-1, :-2]) / 2, (y[2:, 1:-1] - y[:-2, 1:-1]) / 2,
    )  # fmt: skip
    # the outer points of a pixel lie within 3/8 of both derivatives; half covers the curvature within it, too
    reach = [
        0.5 * (np.abs(a) + np.abs(b)) + _SPREAD_REACH * _SPREAD_PX * np.hypot(a, b)
        for a, b in ((at.x_u, at.x_v), (at.y_u, at.y_v))
    ]
    reflectance, coverage, is_constant = sheet.classify(at, *reach)
    coverage = np.where(is_off, np.float32(0), coverage)
    light = (
        np.float32(options.white_dn - options.black_dn) * reflectance * coverage
        + np.float32(options.black_dn) * coverage
    )
    rows, columns = np.nonzero(~is_constant & ~is_off)
    height, width = coverage.shape
    fine = cv2.resize(light, (width * _FINE, height * _FINE), interpolation=cv2.INTER_NEAREST)
    for first in range(0, len(rows), 2048):  # blocks that stay in the processor's cache
        some = np.s_[rows[first : first + 2048], columns[first : first + 2048]]
        reflected, covered = sheet.spread(_expand(x, y, *some), _SPREAD_PX)
        coverage[some] = covered.mean(axis=(1, 2))
        reflected *= np.float32(options.white_dn - options.black_dn)
        fine.reshape(height, _FINE, width, _FINE)[some[0], :, some[1]] = (
            reflected + np.float32(options.black_dn) * covered
        )
    if any(options.shading):
        x0, y0, x1, y1 = np.array(printed_extent_m(board)) / board.pitch_m
        slope = np.array(options.shading) / [x1 - x0, y1 - y0]
        shade = 1 + slope[0] * (at.x - (x0 + x1) / 2) + slope[1] * (at.y - (y0 + y1) / 2)
        shade = np.where(coverage > 0, np.clip(shade, 0, 2), 1).astype(np.float32)
        fine *= cv2.resize(shade, (width * _FINE, height * _FINE), interpolation=cv2.INTER_LINEAR)
    return fine, coverage


def _board_coordinates(
    rays: Float[ndarray, "3 h w"], T_camera_board: SE3, pitch_m: float, shape: PrintedShape | None
) -> tuple[Float[ndarray, "h w"], Float[ndarray, "h w"], Bool[ndarray, "h-2 w-2"]]:
    """Which place of the drawing each ray meets, in pitches, and which inner pixels meet none (their neighbours included)."""
    R, eye = T_camera_board.R, T_camera_board.inverse().t / pitch_m
    with np.errstate(all="ignore"):
        toward = R[0, 2] * rays[0] + R[1, 2] * rays[1] + R[2, 2] * rays[2]
        is_hit = toward > 1e-6  # NaN where there is no ray; grazing rays meet the plane a million pitches away
        along_x = (R[0, 0] * rays[0] + R[1, 0] * rays[1] + R[2, 0] * rays[2]) / toward
        along_y = (R[0, 1] * rays[0] + R[1, 1] * rays[1] + R[2, 1] * rays[2]) / toward
        x = np.where(is_hit, eye[0] - eye[2] * along_x, 0.0)
        y = np.where(is_hit, eye[1] - eye[2] * along_y, 0.0)
        if shape is not None:
            for _ in range(_BEND_ROUNDS):
                depth = shape.height(x, y) - eye[2]
                x = np.where(is_hit, eye[0] + depth * along_x, 0.0)
                y = np.where(is_hit, eye[1] + depth * along_y, 0.0)
            x, y = shape.drawn_over_image(x, y) if is_hit.all() else shape.drawn_at(x, y)
    near = is_hit[:, :-2] & is_hit[:, 1:-1] & is_hit[:, 2:]
    return x, y, ~(near[:-2] & near[1:-1] & near[2:])


def _expand(x: Float[ndarray, "h w"], y: Float[ndarray, "h w"], rows: ndarray, columns: ndarray) -> Footprint:
    """Board coordinates (n, 4, 4) of the 16 points in each listed pixel, by expansion to second order."""
    dv, du = _OFFSETS_PX[:, None], _OFFSETS_PX[None, :]
    width = x.shape[1]
    place = (rows + 1) * width + columns + 1
    values = []
    for z in (x.ravel(), y.ravel()):
        n = {(i, j): z[place + i * width + j][:, None, None] for i in (-1, 0, 1) for j in (-1, 0, 1)}
        z_u, z_v = (n[0, 1] - n[0, -1]) / 2, (n[1, 0] - n[-1, 0]) / 2
        z_uu, z_vv = n[0, 1] - 2 * n[0, 0] + n[0, -1], n[1, 0] - 2 * n[0, 0] + n[-1, 0]
        z_uv = (n[1, 1] - n[1, -1] - n[-1, 1] + n[-1, -1]) / 4
        at = n[0, 0] + z_u * du + z_v * dv + 0.5 * z_uu * du**2 + 0.5 * z_vv * dv**2 + z_uv * du * dv
        values += [at, z_u, z_v]
    return Footprint(values[0], values[3], values[1], values[2], values[4], values[5])
