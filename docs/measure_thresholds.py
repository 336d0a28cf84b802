"""Measures what halving and doubling each threshold of docs/how-a-chessboard-is-found.md does: a column of its table.

`python docs/measure_thresholds.py [IMAGES]` renders images that are harder than the detection benchmark's (700 unless said) and
prints how many more boards are found, and how many of them wrongly, for each value. Shares above one half are changed by
halving and doubling what is missing from the whole.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import pkgutil
import re
import sys
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np

import binocal.benchmark.detection as benchmark
import binocal.detection

PAGE = Path(__file__).with_name("how-a-chessboard-is-found.md")
SEED = 41
HARDER = {"MAX_TILT_RAD": np.radians(75), "LEAST_SIDE_PX": 5.0, "LEAST_SIDE_PER_BLUR": 2.5, "NOISES_DN": (1.0, 14.0)}
scenes: list[benchmark.DetectionScene] = []  # of this process


def draw(index: int) -> benchmark.DetectionScene:
    """A harder image of the benchmark's generator."""
    for name, value in HARDER.items():
        setattr(benchmark, name, value)
    return benchmark.draw_detection_scene(SEED, index)


def names_in_table() -> list[str]:
    """Dotted names of the page's table, within binocal.detection."""
    rows = re.findall(r"^\| `([\w.]+)` \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return [name for name in rows if not name.startswith("kernels.")]


def changed(value: float) -> tuple[float, float]:
    """The value halved and doubled; of shares above one half, what is missing from the whole doubled and halved."""
    pair = (2 * value - 1, (1 + value) / 2) if 0.5 < value < 1 else (value / 2, value * 2)
    return (round(pair[0]), round(pair[1])) if isinstance(value, int) else pair


def put(module: ModuleType, name: str, value: float) -> None:
    """The constant with another value, wherever it was imported to and in defaults of arguments."""
    old = getattr(module, name)
    for info in pkgutil.walk_packages(binocal.detection.__path__, "binocal.detection."):
        other = importlib.import_module(info.name)
        if getattr(other, name, None) is old:
            setattr(other, name, value)
    for function in vars(module).values():
        defaults = getattr(function, "__kwdefaults__", None) or {}
        for key, default in defaults.items():
            if default is old and isinstance(old, float):
                defaults[key] = value


def count() -> tuple[int, int]:
    """Boards found at their places, and found wrongly, boards where there is none among them."""
    found = wrong = 0
    for scene in scenes:
        result = binocal.detection.detect(scene.image, scene.board)
        if result.is_found:
            is_right = benchmark.is_in_place(result.points_px, scene)
            found, wrong = found + is_right, wrong + (not is_right)
    return found, wrong


def measure(dotted: str) -> tuple[str, list[tuple[float, int, int]]]:
    """A threshold's name, and for each of its other values the boards found and wrong."""
    module_name, name = dotted.rsplit(".", 1)
    module = importlib.import_module(f"binocal.detection.{module_name}")
    value = getattr(module, name)
    results = []
    for other in changed(value):
        put(module, name, other)
        results.append((other, *count()))
        put(module, name, value)
    return dotted, results


def main() -> None:
    """Render, then try every threshold in as many processes as there are processors."""
    cv2.setNumThreads(1)
    with multiprocessing.Pool(os.cpu_count()) as pool:
        scenes.extend(pool.map(draw, range(int(sys.argv[1]) if len(sys.argv) > 1 else 700)))
    n_found, n_wrong = count()
    n_boards = sum(scene.corners_px is not None for scene in scenes)
    print(f"{len(scenes)} images, {n_boards} boards: {n_found} found, {n_wrong} wrong", flush=True)
    single = [name for name in names_in_table() if isinstance(getattr_dotted(name), (int, float))]
    with multiprocessing.get_context("fork").Pool(os.cpu_count()) as pool:
        for dotted, results in pool.imap(measure, single):
            text = "; ".join(f"{other:g}: {found - n_found:+d}, {wrong} wrong" for other, found, wrong in results)
            print(f"{dotted}: {text}", flush=True)


def getattr_dotted(dotted: str) -> object:
    """A constant by its dotted name within binocal.detection; None for what is no name."""
    module_name, name = dotted.rsplit(".", 1)
    return getattr(importlib.import_module(f"binocal.detection.{module_name}"), name, None)


if __name__ == "__main__":
    main()
