"""Every rule on both sides of its limits, on a sound calibration of which one figure is changed."""

from dataclasses import replace

import numpy as np
import pytest

from binocal import acceptance
from binocal.acceptance import rules, variety
from binocal.acceptance.figures import board_normals, corner_spacing_px
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.errors import BinocalError, DegenerateGeometryError, InconsistentViewsError, NotConvergedError
from binocal.findings import KINDS, Severity, finding
from binocal.geometry import SE3, so3
from binocal.result import Covariance, OutlierCorner
from binocal.simulation import sample_scene, simulate_detections, table2_rig

REFUSALS = [rule.code for rule in acceptance.RULES if KINDS[rule.code].severity is Severity.REFUSAL]


@pytest.fixture(scope="module")
def sound():
    rng = np.random.default_rng(0)
    scene = sample_scene(table2_rig(), parse_board("chessboard:9x6:30mm"), 8, rng)
    return calibrate(simulate_detections(scene, rng, noise_px=0.1), model="brown4", calibrator="lm")


def with_sigma(calibration, **sigma):
    """The calibration with other standard deviations; names with _ for the dot."""
    matrix = calibration.covariance.matrix.copy()
    names = calibration.covariance.names
    for name, value in sigma.items():
        i = names.index(name.replace("_", "."))
        matrix[i], matrix[:, i] = 0.0, 0.0
        matrix[i, i] = value**2
    return replace(calibration, covariance=Covariance(names, matrix))


def with_centre(calibration, side, x):
    camera = getattr(calibration.rig, side)
    parameters = camera.parameters.copy()
    parameters[2] = x
    return replace(calibration, rig=replace(calibration.rig, **{side: replace(camera, parameters=parameters)}))


def with_outliers(calibration, share):
    first, *others = calibration.views
    n = round(share * sum(view.n_corners for view in calibration.views))
    return replace(calibration, views=(replace(first, outliers=(OutlierCorner("left", 3, 12.5),) * n), *others))


def with_parallel_boards(calibration):
    evidence = calibration.evidence
    R = np.broadcast_to(evidence.T_left_board.R[:1], evidence.T_left_board.R.shape)
    return replace(calibration, evidence=replace(evidence, T_left_board=replace(evidence.T_left_board, R=R)))


def cases(calibration):
    """code: (just inside, just outside, the exception)."""
    spacing_px = corner_spacing_px(calibration.evidence.detections)
    fx, baseline = calibration.rig.left.parameters[0], calibration.rig.baseline_m
    calm = with_sigma(calibration, translation_x=0.0, translation_y=0.0, translation_z=0.0)
    sure = with_sigma(calibration, left_cx=1.0, right_cx=1.0)
    middle = (1280 - 1) / 2
    return {
        "corners-do-not-fit": (
            replace(calibration, noise_px=0.119 * spacing_px),
            replace(calibration, noise_px=0.121 * spacing_px),
        ),
        "too-many-outliers": (with_outliers(calibration, 0.29), with_outliers(calibration, 0.31)),
        "focal-length-undetermined": (
            with_sigma(calibration, left_fx=0.049 * fx),
            with_sigma(calibration, left_fx=0.051 * fx),
        ),
        "principal-point-impossible": (
            with_centre(sure, "right", middle + 0.249 * 1280),
            with_centre(sure, "right", middle + 0.251 * 1280),
        ),
        "rotation-undetermined": (
            with_sigma(calibration, rotation_y=np.radians(0.99)),
            with_sigma(calibration, rotation_y=np.radians(1.01)),
        ),
        "translation-undetermined": (
            with_sigma(calm, translation_z=0.199 * baseline),
            with_sigma(calm, translation_z=0.201 * baseline),
        ),
        "focal-length-uncertain": (
            with_sigma(calibration, right_fy=0.0099 * calibration.rig.right.parameters[1]),
            with_sigma(calibration, right_fy=0.0101 * calibration.rig.right.parameters[1]),
        ),
        "corners-without-weight": (with_outliers(calibration, 0.009), with_outliers(calibration, 0.011)),
        "lens-model-folds": (with_k1(calibration, -0.56), with_k1(calibration, -0.64)),
        "image-size-doubtful": (stated_wider(calibration, 1.07), stated_wider(calibration, 1.12)),
    }


def with_k1(calibration, k1):
    """The calibration with a right lens of that distortion alone; it folds at r = (-3 k1)^-0.5, 2/3 of that in the image."""
    camera = calibration.rig.right
    parameters = np.r_[camera.parameters[:5], k1, 0, 0, 0]
    return replace(calibration, rig=replace(calibration.rig, right=replace(camera, parameters=parameters)))


def stated_wider(calibration, factor):
    """The calibration as if the images were that much wider than the corners' own."""
    rig, evidence = calibration.rig, calibration.evidence
    cameras = {}
    for side in ("left", "right"):
        camera = getattr(rig, side)
        parameters = camera.parameters.copy()
        parameters[2] = (camera.size_wh[0] - 1) / 2
        cameras[side] = replace(camera, parameters=parameters, size_wh=(round(factor * 1280), 960))
    return replace(calibration, rig=replace(rig, **cameras), evidence=evidence)


def codes(calibration):
    return [found.code for found in acceptance.findings_of_rules(calibration, acceptance.RULES)]


def test_a_sound_calibration_passes_every_rule(sound):
    assert codes(sound) == []
    assert acceptance.apply_rules(sound, is_converged=True).findings == ()


@pytest.mark.parametrize("code", [rule.code for rule in acceptance.RULES])
def test_a_rule_speaks_just_beyond_its_limit_and_not_before(sound, code):
    inside, outside = cases(sound)[code]
    assert code not in codes(inside)
    assert code in codes(outside)


@pytest.mark.parametrize("code", REFUSALS)
def test_a_refusal_is_raised_with_its_finding_and_what_the_views_show(sound, code):
    error = KINDS[code].error
    with pytest.raises(error) as caught:
        acceptance.apply_rules(cases(sound)[code][1], is_converged=True)
    (found,) = caught.value.findings
    assert found.code == code and found.text == str(caught.value) and found.remedy in found.text
    assert set(caught.value.rejected) == {view.name for view in sound.views}
    assert all("board tilted" in reason for reason in caught.value.rejected.values())


@pytest.mark.parametrize("code", ["focal-length-uncertain", "corners-without-weight", "image-size-doubtful"])
def test_a_warning_is_kept_before_those_of_the_views(sound, code):
    own = finding("cameras-exchanged")
    reviewed = acceptance.apply_rules(replace(cases(sound)[code][1], findings=(own,)), is_converged=True)
    assert {found.code for found in reviewed.findings} == {code, "cameras-exchanged"}
    assert reviewed.warnings == tuple(found.text for found in reviewed.findings)
    if code != "corners-without-weight":  # the solve's own last
        assert reviewed.findings[-1] is own


def test_parallel_views_are_refused_unless_the_focal_length_is_known(sound):
    fx = sound.rig.left.parameters[0]
    weak, strong = (with_sigma(sound, left_fx=share * fx) for share in (0.0021, 0.0019))
    assert "focal-length-undetermined" not in codes(weak)
    assert "focal-length-undetermined" in codes(with_parallel_boards(weak))
    assert "focal-length-undetermined" not in codes(with_parallel_boards(strong))


def test_a_principal_point_that_is_not_known_is_not_impossible(sound):
    far = with_centre(sound, "left", 0.9 * 1280)
    offset = 0.9 * 1280 - (1280 - 1) / 2
    assert "principal-point-impossible" in codes(with_sigma(far, left_cx=offset / 5.1))
    assert "principal-point-impossible" not in codes(with_sigma(far, left_cx=offset / 4.9))


def test_a_size_is_doubted_only_where_both_are_short_and_no_corner_lies_beyond(sound):
    doubtful = stated_wider(sound, 1.12)
    assert "image-size-doubtful" in codes(doubtful)
    assert "image-size-doubtful" not in codes(with_centre(doubtful, "left", 1.12 * 1280 / 2 - 0.01 * 1280))
    px = sound.evidence.detections.left_px.copy()
    px[0, 0, 0] = 1.1 * 1280
    beyond = replace(sound.evidence, detections=replace(sound.evidence.detections, left_px=px))
    assert "image-size-doubtful" not in codes(replace(doubtful, evidence=beyond))


def test_a_size_is_not_doubted_where_the_principal_points_are_hardly_known(sound):
    """Both short by 0.054 of the width: with standard deviations that make it 3 or 5 of their mean's."""
    doubtful = stated_wider(sound, 1.12)
    short_px = (0.5 - 0.5 / 1.12) * 1.12 * 1280
    for sigmas, is_said in ((5.0, True), (3.0, False)):
        sigma_px = np.sqrt(2) * short_px / sigmas
        unsure = with_sigma(doubtful, left_cx=sigma_px, right_cx=sigma_px)
        assert ("image-size-doubtful" in codes(unsure)) == is_said


def test_a_solve_that_did_not_converge_is_no_result(sound):
    with pytest.raises(NotConvergedError, match="did not reach a minimum") as caught:
        acceptance.apply_rules(sound, is_converged=False)
    assert caught.value.findings[0].code == "not-converged"
    cv2s = replace(sound, n_iterations=0)
    with pytest.raises(NotConvergedError, match=r"^cv2 did not reach a minimum; the views .* undetermined: use lm\.$"):
        acceptance.apply_rules(cv2s, is_converged=False, solver="cv2", else_use="use lm")


def held_still(calibration, turn_deg, move_px):
    """The calibration with views that are all variations of its first one."""
    evidence = calibration.evidence
    rng = np.random.default_rng(1)
    n = evidence.detections.n_views
    first = evidence.T_left_board.R[:1]
    R = first @ so3.exp(np.radians(turn_deg) * rng.uniform(-1, 1, (n, 3)) / np.sqrt(3))
    left, right = (
        np.repeat(px[:1], n, axis=0) + move_px * rng.uniform(-1, 1, (n, 1, 2))
        for px in (evidence.detections.left_px, evidence.detections.right_px)
    )
    detections = replace(evidence.detections, left_px=left, right_px=right)
    pose = SE3(R, np.repeat(evidence.T_left_board.t[:1], n, axis=0))
    return replace(calibration, evidence=replace(evidence, detections=detections, T_left_board=pose))


def test_variations_of_one_pose_are_named_where_they_leave_the_rig_open(sound):
    still = held_still(sound, 5.0, 10.0)
    with pytest.raises(DegenerateGeometryError, match="nearly one pose") as caught:
        acceptance.apply_rules(still, is_converged=False)
    assert caught.value.findings[0].code == "views-of-one-pose"
    fx = sound.rig.left.parameters[0]
    with pytest.raises(DegenerateGeometryError, match="nearly one pose"):
        acceptance.apply_rules(with_sigma(still, left_fx=0.011 * fx), is_converged=True)
    assert variety.find_one_pose(with_sigma(still, left_fx=0.009 * fx), is_converged=True) is None
    assert variety.find_one_pose(held_still(sound, 40.0, 10.0), is_converged=False) is None
    assert variety.find_one_pose(held_still(sound, 5.0, 200.0), is_converged=False) is None


def test_advice_never_asks_for_the_tilts_that_are_there(sound):
    assert variety.has_tilts(board_normals(sound))
    with pytest.raises(NotConvergedError) as caught:
        acceptance.apply_rules(sound, is_converged=False)
    remedy = caught.value.findings[0].remedy
    assert "tilted" not in remedy and "the tilts are there" in remedy
    parallel = with_parallel_boards(sound)
    with pytest.raises(NotConvergedError, match="tilted 20-45 deg"):
        acceptance.apply_rules(
            with_sigma(parallel, left_fx=0.0, left_fy=0.0, right_fx=0.0, right_fy=0.0), is_converged=False
        )


def test_tilts_about_one_axis_are_not_enough():
    angles = np.radians([10.0, 20.0, 30.0, -25.0])
    about_x = so3.exp(np.stack([angles, 0 * angles, 0 * angles], axis=-1))[:, :, 2]
    about_y = so3.exp(np.stack([0 * angles, angles, 0 * angles], axis=-1))[:, :, 2]
    assert not variety.has_tilts(about_x) and variety.has_tilts(np.concatenate([about_x, about_y]))


def test_residuals_come_before_geometry(sound):
    # what the corners are is in doubt before what they tell
    spacing_px = corner_spacing_px(sound.evidence.detections)
    both = with_sigma(replace(sound, noise_px=spacing_px), rotation_x=0.1)
    with pytest.raises(InconsistentViewsError):
        acceptance.apply_rules(both, is_converged=True)
    with pytest.raises(DegenerateGeometryError):
        acceptance.apply_rules(replace(both, noise_px=sound.noise_px), is_converged=False)


def test_what_has_no_evidence_is_reviewed_by_the_rest(sound):
    bare = replace(sound, evidence=None, noise_px=100.0)
    assert codes(bare) == []
    with pytest.raises(BinocalError) as caught:
        acceptance.apply_rules(with_sigma(bare, rotation_x=0.1), is_converged=True)
    assert caught.value.rejected == {}


def test_every_limit_is_positive_and_reasoned():
    limits = [limit for rule in rules.RULES for limit in rule.limits]
    assert len(limits) >= 12 and all(limit.value > 0 and limit.reason and limit.what for limit in limits)
