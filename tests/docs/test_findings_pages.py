"""docs/findings/ says what the table of codes and the rules say."""

import importlib.util
from pathlib import Path

from binocal.findings import KINDS

DOCS = Path(__file__).resolve().parents[2] / "docs"


def script():
    spec = importlib.util.spec_from_file_location("make_findings", DOCS / "make_findings.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_code_has_its_page_and_no_page_is_old():
    make = script()
    assert set(make.EXPLANATIONS) == set(KINDS)
    found = {path.name: path.read_text(encoding="utf-8") for path in (DOCS / "findings").glob("*.md")}
    assert found == make.pages(), "run: python docs/make_findings.py"


def test_the_table_of_the_method_is_up_to_date():
    text = (DOCS / "method.md").read_text(encoding="utf-8")
    assert text == script().with_rules_table(text), "run: python docs/make_findings.py"
