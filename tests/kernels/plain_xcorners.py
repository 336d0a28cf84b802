"""Rings, saddles, links and groups of X-corners stated plainly in NumPy."""

from __future__ import annotations

from collections import deque

import numpy as np

N_RING = 32
STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))


def sample(image, points):
    """Bilinear values; the border's value beyond the border."""
    height, width = image.shape
    x, y = np.clip(points[..., 0], 0, width - 1), np.clip(points[..., 1], 0, height - 1)
    column, row = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    a, b, image = x - column, y - row, image.astype(float)
    top = (1 - a) * image[row, column] + a * image[row, column + 1]
    return (1 - b) * top + b * ((1 - a) * image[row + 1, column] + a * image[row + 1, column + 1])


def read_ring(image, point, radius, min_contrast, max_unlikeness):
    """The four rays of an X-corner (None: it is none) and the ring's contrast."""
    angles = 2 * np.pi * np.arange(N_RING) / N_RING
    values = sample(image, point + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1))
    contrast = np.ptp(values)
    level = values - 0.5 * (values.max() + values.min())
    following = np.roll(level, -1)
    at = np.nonzero((level > 0) != (following > 0))[0]
    half = N_RING // 2
    if (
        len(at) != 4
        or np.abs(values[:half] - values[half:]).mean() >= max_unlikeness * contrast
        or contrast <= min_contrast
    ):
        return None, contrast
    rays = (at + level[at] / (level[at] - following[at])) * 2 * np.pi / N_RING
    if level[at[0]] > 0:
        rays = np.roll(rays, -1)
    bend = (rays[:2] + 2 * np.pi - rays[2:]) % (2 * np.pi) - np.pi
    sectors = (np.roll(rays, -1) - rays) % (2 * np.pi)
    is_straight = (np.abs(bend) < np.radians(40)).all() and (sectors > np.radians(18)).all()
    return (rays if is_straight else None), contrast


def localize_saddle(image, start, fit, reach):
    """One point after two rounds."""
    point, step = start.copy(), np.arange(-reach, reach + 1)
    for _ in range(2):
        x, y = np.rint(point).astype(int)
        if min(x, y) < reach or x >= image.shape[1] - reach or y >= image.shape[0] - reach:
            break
        a, b, c, d, e = fit @ image[np.ix_(y + step, x + step)].ravel().astype(float)
        determinant = 4 * a * c - b * b
        moved = np.array([x, y]) + np.array([b * e - 2 * c * d, b * d - 2 * a * e]) / determinant
        if determinant < -1e-6 and (np.abs(moved - start) <= reach).all():
            point = moved
    return point


def is_edge(image, start, way, sign, contrast):
    """Whether one side of the way is brighter all along it."""
    aside = np.clip(1.5 / max(np.linalg.norm(way), 1), 0.15, 0.4) * np.array([-way[1], way[0]])
    along = start + np.array([[0.3], [0.5], [0.7]]) * way
    return bool((sign * (sample(image, along + aside) - sample(image, along - aside)) > 0.3 * contrast).all())


def link_corners(image, points, rays, contrast, max_turn, n_neighbours=14):
    """Neighbours along the rays, and the rays that point back."""
    n = len(points)
    neighbour, back_ray = np.full((n, 4), -1), np.full((n, 4), -1)
    unit = np.stack([np.cos(rays), np.sin(rays)], axis=-1)
    for i in range(n):
        distance = np.linalg.norm(points - points[i], axis=1)
        for other in np.argsort(distance)[1 : n_neighbours + 1]:
            way = points[other] - points[i]
            along, along_back = unit[i] @ way, -unit[other] @ way
            ray, back = along.argmax(), along_back.argmax()
            weak, strong = sorted((contrast[i], contrast[other]))
            is_along = min(along.max(), along_back.max()) > np.cos(max_turn) * distance[other]
            if neighbour[i, ray] >= 0 or not is_along or ray % 2 == back % 2 or weak <= 0.15 * strong:
                continue
            if is_edge(image, points[i], way, -1.0 if ray % 2 else 1.0, weak):
                neighbour[i, ray], back_ray[i, ray] = other, back
    is_mutual = np.array(
        [[o >= 0 and neighbour[o, b] == i for o, b in zip(neighbour[i], back_ray[i], strict=True)] for i in range(n)]
    )
    return np.where(is_mutual.reshape(n, 4), neighbour, -1), back_ray


def is_ahead(points, corner_at, start, step, other):
    """Whether a corner lies where the row behind it and the rows beside it lead, to half a step."""
    way = points[other] - points[corner_at[start]]
    for turn in ((-step[0], -step[1]), (-step[1], step[0]), (step[1], -step[0])):
        behind = (start[0] + turn[0], start[1] + turn[1])
        ahead = (behind[0] + step[0], behind[1] + step[1])
        if behind in corner_at and ahead in corner_at:
            expected = points[corner_at[ahead]] - points[corner_at[behind]]
            if np.linalg.norm(way - expected) > 0.5 * np.linalg.norm(expected):
                return False
    return True


def grow_groups(points, neighbour, back_ray):
    """Connected corners with integer cells and the turns of their rays."""
    degree = (neighbour >= 0).sum(axis=1)
    seen, groups = set(), []
    for seed in np.argsort(-degree, kind="stable").tolist():
        if seed in seen or degree[seed] < 2:
            continue
        seen.add(seed)
        place, corner_at, queue = {seed: ((0, 0), 0)}, {(0, 0): seed}, deque([seed])
        while queue:
            corner = queue.popleft()
            (x, y), turn = place[corner]
            for ray, other in enumerate(neighbour[corner].tolist()):
                step = (ray + turn) % 4
                cell = (x + STEPS[step][0], y + STEPS[step][1])
                if other < 0 or other in seen or cell in corner_at:
                    continue
                if not is_ahead(points, corner_at, (x, y), STEPS[step], other):
                    continue
                seen.add(other)
                corner_at[cell] = other
                place[other] = cell, (step + 2 - int(back_ray[corner, ray])) % 4
                queue.append(other)
        groups.append((list(place), [cell for cell, _ in place.values()], [turn for _, turn in place.values()]))
    return groups


def saddle_response(smooth):
    """Minus the determinant of the Hessian by Sobel's second derivatives over 4; 0 in the outermost pixels."""
    mean, bend, slope = np.array([1.0, 2, 1]), np.array([1.0, -2, 1]), np.array([-1.0, 0, 1])

    def filtered(down, across):
        return sum(
            down[i] * across[j] * smooth[i : i + smooth.shape[0] - 2, j : j + smooth.shape[1] - 2].astype(float)
            for i in range(3)
            for j in range(3)
        )

    response = filtered(slope, slope) ** 2 - filtered(mean, bend) * filtered(bend, mean)
    return np.pad(response / 16, 1)


def find_peaks(response, reach, margin, least, most):
    """Greatest values of their windows, to a fraction of a pixel, in reading order; the ``most`` greatest."""
    height, width = response.shape
    found = []
    for y in range(margin, height - margin):
        for x in range(margin, width - margin):
            value = response[y, x]
            window = response[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
            if value < least or value < window.max():
                continue
            place = [x, y]
            for axis, (before, after) in enumerate(
                ((response[y, x - 1], response[y, x + 1]), (response[y - 1, x], response[y + 1, x]))
            ):
                bend = before - 2 * value + after
                place[axis] += np.clip(0.5 * (before - after) / bend, -0.5, 0.5) if bend < 0 else 0
            found.append((value, y * width + x, place))
    strongest = sorted(found, key=lambda peak: (-peak[0], peak[1]))[:most]
    return np.array([place for _, _, place in sorted(strongest, key=lambda peak: peak[1])]).reshape(-1, 2)
