from __future__ import annotations

import pytest

from binocal.datasets import list_pairs
from binocal.errors import DataError


@pytest.fixture
def make(tmp_path):
    def make(*names):
        for name in names:
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(name)
        return tmp_path

    return make


def pairs_of(folder, left, right):
    found = list_pairs(str(folder / left), str(folder / right))
    names = [(pair.name, pair.left_path.name, pair.right_path.name) for pair in found.pairs]
    return names, {path.name: reason for path, reason in found.ignored}


@pytest.mark.parametrize(
    ("names", "left", "right", "expected"),
    [
        (["left01.png", "left02.png", "right01.png", "right02.png"], "left*", "right*", ["01", "02"]),
        (["imageL0.png", "imageL1.png", "imageR0.png", "imageR1.png"], "imageL*", "imageR*", ["image0", "image1"]),
        (["0_left.png", "1_left.png", "0_right.png", "1_right.png"], "*_left.png", "*_right.png", ["0", "1"]),
        (["0_0.png", "0_1.png", "1_0.png", "1_1.png"], "*_0.png", "*_1.png", ["0", "1"]),
        (["cam0/0.png", "cam0/1.png", "cam1/0.png", "cam1/1.png"], "cam0", "cam1", ["0", "1"]),
        (["cam0_0.png", "cam0_1.png", "cam1_0.png", "cam1_1.png"], "cam0_*", "cam1_*", ["cam_0", "cam_1"]),
        (["l/7.png", "l/8.png", "r/7.png", "r/8.png"], "l/*.png", "r/*.png", ["7", "8"]),
        (["a/left/3.png", "b/left/3.png", "a/right/3.png", "b/right/3.png"], "*/left/*", "*/right/*", ["a/3", "b/3"]),
        (["left (1).png", "left (2).png", "right (1).png", "right (2).png"], "left*", "right*", ["(1)", "(2)"]),
        (["L_1_70.png", "L_2_71.png", "R_1_72.png", "R_2_74.png"], "L*", "R*", ["1", "2"]),
        (["a_cam_01.png", "a_cam_02.png", "b01.png", "b02.png"], "a*", "b*", ["01", "02"]),
    ],
)
def test_names_that_rigs_give(make, names, left, right, expected):
    found, ignored = pairs_of(make(*names), left, right)
    assert [name for name, _, _ in found] == expected and not ignored


def test_one_side_may_be_relative(make, monkeypatch):
    folder = make("cam0/0.png", "cam0/1.png", "cam1/0.png", "cam1/1.png")
    monkeypatch.chdir(folder)
    assert [pair.name for pair in list_pairs(str(folder / "cam0"), "cam1").pairs] == ["0", "1"]


def test_order_is_natural_leading_zeros_are_equal_gaps_and_orphans_are_told(make):
    folder = make(
        "left1.png", "left2.png", "left10.png", "left12.png", "right01.png", "right02.png", "right10.png", "right11.png"
    )
    found, ignored = pairs_of(folder, "left*", "right*")
    assert found == [
        ("1", "left1.png", "right01.png"),
        ("2", "left2.png", "right02.png"),
        ("10", "left10.png", "right10.png"),
    ]
    assert ignored == {"left12.png": "has no right partner", "right11.png": "has no left partner"}


def test_leading_zeros_count_where_they_tell_images_apart(make):
    found, _ = pairs_of(make("left1.png", "left01.png", "right1.png", "right01.png"), "left*", "right*")
    assert sorted(found) == [("01", "left01.png", "right01.png"), ("1", "left1.png", "right1.png")]


def test_copies_doubles_and_other_files_are_listed_with_reasons(make):
    copies = ["left03 (1).jpg", "left03 copy.jpg", "left03 - Copy.jpg"]
    lefts, rights = (
        ["left03.jpg", "left04.jpg", "left05.jpg", "left05.png"],
        ["right03.jpg", "right04.jpg", "right05.jpg"],
    )
    names = [*lefts, *copies, *rights, "left.yml"]
    found, ignored = pairs_of(make(*names), "left*", "right*")
    assert [name for name, _, _ in found] == ["03", "04"]
    assert {ignored[n] for n in copies} == {"is a copy of left03.jpg"}
    assert "left05.png" in ignored["left05.jpg"] and "2 images" in ignored["right05.jpg"]
    assert "not an image" in ignored["left.yml"]


def test_one_folder_for_both_sides_is_sorted_out(make):
    folder = make("left1.png", "left2.png", "right1.png", "right2.png", "notes.txt", "other.png")
    found, ignored = pairs_of(folder, "*", "*")
    assert found == [("1", "left1.png", "right1.png"), ("2", "left2.png", "right2.png")]
    assert set(ignored) == {"notes.txt", "other.png"}


def test_two_files_are_a_pair_whatever_their_names(make):
    folder = make("front.png", "back[1].png")
    assert pairs_of(folder, "front.png", "back[1].png")[0] == [("front", "front.png", "back[1].png")]


@pytest.mark.parametrize(
    ("left", "right", "is_odd"),
    [
        ("left01.png", "right02.png", True),
        ("imageL_3.png", "imageR_4.png", True),
        ("left01.png", "right1.png", False),
        ("cam0.png", "cam1.png", False),
        ("rig2_left.png", "rig2_right.png", False),
        ("a.png", "right2.png", False),
    ],
)
def test_two_files_of_different_numbers_are_noted(make, left, right, is_odd):
    folder = make(left, right)
    pairing = list_pairs(folder / left, folder / right)
    assert len(pairing.pairs) == 1 and bool(pairing.notes) == is_odd
    assert not is_odd or f"{left} and {right} bear different numbers" in pairing.notes[0]


def test_lists_of_paths_are_taken_as_they_are(make):
    folder = make("left1.png", "left2.png", "left3.png", "right1.png", "right2.png", "right3.png")
    found = list_pairs([folder / "left1.png", folder / "left3.png"], [folder / "right3.png", folder / "right1.png"])
    assert [pair.name for pair in found.pairs] == ["1", "3"]


@pytest.mark.parametrize(
    "names",
    [
        ["left01.png", "left03.png", "right02.png", "right04.png"],
        ["left_a/apple.png", "left_a/pear.png", "right_b/plum.png", "right_b/cherry.png"],
    ],
)
def test_nothing_is_paired_by_position(make, names):
    folder = make(*names)
    with pytest.raises(DataError, match=r"share no name or number"):
        list_pairs([folder / n for n in names[:2]], [folder / n for n in names[2:]])


def test_the_same_images_twice_are_refused(make):
    folder = make("left1.png", "left2.png")
    with pytest.raises(DataError, match=r"left and right are the same images"):
        list_pairs(str(folder / "left*"), str(folder / "left*"))
    for number in "12":
        (folder / f"right{number}.png").write_text(f"left{number}.png")  # same bytes under another name
    with pytest.raises(DataError, match=r"left and right are the same images"):
        list_pairs(str(folder / "left*"), str(folder / "right*"))


def test_one_identical_pair_among_others_is_left_out(make):
    folder = make("left1.png", "left2.png", "right1.png", "right2.png")
    (folder / "right2.png").write_text("left2.png")
    found, ignored = pairs_of(folder, "left*", "right*")
    assert [name for name, _, _ in found] == ["1"] and "same image as" in ignored["left2.png"]


def test_empty_places_say_what_is_there(make):
    folder = make("img1.png", "img2.png", "sub/x.txt")
    with pytest.raises(DataError, match=r"nothing matches .*left\*.*holds 3 entries such as img1.png"):
        list_pairs(str(folder / "left*"), str(folder / "img*"))
    with pytest.raises(DataError, match=r"no image in .*sub"):
        list_pairs(str(folder / "sub"), str(folder / "img*"))
    (folder / "void").mkdir()
    with pytest.raises(DataError, match=r"void is empty"):
        list_pairs(str(folder / "void"), str(folder / "img*"))
    with pytest.raises(DataError, match=r"there is no nowhere in"):
        list_pairs(str(folder / "nowhere" / "left*"), str(folder / "img*"))


def test_brackets_of_a_folder_that_exists_are_no_pattern(make):
    """ "rig [2]" would match the folder "rig 2" only, and images of another rig, where that exists."""
    make("rig [2]/left1.png", "rig [2]/right1.png", "rig 2/left7.png", "rig 2/right7.png")
    folder = make("rig [2]/sub[a]/left3.png", "rig [2]/sub[a]/right3.png")
    assert pairs_of(folder, "rig [2]/left*", "rig [2]/right*")[0] == [("1", "left1.png", "right1.png")]
    assert pairs_of(folder, "rig [2]/sub[a]/left*", "rig [2]/sub[a]/right*")[0] == [("3", "left3.png", "right3.png")]
    assert pairs_of(folder, "rig [0-9]/left*", "rig [0-9]/right*")[0] == [("7", "left7.png", "right7.png")]
