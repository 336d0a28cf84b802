from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated_rigs import T_RIGHT_LEFT, TABLE2, Rig, grid, project, rotation_error_deg, simulate, with_outliers

from binocal.errors import BinocalError, DataError, DegenerateGeometryError, InconsistentViewsError, TooFewViewsError
from binocal.evidence import Detections
from binocal.findings import findings_of
from binocal.geometry import SE3, so3
from binocal.geometry.homography import fit_homographies
from binocal.initialization.diagnosis import Diagnosis, diagnose_views
from binocal.initialization.input_checks import check_degeneracy
from binocal.initialization.intrinsics import estimate_intrinsics

FISHEYE = np.array([300, 300, 325, 236, 0, -0.02, 0.005, -0.003, 0.0005])
KITTI_LIKE = np.array([721, 721, 609.5, 172.8, 0, 0, 0, 0, 0])
BAD = 3


def _is_right(diagnosis: Diagnosis, rig: Rig) -> None:
    """A start that the joint solver takes to the answer: clean rigs give 0.1 deg and 1 mm."""
    assert rotation_error_deg(diagnosis.T_right_left.R, rig.T_right_left.R) < 0.6
    np.testing.assert_allclose(diagnosis.T_right_left.t, rig.T_right_left.t, atol=3e-3)
    used = diagnosis.is_used
    assert np.isfinite(diagnosis.t_left_board[used]).all() and np.isnan(diagnosis.t_left_board[~used]).all()
    board = SE3(diagnosis.R_left_board[used], diagnosis.t_left_board[used])
    for camera, T, px in (
        (diagnosis.left, SE3.identity(), diagnosis.detections.left_px),
        (diagnosis.right, diagnosis.T_right_left, diagnosis.detections.right_px),
    ):
        miss = np.linalg.norm(project(rig.model, camera.parameters, rig.points, T @ board) - px[used], axis=-1)
        assert np.nanmedian(miss) < 0.5  # measured 0.24: the noise


def _rejected(diagnosis: Diagnosis) -> dict[str, str]:
    return {view.name: view.reason for view in diagnosis.rejected}


CLEAN = {
    "table2": {},
    "noisy": {"noise_px": 0.3},
    "three_views": {"n_views": 3},
    "weak": {"n_views": 6, "tilt_deg": (2, 12), "distance_m": (1, 2)},
    "vergent": {
        "T_right_left": SE3(so3.exp(np.array([0.02, 0.35, 0.03])), np.array([-0.3, 0.01, 0.05])),
        "tilt_deg": (5, 30),
    },
    "vertical": {"T_right_left": SE3(so3.exp(np.array([0.05, 0.01, 0.0])), np.array([0.002, -0.08, 0.0]))},
    "fisheye": {"model": "fisheye4", "parameters": FISHEYE, "size_wh": (640, 480)},
    "wide": {"parameters": np.array([700, 700, 641, 470, 0, -0.35, 0.12, 1e-3, -5e-4])},
    "off_centre": {
        "parameters": KITTI_LIKE,
        "size_wh": (1242, 375),
        "n_views": 12,
        "points": grid(7, 5, 0.1),
        "T_right_left": SE3(np.eye(3), np.array([-0.54, 0, 0])),
    },
    "square_board": {"points": grid(8, 8)},
    "exact": {"noise_px": 0.0},
}


def _assert_no_alarm(rig: Rig) -> None:
    diagnosis = diagnose_views(rig.detections(), rig.model)
    assert diagnosis.is_used.all() and not diagnosis.rejected and not any(diagnosis.notes)
    assert diagnosis.rms_px < 2.0


@pytest.mark.parametrize("scene", CLEAN)
def test_clean_rigs_raise_no_alarm(scene: str) -> None:
    for seed in range(4):
        _assert_no_alarm(simulate(seed, **CLEAN[scene]))


@pytest.mark.slow
@pytest.mark.parametrize("scene", CLEAN)
def test_many_clean_rigs_raise_no_alarm(scene: str) -> None:
    for seed in range(100, 250 if scene == "table2" else 130):
        _assert_no_alarm(simulate(seed, **CLEAN[scene]))


def test_a_clean_rig_starts_at_the_noise() -> None:
    rig = simulate(0)
    diagnosis = diagnose_views(rig.detections())
    _is_right(diagnosis, rig)
    assert diagnosis.rms_px == pytest.approx(0.2 * np.sqrt(2), rel=0.1)
    assert not diagnosis.findings


@pytest.mark.parametrize(("share", "size_px"), [(0.05, 5), (0.05, 50), (0.1, 50)])
def test_outlying_corners_stay_in_their_views(share: float, size_px: float) -> None:
    rig = simulate(1)
    left, _ = with_outliers(rig.left_px, share, size_px, rig.rng)
    right, wild = with_outliers(rig.right_px, share, size_px, rig.rng)
    diagnosis = diagnose_views(rig.detections(left, right))
    assert diagnosis.is_used.all()
    _is_right(diagnosis, rig)
    assert np.median(diagnosis.right_weights[wild]) < 0.1


def test_missing_corners_and_views_of_one_camera_count() -> None:
    rig = simulate(2)
    left, right = rig.left_px.copy(), rig.right_px.copy()
    left[rig.rng.random(left.shape[:2]) < 0.3] = np.nan
    right[rig.rng.random(right.shape[:2]) < 0.3] = np.nan
    left[:3], right[3:6] = np.nan, np.nan
    diagnosis = diagnose_views(rig.detections(left, right))
    assert diagnosis.is_used.all()
    _is_right(diagnosis, rig)


def _flip(px: np.ndarray) -> np.ndarray:
    return px[::-1]


def _mirror(px: np.ndarray) -> np.ndarray:
    return px.reshape(8, 11, 2)[:, ::-1].reshape(88, 2)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("reorder", "words"), [(_flip, "reversed (180 deg)"), (_mirror, "mirrored (columns reversed)")]
)
def test_a_wrong_corner_order_is_repaired(side: str, reorder: Callable[[np.ndarray], np.ndarray], words: str) -> None:
    rig = simulate(3)
    px = {"left": rig.left_px.copy(), "right": rig.right_px.copy()}
    original = px[side][BAD].copy()
    px[side][BAD] = reorder(original)
    diagnosis = diagnose_views(rig.detections(px["left"], px["right"]))
    assert diagnosis.is_used.all()
    assert [i for i, note in enumerate(diagnosis.notes) if note] == [BAD]
    assert words in diagnosis.notes[BAD] and side in diagnosis.notes[BAD]
    np.testing.assert_array_equal(getattr(diagnosis.detections, f"{side}_px")[BAD], original)
    _is_right(diagnosis, rig)


def test_all_left_views_flipped_are_repaired_and_said() -> None:
    rig = simulate(4)
    diagnosis = diagnose_views(rig.detections(left_px=rig.left_px[:, ::-1]))
    assert diagnosis.is_used.all() and all("left corner order was reversed" in note for note in diagnosis.notes)
    assert [found.code for found in diagnosis.findings] == ["corner-orders-repaired"]
    _is_right(diagnosis, rig)


@pytest.mark.parametrize(("axis", "word"), [(0, "row"), (1, "column")])
def test_a_shifted_view_is_rejected_by_name(axis: int, word: str) -> None:
    rig = simulate(5)
    left = rig.left_px.copy()
    left[BAD] = np.roll(left[BAD].reshape(8, 11, 2), 1, axis=axis).reshape(88, 2)
    diagnosis = diagnose_views(rig.detections(left_px=left))
    assert list(_rejected(diagnosis)) == ["03"]
    assert f"left corners are shifted by one {word}" in _rejected(diagnosis)["03"]
    _is_right(diagnosis, rig)


def test_a_mismatched_pair_is_rejected() -> None:
    rig = simulate(6)
    left = rig.left_px.copy()
    left[BAD] = left[9]
    diagnosis = diagnose_views(rig.detections(left_px=left))
    assert list(_rejected(diagnosis)) == ["03"]
    assert "do not show the same board pose" in _rejected(diagnosis)["03"]
    _is_right(diagnosis, rig)


@pytest.mark.parametrize("shift", [-2, -1, 1, 3])
def test_pairs_off_by_some_are_refused(shift: int) -> None:
    rig = simulate(7)
    with pytest.raises(InconsistentViewsError, match="pairs are off by") as caught:
        diagnose_views(rig.detections(left_px=np.roll(rig.left_px, shift, axis=0)))
    first = max(shift, 0)
    assert f"left view {first:02d} matches right view {first - shift:02d}" in str(caught.value)


def test_unrelated_pairs_are_refused() -> None:
    with pytest.raises(InconsistentViewsError, match="contradict each other"):
        diagnose_views(simulate(8).detections(right_px=simulate(9).right_px))


def test_left_and_right_exchanged_is_said_and_still_calibrated() -> None:
    rig = simulate(10)
    diagnosis = diagnose_views(rig.detections(rig.right_px, rig.left_px))
    assert "cameras-exchanged" in [found.code for found in diagnosis.findings]
    np.testing.assert_allclose(diagnosis.T_right_left.t, T_RIGHT_LEFT.inverse().t, atol=3e-3)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("is_exchanged", [False, True])
def test_a_camera_upside_down_is_not_taken_for_exchanged_cameras(side: str, is_exchanged: bool) -> None:
    """Each image turned by 180 degrees about its middle is what the camera sees upside down."""
    rig = simulate(11)
    left, right = rig.left_px, rig.right_px
    turned = np.array([1279, 959]) - (left if side == "left" else right)
    left, right = (turned, right) if side == "left" else (left, turned)
    if is_exchanged:
        left, right = right, left
    diagnosis = diagnose_views(rig.detections(left, right))
    assert "cameras-exchanged" not in [found.code for found in diagnosis.findings]
    assert np.degrees(so3.angle_rad(diagnosis.T_right_left.R)) > 170


def test_a_camera_without_corners_is_named() -> None:
    rig = simulate(12, 6)
    nowhere = np.full_like(rig.right_px, np.nan)
    with pytest.raises(
        TooFewViewsError, match="left camera sees the board in 6 of 6 views, the right one in 0"
    ) as caught:
        diagnose_views(rig.detections(rig.left_px, nowhere))
    assert "both cameras see the board" in caught.value.remedy
    with pytest.raises(TooFewViewsError, match="add views with the board tilted"):
        diagnose_views(rig.detections(rig.left_px[:2], rig.right_px[:2]))


def test_the_commonest_reason_of_views_left_out_is_in_the_sentence() -> None:
    rig = simulate(13, 6)
    left = rig.left_px.copy()
    left[1:5] = left[1:5, :1]
    with pytest.raises(
        TooFewViewsError, match="4 of 6 views were left out, 4 of them as view 1: the left corners all lie"
    ):
        diagnose_views(rig.detections(left))


def _by_columns(px: np.ndarray) -> np.ndarray:
    return px.reshape(-1, 8, 11, 2).swapaxes(1, 2).reshape(-1, 88, 2)


def _size(rig: Rig, width: int, height: int, right: tuple[int, int] | None = None) -> Detections:
    return Detections.from_arrays(rig.points, rig.left_px, rig.right_px, (width, height), right_image_size_wh=right)


REFUSED: dict[str, tuple[Callable[[Rig], Detections], type[BinocalError], str]] = {
    "columns and rows exchanged": (
        lambda r: r.detections(_by_columns(r.left_px), _by_columns(r.right_px)),
        InconsistentViewsError,
        "columns and rows are exchanged",
    ),
    "right columns and rows exchanged": (
        lambda r: r.detections(right_px=_by_columns(r.right_px)),
        InconsistentViewsError,
        "exchanged in the right corners",
    ),
    "board with exchanged dimensions": (
        lambda r: Detections.from_arrays(grid(8, 11), r.left_px, r.right_px, r.size_wh),
        InconsistentViewsError,
        "columns and rows",
    ),
    "another board": (
        lambda r: Detections.from_arrays(grid(22, 4), r.left_px, r.right_px, r.size_wh),
        InconsistentViewsError,
        "columns, rows or corner order",
    ),
    "one view": (lambda r: r.detections().select(np.arange(1)), TooFewViewsError, "1 usable view, 3 needed"),
    "two views": (lambda r: r.detections().select(np.arange(2)), TooFewViewsError, "2 usable views, 3 needed"),
    "image size too small": (lambda r: _size(r, 640, 480), DataError, "lies outside the 640x480 image"),
    "image size swapped": (lambda r: _size(r, 960, 1280), DataError, "swapped: give 1280x960"),
    "image size too large": (lambda r: _size(r, 2560, 1920), DataError, "image size looks wrong"),
    "right corners at half resolution": (
        lambda r: r.detections(right_px=r.right_px / 2),
        DataError,
        "right corners are at about 0.5",
    ),
    "left corners at half resolution": (
        lambda r: r.detections(left_px=r.left_px / 2),
        DataError,
        "left corners are at about 0.5",
    ),
    "nothing seen": (
        lambda r: r.detections(right_px=np.full_like(r.right_px, np.nan)),
        TooFewViewsError,
        "0 usable views",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
@pytest.mark.parametrize("seed", [11, 12])
def test_unusable_sets_are_refused_by_name(case: str, seed: int) -> None:
    make, error, words = REFUSED[case]
    with pytest.raises(error, match=words):
        diagnose_views(make(simulate(seed)))


def test_a_smaller_right_camera_is_no_fault() -> None:
    rig = simulate(13)
    detections = Detections.from_arrays(
        rig.points, rig.left_px, rig.right_px / 2, (1280, 960), right_image_size_wh=(640, 480)
    )
    assert diagnose_views(detections).right.parameters[0] == pytest.approx(800, rel=0.02)


def test_a_image_size_off_in_one_axis_is_warned_of() -> None:
    assert any(
        "check the image size" in found.remedy for found in diagnose_views(_size(simulate(14), 1920, 1080)).findings
    )


@pytest.mark.parametrize(
    ("corners", "words"),
    [
        (np.zeros((88, 2)), "all lie at one point (0, 0)"),
        (np.linspace([100, 100], [500, 400], 88), "lie on one line"),
        (np.random.default_rng(0).uniform([0, 0], [1280, 960], (88, 2)), "do not lie on the board's grid"),
    ],
)
def test_a_view_without_a_board_is_rejected(corners: np.ndarray, words: str) -> None:
    rig = simulate(15)
    left = rig.left_px.copy()
    left[BAD] = corners
    diagnosis = diagnose_views(rig.detections(left_px=left))
    assert list(_rejected(diagnosis)) == ["03"] and words in _rejected(diagnosis)["03"]
    _is_right(diagnosis, rig)


def test_the_rejected_are_named_when_too_few_remain() -> None:
    rig = simulate(16, 4)
    left = rig.left_px.copy()
    left[:2] = 0.0
    with pytest.raises(TooFewViewsError) as caught:
        diagnose_views(rig.detections(left_px=left))
    assert caught.value.found == 2 and set(caught.value.rejected) == {"0", "1"}


@pytest.mark.parametrize("tilt_deg", [0.0, 0.3])
def test_fronto_parallel_boards_are_refused(tilt_deg: float) -> None:
    for seed in range(3):
        with pytest.raises(DegenerateGeometryError, match="tilt the board 20-45 deg"):
            diagnose_views(simulate(seed, tilt_deg=(0, tilt_deg)).detections())


@pytest.mark.parametrize("noise_px", [0.0, 0.2])
def test_one_pose_twenty_times_is_refused(noise_px: float) -> None:
    rig = simulate(17, 1, noise_px=0.0)
    rng = np.random.default_rng(0)
    left, right = (
        np.repeat(px, 20, axis=0) + rng.normal(0, noise_px, (20, 88, 2)) for px in (rig.left_px, rig.right_px)
    )
    with pytest.raises(DegenerateGeometryError, match="only 1 different pose in 20 views"):
        diagnose_views(rig.detections(left, right))


def test_parallel_boards_are_refused() -> None:
    rng = np.random.default_rng(18)
    R = np.broadcast_to(so3.exp(np.array([0.35, 0.2, 0.0])), (20, 3, 3))
    t = np.array([-0.1, -0.07, 0.7]) + rng.uniform(-0.06, 0.06, (20, 3))
    left, right = (project("brown4", TABLE2, grid(), T @ SE3(R, t)) for T in (SE3.identity(), T_RIGHT_LEFT))
    noise = rng.normal(0, 0.2, left.shape)
    with pytest.raises(DegenerateGeometryError, match="parallel to each other"):
        diagnose_views(Detections.from_arrays(grid(), left + noise, right + noise[::-1], (1280, 960)))


def test_tilts_that_leave_the_focal_length_open_are_refused() -> None:
    rig = simulate(0, 20)
    fit = fit_homographies(rig.points, rig.left_px)
    initial = estimate_intrinsics(rig.points, rig.left_px, rig.size_wh, "brown4", homographies=fit)
    check_degeneracy("left", initial, rig.points)
    uncertain = replace(initial, vanishing=replace(initial.vanishing, sigma_log_focal=0.6))
    with pytest.raises(DegenerateGeometryError, match="no perspective"):
        check_degeneracy("left", uncertain, rig.points)
    bent = replace(uncertain, homographies=replace(fit, sigma_px=fit.sigma_px + 10))  # then its tilts are not plain
    with pytest.raises(DegenerateGeometryError, match="60 %"):
        check_degeneracy("left", bent, rig.points)


def _mirrored(px: np.ndarray, width: int) -> np.ndarray:
    """As a finder numbers the corners of a flipped image: row by row from its own left."""
    flipped = px * [-1, 1] + [width - 1, 0]
    order = np.lexsort((-grid()[:, 0], grid()[:, 1]))
    return flipped[:, order]


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_mirrored_side_is_said_to_be_mirrored(side: str) -> None:
    rig = simulate(0)
    images = {f"{side}_px": _mirrored(getattr(rig, f"{side}_px"), rig.size_wh[0])}
    with pytest.raises(InconsistentViewsError, match="left images are mirrored against the right ones") as caught:
        diagnose_views(rig.detections(**images))
    (found,) = findings_of(caught.value)
    assert found.code == "one-side-mirrored" and found.figures["mended_px"] < 1 < found.figures["miss_px"]


def test_mirrored_images_of_some_views_are_named() -> None:
    rig = simulate(0)
    px = rig.right_px.copy()
    px[[3, 8]] = _mirrored(px[[3, 8]], rig.size_wh[0])
    diagnosis = diagnose_views(rig.detections(right_px=px))
    assert {view.name: view.code for view in diagnosis.rejected} == {"03": "view-mirrored", "08": "view-mirrored"}
    assert all("right image is mirrored" in view.reason for view in diagnosis.rejected)
