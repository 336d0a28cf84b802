"""Draws docs/chessboard-search.svg and docs/chessboard-growth.svg: `python docs/make_chessboard_figures.py`.

Images are rendered by the simulator, and everything drawn over them is what the library's detection found in them.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from binocal.benchmark.detection import draw_detection_scene
from binocal.boards import Board, parse_board
from binocal.cameras import Camera
from binocal.detection import detect
from binocal.detection.detect import stretch_8_bit
from binocal.detection.finding.groups import MAX_TURN_RAD, link_corners
from binocal.detection.finding.growth import grow
from binocal.detection.finding.lattice import Lattice
from binocal.detection.finding.search import SearchLevel, scaled_levels
from binocal.geometry import SE3, so3
from binocal.kernels import images
from binocal.simulation import RenderOptions, render_image

FOLDER = Path(__file__).parent
WIDTH, GAP, CAPTION = 420, 16, 22  # drawn pixels
RED, BLUE, GREEN, YELLOW = "#d1410c", "#1767c0", "#1a8f3c", "#e0a800"
JPEG_QUALITY = 55  # the images are a background


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """An image, its board, and the part of the image that is drawn: left, top, right, bottom, pixels."""

    name: str
    image: np.ndarray
    board: Board
    crop: tuple[int, int, int, int]

    @property
    def scale(self) -> float:
        return WIDTH / (self.crop[2] - self.crop[0])

    @property
    def height(self) -> float:
        return self.scale * (self.crop[3] - self.crop[1])

    def place(self, points_px: np.ndarray) -> np.ndarray:
        """Drawn places of the image's points."""
        return (points_px - self.crop[:2] + 0.5) * self.scale


def covered_board() -> Scene:
    """A board before clutter, with a shadow's border across it and a finger on one corner."""
    board, size = parse_board("chessboard:9x6:30mm"), (640, 480)
    camera = Camera("brown4", size, [700, 700, 320, 240, 0, -0.12, 0.03, 0, 0])
    centre = board.object_points_m.mean(axis=0)
    R = so3.exp(np.array([0.45, -0.5, 0.2]))
    options = RenderOptions(blur_px=1.0, noise_dn=3.0, clutter_dn=45.0, shading=(0.2, -0.1))
    shot = render_image(
        camera, SE3(R, np.array([0.0, 0.0, 0.5]) - R @ centre), board, options, np.random.default_rng(4)
    )
    light = shot.image.astype(float)
    y, x = np.mgrid[: size[1], : size[0]]
    light *= 0.45 + 0.55 / (1 + np.exp(-(x + 0.6 * y - 430) / 6))
    corners = shot.corners_px.reshape(board.rows, board.columns, 2)
    finger = np.hypot(x - corners[2, 5, 0], y - corners[2, 5, 1]) < 12
    light[finger] = 120
    return Scene("search", np.rint(light).astype(np.uint8), board, (60, 44, 580, 434))


def oblique_board() -> Scene:
    """A board seen so obliquely that its squares are 10 by 4 pixels (image 2923 of the detection benchmark's seed 13)."""
    scene = draw_detection_scene(13, 2923)
    low, high = scene.corners_px.min(axis=0).astype(int) - 22, scene.corners_px.max(axis=0).astype(int) + 22
    return Scene("growth", scene.image, scene.board, (*low.tolist(), *high.tolist()))


def levels_of(scene: Scene) -> list[SearchLevel]:
    """The searches of the scene's image, each kept: the library gives out the same arrays again only in the next image."""
    size = max(scene.board.columns, scene.board.rows), min(scene.board.columns, scene.board.rows)
    return list(scaled_levels(stretch_8_bit(scene.image)[0], size))


def line(a: np.ndarray, b: np.ndarray, colour: str, width: float) -> str:
    return f'<path d="M{a[0]:.1f},{a[1]:.1f}L{b[0]:.1f},{b[1]:.1f}" stroke="{colour}" stroke-width="{width:g}"/>'


def dot(at: np.ndarray, colour: str, radius: float, *, is_open: bool = False) -> str:
    fill = f'fill="none" stroke="{colour}" stroke-width="2"' if is_open else f'fill="{colour}"'
    return f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:g}" {fill}/>'


def draw_corners(scene: Scene, level: SearchLevel) -> list[str]:
    """X-corners with the four directions of their edges; the sectors' colours turn in order."""
    parts = []
    for point, rays in zip(level.corners.points_px, level.corners.rays_rad, strict=True):
        at = scene.place(level.to_image(point))
        for k, ray in enumerate(rays):
            parts.append(line(at, at + 9 * np.array([np.cos(ray), np.sin(ray)]), RED if k % 2 else BLUE, 2))
        parts.append(dot(at, YELLOW, 2.5))
    return parts


def draw_links(scene: Scene, level: SearchLevel) -> list[str]:
    """Links, those of the largest group in full colour."""
    corners = level.corners
    neighbour, _ = images.link_corners(
        level.saddles.smooth, corners.points_px, corners.rays_rad, corners.contrast_dn, MAX_TURN_RAD
    )
    largest = set(link_corners(level.saddles, corners)[0].members.tolist())
    places = scene.place(level.to_image(corners.points_px))
    parts = []
    for i, ends in enumerate(neighbour):
        colour = BLUE if i in largest else YELLOW
        parts += [line(places[i], places[j], colour, 2.5) for j in ends if j > i]
        parts.append(dot(places[i], colour, 3))
    return parts


def draw_grid(scene: Scene, grid_px: np.ndarray, colour: str, *, is_new: np.ndarray | None = None) -> list[str]:
    """A grid's lines and corners; those that are new in green."""
    places, seen = scene.place(grid_px), np.isfinite(grid_px[..., 0])
    new = np.zeros(seen.shape, bool) if is_new is None else is_new
    parts = []
    for axis in (0, 1):
        a, b = (places.take(range(k, places.shape[axis] - 1 + k), axis=axis).reshape(-1, 2) for k in (0, 1))
        parts += [line(p, q, colour, 1.5) for p, q in zip(a, b, strict=True) if np.isfinite(p + q).all()]
    parts += [dot(places[i], GREEN if new[i] else colour, 3.5) for i in np.ndindex(seen.shape) if seen[i]]
    return parts


def draw_board(scene: Scene) -> list[str]:
    """The board as it is given out: rows in order, the first corner marked, what was not seen open."""
    found = detect(scene.image, scene.board)
    truth_free = found.points_px.reshape(scene.board.rows, scene.board.columns, 2)
    parts = draw_grid(scene, truth_free, RED)
    for row, column in np.argwhere(np.isnan(truth_free[..., 0])):
        beside = truth_free[row, [column - 1, column + 1]]
        parts.append(dot(scene.place(beside.mean(axis=0)), RED, 5, is_open=True))
    first, along, down = (scene.place(truth_free[i]) for i in ((0, 0), (0, 1), (1, 0)))
    for name, end in (("x", along), ("y", down)):
        tip = first + 1.5 * (end - first)
        parts.append(line(first, tip, GREEN, 4))
        parts.append(f'<text x="{tip[0] + 4:.1f}" y="{tip[1] + 4:.1f}" fill="{GREEN}" font-weight="bold">{name}</text>')
    return [*parts, dot(first, GREEN, 6)]


def largest_lattice(levels: list[SearchLevel]) -> tuple[Lattice, SearchLevel]:
    """The fullest lattice of all searches, as the detection takes it for growing."""
    candidates = [(lattice, level) for level in levels for lattice in level.lattices]
    return max(candidates, key=lambda candidate: candidate[0].n_seen)


def figure(scene: Scene, panels: list[tuple[str, list[str]]], title: str) -> str:
    """An SVG of the scene's image, two panels a row, each with what is drawn over it."""
    left, top, right, bottom = scene.crop
    _, jpeg = cv2.imencode(".jpg", scene.image[top:bottom, left:right], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    rows = (len(panels) + 1) // 2
    size = 2 * WIDTH + GAP, rows * (scene.height + CAPTION + GAP) - GAP
    href = "data:image/jpeg;base64," + base64.b64encode(jpeg.tobytes()).decode()
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size[0]:g} {size[1]:g}" font-family="sans-serif" font-size="14">',
        f"<title>{title}</title>",
        f'<rect width="{size[0]:g}" height="{size[1]:g}" fill="#fff"/>',
        f'<defs><image id="i" width="{WIDTH}" height="{scene.height:g}" href="{href}"/>'
        f'<clipPath id="c"><rect width="{WIDTH}" height="{scene.height:g}"/></clipPath></defs>',
    ]
    for k, (caption, drawn) in enumerate(panels):
        x, y = (k % 2) * (WIDTH + GAP), (k // 2) * (scene.height + CAPTION + GAP) + CAPTION
        parts.append(f'<text x="{x:g}" y="{y - 7:g}" fill="#333">{k + 1}. {caption}</text>')
        parts.append(
            f'<g transform="translate({x:g} {y:g})" clip-path="url(#c)" stroke-linecap="round"><use href="#i"/>'
        )
        parts += [*drawn, "</g>"]
    return "\n".join([*parts, "</svg>"]) + "\n"


def search_figure() -> str:
    """X-corners, links, lattice and board of an ordinary image."""
    scene = covered_board()
    level = levels_of(scene)[0]
    lattice = level.lattices[0]
    panels = [
        ("X-corners, with the directions of their edges", draw_corners(scene, level)),
        ("links along edges; blue: the largest group", draw_links(scene, level)),
        (
            f"the lattice: {lattice.size[0]} by {lattice.size[1]} corners",
            draw_grid(scene, level.to_image(lattice.points_px), BLUE),
        ),
        ("the board: oriented, measured, checked", draw_board(scene)),
    ]
    return figure(scene, panels, "How a chessboard is found")


def growth_figure() -> str:
    """A part of a board and the whole that it grows to."""
    scene = oblique_board()
    lattice, level = largest_lattice(levels_of(scene))
    size = max(scene.board.columns, scene.board.rows), min(scene.board.columns, scene.board.rows)
    image8 = stretch_8_bit(scene.image)[0]
    smooth = cv2.GaussianBlur(image8.astype(np.float32), (0, 0), 0.8)
    part = level.to_image(lattice.points_px)
    grown = grow(scene.image, smooth, part, size)
    if grown is None:
        raise RuntimeError("the lattice did not grow: choose another image")
    whole = grown[0]
    distance = np.linalg.norm(whole[:, :, None] - part.reshape(-1, 2), axis=-1)
    is_new = ~(np.nan_to_num(distance, nan=np.inf).min(axis=-1) < 1e-6)
    panels = [
        (f"the fullest lattice: {lattice.size[0]} by {lattice.size[1]}", draw_grid(scene, part, BLUE)),
        (f"grown to {size[0]} by {size[1]} (green: new)", draw_grid(scene, whole, BLUE, is_new=is_new)),
    ]
    return figure(scene, panels, "A part of a board grows to the whole")


if __name__ == "__main__":
    for name, draw in (("search", search_figure), ("growth", growth_figure)):
        (FOLDER / f"chessboard-{name}.svg").write_text(draw(), encoding="utf-8")
