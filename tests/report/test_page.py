"""The report's page: whole, by itself, under its own content policy, readable without seeing it; and its verdict."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="Matplotlib is an extra: pip install binocal[report]")
pytest.importorskip("jinja2", reason="Jinja is an extra: pip install binocal[report]")

import headless_browser

from binocal.app import report as reporting
from binocal.app.corners import FoundCorners
from binocal.app.report import ReportRequest, make_report, write_report
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cli import main
from binocal.errors import DataError
from binocal.findings import finding
from binocal.formats.detections_npz import write_detections
from binocal.formats.rig_json import read_calibration, write_calibration
from binocal.geometry import SE3, so3
from binocal.report import printing
from binocal.report.contents import ReportContents
from binocal.report.headline import headline_of
from binocal.report.plan_sections import next_section
from binocal.report.svg import figure_svg, themed
from binocal.requirements import parse_requirement
from binocal.result import Covariance
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

RIG, SPEC = table2_rig(), "chessboard:6x5:30mm"
BOARD = parse_board(SPEC)


def seen(seed, n_views=10):
    rng = np.random.default_rng(seed)
    scene = StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, n_views, rng))
    return replace(simulate_detections(scene, rng, noise_px=0.1), board_spec=SPEC)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A rig and its corners beside it, and the report of both."""
    place = tmp_path_factory.mktemp("report")
    detections = seen(0)
    calibration = calibrate(detections, model="brown4", calibrator="lm")
    calibration = replace(calibration, provenance={**calibration.provenance, "board": SPEC, "note": "<b>&'\""})
    write_calibration(place / "rig.json", calibration)
    write_detections(place / "corners.npz", detections)
    needs = (parse_requirement("depth 0.01% at 2m"), parse_requirement("row 5px"))
    write_report(place / "rig.json", place / "report.html", ReportRequest(requirements=needs))
    return place


@pytest.fixture
def undrawn(monkeypatch):
    """Everything but the drawing, which takes most of the time."""
    monkeypatch.setattr(reporting, "report_page", lambda contents, headline: f"<h1>{headline.sentence}</h1>")


class Elements(HTMLParser):
    """All start tags with their attributes, and the texts of style and script elements."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.tags, self.sources = [], {"style": [], "script": []}
        self._open = ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self._open = tag

    def handle_endtag(self, tag):
        self._open = ""

    def handle_data(self, data):
        if self._open in self.sources:
            self.sources[self._open].append(data)


@pytest.fixture(scope="module")
def page(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def test_the_page_asks_for_nothing_and_keeps_its_own_policy(page):
    found = Elements(page)
    policy = next(a["content"] for _, a in found.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'; ") and "unsafe" not in policy and "http" not in policy
    runs = [a for tag, a in found.tags if tag == "script" and a.get("type") != "application/json"]
    assert len(runs) >= 1 and not any("src" in a for a in runs)
    for kind in ("style", "script"):
        for text in found.sources[kind]:
            if kind == "script" and text.lstrip().startswith(("{", "[")):
                continue  # data
            digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
            assert f"'sha256-{digest}'" in policy
    for tag, attributes in found.tags:
        assert "style" not in attributes and not any(name.startswith("on") for name in attributes), (tag, attributes)
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:")), (tag, attributes)
    assert len(page.encode()) < 1_000_000


def test_the_page_can_be_read_without_seeing_it(page):
    found = Elements(page)
    tags = [tag for tag, _ in found.tags]
    assert tags.count("h1") == tags.count("main") == 1 and "nav" in tags and dict(found.tags)["html"] == {"lang": "en"}
    ids = [a["id"] for _, a in found.tags if "id" in a]
    assert len(ids) == len(set(ids))
    for tag, attributes in found.tags:
        if tag == "svg":
            assert attributes.get("aria-label") or attributes.get("aria-hidden") == "true"
        if tag == "a":
            assert attributes["href"].removeprefix("#") in ids
        if tag == "use":
            assert attributes["href"].removeprefix("#") in ids
    assert html.escape("<b>&'", quote=False).replace("'", "&#39;") in page and "<b>&" not in page


def test_needs_come_first_in_the_verdict(page):
    assert '<h1 id="verdict-title">Not good enough: 1 of 2 needs are not met.</h1>' in page
    assert page.index("depth 0.01% at 2m: not met") < page.index("row 5px: met")


def test_same_inputs_same_page(folder, page):
    needs = (parse_requirement("depth 0.01% at 2m"), parse_requirement("row 5px"))
    again = make_report(read_calibration(folder / "rig.json"), folder / "rig.json", ReportRequest(requirements=needs))
    assert again.page == page


def test_warnings_come_before_depth(folder):
    calibration = read_calibration(folder / "rig.json")
    unchecked = headline_of(calibration, ())
    assert (unchecked.level, unchecked.sentence) == ("care", "No fault is known.")
    assert unchecked.points == ("Nothing was checked anew: the corners of the calibration are not at hand.",)
    good = headline_of(calibration.with_evidence(seen(0)), ())
    assert (good.level, good.sentence, good.points) == ("good", "No fault found.", ())
    kept = finding("lens-model-misfits", model="brown4", profile_px=0.1, share_percent=9.0, standard_errors=4.0)
    care = headline_of(calibration, (kept,))
    assert care.level == "care" and care.sentence.startswith("Use with care: the lens bends light")
    grave = finding(
        "halves-disagree", projection_px=1.0, depth_percent=3.0, stated_percent=0.5, range=1.0, unit="m", over_sigma=6.0
    )
    bad = headline_of(calibration, (kept, grave))
    assert bad.level == "bad" and bad.sentence.startswith("Do not rely on this rig yet: two halves")
    assert bad.points == ("The lens bends light as its model cannot.",)
    twice = headline_of(calibration, (kept, kept))
    assert twice.sentence == care.sentence and twice.points == ()


def test_depth_that_is_known_badly_somewhere_stands_in_the_first_line(folder, undrawn):
    calibration = read_calibration(folder / "rig.json")
    good = make_report(calibration, folder / "rig.json").headline
    assert good.sentence == "No fault found." and re.search(r"by 0\.\d+ % at its worst place", good.points[-1])
    unsure = replace(
        calibration, covariance=Covariance(calibration.covariance.names, 900 * calibration.covariance.matrix)
    )
    at_boards = reporting._uncertainty(unsure)[0]
    poor = headline_of(unsure.with_evidence(seen(0)), (), (), at_boards)
    (percent,) = re.findall(r"by ([\d.]+) % at its worst place", poor.points[-1])
    assert poor.level == "care" and float(percent) > 5
    assert poor.sentence == f"Use with care: depth is uncertain by up to {percent} % (95 %)."
    kept = finding("lens-model-misfits", model="brown4", profile_px=0.1, share_percent=9.0, standard_errors=4.0)
    both = headline_of(unsure, (kept,), (), at_boards)
    assert both.sentence.endswith(f"as its model cannot, and depth is uncertain by up to {percent} % (95 %).")
    assert "Nothing was checked anew" in headline_of(unsure, (), (), at_boards).points[0]
    plans = reporting._usual_plan(unsure, ReportRequest(), BOARD)
    steps = next_section(ReportContents("rig.json", unsure, plans=plans, at_boards=at_boards)).steps
    assert re.match(r"Add the 5 views drawn below: the error of depth at its worst place, [\d.]+ % becomes", steps[0])
    usual = next_section(ReportContents("rig.json", calibration, plans=plans))
    assert len(usual.steps) == len(steps) - 1


def test_corners_beside_that_the_rig_was_not_made_from_come_first(folder, tmp_path, undrawn):
    calibration = read_calibration(folder / "rig.json")
    T = calibration.rig.T_right_left
    turned = SE3(so3.exp(np.radians([0.05, 0, 0])) @ T.R, T.t)
    write_calibration(tmp_path / "rig.json", replace(calibration, rig=replace(calibration.rig, T_right_left=turned)))
    (tmp_path / "corners.npz").write_bytes((folder / "corners.npz").read_bytes())
    run = make_report(read_calibration(tmp_path / "rig.json"), tmp_path / "rig.json")
    assert run.headline.level == "bad" and "not those that it was made from" in run.headline.sentence
    write_detections(tmp_path / "corners.npz", seen(0, n_views=4), force=True)  # of another rig, or of a part
    assert make_report(read_calibration(tmp_path / "rig.json"), tmp_path / "rig.json").headline.level == "good"


def test_the_plan_is_drawn_and_what_comes_next_said(page):
    assert "Outlines of the boards to show next in the left image, for depth 0.01% at 2m" in page
    assert re.search(
        r"<li>Add the (\d+ views|view) drawn below for depth 0.01% at 2m: [\d.]+ % becomes [\d.]+ %, which is (not )?enough",
        page,
    )


def test_without_corners_the_page_says_so(folder, tmp_path):
    (tmp_path / "rig.json").write_bytes((folder / "rig.json").read_bytes())
    run = write_report(tmp_path / "rig.json", tmp_path / "report.html")
    assert any("--evidence" in note for note in run.notes)
    assert 'id="coverage"' not in run.page and 'id="figures"' in run.page
    assert (run.headline.level, run.headline.sentence) == ("good", "No fault is known.")


def test_a_rig_of_which_little_is_known_has_a_page(folder, tmp_path):
    calibration = read_calibration(folder / "rig.json")
    bare = replace(
        calibration, views=(), T_left_board=None, covariance=Covariance((), np.zeros((0, 0))), mean_board_pose=None, board_shape=None,
        findings=(), provenance={},
    )  # fmt: skip
    run = make_report(bare, tmp_path / "rig.json")
    assert len(run.notes) == 2 and "where the boards were" in run.notes[1]
    assert (
        'id="rig"' in run.page
        and 'id="depth"' not in run.page
        and "nan" not in run.page.partition("<script")[0].lower()
    )


def test_without_a_file_of_corners_the_board_is_found_again_as_it_was(folder, tmp_path, monkeypatch):
    calibration = read_calibration(folder / "rig.json")
    asked = []

    def find(left, right, board, preparation, *rest):
        asked.append((left, right, board.n_points, preparation.channel, preparation.strengthens))
        return FoundCorners(seen(0), (), (), (), {})

    monkeypatch.setattr(reporting, "find_corners", find)
    monkeypatch.setattr(reporting, "report_images", lambda *given: ((), None, ("three images",)))
    monkeypatch.setattr(reporting, "report_page", lambda contents, headline: headline.sentence)
    made = replace(calibration, provenance={**calibration.provenance, "channel": "red", "preprocess": True})
    request = ReportRequest(left="l/*", right="r/*")
    run = make_report(made, tmp_path / "rig.json", request)
    assert asked == [("l/*", "r/*", BOARD.n_points, "red", True)] and run.notes == ("three images",)
    with pytest.raises(DataError, match="does not name the board"):
        make_report(replace(made, provenance={"board": "a wall"}), tmp_path / "rig.json", request)


def test_corners_of_another_rig_are_refused(folder, tmp_path, capsys):
    write_detections(tmp_path / "other.npz", seen(1))
    rig, out = str(folder / "rig.json"), str(tmp_path / "report.html")
    assert main(["report", rig, "--output", out, "--evidence", str(tmp_path / "other.npz")]) == 3
    error = capsys.readouterr().err
    assert "these are not the corners that the calibration was made from" in error and error.count("\n") == 1
    assert not (tmp_path / "report.html").exists()


def test_wrong_use_is_one_line_and_its_exit_code(folder, tmp_path, capsys, monkeypatch):
    rig, out = str(folder / "rig.json"), str(tmp_path / "report.html")
    for arguments, code, words in (
        ([rig, "--require", "depth 1% at 5 px"], 2, "--require"),
        ([rig, "--require", "depth 1% at 5"], 3, "board pitches"),
        ([rig, "--left", "l/*.png"], 2, "both --left and --right"),
        ([rig, "--board", "chessboard:9"], 2, "chessboard:9"),
        ([str(folder / "none.json")], 3, "none.json"),
        ([str(folder / "corners.npz")], 3, "corners.npz"),
        ([rig, "--output", str(folder)], 3, "is a folder"),
        ([rig, "--output", str(folder / "rig.json" / "r.html")], 3, "cannot be made"),
    ):
        assert main(["report", *arguments, *([] if "--output" in arguments else ["--output", out])]) == code, arguments
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1, error
    for missing in ("jinja2", "matplotlib"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, missing, None)
            assert main(["report", rig, "--output", out]) == 1
        assert "pip install 'binocal[report]'" in capsys.readouterr().err


def test_the_verb_prints_the_verdict(folder, tmp_path, capsys, undrawn):
    arguments = ["report", str(folder / "rig.json"), "--output", str(tmp_path / "r.html")]
    assert main([*arguments, "--require", "row 5px", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["level"] == "good" and document["requirements"][0]["outcome"] == "pass"
    assert main([*arguments, "--require", "baseline 0.00001%", "--force"]) == 4
    assert "Verdict  Not good enough" in capsys.readouterr().out
    with pytest.raises(DataError, match="exists already"):
        write_report(folder / "rig.json", tmp_path / "r.html")


def test_the_page_is_printed(folder, tmp_path, monkeypatch, undrawn):
    output, pdf = tmp_path / "r.html", tmp_path / "r.pdf"
    monkeypatch.setattr(printing.shutil, "which", lambda name: None)
    monkeypatch.setattr(printing, "PLACES", ())
    arguments = ["report", str(folder / "rig.json"), "--output", str(output), "--pdf"]
    assert main(arguments) == 3 and not output.exists()
    asked = []

    def run(command, **options):
        asked.append(command)
        place = next(part.partition("=")[2] for part in command if part.startswith("--print-to-pdf="))
        Path(place).write_bytes(b"%PDF-1.7 made up")
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(printing.shutil, "which", lambda name: f"/opt/{name}" if name == "google-chrome" else None)
    monkeypatch.setattr(printing.subprocess, "run", run)
    assert main(arguments) == 0 and pdf.read_bytes() == b"%PDF-1.7 made up"
    assert asked[0][0] == "/opt/google-chrome" and asked[0][-1].startswith("file://")
    monkeypatch.setattr(printing.subprocess, "run", lambda command, **options: subprocess.CompletedProcess(command, 7))
    assert main([*arguments, "--force"]) == 1 and pdf.read_bytes() == b"%PDF-1.7 made up"
    assert main(["report", str(folder / "rig.json"), "--output", str(pdf), "--pdf", "--force"]) == 2


def test_a_figure_has_no_style_and_ids_of_its_own():
    def draw(axes):
        axes.plot([0, 1], [0, 1], "o-", color="#0072b2", label="$x^2$")
        axes.legend()

    svg = figure_svg(draw, name="one", title='a "title"').svg
    assert " style=" not in svg and "var(--left)" in svg and "var(--ink)" in svg and "&quot;title&quot;" in svg
    assert not re.search(r'id="(?!one-)', svg) and not re.search(r'href="#(?!one-)', svg)
    assert themed('<svg width="1" viewBox="0 0 9 9"><g id="a"/></svg>', name="n", title="t").startswith(
        '<svg viewBox="0 0 9 9"'
    )


def test_in_a_browser(folder, capsys):
    browser = headless_browser.find()
    if browser is None:
        with capsys.disabled():
            print("\nno browser: the report was not opened in one (install chromium to test it)")
        pytest.skip("no browser is installed: the report was not opened in one")
    with headless_browser.page(browser) as shown:
        for width, theme in ((1600, "light"), (400, "dark")):
            shown.open(folder / "report.html", width, theme=theme)
            assert shown.messages == []
            assert shown.value("document.documentElement.scrollWidth") <= width
        shown.value("document.querySelector('#coverage figure').scrollIntoView({block: 'center', behavior: 'instant'})")
        x, y = middle_of(shown, "#coverage svg")
        shown.mouse("mouseMoved", x, y)
        assert re.fullmatch(r"\d+ corners? here", shown.value("document.getElementById('tip').textContent"))
        assert shown.value("document.getElementById('tip').hidden") is False
        outlines = (
            "[...document.querySelectorAll('#scene polygon')].map((e) => e.getAttribute('points')).sort().join(';')"
        )
        shown.value("document.getElementById('scene').scrollIntoView({block: 'center', behavior: 'instant'})")
        x, y = middle_of(shown, "#scene")
        before = shown.value(outlines)
        assert before.count(";") > 10 and "NaN" not in before
        for kind, dx, buttons in (("mousePressed", 0, 1), ("mouseMoved", 60, 1), ("mouseReleased", 60, 0)):
            shown.mouse(kind, x + dx, y, buttons)
        dragged = shown.value(outlines)
        assert dragged != before
        shown.value("document.getElementById('scene-view').focus({preventScroll: true})")
        x, y = shown.value(
            "(() => { const b = [...document.querySelectorAll('#scene .board')].at(-1).getBoundingClientRect();"
            " return [b.left + b.width / 2, b.top + b.height / 2]; })()"
        )
        shown.mouse("mouseMoved", x, y)
        assert "view" in shown.value("document.getElementById('tip').textContent")
        shown.key("ArrowLeft")
        assert shown.value(outlines) not in (before, dragged)
        shown.key("0")
        assert shown.value(outlines) == before
        shown.value("document.querySelector('[data-look=top]').click()")
        assert shown.value(outlines) != before
        assert shown.messages == []


def middle_of(shown, selector):
    return shown.value(
        f"(() => {{ const b = document.querySelector('{selector}').getBoundingClientRect();"
        " return [b.left + b.width / 2, b.top + b.height / 2]; })()"
    )
