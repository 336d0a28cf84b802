"""Writes the drawing of ARCHITECTURE.md from the package's own imports: the fewest arrows that imply them all.

Run by ``make docs``; a test holds the page in step.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "ARCHITECTURE.md"
PACKAGE = ROOT / "src" / "binocal"
BEGIN, END = "<!-- drawing: written by docs/make_architecture.py -->", "<!-- end of drawing -->"

LABELS = {
    "acceptance": "rules, proof, findings of a rig",
    "app": "one file per verb",
    "benchmark": "tables against peers",
    "boards": "SPEC, points",
    "calibrators": "evidence to rig, registry",
    "set_checks": "what is wrong with a whole set of views",
    "cameras": "lens models, rig",
    "cli": "verbs, tables, exit codes",
    "datasets": "pairs of files",
    "detection": "finding, measuring",
    "experiments": "cases, methods, seeds to rows",
    "evidence": "corners of all views",
    "findings": "codes and sentences",
    "formats": "rig.json, OpenCV, npz",
    "geometry": "rotations, homographies",
    "images": "strict reading",
    "initialization": "closed forms, diagnosis",
    "kernels": "C++: inner loops",
    "matching": "points that both cameras saw",
    "metrics": "figures of merit",
    "planning": "which views to take next",
    "printing": "boards on paper and screens",
    "rectification": "maps, disparity, depth",
    "report": "figures, pages",
    "requirements": "what a user needs, verdicts",
    "result": "a calibration",
    "rl": "agent, environment, training",
    "simulation": "rigs, views, images",
    "solvers": "problem, loop, covariance",
    "validation": "a rig tested on its own corners",
    "uncertainty": "sigmas of depth, rows, projection",
}
"""What stands in each package. Modules that nearly all import (errors, shapes, ...) are left out."""


def imports() -> dict[str, set[str]]:
    """Which package imports which, imports within functions too."""
    found: dict[str, set[str]] = defaultdict(set)
    for path in sorted(PACKAGE.rglob("*.py")):
        own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "binocal":
                below = node.module.split(".")[1:]
                names = below[:1] or [alias.name for alias in node.names]
                found[own] |= {name for name in names if name in LABELS and name != own}
    return {name: found[name] for name in LABELS}


def reachable(graph: dict[str, set[str]], start: str) -> set[str]:
    """What can be reached in one step or more."""
    seen: set[str] = set()
    waiting = list(graph[start])
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting += graph[name]
    return seen


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """The fewest edges with the same reachability; the graph has no circles."""
    return {
        name: {b for b in below if not any(b in reachable(graph, other) for other in below - {b})}
        for name, below in graph.items()
    }


def drawing() -> str:
    """The Mermaid source."""
    graph = reduced(imports())
    lines = ["```mermaid", "graph TD"]
    lines += [f'  {name}["<b>{name}</b><br>{label}"]' for name, label in LABELS.items()]
    lines += [f"  {name} --> {' & '.join(sorted(below))}" for name, below in graph.items() if below]
    return "\n".join([*lines, "```"])


def page() -> str:
    """ARCHITECTURE.md with the present drawing."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return f"{before}{BEGIN}\n\n{drawing()}\n\n{END}{rest.partition(END)[2]}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
