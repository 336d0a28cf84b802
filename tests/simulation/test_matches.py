"""Simulated matches: the right ones are those of the rig, the wrong ones are wrong as their kind says."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3, so3
from binocal.simulation import (
    WRONG_KINDS,
    MatchDistribution,
    random_rig,
    sample_match_problems,
    simulate_matches,
    table2_rig,
)
from binocal.simulation.surroundings import SURROUNDINGS, draw_planes
from binocal.solvers.epipolar import EpipolarProblem, parallax_and_sides
from binocal.solvers.relative_pose import RelativePose


def residuals_px(found):
    problem, has_rays = EpipolarProblem.of_matches((found.rig.left, found.rig.right), found.matches)
    assert has_rays.all()
    return problem, problem.residuals_px(RelativePose.of(found.rig.T_right_left))


@pytest.mark.parametrize("family", SURROUNDINGS)
@pytest.mark.parametrize("model", ["brown4", "brown8", "fisheye4"])
def test_matches_are_exact_without_noise_and_in_front_of_both_cameras(model, family):
    rig = random_rig(np.random.default_rng(1), model)
    found = simulate_matches(rig, 200, np.random.default_rng(2), family=family, noise_px=0.0)
    problem, residuals = residuals_px(found)
    assert len(found.matches) == 200 and found.is_right.all()
    assert np.abs(residuals).max() < 1e-8
    parallax_px, sides = parallax_and_sides(problem, RelativePose.of(rig.T_right_left))
    assert (sides[parallax_px > 1e-3] == 1).all()


def test_cameras_of_two_models_and_without_a_metric_baseline():
    left, right = table2_rig().left, random_rig(np.random.default_rng(0), "fisheye4").right
    for is_metric in (True, False):
        rig = StereoRig(left, right, SE3(np.eye(3), np.array([-1.0, 0, 0])), is_metric)
        found = simulate_matches(rig, 100, np.random.default_rng(2), noise_px=0.0)
        assert np.abs(residuals_px(found)[1]).max() < 1e-8


def test_a_batch_holds_what_its_distribution_says():
    distribution = MatchDistribution(noise_px=(0.3, 0.3), n_matches=(150, 250), wrong_share=(0.4, 0.4))
    batch = sample_match_problems(distribution, 200, np.random.default_rng(0))
    n = batch.is_present.sum(axis=1)
    assert len(batch) == 200 and n.max() <= 250 and np.median(n) > 180
    assert np.mean(batch.is_right.sum(axis=1) / n) == pytest.approx(0.6, abs=0.01)
    assert not batch.is_right[~batch.is_present].any()
    scores = []
    for index in range(40):
        found = batch.problem(index)
        scores.append(np.mean(residuals_px(found)[1][found.is_right] ** 2))
        assert len(found.matches) == n[index] and found.noise_px == pytest.approx(0.3)
    # 40 x 120 residuals: the RMS scatters by 1 %
    assert np.sqrt(np.mean(scores)) == pytest.approx(0.3, rel=0.04)


def test_the_same_seed_draws_the_same():
    first, again, other = (sample_match_problems(MatchDistribution(), 5, np.random.default_rng(s)) for s in (3, 3, 4))
    assert np.array_equal(first.right_px, again.right_px)
    assert first.right_px.shape != other.right_px.shape or not np.array_equal(first.right_px, other.right_px)


def test_rigs_look_sideways_or_forward():
    sideways = sample_match_problems(MatchDistribution(), 50, np.random.default_rng(0)).T_right_left
    forward = sample_match_problems(MatchDistribution(is_forward=True), 50, np.random.default_rng(0)).T_right_left
    for T, axis in ((sideways, 0), (forward, 2)):
        along = np.abs(T.t[:, axis]) / np.linalg.norm(T.t, axis=1)
        assert np.degrees(np.arccos(along.min())) < 17.5


@pytest.mark.parametrize("kind", WRONG_KINDS)
def test_wrong_matches_are_wrong_as_their_kind_says(kind):
    right = SE3(so3.exp(np.radians([2.0, -1.0, 3.0])), np.array([-0.4, 0.01, 0.02]))
    camera = Camera("brown4", (1000, 500), np.array([700.0, 700, 500, 250, 0, 0, 0, 0, 0]))
    rig = StereoRig(camera, camera, right)
    found = simulate_matches(
        rig, 600, np.random.default_rng(5), noise_px=0.05, wrong_share=0.5, wrong_kinds=[kind], family="street"
    )
    assert found.is_right.sum() == 300
    _, residuals = residuals_px(found)
    assert np.abs(residuals[found.is_right]).max() < 0.3
    away = np.median(np.abs(residuals[~found.is_right]))
    assert 0.05 < away < 0.3 if kind == "row" else away > 0.3  # what repeats along the row stays near its epipolar line
    wrong = found.matches.select(~found.is_right)
    spread = np.ptp(wrong.left_px, axis=0) / camera.size_wh
    is_regional = kind in ("row", "slope", "moving")
    assert (spread.max() < 0.55) if is_regional else (spread.min() > 0.8)
    if kind in ("slope", "moving"):  # all in one way: their residuals agree
        assert np.abs(np.mean(residuals[~found.is_right])) > 2 * np.std(residuals[~found.is_right])


def test_far_scenes_have_hardly_any_parallax():
    rig = table2_rig()
    near, far = (
        simulate_matches(rig, 300, np.random.default_rng(7), noise_px=0.0, family=family) for family in ("room", "far")
    )
    pose = RelativePose.of(rig.T_right_left)
    medians = [np.median(parallax_and_sides(residuals_px(found)[0], pose)[0]) for found in (near, far)]
    assert medians[1] < 0.1 * medians[0]


def test_rays_meet_the_nearest_plane():
    planes = draw_planes([SURROUNDINGS["street"], SURROUNDINGS["plane"]], np.random.default_rng(0))
    down, up = np.array([[0.0, 1.0, 0.0]]), np.array([[0.0, -1.0, 0.0]])
    first = np.zeros(1, dtype=int)
    assert 1.2 <= planes.surface_m(first, down)[0] <= 2.0
    assert planes.surface_m(first, up)[0] == np.inf and planes.surface_m(first + 1, down)[0] > 2.0


@pytest.mark.usefixtures("unchecked_types")
def test_wrong_options_are_refused():
    rig = table2_rig()
    rng = np.random.default_rng(0)
    for wrong in ({"family": "moon"}, {"wrong_share": 1.2}, {"wrong_kinds": ["odd"]}, {"noise_px": -1.0}):
        with pytest.raises(ValueError):
            simulate_matches(rig, 10, rng, **wrong)
    for wrong in (
        {"families": ("moon",)},
        {"wrong_share": (0.5, 0.2)},
        {"noise_px": (0.0, 1.0)},
        {"wrong_kinds": ("x",)},
    ):
        with pytest.raises(ValueError):
            MatchDistribution(**wrong)
