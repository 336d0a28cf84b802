"""Tables, the page and the figures of an experiment; the folder that it is written to."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from binocal.app import experiment_times
from binocal.cli import main
from binocal.experiments import boards, paper, stability
from binocal.experiments.case import Case, Result, results_of
from binocal.experiments.options import ExperimentOptions
from binocal.experiments.page import Figure, Page, Part, page_files
from binocal.experiments.row import Measured, Row
from binocal.experiments.tables import markdown, tables_of
from small_cases import Fails, Several, make, measure


def row(calibrator, case, median, **more):
    spread = (None, None) if median is None else (0.9 * median, 1.1 * median)
    values = {"bound": None, "paper": None, "seeds": 3, "failures": 0, "criterion": "length", "unit": "mm"} | more
    criterion, unit = values.pop("criterion"), values.pop("unit")
    return Row("3", case, calibrator, criterion, unit, median, *spread, **values)


ROWS = (
    row("drl", "a <b>", 1.0, bound=0.5, paper=0.36),
    row("drl", "c", 2.0, bound=0.6),
    row("lm", "a <b>", None, criterion=None, unit=None, failures=3),
    row("lm", "c", 4.0, failures=1),
)


def test_a_table_has_methods_down_and_cases_across_and_counts_failures():
    (table,) = tables_of(ROWS, "3")
    assert table.title == "Length, mm" and table.header == ("method", "a <b>", "c", "bound", "paper, a <b>")
    assert table.lines[0] == ("drl", "1 (0.9..1.1)", "2 (1.8..2.2)", "0.5 / 0.6", "0.36")
    assert table.lines[1] == ("lm", "3 of 3 refused", "4 (3.6..4.4), 1 of 3 refused", "", "")
    assert markdown(table).splitlines()[2] == "| method | a <b> | c | bound | paper, a <b> |"


def test_the_page_is_whole_and_the_same_for_the_same_rows():
    drawn = Figure("length", "length (mm)", "Lengths", "lengths.svg", is_log=True)
    page = Page(
        "Title",
        ("Text & `code` more.",),
        (Part("3", "Table 3", "What it is.", (drawn,)), Part("9", "Nothing", "")),
        ROWS,
    )
    files = page_files(page)
    assert files == page_files(page) and set(files) == {"page.md", "page.html", "rows.csv", "lengths.svg"}
    assert "![Lengths](lengths.svg)" in files["page.md"] and "Nothing" not in files["page.md"]
    assert (
        "<svg" in files["page.html"]
        and "a &lt;b&gt;" in files["page.html"]
        and "<p>Text &amp; <code>code</code> more.</p>" in files["page.html"]
        and "http" not in files["page.html"].split("</style>")[0]
    )
    texts = "".join(ElementTree.fromstring(files["lengths.svg"].encode()).itertext())
    assert "length (mm)" in texts and "printed in the paper" in texts and "lm" in texts
    listed = list(csv.DictReader(io.StringIO(files["rows.csv"])))
    assert len(listed) == 4 and listed[0]["median"] == "1.0" and listed[2]["median"] == ""


def test_order_that_is_kept():
    up = np.arange(5.0)
    assert stability.order_kept_percent(up, up) == 100 and stability.order_kept_percent(up, -up) == 0
    assert stability.order_kept_percent(up, up[[1, 0, 2, 3, 4]]) == 90  # one pair of ten
    with pytest.raises((ValueError, TypeCheckError)):
        stability.order_kept_percent(up, up[:3])


def test_stability_is_over_all_pairs_of_seeds():
    case = Case("one", make, lambda made, sample: [], (Several(),))
    values = {0: (1.0, 2.0, 3.0), 1: (1.1, 2.1, 2.9), 2: (2.5, 2.0, 3.0)}
    results = {
        ("one", "several", seed): Result(
            "one",
            "several",
            seed,
            tuple(Measured(n, "", v, table="parameters") for n, v in zip("abc", of, strict=True)),
        )
        for seed, of in values.items()
    }
    (kept,) = stability.stability_rows([case], (0, 1, 2), results)
    assert (kept.low, kept.high) == (pytest.approx(100 * 2 / 3), 100.0) and kept.table == "figure 7"


def test_options_that_leave_too_few_pairs_are_refused():
    with pytest.raises(ValueError, match="100 images over 10 seeds are 5 pairs each; at least 8"):
        ExperimentOptions(100, 10)
    assert ExperimentOptions(1000, 10, 5).seeds == tuple(range(5, 15))


@pytest.fixture
def small(monkeypatch):
    """An experiment whose cases cost nothing; how often a sample was made."""
    made = []

    def counted(seed):
        made.append(seed)
        return make(seed)

    case = Case("one", counted, measure, (Fails(), Several()), {}, "3")
    monkeypatch.setattr(paper, "cases_of", lambda options, folder: [case])
    monkeypatch.setattr(sys.modules["binocal.app.experiment"], "n_threads", lambda: 1)
    monkeypatch.setattr(experiment_times, "timed_results", lambda options, has: iter(()))
    return made


def test_the_verb_writes_everything_once_and_goes_on_after_a_cut(small, tmp_path, capsys):
    output = tmp_path / "out"
    arguments = ["experiment", "--images", "60", "--seeds", "3", "--output", str(output)]
    assert main([*arguments, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads((output / "results.json").read_text())
    first = document["rows"][0]
    assert (
        first["table"] == "3" and first["calibrator"] == "fails" and first["failures"] == 1 and first["median"] == 11.0
    )
    names = {path.name for path in output.iterdir()}
    assert {"page.md", "page.html", "times.md", "rows.csv", "results.json", "rows.jsonl"} <= names
    before = {name: (output / name).read_bytes() for name in names}
    assert main(arguments) == 3  # it is whole: nothing is overwritten
    assert "--force" in capsys.readouterr().err
    (output / "results.json").unlink()
    journal = (output / "rows.jsonl").read_bytes().splitlines(keepends=True)
    (output / "rows.jsonl").write_bytes(b"".join(journal[:4]))  # killed after three results
    small.clear()
    assert main(arguments) == 0 and small == [1, 2]
    assert "Went on" in capsys.readouterr().out
    assert {name: (output / name).read_bytes() for name in names} == before


def test_a_cut_experiment_of_other_options_is_not_gone_on_with(small, tmp_path, capsys):
    output = tmp_path / "out"
    assert main(["experiment", "--images", "60", "--seeds", "3", "--output", str(output)]) == 0
    (output / "results.json").unlink()
    assert main(["experiment", "--images", "80", "--seeds", "3", "--output", str(output)]) == 3
    assert "the journal of another experiment" in capsys.readouterr().err
    assert main(["experiment", "--images", "80", "--seeds", "3", "--output", str(output), "--force"]) == 0
    assert main(["experiment", "--images", "100000000", "--output", str(output)]) == 2
    assert "above 20000" in capsys.readouterr().err
    assert main(["experiment", "--images", "20", "--seeds", "3", "--output", str(output)]) == 2
    assert "at least 8 are needed" in capsys.readouterr().err


@pytest.mark.slow
def test_a_sample_of_rendered_boards_is_halved_and_drl_reaches_its_bound():
    case = paper.board_cases(ExperimentOptions(160, 10))[0]
    assert isinstance(case.make, boards.RenderedBoards) and case.make.n_pairs == 8
    results = results_of(case, 0, ("drl", "opencv, its own corners", "prior unchanged", "Cramér-Rao bound"))
    drl, theirs, prior, bound = ({m.criterion: m.value for m in result.measured} for result in results)
    assert drl[paper.LENGTH] < 0.05 < 1.0 < prior[paper.LENGTH]  # percent
    assert drl[paper.LENGTH] < theirs[paper.LENGTH] < 0.2  # cv2's corners are three times as noisy
    assert drl["error of a single side"] == pytest.approx(bound["error of a single side"], rel=0.05)
    assert drl[paper.CORRECT] >= 95 and prior[paper.CORRECT] < 10
    assert {"left.fx", "translation.z", "iterations"} <= set(drl)


def test_one_method_on_many_cases_is_read_downward():
    rows = [row("zoom", f"case {i}", float(i), bound=0.5 if i else None, paper="0.12") for i in range(6)]
    (table,) = tables_of(rows, "3")
    assert table.header == ("case", "zoom", "bound", "paper") and len(table.lines) == 6
    assert table.lines[2] == ("case 2", "2 (1.8..2.2)", "0.5", "0.12") and table.lines[0][2] == ""


def test_a_figure_shows_its_own_part_alone():
    other = dataclasses.replace(row("elsewhere", "c", 7.0), table="training")
    part = Part("3", "Table 3", "", (Figure("length", "length (mm)", "Lengths", "lengths.svg"),))
    files = page_files(Page("Page", (), (part,), (*ROWS, other)))
    assert ">drl<" in files["lengths.svg"] and "elsewhere" not in files["lengths.svg"]
