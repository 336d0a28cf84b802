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
    ],
)
def test_what_cannot_be_printed_is_a_line(here, capsys, arguments, message):
    assert main(["board", *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1 and not list(here.iterdir())
