"""Options and places that nobody means: one line, the right exit code, nothing lost."""

from __future__ import annotations

import os

import cv2
import numpy as np
import pytest

from binocal import output
from binocal.boards import parse_board
from binocal.cli import main
from binocal.cli.exits import one_line
from binocal.cli.grouping import group_lines
from binocal.errors import FormatError, OutputError
from binocal.formats.json_document import load_document
from binocal.threads import set_threads


def images(folder):
    for k in range(3):
        for grey, side in enumerate(("left", "right")):
            cv2.imwrite(str(folder / f"{side}_{k}.png"), np.full((40, 50), 100 + 10 * k + grey, np.uint8))
    return ["--left", str(folder / "left_*"), "--right", str(folder / "right_*"), "--board", "chessboard:9x6:30mm"]


def test_an_output_that_is_an_input_is_refused(tmp_path, capsys):
    given = images(tmp_path)
    before = (tmp_path / "left_0.png").read_bytes()
    assert main(["calibrate", *given, "--output", str(tmp_path / "left_0.png"), "--force"]) == 2
    assert "is one of the input images" in capsys.readouterr().err
    assert (tmp_path / "left_0.png").read_bytes() == before


def test_a_folder_that_takes_no_new_files_ends_in_a_line(tmp_path, monkeypatch):
    """Some folders answer every new name as if it were missing, and exist."""

    def refuse(*args):
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(output.os, "mkdir", refuse)
    with pytest.raises(OutputError, match="takes no new files"), output._part_folder(tmp_path / "new"):
        pass


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--board", ""], "--board: nothing is given"),
        (["--left="], "--left: nothing is given"),
        (["--output", "made/"], "--output: made/ names a folder; name a file, such as made/rig.json"),
        (["--evidence=made/"], "--evidence: made/ names a folder"),
        ([""], "an argument is empty"),
        (["--board", "chessboard:9x6:nanmm"], "board 'chessboard:9x6:nanmm': 'nanmm' is neither a length"),
    ],
)
def test_what_an_option_cannot_mean_is_named(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", *images(tmp_path), *arguments]) == 2
    assert said in one_line(capsys.readouterr().err)
    assert not (tmp_path / "made").exists()


def test_a_key_that_stands_twice_is_refused(tmp_path):
    path = tmp_path / "rig.json"
    path.write_text('{"schema": "binocal.rig/1", "cameras": {"left": 1, "left": 2}}')
    with pytest.raises(FormatError, match='holds the key "left" twice'):
        load_document(path, "binocal.rig/1")


@pytest.mark.parametrize("value", ["99999999999999999999999", "0", "-3"])
def test_numbers_of_threads_are_bounded(value, capsys):
    assert main(["demo", "--threads", value]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    with pytest.raises(ValueError, match="between 1 and 4096"):
        set_threads(int(value))


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--noise", "nan", "'nan' is not a finite number"),
        ("--blur", "-inf", "'-inf' is not a finite number"),
        ("--noise", "1e400", "'1e400' is not a finite number"),
        ("--noise", "two", "'two' is not a finite number"),
        ("--noise", "-1", "'-1' is below 0"),
        ("--blur", "250.5", "'250.5' is above 100"),
        ("--pairs", "2.5", "'2.5' is not a whole number"),
        ("--seed", "9" * 6000, "9' is not a whole number"),
    ],
)
def test_a_wrong_number_is_answered_with_what_was_typed(option, value, said, capsys):
    assert main(["simulate", "--board", "chessboard:4x3:30mm", "--pairs", "2", "--output", "never", option, value]) == 2
    line = capsys.readouterr().err
    assert said in line and f"'{option}'" in line and line.count("\n") == 1 and len(line) < 250


def test_pairs_are_bounded(capsys):
    assert main(["simulate", "--board", "chessboard:4x3:30mm", "--pairs", "9" * 20, "--output", "never"]) == 2
    assert not os.path.exists("never")


@pytest.mark.parametrize("length", ["1e-300mm", "1e-9mm"])
def test_boards_too_small_to_be_are_refused(length):
    with pytest.raises(ValueError, match="not plausible"):
        parse_board(f"chessboard:9x6:{length}")


def test_names_reach_the_terminal_written_out():
    assert one_line("a\nb\x1b[31m\x9b") == "a b\\x1b[31m\\x9b"
    assert group_lines("dropped", "image", [("a\nb\x1b[31m", "is an empty file")]) == [
        "dropped image a b\\x1b[31m: is an empty file"
    ]


def test_images_that_show_nothing_are_not_called_one_file_alone(tmp_path, capsys):
    for side in ("left", "right"):
        for k in range(3):
            cv2.imwrite(str(tmp_path / f"{side}_{k}.png"), np.zeros((40, 50), np.uint8))
    arguments = [
        "--left",
        str(tmp_path / "left_*"),
        "--right",
        str(tmp_path / "right_*"),
        "--board",
        "chessboard:9x6:30mm",
    ]
    assert main(["calibrate", *arguments]) == 3
    assert "black or white all over" in capsys.readouterr().err


def test_patterns_that_the_shell_expanded_are_named(tmp_path, capsys):
    given = images(tmp_path)
    expanded = [given[0], *sorted(str(path) for path in tmp_path.glob("left_*")), *given[2:]]
    assert main(["calibrate", *expanded, "--output", str(tmp_path / "rig.json")]) == 2
    assert "put patterns in quotes: --left 'left_*.png'" in capsys.readouterr().err
    (tmp_path / "of a rig.png").touch()
    many = [str(tmp_path / "of a rig.png"), *(f"left_{k:04}.png" for k in range(400))]
    assert main(["calibrate", *given, *many]) == 2
    line = capsys.readouterr().err
    assert "of a rig.png' and others; put patterns in quotes" in line and len(line) < 300
    assert main(["calibrate", *given, "no-such-file", "--output", str(tmp_path / "rig.json")]) == 2
    assert "quotes" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("board: !!timestamp .02", "ill-formed"),
        (f"targetCols: {'9' * 6000}", "thousands of digits"),
        (
            "{target_type: checkerboard, targetCols: 9, targetRows: 6, colSpacingMeters: 0x14, rowSpacingMeters: 0x14}",
            "colSpacingMeters must be a positive number; got the text '0x14'",
        ),
    ],
)
def test_board_files_are_refused_in_words_about_the_file(content, words, tmp_path, capsys):
    (tmp_path / "board.yaml").write_text(content)
    given = [*images(tmp_path)[:4], "--board", str(tmp_path / "board.yaml")]
    assert main(["calibrate", *given, "--output", str(tmp_path / "rig.json")]) == 3
    said = capsys.readouterr().err
    assert words in said and "Python" not in said and "sys." not in said


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("circles:1x1:30mm", "too small for a circle grid. See"),
        ("chessboard:9x6:30m", "0.03)? See"),
    ],
)
def test_boards_are_refused_in_whole_sentences(spec, words, tmp_path, capsys):
    given = [*images(tmp_path)[:4], "--board", spec]
    assert main(["calibrate", *given, "--output", str(tmp_path / "rig.json")]) == 2
    assert words in capsys.readouterr().err


def test_a_pipe_as_board_is_named(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe")
    given = [*images(tmp_path)[:4], "--board", str(tmp_path / "pipe")]
    assert main(["calibrate", *given, "--output", str(tmp_path / "rig.json")]) == 3
    assert "is a pipe, not an ordinary file" in capsys.readouterr().err


def test_no_number_is_refused_in_plain_words(capsys):
    assert main(["simulate", "--board", "chessboard:4x3:30mm", "--noise", "nan", "--output", "never"]) == 2
    assert "Input" not in capsys.readouterr().err


def test_reasons_that_differ_in_numbers_share_a_line():
    reasons = [(f"left_{k}.png", f"no circle grid found ({k} round spots seen)") for k in range(7)]
    (line,) = group_lines("dropped", "image", reasons)
    assert line.startswith("dropped 7 images (left_0.png") and "such as no circle grid found (0" in line
