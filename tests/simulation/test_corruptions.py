import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.simulation import (
    drop_view,
    exchange_columns_and_rows,
    flip_all,
    flip_all_left,
    flip_view,
    halve_right_resolution,
    mismatch_pair,
    repeat_view,
    sample_scene,
    shift_all_pairs,
    shift_view_by_row,
    simulate_detections,
    state_image_size,
    swap_cameras,
    swap_image_size,
    table2_rig,
    zero_view,
)

BOARD = parse_board("chessboard:9x6:30mm")


@pytest.fixture(scope="module")
def clean():
    rng = np.random.default_rng(0)
    return simulate_detections(sample_scene(table2_rig(), BOARD, 5, rng), rng, noise_px=0.1)


def _changed_views(before, after, side):
    a, b = getattr(before, f"{side}_px"), getattr(after, f"{side}_px")
    return [i for i in range(len(a)) if not np.array_equal(a[i], b[i], equal_nan=True)]


def test_shift_by_a_row(clean):
    grid = clean.left_px[2].reshape(6, 9, 2)
    for vacated in ("extrapolate", "wrap", "missing"):
        shifted = shift_view_by_row(clean, BOARD, 2, vacated=vacated)
        assert _changed_views(clean, shifted, "left") == [2]
        assert _changed_views(clean, shifted, "right") == []
        got = shifted.left_px[2].reshape(6, 9, 2)
        assert np.array_equal(got[:5], grid[1:])
        if vacated == "wrap":
            assert np.array_equal(got[5], grid[0])
        elif vacated == "missing":
            assert np.isnan(got[5]).all()
        else:  # continues the grid: as far from the last row as that is from the one before
            assert got[5] - grid[5] == pytest.approx(grid[5] - grid[4])


def test_shift_needs_rows():
    april = parse_board("aprilgrid:6x6:88mm:0.3")
    rng = np.random.default_rng(0)
    detections = simulate_detections(sample_scene(table2_rig(), april, 2, rng), rng)
    with pytest.raises(ValueError, match="aprilgrid"):
        shift_view_by_row(detections, april, 0)


def test_flips(clean):
    flipped = flip_view(clean, 1, side="right")
    assert _changed_views(clean, flipped, "right") == [1]
    assert np.array_equal(flipped.right_px[1], clean.right_px[1, ::-1])
    assert np.array_equal(flip_all_left(clean).left_px, clean.left_px[:, ::-1])
    assert np.array_equal(flip_all_left(clean).right_px, clean.right_px)
    assert np.array_equal(flip_all(flip_all(clean, side="right"), side="right").right_px, clean.right_px)


def test_pairing(clean):
    mismatched = mismatch_pair(clean, 1, 3)
    assert _changed_views(clean, mismatched, "right") == [1]
    assert np.array_equal(mismatched.right_px[1], clean.right_px[3])
    shifted = shift_all_pairs(clean)
    assert np.array_equal(shifted.left_px, clean.left_px)
    assert np.array_equal(shifted.right_px, clean.right_px[[1, 2, 3, 4, 0]])
    with pytest.raises(ValueError, match="itself"):
        mismatch_pair(clean, 1, 1)


def test_swapped_cameras(clean):
    swapped = swap_cameras(state_image_size(clean, (1280, 960)))
    assert np.array_equal(swapped.left_px, clean.right_px)
    assert np.array_equal(swapped.right_px, clean.left_px)


def test_exchanged_columns_and_rows(clean):
    wrong = exchange_columns_and_rows(clean, BOARD)
    assert np.array_equal(wrong.left_px, clean.left_px)
    assert wrong.object_points_m[:, 0].max() == pytest.approx(5 * 0.03)
    assert wrong.object_points_m[:, 1].max() == pytest.approx(8 * 0.03)


def test_halved_resolution_keeps_the_pixel_convention(clean):
    halved = halve_right_resolution(clean)
    # the centre of the full image stays the centre of the half one
    assert (halved.right_px + 0.5) * 2 == pytest.approx(clean.right_px + 0.5)
    assert halved.right_size_wh == clean.right_size_wh
    assert np.array_equal(halved.left_px, clean.left_px)


@pytest.mark.usefixtures("unchecked_types")
def test_zero_and_missing_views(clean):
    assert not zero_view(clean, 4).left_px[4].any()
    assert _changed_views(clean, zero_view(clean, 4), "left") == [4]
    assert np.isnan(drop_view(clean, 0, side="right").right_px[0]).all()
    with pytest.raises(ValueError, match="side"):
        zero_view(clean, 0, side="both")


def test_sizes_and_repeats(clean):
    assert swap_image_size(clean).left_size_wh == (960, 1280)
    assert state_image_size(clean, (640, 480)).right_size_wh == (640, 480)
    repeated = repeat_view(clean, 3, 20)
    assert repeated.n_views == 20
    assert len(set(repeated.names)) == 20
    assert np.array_equal(repeated.left_px[7], clean.left_px[3])


def test_nothing_is_changed_in_place(clean):
    before = clean.left_px.copy()
    for corrupt in (flip_all_left, shift_all_pairs, swap_cameras, halve_right_resolution, lambda d: zero_view(d, 0)):
        corrupt(clean)
    assert np.array_equal(clean.left_px, before)
