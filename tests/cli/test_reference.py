"""docs/cli.md is the command line's own word."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest
import typer

from binocal.calibrators.registry import CALIBRATORS
from binocal.cli.verbs import app

DOCS = Path(__file__).resolve().parents[2] / "docs"
COMMANDS = typer.main.get_command(app).commands


def reference() -> str:
    spec = importlib.util.spec_from_file_location("make_cli_reference", DOCS / "make_cli_reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.reference()


def test_the_page_is_up_to_date():
    assert (DOCS / "cli.md").read_text(encoding="utf-8") == reference(), "run: python docs/make_cli_reference.py"


@pytest.mark.parametrize("verb", COMMANDS)
def test_every_verb_and_option_is_documented(verb):
    section = (DOCS / "cli.md").read_text(encoding="utf-8").partition(f"## binocal {verb}\n")[2].partition("\n## ")[0]
    section = " ".join(section.split())
    assert COMMANDS[verb].help and " ".join(COMMANDS[verb].help.split()) in section
    for parameter in COMMANDS[verb].params:
        if parameter.name != "help":
            assert parameter.help and parameter.help in section, f"{verb}: {parameter.name} has no help"


@pytest.mark.parametrize("verb", COMMANDS)
def test_every_verb_is_in_the_readme(verb):
    assert f"binocal {verb}" in (DOCS.parent / "README.md").read_text(encoding="utf-8")


def test_every_option_that_a_sentence_names_exists():
    known = {option for command in COMMANDS.values() for p in command.params for option in (*p.opts, *p.secondary_opts)}
    known |= {"--help", "--version"}
    source = DOCS.parent / "src" / "binocal"
    for path in sorted(source.rglob("*.py")):
        if path.parent.name != "report":  # which names properties of style sheets, and a browser's options
            named = re.findall(r"(?<![\w-])--[a-z][a-z-]+", path.read_text(encoding="utf-8"))
            assert set(named) <= known, path


def test_every_calibrator_is_in_the_help():
    (option,) = (p for p in COMMANDS["calibrate"].params if p.name == "calibrator")
    assert all(name in option.help.replace(",", " ").split() for name in CALIBRATORS)
