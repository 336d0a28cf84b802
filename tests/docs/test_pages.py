"""The pages: one text width, the field's words, names that exist, links that lead somewhere, and examples that run."""

import importlib
import re
import shlex
from pathlib import Path

import pytest
import yaml

from binocal.cli import main

ROOT = Path(__file__).parents[2]
WRITTEN = {ROOT / "docs" / "cli.md", *(ROOT / "docs" / "findings").glob("*.md")}  # by scripts; tests of their own
PAGES = sorted({*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").glob("*.md")} | WRITTEN)
WIDTH = 100
PRIVATE_WORDS = (
    r"road|roads|door|doors|told|led|astray|dear|betrays?|thrice|story|judges?|judged|by halves|pupils?|lessons?|exams?|"
    r"stranger|culprit|handed over|pictures?"
)
IDS = [str(path.relative_to(ROOT)) for path in PAGES]


def prose(path: Path) -> list[tuple[int, str]]:
    """Lines outside of code blocks, with code, links and quoted text of other tools taken out."""
    lines, is_code = [], False
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        if line.lstrip().startswith("```"):
            is_code = not is_code
        elif not is_code:
            lines.append((number, line))
    return lines


@pytest.mark.parametrize("path", PAGES, ids=IDS)
def test_lines_are_no_longer_than_one_hundred_characters(path):
    def may_be_long(line):  # tables, links and what has no space to break at
        return line.startswith(("|", "![", "<")) or "](" in line

    long = [n for n, line in prose(path) if len(line) > WIDTH and not may_be_long(line)]
    assert not long


@pytest.mark.parametrize("path", PAGES, ids=IDS)
def test_numbers_have_a_leading_zero_and_words_are_the_fields(path):
    found = []
    for number, line in prose(path):
        plain = re.sub(r"`[^`]*`|\]\([^)]*\)|https?://\S+", "", line)
        if re.search(r"(?<![\w.\])…])\.\d", plain) or re.search(rf"\b({PRIVATE_WORDS})\b", plain, re.IGNORECASE):
            found.append((number, line))
    assert not found


@pytest.mark.parametrize("path", PAGES, ids=IDS)
def test_links_to_files_and_headings_exist(path):
    missing = []
    for target in re.findall(r"\]\(([^)\s]+)\)", path.read_text(encoding="utf-8")):
        if "://" in target or target.startswith("mailto:"):
            continue
        file, _, anchor = target.partition("#")
        linked = (path.parent / file).resolve() if file else path
        if not linked.exists() or (anchor and anchor not in anchors(linked)):
            missing.append(target)
    assert not missing


def anchors(path: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and MkDocs make them."""
    headings = [line.lstrip("#").strip() for _, line in prose(path) if line.startswith("#")]
    return {re.sub(r"[\s]+", "-", re.sub(r"[^\w\s-]", "", h.lower())).strip("-") for h in headings}


@pytest.mark.parametrize("path", PAGES, ids=IDS)
def test_modules_files_and_make_targets_that_are_named_exist(path):
    text = path.read_text(encoding="utf-8")
    if path.name == "CHANGELOG.md":
        text = text.partition("## 0.1.0")[0].partition("### Breaking")[0]  # old names may be named
    missing = []
    for name in set(re.findall(r"`(binocal(?:\.\w+)+)", text)):
        if not resolves(name):
            missing.append(name)
    for name in set(re.findall(r"`([\w/.-]+/[\w.-]+\.(?:py|toml|hpp|cpp|yml))`", text)):
        package = ROOT / "src" / "binocal"
        places = (ROOT, package, package / "detection", package / "kernels" / "cpp")
        if not any((place / name).exists() for place in places):
            missing.append(name)
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    missing += [f"make {name}" for name in set(re.findall(r"`make ([a-z]+)`", text)) if name not in targets]
    assert not missing


def resolves(name: str) -> bool:
    """Whether a dotted name is a module of binocal or an attribute of one; the groups of entry points are names too."""
    if name in ("binocal.calibrators", "binocal.formats", "binocal.camera_models"):
        return True
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:length]))
        except ImportError:
            continue
        try:
            for attribute in parts[length:]:
                value = getattr(value, attribute)
        except AttributeError:
            return False
        return True
    return False


def test_every_page_is_in_the_navigation():
    class Loader(yaml.SafeLoader):
        """Without MkDocs' tags for Python names."""

    Loader.add_multi_constructor("tag:yaml.org,2002:python/name:", lambda loader, suffix, node: suffix)
    site = yaml.load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"), Loader)

    def files(part):
        if isinstance(part, str):
            return {part}
        values = part.values() if isinstance(part, dict) else part
        return set().union(*(files(value) for value in values))

    pages = {str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md")}
    assert files(site["nav"]) == pages


def blocks(path: Path, language: str) -> list[str]:
    """The code blocks of a page in that language."""
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def worked_in(tmp_path_factory):
    """A folder in which the commands of the README and the tutorial were run."""
    folder = tmp_path_factory.mktemp("pages")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in commands():
            assert main([*command, "--json"]) == 0, command
        street = ["simulate", "--rig", "rig.json", "--scene", "street", "--pairs", "1", "--output", "street"]
        assert main([*street, "--json"]) == 0
    return folder


def commands() -> list[list[str]]:
    """The commands of the tutorial and of the page about evidence, which the examples build on."""
    out = []
    for page in ("tutorial.md", "how-to/evidence.md"):
        for block in blocks(ROOT / "docs" / page, "sh"):
            for line in block.splitlines():
                words = shlex.split(line, comments=True)
                if words and words[0] == "binocal":
                    out.append([*words[1:], *(["--force"] if words[1] in ("calibrate", "simulate") else [])])
    return out


EXAMPLES = [
    (path, i) for path in PAGES if path.parent.name in ("docs", "how-to") for i, _ in enumerate(blocks(path, "python"))
]
ELSEWHERE = {"extending.md", "datasets.md", "calibrators.md"}
"""Whose examples tests/test_extending.py, tests/datasets and tests/calibrators/test_zoom.py run."""
EXAMPLES = [(path, i) for path, i in EXAMPLES if path.name not in ELSEWHERE]


@pytest.mark.slow
@pytest.mark.parametrize(("path", "index"), EXAMPLES, ids=[f"{p.relative_to(ROOT)}-{i}" for p, i in EXAMPLES])
def test_examples_run(path, index, worked_in, monkeypatch):
    monkeypatch.chdir(worked_in)
    exec(compile(blocks(path, "python")[index], f"{path.name}, example {index}", "exec"), {"__name__": "__main__"})


@pytest.mark.slow
def test_the_readmes_example_runs(worked_in, monkeypatch):
    from binocal import read_detections

    monkeypatch.chdir(worked_in)
    corners = read_detections("corners.npz")
    given = {"object_points_m": corners.object_points_m, "left_px": corners.left_px, "right_px": corners.right_px}
    (example,) = blocks(ROOT / "README.md", "python")
    exec(compile(example, "README.md", "exec"), given)
    assert given["calibration"].rig.baseline_m == pytest.approx(0.06, rel=1e-3)


def test_the_readmes_commands_are_those_that_the_tutorial_runs():
    tutorial = {line for block in blocks(ROOT / "docs" / "tutorial.md", "sh") for line in block.splitlines()}
    for block in blocks(ROOT / "README.md", "sh"):
        for line in block.splitlines():
            if line.startswith("binocal "):
                assert line in tutorial
