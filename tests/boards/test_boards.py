"""Board specifications and point orders."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from binocal.boards import Board, format_board, load_board, parse_board
from binocal.boards.dictionaries import DICTIONARY_SIZES
from binocal.boards.target_file import format_kalibr_target
from binocal.errors import FormatError


def test_chessboard_counts_inner_corners_row_by_row():
    board = parse_board("chessboard:9x6:30mm")
    points = board.object_points_m
    assert points.shape == (54, 3)
    assert np.allclose(points[1], [0.03, 0, 0]) and np.allclose(points[9], [0, 0.03, 0])


@pytest.mark.parametrize(("text", "metres"), [("1in", 0.0254), ("2.5cm", 0.025), ("0.03m", 0.03), ("24.23mm", 0.02423)])
def test_lengths_carry_units(text, metres):
    board = parse_board(f"chessboard:9x6:{text}")
    assert board.is_metric and board.pitch_m == pytest.approx(metres, rel=1e-15)


@pytest.mark.parametrize("spec", ["chessboard:9x6", "chessboard:9x6:30"])
def test_without_a_unit_the_scale_is_unknown(spec):
    board = parse_board(spec)
    assert not board.is_metric and board.pitch_m == 1.0


def test_the_other_kinds():
    assert parse_board("charuco:11x8:30mm:22mm:DICT_5X5_50").object_points_m.shape == (70, 3)
    april = parse_board("aprilgrid:6x6:88mm:0.3").object_points_m
    assert april.shape == (144, 3)
    assert np.allclose(april[:4, :2], np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * 0.088)
    assert np.allclose(april[4, :2], [1.3 * 0.088, 0])
    assert parse_board("circles:10x10:30mm").n_points == 100
    staggered = parse_board("acircles:4x11:20mm").object_points_m
    assert np.allclose(staggered[4, :2], [0.02, 0.02]) and np.allclose(staggered[1, :2], [0.04, 0])


@pytest.mark.parametrize(
    "spec",
    [
        "",
        "chess",
        "chessboard:9",
        "chessboard:9x6:-3mm",
        "chessboard:9x6:3ft",
        "chessboard:1x6:3mm",
        "charuco:5x5:30mm",
        "charuco:5x5:30mm:40mm:DICT_4X4_50",
        "charuco:5x5:30mm:20:DICT_4X4_50",
        "chessboard:9x6:30mm:4",
    ],
)
def test_a_bad_spec_is_refused(spec):
    with pytest.raises(ValueError, match=r"."):
        parse_board(spec)


def test_kalibr_targets_are_read(tmp_path):
    path = tmp_path / "target.yaml"
    path.write_text("target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 5\ntagSize: 0.088\ntagSpacing: 0.3\n")
    board = load_board(str(path))
    assert board == Board("aprilgrid", 6, 5, 0.088, dictionary="tag36h11", tag_gap_ratio=0.3)
    path.write_text(
        "target_type: 'checkerboard'\ntargetCols: 9\ntargetRows: 6\nrowSpacingMeters: 0.03\ncolSpacingMeters: 0.03\n"
    )
    assert load_board(str(path)) == parse_board("chessboard:9x6:30mm")


def test_other_families_and_first_ids_are_read(tmp_path):
    path = tmp_path / "target.yaml"
    path.write_text(
        "target_type: 'aprilgrid'\ntagCols: 4\ntagRows: 3\ntagSize: 0.03\ntagSpacing: 0.3\nstartId: 24\ntagFamily: 25h9\n"
    )
    with pytest.raises(FormatError, match="25h9 has 35 tags, but the board needs ids up to 35"):
        load_board(str(path))
    path.write_text(path.read_text().replace("25h9", "36h10"))
    board = load_board(str(path))
    assert (
        board == parse_board("aprilgrid:4x3:30mm:0.3:tag36h10:24") and board.marker_dictionary == "DICT_APRILTAG_36h10"
    )
    assert parse_board("aprilgrid:4x3:30mm:0.3:24").first_tag_id == 24
    path.write_text(path.read_text().replace("24", "-1"))
    with pytest.raises(FormatError, match="startId must be a whole number"):
        load_board(str(path))
    path.write_text(path.read_text().replace("startId: -1", "codeOffset: 7"))  # as in Kalibr's own examples
    assert load_board(str(path)).first_tag_id == 7
    path.write_text(path.read_text().replace("36h10", "t25h9"))
    with pytest.raises(FormatError, match="tagFamily 't25h9' is not a known tag family"):
        load_board(str(path))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "target_type: aprilgrid\ntagCols: 4\ntagRows: 3\ntagSize: 0.03\ntagSpacing: 0.3\nstartID: 3\n",
            "did you mean startId?",
        ),
        ("board: chessboard:9x6:30mm\nmeasured: 1\n", "unknown key 'measured'; known are board"),
        ("target_type: circlegrid\ntargetCols: 4\ntargetRows: 3\nspacingMeters: 0.03\ntagCols: 3\n", "'tagCols'"),
    ],
)
def test_a_key_that_is_not_known_is_refused_by_name(tmp_path, text, words):
    """It was read as if it were not there: ids from 0 on."""
    path = tmp_path / "target.yaml"
    path.write_text(text)
    with pytest.raises(FormatError, match=re.escape(words)):
        load_board(str(path))


@pytest.mark.parametrize(
    "spec", ["aprilgrid:4x3:30mm:0.3", "aprilgrid:4x3:30mm:0.3:tag25h9:10", "aprilgrid:2x3:30mm:0.3:7"]
)
def test_a_target_file_says_family_and_first_id_where_they_are_not_kalibrs(tmp_path, spec):
    board, path = parse_board(spec), tmp_path / "target.yaml"
    text = format_kalibr_target(board)
    path.write_text(text)
    assert load_board(str(path)) == board
    assert ("tagFamily: 'tag25h9'" in text) == ("tag25h9" in spec) and ("startId" in text) == (board.first_tag_id > 0)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("aprilgrid:4x3:30mm:0.3:tag99h1", "not a known tag family"),
        ("aprilgrid:4x3:30mm:0.3:24:24", "too many fields"),
        ("charuco:8x6:30mm:22mm:DICT_5X5_50:x", "no first id"),
        ("charuco:8x6:30mm:22mm:DICT_5X5_50:40", "50 markers, but the board needs ids up to 63; DICT_5X5_100 would"),
    ],
)
def test_bad_families_and_ids_are_named(spec, words):
    with pytest.raises(ValueError, match=words):
        parse_board(spec)


def test_a_bad_board_file_is_named(tmp_path):
    with pytest.raises(FormatError, match="no such file"):
        load_board(str(tmp_path / "none.yaml"))
    path = tmp_path / "bad.yaml"
    path.write_text("target_type: aprilgrid\n")
    with pytest.raises(FormatError, match=r"bad\.yaml.*tagCols"):
        load_board(str(path))


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("board: charuco:11x8:30mm:22mm:DICT_5X5_50", "charuco:11x8:30mm:22mm:DICT_5X5_50"),
        ("target_type: circlegrid\ntargetCols: 10\ntargetRows: 9\nspacingMeters: 0.03", "circles:10x9:30mm"),
        (
            "target_type: circlegrid\ntargetCols: 4\ntargetRows: 11\nspacingMeters: 0.02\nasymmetricGrid: true",
            "acircles:4x11:20mm",
        ),
    ],
)
def test_other_board_files_are_read(text, spec, tmp_path):
    path = tmp_path / "board.yml"
    path.write_text(text)
    assert load_board(str(path)) == parse_board(spec)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- 1\n- 2", "expected `board: SPEC`"),
        ("board: [", "cannot be read as YAML"),
        ("board: hexagons:3x3", "is not a board"),
        ("target_type: torus\ntargetCols: 3\ntargetRows: 3", "torus"),
        (
            "target_type: checkerboard\ntargetCols: 9\ntargetRows: 6\nrowSpacingMeters: 0.03\ncolSpacingMeters: 0.04",
            "only square fields",
        ),
    ],
)
def test_other_bad_board_files_are_named(text, words, tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(FormatError, match=words) as caught:
        load_board(str(path))
    assert "bad.yaml" in str(caught.value) and "\n" not in str(caught.value)


def test_the_dictionaries_are_opencvs():
    theirs = {name: getattr(cv2.aruco, name) for name in dir(cv2.aruco) if name.startswith("DICT_")}
    sizes = {name: len(cv2.aruco.getPredefinedDictionary(which).bytesList) for name, which in theirs.items()}
    assert sizes.items() <= DICTIONARY_SIZES.items()


def test_a_board_without_a_spec_needs_a_dictionary_too():
    with pytest.raises(ValueError, match="'DICT_5X5' is not an ArUco dictionary"):
        Board("charuco", 5, 7, 0.03, True, 0.02, "DICT_5X5")


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("charuco:5x7:30mm:22mm:DICT_5X5", r"'DICT_5X5' is not an ArUco dictionary.*DICT_5X5_50"),
        (
            "charuco:20x30:30mm:22mm:DICT_5X5_100",
            r"has 100 markers, but the board needs ids up to 299; DICT_\dX\d_1000",
        ),
        ("aprilgrid:6x6:88mm:nan", "gap between tags"),
        ("aprilgrid:6x6:88mm:inf", "gap between tags"),
        ("aprilgrid:6x6:88mm:-1", "gap between tags"),
        ("aprilgrid:6x6:88mm:third", "gap between tags"),
        ("aprilgrid:30x30:88mm:0.3", "has 587 tags, but the board needs ids up to 899"),
        ("chessboard:99999x99999:30mm", "too large"),
        ("chessboard:" + "9" * 5000 + "x6:30mm", "too large"),
        ("chessboard:9x6:30m", r"pitch of 30 m is not plausible.*30mm"),
        ("chessboard:9x6:1e400mm", "is not a length"),
        ("squares:4x3:30mm:2mm", "gap between squares must be 0.1 to 10 times their side"),
        ("squares:4x3:30mm:20", "give both lengths a unit, or neither"),
        ("squares:4x3:30mm:20mm:5mm", "too many fields"),
        ("squares:4x1:30mm:20mm", "too small for a square grid"),
    ],
)
def test_an_impossible_board_is_refused_by_name(spec, words):
    with pytest.raises(ValueError, match=words) as caught:
        parse_board(spec)
    assert len(str(caught.value)) < 400


KALIBR = "target_type: checkerboard\ntargetCols: {}\ntargetRows: 6\nrowSpacingMeters: {}\ncolSpacingMeters: {}\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (KALIBR.format("6.9", "0.03", "0.03"), "targetCols must be a whole number; got 6.9"),
        (KALIBR.format("'6'", "0.03", "0.03"), "targetCols must be a whole number; got the text '6'"),
        ("target_type: spiral", "'spiral' is not aprilgrid"),
        (KALIBR.format("6\ntargetCols: 8", "0.03", "0.03"), "it holds 'targetCols' twice, in line 3, column 1$"),
        (KALIBR.format(".inf", "0.03", "0.03"), "targetCols must be a whole number"),
        (KALIBR.format("true", "0.03", "0.03"), "targetCols must be a whole number"),
        (KALIBR.format("9", ".inf", ".inf"), "colSpacingMeters must be a positive number"),
        (KALIBR.format("9", "1" + "0" * 400, "0.03"), "rowSpacingMeters must be a positive number"),
        (KALIBR.format("9", "9" * 5000, "0.03"), "cannot be read as YAML"),
        (KALIBR.format("9", "30", "30"), "pitch of 30 m is not plausible"),
        ("[" * 5000, "nested too deeply"),
        ("board: !!int ''", "cannot be read as YAML"),
        ("board: !!bool maybe", "cannot be read as YAML"),
        ("board: 2001-99-99", "cannot be read as YAML"),
        ("#" * 100_000, "larger than the 64 kB"),
    ],
)
def test_a_board_file_of_impossible_values_is_named(text, words, tmp_path):
    path = tmp_path / "board.yaml"
    path.write_text(text)
    with pytest.raises(FormatError, match=words) as caught:
        load_board(str(path))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_a_board_file_whose_aliases_have_no_end_is_refused_at_once(tmp_path):
    path = tmp_path / "bomb.yaml"
    rows = ["a0: &a0 [x, x]"] + [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 40)]
    path.write_text("\n".join([*rows, "board: *a39"]))
    with pytest.raises(FormatError, match=r"it holds an alias \(\*name\), in line 2, column 10$"):
        load_board(str(path))


@settings(max_examples=200, derandomize=True)
@given(st.text(alphabet="chesboardurcilgp:x0123456789.m ", max_size=24))
def test_any_text_is_a_board_or_one_clear_line(text):
    try:
        board = parse_board(text)
    except ValueError as error:
        assert str(error) and "\n" not in str(error)
    else:
        assert board.columns >= 1 and board.rows >= 1 and len(board.object_points_m) > 0


LENGTHS = st.floats(1e-3, 2.0).map(lambda metres: round(metres, 6))


@st.composite
def boards(draw):
    """A board of any kind that a SPEC can say."""
    kind = draw(st.sampled_from(("chessboard", "charuco", "aprilgrid", "circles", "acircles", "squares")))
    columns, rows = draw(st.integers(3, 20)), draw(st.integers(3, 20))
    pitch_m, is_metric = draw(LENGTHS), draw(st.booleans()) if kind != "charuco" else True
    given_board = {"is_metric": is_metric}
    if kind == "charuco":
        given_board |= {"marker_m": round(pitch_m * draw(st.floats(0.3, 0.9)), 7), "dictionary": "DICT_5X5_250"}
    if kind == "aprilgrid":
        given_board |= {"dictionary": "tag36h11", "tag_gap_ratio": round(draw(st.floats(0.1, 0.9)), 3)}
        if columns * rows < 300:
            given_board |= {"dictionary": draw(st.sampled_from(("tag36h11", "tag36h10")))}
    if kind == "squares":
        given_board |= {"gap_m": round((pitch_m if is_metric else 1.0) * draw(st.floats(0.2, 3.0)), 7)}
    if kind in ("charuco", "aprilgrid") and columns * rows < 300:
        given_board |= {"first_tag_id": draw(st.integers(0, 80))}
    return Board(kind, columns, rows, pitch_m if is_metric else 1.0, **given_board)


@settings(max_examples=100, derandomize=True)
@given(boards())
def test_every_board_is_said_by_its_spec(board):
    said = parse_board(format_board(board))
    lengths = {name: getattr(board, name) for name in ("pitch_m", "marker_m", "gap_m")}
    assert replace(said, **lengths) == board
    for name, length in lengths.items():
        assert getattr(said, name) == pytest.approx(length, rel=1e-9)


MARKED = [
    "chessboard:14x9:12.1mm:marked",
    "chessboard:9x6:20mm:discs=1,1,3,2",
    "chessboard:9x6:20mm:swapped=2,1",
    "chessboard:4x3:marked:swapped=1,1",
]


@pytest.mark.parametrize("spec", MARKED)
def test_marked_squares_come_back_out_of_their_specs(spec):
    board = parse_board(spec)
    assert format_board(board) == spec and board.is_marked and board.allows_partial


def test_a_marked_board_has_the_discs_of_opencvs_documentation():
    assert parse_board("chessboard:14x9:12.1mm:marked").discs == ((7, 4), (7, 5), (8, 5))
    assert not parse_board("chessboard:14x9:12.1mm").allows_partial


def test_no_edges_cross_at_the_corners_of_a_square_of_the_other_colour():
    is_printed = parse_board("chessboard:9x6:20mm:swapped=2,1").is_printed.reshape(6, 9)
    assert np.argwhere(~is_printed).tolist() == [[0, 1], [0, 2], [1, 1], [1, 2]]


@pytest.mark.parametrize(
    ("spec", "problem"),
    [
        (
            "chessboard:9x6:20mm:markd",
            "'markd' is neither a length such as 30mm nor a mark of a chessboard: marked, discs=",
        ),
        ("chessboard:9x6:20mm:discs=1,1,2", "needs a column and a row for each square"),
        ("chessboard:9x6:20mm:swapped=0,1", "square 0,1 cannot be marked: column 1 to 8 and row 1 to 5 can"),
        ("chessboard:9x6:20mm:swapped=1,6", "square 1,6 cannot be marked"),
        ("chessboard:9x6:20mm:discs=1,1:swapped=1,1", "square 1,1 is marked twice"),
        ("chessboard:9x6:20mm:discs=1,1:marked", "discs are given twice"),
        ("chessboard:3x3:20mm:marked", "at least 4x3 inner corners; got 3x3"),
        ("circles:9x6:20mm:marked", "too many fields"),
    ],
)
def test_a_mark_that_no_board_can_have_is_named(spec, problem):
    with pytest.raises(ValueError, match=problem):
        parse_board(spec)


def test_only_chessboards_have_marked_squares():
    with pytest.raises(ValueError, match="a circle grid has no marked ones"):
        replace(parse_board("circles:9x6:20mm"), discs=((1, 1),))
    with pytest.raises(ValueError, match="at most 64 marked squares"):
        replace(parse_board("chessboard:99x6:20mm"), discs=tuple((c, 1) for c in range(1, 66)))
    with pytest.raises(ValueError, match="Kalibr knows no marked chessboards"):
        format_kalibr_target(parse_board("chessboard:9x6:20mm:marked"))


def test_the_corners_of_a_square_grid_are_in_boofcvs_order():
    board = parse_board("squares:2x2:30mm:20mm")
    assert board.n_points == 16 and not board.allows_partial
    x, y = 1e3 * board.object_points_m[:, :2].T
    # its first row are the upper corners of the upper squares, from the left
    assert x == pytest.approx(4 * [0, 30, 50, 80]) and y == pytest.approx(np.repeat([0, 30, 50, 80], 4))
    assert parse_board("squares:4x3:30mm") == parse_board("squares:4x3:30mm:30mm")  # a gap as wide as the squares
    assert parse_board("squares:4x3:2:1").gap_m == 0.5
    with pytest.raises(ValueError, match="a circle grid has none"):
        replace(parse_board("circles:9x6:20mm"), gap_m=0.01)
    with pytest.raises(ValueError, match="no square grids"):
        format_kalibr_target(board)


def test_circle_styles_are_read_and_written():
    for spec in ("circles:11x9:30mm:large", "circles:11x9:hollow", "acircles:4x11:20mm:rings", "circles:10x10:30mm"):
        assert format_board(parse_board(spec)) == spec
    board = parse_board("circles:11x9:30mm:large")
    assert board.allows_partial and not parse_board("circles:11x9:30mm:rings").allows_partial
    places = board.object_points_m[list(board.marked_points), :2] / 0.03
    assert np.allclose(places - places[0], [[0, 0], [2, 0], [0, 3]]) and np.allclose(places[0], [4, 2])
    with pytest.raises(ValueError, match="at least 3 columns and 4 rows"):
        parse_board("circles:9x3:30mm:large")
    with pytest.raises(ValueError, match="kind circles"):
        parse_board("acircles:4x11:20mm:hollow")
    with pytest.raises(ValueError, match="plain discs alone"):
        format_kalibr_target(board)
