"""Draws docs/rectified.svg, a board as a stereo rig sees it and rectified: `python docs/make_image.py`.

Every corner is computed by the camera models and the rectification that the library uses; nothing is drawn by hand.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3, so3
from binocal.rectification import rectify, rectify_points

PATH = Path(__file__).with_name("rectified.svg")
COLUMNS, ROWS, SQUARE_M = 12, 9, 0.02
SCALE, GAP = 0.25, 20  # drawn pixels per image pixel; space between images
STEPS_PER_SIDE = 4  # the lens bends edges: each side of a square is drawn in pieces


def make_rig() -> StereoRig:
    """The table-2 rig with a stronger lens and a worse mounting than a good one has, so that the eye can see both."""
    left = Camera("brown4", (1280, 960), [1200, 1200, 640, 480, 0, -0.34, 0.12, 0, 0])
    right = Camera("brown4", (1280, 960), [1215, 1215, 655, 470, 0, -0.31, 0.10, 0, 0])
    return StereoRig(left, right, SE3(so3.exp(np.array([0.02, -0.06, 0.05])), np.array([-0.06, 0.002, 0.003])))


def squares() -> list[np.ndarray]:
    """Outlines of the dark squares in the board frame, metres."""
    outlines = []
    steps = np.linspace(0, 1, STEPS_PER_SIDE, endpoint=False)[:, None]
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    unit = np.concatenate([a + steps * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    for row in range(ROWS):
        for column in range(row % 2, COLUMNS, 2):
            outline = (unit + [column - COLUMNS / 2, row - ROWS / 2]) * SQUARE_M
            outlines.append(np.column_stack([outline, np.zeros(len(outline))]))
    return outlines


def image() -> str:
    """The SVG: two rows (raw, rectified) of two images (left, right), the rows of three corners drawn through."""
    rig = make_rig()
    r = rectify(rig)
    T_left_board = SE3(so3.exp(np.array([0.25, 0.35, 0.05])), np.array([0.02, 0.0, 0.33]))
    marks = np.array([[-4.0, -2.5], [0.0, 0.5], [4.0, 3.5]]) * SQUARE_M
    marks_m = np.column_stack([marks, np.zeros(3)])
    sides = (
        (rig.left, T_left_board, r.R_rect_left, r.P_left),
        (rig.right, rig.T_right_left @ T_left_board, r.R_rect_right, r.P_right),
    )
    width, height = (SCALE * n for n in rig.left.size_wh)
    total = (2 * width + GAP, 2 * height + 2 * 26 + GAP)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total[0]:g} {total[1]:g}" font-family="sans-serif" '
        'font-size="13">',
        "<title>A stereo pair before and after rectification</title>",
        f'<rect width="{total[0]:g}" height="{total[1]:g}" fill="#fff"/>',
    ]
    for stage, label in enumerate(("as the cameras see it", "rectified with the calibrated rig")):
        top = stage * (height + GAP + 26) + 20
        parts.append(f'<text x="0" y="{top - 6:g}" fill="#333">{label}</text>')
        for side, (camera, T_camera_board, R_rect, P) in enumerate(sides):

            def pixels(points_m: np.ndarray, camera=camera, T=T_camera_board, R=R_rect, P=P) -> np.ndarray:
                raw = camera.project(T.apply(points_m))
                return SCALE * (rectify_points(camera, R, P, raw) if stage else raw)  # noqa: B023 - used at once

            left = side * (width + GAP)
            path = "".join(
                "M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels(outline)) + "Z" for outline in squares()
            )
            clip = f"c{stage}{side}"
            parts += [
                f'<clipPath id="{clip}"><rect width="{width:g}" height="{height:g}"/></clipPath>',
                f'<g transform="translate({left:g} {top:g})">',
                f'<rect width="{width:g}" height="{height:g}" fill="#e9e6df"/>',
                f'<path d="{path}" fill="#222" clip-path="url(#{clip})"/>',
                *(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#d1410c"/>' for x, y in pixels(marks_m)),
                "</g>",
            ]
            if side == 0:
                rows = [y + top for _, y in pixels(marks_m)]
        parts += [
            f'<line x1="0" x2="{total[0]:g}" y1="{y:.1f}" y2="{y:.1f}" stroke="#d1410c" stroke-width="1"/>'
            for y in rows
        ]
    return "\n".join([*parts, "</svg>"]) + "\n"


if __name__ == "__main__":
    PATH.write_text(image(), encoding="utf-8")
