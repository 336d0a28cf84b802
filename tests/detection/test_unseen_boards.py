"""Images that show another board than the one that was given: it is named, and what is proposed is right."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.datasets import list_pairs
from binocal.detection import detect_pairs
from binocal.detection.recognition import recognize
from binocal.errors import DetectionError

TURNS = [(0.25, -0.3, 0.1), (-0.3, 0.2, 0.2)]
SHOWN = {  # a board, and the SPEC that must be proposed where another one is given
    "chessboard:9x6:30mm": r"chessboard:9x6",
    "charuco:8x6:30mm:22mm:DICT_5X5_50": r"charuco:8x6:(30mm|SQUARE):(22mm|MARKER):DICT_5X5_50",
    "charuco:11x8:30mm:22mm:DICT_4X4_250": r"charuco:11x8:(30mm|SQUARE):(22mm|MARKER):DICT_4X4_50",
    "charuco:7x5:30mm:22mm:DICT_APRILTAG_36h11": r"charuco:7x5:(30mm|SQUARE):(22mm|MARKER):DICT_APRILTAG_36h11",
    "aprilgrid:5x4:30mm:0.3": r"aprilgrid:5x4:(30mm:0\.3|SIDE:GAP)",
    "circles:7x6:30mm": r"circles:7x6",
    "acircles:4x11:20mm": r"acircles:4x11",
    "squares:5x4:30mm:20mm": r"squares:5x4:SIDE:GAP",
}
GIVEN = [
    "chessboard:9x6:30mm",
    "chessboard:7x5:30mm",
    "chessboard:8x6:30mm",
    "charuco:8x6:30mm:22mm:DICT_5X5_50",
    "charuco:6x8:30mm:22mm:DICT_5X5_50",
    "charuco:9x7:30mm:22mm:DICT_APRILTAG_36h11",
    "aprilgrid:4x5:30mm:0.3",
    "aprilgrid:7x7:30mm:0.3",
    "circles:8x6:30mm",
    "acircles:11x4:20mm",
]
PAIRS = [(shown, given) for shown in SHOWN for given in GIVEN if not re.match(f"{SHOWN[shown]}(:|$)", given)]
FAST = {
    ("chessboard:9x6:30mm", "charuco:8x6:30mm:22mm:DICT_5X5_50"),
    ("charuco:8x6:30mm:22mm:DICT_5X5_50", "chessboard:9x6:30mm"),  # release 0.1: did you mean chessboard:5x3?
    ("charuco:7x5:30mm:22mm:DICT_APRILTAG_36h11", "aprilgrid:4x5:30mm:0.3"),
    ("aprilgrid:5x4:30mm:0.3", "charuco:9x7:30mm:22mm:DICT_APRILTAG_36h11"),
    ("circles:7x6:30mm", "chessboard:7x5:30mm"),
    ("acircles:4x11:20mm", "acircles:11x4:20mm"),
    ("squares:5x4:30mm:20mm", "circles:8x6:30mm"),
}


@pytest.fixture(scope="session")
def folders(tmp_path_factory, shoot):
    """A folder of two pairs of each board, rendered when first asked for."""
    made = {}

    def folder(spec, **options):
        key = (spec, *options.items())
        if key not in made:
            made[key] = tmp_path_factory.mktemp("shown")
            for i, turn in enumerate(TURNS):
                for j, side in enumerate(("left", "right")):
                    options = {"distance": 1.7, "size_wh": (720, 540)} | options
                    shot = shoot(spec, turn, shift=(-0.1 * j, 0), seed=2 * i + j, **options)
                    cv2.imwrite(str(made[key] / f"{side}{i}.png"), shot.image)
        return made[key]

    return folder


def refusal_of(folder, spec):
    with pytest.raises(DetectionError) as caught:
        detect_pairs(list_pairs(str(folder / "left*"), str(folder / "right*")), parse_board(spec))
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize(
    ("shown", "given"), [pytest.param(*pair, marks=() if pair in FAST else pytest.mark.slow) for pair in PAIRS]
)
def test_another_board_is_named_and_proposed(folders, shown, given):
    error = refusal_of(folders(shown), given)
    assert error.findings[0].code == "board-is-another"
    assert re.search(f"did you mean {SHOWN[shown]}( \\(|\\?)", str(error)), str(error)


@pytest.mark.parametrize(
    ("shown", "given"),
    [
        ("charuco:8x6:30mm:22mm:DICT_5X5_50", "charuco:8x6:30mm:22mm:DICT_5X5_50:4"),
        ("aprilgrid:5x4:30mm:0.3", "aprilgrid:5x4:30mm:0.3:1"),
        ("aprilgrid:5x4:30mm:0.3", "aprilgrid:5x3:30mm:0.3"),
    ],
)
def test_a_board_that_goes_on_beyond_the_spec_is_another(folders, shown, given):
    """They were accepted, with the names of other corners."""
    error = refusal_of(folders(shown), given)
    assert error.findings[0].code == "board-is-another" and str(error).endswith(f"did you mean {shown}?"), str(error)


@pytest.mark.parametrize("given", ["chessboard:9x6:30mm", "chessboard:7x4:30mm"])
def test_no_image_of_a_charuco_board_counts_a_piece_of_it_as_a_chessboard(folders, given):
    """The first images of release 0.1 said that the SPEC was probably chessboard:8x5."""
    reasons = refusal_of(folders("charuco:9x6:30mm:22mm:DICT_6X6_250", is_legacy_charuco=True), given).reasons
    assert len(reasons) == 4 and any("ChArUco" in reason for reason in reasons.values())
    assert not any("probably" in reason or "corners of the board's" in reason for reason in reasons.values()), reasons


def test_markers_of_a_board_cut_off_propose_no_number_of_rows(folders, shoot):
    """Where the images end within the board, more rows may follow."""
    shot = shoot("charuco:8x12:30mm:22mm:DICT_5X5_50", (0.1, -0.2, 0.0), distance=0.75, size_wh=(800, 600))
    seen = recognize(shot.image)
    assert seen is not None and (seen.kind, seen.columns, seen.is_whole) == ("charuco", 8, False) and seen.rows < 12


def test_a_board_is_not_taken_for_another_because_it_cannot_be_read(folders, tmp_path):
    """The right SPEC and images too blurred to be measured: nothing is proposed."""
    spec = "charuco:8x6:30mm:22mm:DICT_5X5_50"
    for path in folders(spec).iterdir():
        cv2.imwrite(str(tmp_path / path.name), cv2.GaussianBlur(cv2.imread(str(path), 0), (0, 0), 11.0))
    error = refusal_of(tmp_path, spec)
    assert error.findings[0].code == "board-not-found" and "did you mean" not in str(error)


@pytest.mark.parametrize("spec", ["charuco:8x6:30mm:22mm:DICT_5X5_50", "aprilgrid:5x4:30mm:0.3"])
def test_mirrored_images_of_the_board_are_said_to_be_mirrored(folders, tmp_path, spec):
    """They blamed the SPEC, the light and the focus."""
    for path in folders(spec).iterdir():
        cv2.imwrite(str(tmp_path / path.name), cv2.imread(str(path), 0)[:, ::-1])
    assert re.search(r"show the board mirrored \(.*as the cameras took them", str(refusal_of(tmp_path, spec)))


@pytest.mark.parametrize(("marker", "distance"), [("18mm:DICT_6X6_250", 6.5), ("15mm:DICT_6X6_250", 5.4)])
def test_markers_too_small_to_be_read_are_named_with_their_size(folders, marker, distance):
    spec = f"charuco:11x8:30mm:{marker}"
    folder = folders(spec, distance=distance, size_wh=(640, 480), blur_px=0.6)
    error = refusal_of(folder, spec)
    (found,) = error.findings
    assert found.code == "markers-too-small" and "move nearer" in str(error)
    share = int(marker[:2]) / 30
    assert found.figures["marker_px"] == pytest.approx(share * found.figures["square_px"])
    assert 4 < found.figures["marker_px"] < 12 and found.figures["cell_px"] < 1.6
    # Under another SPEC the squares alone are seen, and neither board is excluded.
    text = str(refusal_of(folder, "circles:8x6:30mm"))
    assert "or a ChArUco board of 11x8 squares" in text and "did you mean" not in text


def test_nothing_is_recognised_in_an_image_of_nothing():
    assert recognize(np.full((240, 320), 90, np.uint8)) is None
    rng = np.random.default_rng(0)
    assert recognize(rng.integers(0, 255, (240, 320)).astype(np.uint8)) is None


def test_one_image_of_another_board_proposes_nothing(folders, tmp_path):
    """A poster behind the rig in one image is not the board of the set."""
    (first, *others) = sorted(folders("chessboard:9x6:30mm").iterdir())
    (tmp_path / first.name).write_bytes(first.read_bytes())
    for i, path in enumerate(others):
        image = cv2.GaussianBlur(cv2.imread(str(path), 0), (0, 0), 40.0 + i)
        cv2.imwrite(str(tmp_path / path.name), image)
    error = refusal_of(tmp_path, "circles:7x6:30mm")
    assert error.findings[0].code == "board-not-found" and "did you mean" not in str(error)
