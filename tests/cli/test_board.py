"""The verb ``board``."""

from __future__ import annotations

import json

import pytest

from binocal.cli import main


@pytest.fixture(autouse=True)
def here(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_board_is_written_and_its_distances_are_said(here, capsys):
    assert main(["board", "chessboard:9x6:20mm", "new/board.pdf"]) == 0
    out = capsys.readouterr().out
    assert "new/board.pdf: 297 x 210 mm; print it at 100 %" in out and "A-B (200 mm) and A-C (140 mm)" in out
    assert (here / "new" / "board.pdf").read_bytes().endswith(b"%%EOF\n")
    assert main(["board", "chessboard:9x6:20mm", "new/board.pdf"]) == 3
    assert "--force" in capsys.readouterr().err


def test_pages_are_files_where_a_format_has_one_page(here, capsys):
    assert main(["board", "chessboard:9x6:40mm", "b.svg", "--page", "A3", "--tiles", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["files"] == ["b-1.svg", "b-2.svg"] and document["pages"] == 2
    assert document["distances_mm"] == {"A-B": pytest.approx(400), "A-C": pytest.approx(280)}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["chessboard:9x6", "b.pdf"], "give the length a unit"),
        (["chessboard:9x6:20mm", "b.jpg"], "ends in none of .pdf, .svg, .dxf, .png"),
        (["chessboard:9x6:20mm", "b.pdf", "--legacy"], "ChArUco boards alone"),
        (["chessboard:9x6:20mm", "b.pdf", "--page", "A9"], "is no page"),
        (["chessboard:9x6:20mm", "b.pdf", "--margin", "10"], "--margin 10 is not a length with its unit"),
        (["chessboard:9x6:60mm", "b.pdf", "--page", "A4"], "take --page A1, or --tiles"),
        (["chessboard:9x6:2mm", "b.pdf", "--page", "60x60mm"], "too narrow for the notes"),
        (["nonsense", "b.pdf"], "is not understood"),
        (["b.pdf"], "missing SPEC or FILE"),
        (["chessboard:9x6:20mm", "b.pdf", "--tag-border", "1"], "is of AprilGrids and ChArUco boards"),
        (["aprilgrid:3x2:40mm", "b.pdf", "--tag-border", "1", "--kalibr", "t.yaml"], "not as Kalibr looks for tags"),
        (["chessboard:9x6", "--screen", "--resolution", "big"], "--resolution is 'big'"),
        (["chessboard:9x6", "--screen", "--diagonal", "27"], "needs a unit: mm, cm, m or in, such as 27in"),
        (["chessboard:9x6", "--screen", "--page", "A4"], "belong to paper"),
        (["chessboard:9x6:20mm", "b.pdf", "--diagonal", "27in"], "belong to --screen"),
        (["b.pdf", "--for", "60deg@1280x960"], "--for and --range belong together"),
        (["b.pdf", "--for", "60deg@1280x960", "--range", "0.5-3"], "needs a unit"),
        (["b.pdf", "--for", "500deg@1280x960", "--range", "0.5-3m"], "is none; it runs from 1 to 220 deg"),
        (["chessboard:9x6:20mm", "b.pdf", "--for", "60@1280x960", "--range", "1-2m"], "leave out the SPEC"),
        (["--for", "60@1280x960", "--range", "1-2m", "--kalibr", "t.yaml"], "name its FILE too"),
        (["chessboard:9x6:20mm", "b.pdf", "--kalibr", "t.txt"], "does not end in .yaml"),
    ],
)
def test_what_cannot_be_printed_is_a_line(here, capsys, arguments, message):
    assert main(["board", *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1 and not list(here.iterdir())


def test_a_board_is_recommended_with_its_reasons_and_written(here, capsys):
    assert main(["board", "--for", "60deg@1280x960", "--range", "0.5-3m"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert (
        out[0] == "chessboard:7x4:43mm" and "15.9 px at 3 m" in out[2] and out[4].startswith("- A3") and len(out) == 5
    )
    assert main(["board", "b.svg", "--for", "60deg@1280x960", "--range", "0.5-3m", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["board"] == "chessboard:7x4:43mm" and document["page_mm"] == [420.0, 297.0]
    assert document["files"] == ["b.svg"] and (here / "b.svg").exists()


def test_a_page_for_a_screen_says_its_spec(here, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    arguments = ["board", "chessboard:9x6:20mm", "--screen", "--diagonal", "27in", "--resolution", "2560x1440"]
    assert main(arguments) == 0
    assert "board.html: 860 x 602 pixels, 86 a pitch" in capsys.readouterr().out and not opened
    assert main([*arguments, "--open", "--force", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["board"] == "chessboard:9x6:20.0799mm" and opened == [(here / "board.html").as_uri()]
