"""What the compiled functions on lattices with markers compute, plainly in NumPy."""

from __future__ import annotations

import numpy as np


def to_ray(points, lens):
    """Directions of an equidistant lens."""
    x, y = (np.asarray(points) - [lens.cx, lens.cy]).T
    radius = np.maximum(np.hypot(x, y), 1e-12)
    angle = radius / lens.f_px
    return np.stack([np.sin(angle) * x / radius, np.sin(angle) * y / radius, np.cos(angle)], axis=-1)


def axes_about(middle, lens):
    """The axes of the pinhole camera that looks at a pixel."""
    axis = to_ray([middle], lens)[0]
    u = np.array([axis[2], 0, -axis[0]]) / np.hypot(axis[0], axis[2])
    return axis, u, np.cross(axis, u)


def to_plane(points, middle, lens):
    """The image as that camera sees it, a pixel being about a unit."""
    if not lens.f_px:
        return np.asarray(points) - middle
    axis, u, v = axes_about(middle, lens)
    rays = to_ray(points, lens)
    return lens.f_px * np.stack([rays @ u, rays @ v], axis=-1) / (rays @ axis)[:, None]


def to_pixels(places, middle, lens):
    """Back from that camera to the image."""
    if not lens.f_px:
        return places + middle
    axis, u, v = axes_about(middle, lens)
    rays = axis + places[:, :1] / lens.f_px * u + places[:, 1:] / lens.f_px * v
    off = np.hypot(rays[:, 0], rays[:, 1])
    return [lens.cx, lens.cy] + (lens.f_px * np.arctan2(off, rays[:, 2]) / off)[:, None] * rays[:, :2]


def in_face(quad, lens, places):
    """Places of a face's unit square in the image."""
    middle = quad.mean(axis=0)
    corners = to_plane(quad, middle, lens)
    rows = []
    for (x, y), (X, Y) in zip([(0, 0), (1, 0), (1, 1), (0, 1)], corners, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -X * x, -X * y], [0, 0, 0, x, y, 1, -Y * x, -Y * y]]
    h = np.append(np.linalg.solve(rows, corners.ravel()), 1).reshape(3, 3)
    mapped = np.column_stack([places, np.ones(len(places))]) @ h.T
    return to_pixels(mapped[:, :2] / mapped[:, 2:], middle, lens)


def predict(lines, known, lens, place, n_nearest=12):
    """A place of the board by a homography and a bend through the corners nearest to it."""
    row, column = np.nonzero(np.isfinite(known[..., 0]))
    xy = np.stack([lines.x[column], lines.y[row]], axis=-1)
    square = ((xy - place) ** 2).sum(axis=1) / lines.pitch**2
    order = np.argsort(square, kind="stable")[:n_nearest]
    xy, square, points = xy[order], square[order], known[row[order], column[order]]
    middle, origin = points[0], xy[0]
    image, at = to_plane(points, middle, lens), (xy - origin) / lines.pitch
    weight = np.exp(-0.5 * square / max(1.6**2, square[len(order) // 2]))
    extent = np.linalg.norm(image, axis=1).max()
    rows, values, w = [], [], []
    for (x, y), (X, Y), each in zip(at, image / extent, weight, strict=True):
        rows += [[1, x, y, 0, 0, 0, -x * X, -y * X], [0, 0, 0, 1, x, y, -x * Y, -y * Y]]
        values += [X, Y]
        w += [each, each]
    rows, w = np.array(rows), np.array(w)
    ridge = np.diag([1e-9] * 6 + [1e-4] * 2)
    b = np.linalg.solve(rows.T @ (w[:, None] * rows) + ridge, rows.T @ (w * np.array(values)))

    def through(p):
        terms = np.column_stack([np.ones(len(p)), p])
        return extent * np.stack([terms @ b[:3], terms @ b[3:6]], axis=-1) / (1 + p @ b[6:])[:, None]

    def bent(p):
        return np.stack([p[:, 0] ** 2, p[:, 0] * p[:, 1], p[:, 1] ** 2], axis=-1)

    Q = bent(at)
    q = np.linalg.solve(Q.T @ (weight[:, None] * Q) + 0.1 * np.eye(3), Q.T @ (weight[:, None] * (image - through(at))))
    p = (np.array([place]) - origin) / lines.pitch
    return to_pixels(through(p) + bent(p) @ q, middle, lens)[0]
