"""Point clouds as binary PLY files, which Open3D, CloudCompare, MeshLab and PCL read."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Float32, UInt8


def ply_content(
    points: Float32[ndarray, "n 3"],
    colours_rgb: UInt8[ndarray, "n 3"],
    sigma: Float32[ndarray, "n"],
    comments: tuple[str, ...] = (),
) -> bytes:
    """A little-endian PLY file of vertices x y z, red green blue, and ``sigma``, the standard deviation of the distance.

    Source: Turk 1994, "The PLY polygon file format"; readers pass over properties that they do not know.

    Raises:
        ValueError: The arrays differ in length, or a comment has more than one line.
    """
    n = len(points)
    if not len(colours_rgb) == len(sigma) == n:
        raise ValueError(f"{n} points, {len(colours_rgb)} colours, {len(sigma)} standard deviations")
    if any("\n" in comment or "\r" in comment for comment in comments):
        raise ValueError("a comment of a PLY file is one line")
    fields = (
        [(name, "<f4") for name in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")] + [("sigma", "<f4")]
    )
    vertices = np.empty(n, dtype=fields)
    for i, name in enumerate("xyz"):
        vertices[name] = points[:, i]
    for i, name in enumerate(("red", "green", "blue")):
        vertices[name] = colours_rgb[:, i]
    vertices["sigma"] = sigma
    kinds = {"<f4": "float", "u1": "uchar"}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {comment}" for comment in comments),
        f"element vertex {n}",
    ]
    header += [f"property {kinds[kind]} {name}" for name, kind in fields]
    return "\n".join([*header, "end_header", ""]).encode("ascii", "replace") + vertices.tobytes()
