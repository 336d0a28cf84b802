from __future__ import annotations

from dataclasses import replace

import numpy as np

from binocal.cameras import Camera, StereoRig, camera_model
from binocal.geometry import SE3, so3
from binocal.metrics.image import triangulate
from binocal.rectification import rectify
from binocal.result import Covariance
from binocal.uncertainty.lattice import COLUMNS, LEVELS, ROWS, DepthSigmaLattice, depth_sigma_lattice
from rigs import make_rig

NAMES = ("left.fx", "left.cx", "right.k1", "rotation.y", "rotation.x", "translation.x")
SIGMA = np.array([0.15, 0.1, 5e-4, 2e-5, 1.2e-5, 5e-6])


def moved_rig(rig: StereoRig, name: str, step: float) -> StereoRig:
    """The rig with one parameter of its covariance moved; unknown names move nothing."""
    group, _, item = name.partition(".")
    if group in ("left", "right"):
        camera: Camera = getattr(rig, group)
        names = camera_model(camera.model).parameter_names
        parameters = camera.parameters.copy()
        parameters[names.index(item)] += step
        return replace(rig, **{group: replace(camera, parameters=parameters)})
    T, way = rig.T_right_left, np.eye(3)["xyz".index(item)] * step
    moved = SE3(so3.exp(way) @ T.R, T.t) if group == "rotation" else SE3(T.R, T.t + way)
    return replace(rig, T_right_left=moved)


def correlated() -> Covariance:
    correlation = np.eye(6)
    correlation[1, 3] = correlation[3, 1] = 0.8
    return Covariance(NAMES, correlation * np.outer(SIGMA, SIGMA))


def test_it_is_the_spread_of_depth_over_drawn_rigs():
    """Against 400 rigs drawn from the covariance, in the middle and in two corners, near and far."""
    covariance, rng = correlated(), np.random.default_rng(0)
    for model, level in (("brown4", 0), ("fisheye4", LEVELS - 1)):
        rig = make_rig(model)
        r = rectify(rig)
        lattice = depth_sigma_lattice(rig, covariance, r, 0.5, 4.0)
        width, height = r.size_wh
        u, v = np.meshgrid(np.linspace(0, width - 1, COLUMNS), np.linspace(0, height - 1, ROWS))
        rays = r.left.unproject(np.stack([u, v], axis=-1)[[0, 3, 5], [1, 4, 6]])
        rays = rays / (rays[:, 2:] if r.projection == "pinhole" else np.linalg.norm(rays, axis=1, keepdims=True))
        points = lattice.distances[level] * rays @ r.R_rect_left
        left_px, right_px = rig.left.project(points), rig.right.project(rig.T_right_left.apply(points))
        distances = []
        for step in rng.multivariate_normal(np.zeros(6), covariance.matrix, 400):
            moved = rig
            for name, s in zip(NAMES, step, strict=True):
                moved = moved_rig(moved, name, s)
            found, _ = triangulate(moved, left_px, right_px)
            distances.append(found @ r.R_rect_left[2] if r.projection == "pinhole" else np.linalg.norm(found, axis=1))
        spread = np.std(distances, axis=0) / lattice.distances[level]
        stated = lattice.share[level][[0, 3, 5], [1, 4, 6]]
        np.testing.assert_allclose(stated, spread, rtol=0.12)  # 3.5 % of scatter


def test_yaw_and_baseline_alone_are_what_geometry_says():
    rig = make_rig(rotation_rad=(0, 0, 0), t=(-0.06, 0, 0))
    r = rectify(rig)
    middle = ROWS // 2, COLUMNS // 2
    yaw = depth_sigma_lattice(rig, Covariance(("rotation.y",), np.array([[1e-8]])), r, 0.5, 4.0)
    np.testing.assert_allclose(yaw.share[(slice(None), *middle)], yaw.distances * 1e-4 / 0.06, rtol=0.02)
    baseline = depth_sigma_lattice(rig, Covariance(("translation.x",), np.array([[1e-8]])), r, 0.5, 4.0)
    np.testing.assert_allclose(baseline.share, 1e-4 / 0.06, rtol=1e-3)


def test_pixels_get_what_the_lattice_says():
    rig = make_rig()
    r = rectify(rig)
    lattice = depth_sigma_lattice(rig, correlated(), r, 0.5, 4.0)
    distance = np.full((96, 128), lattice.distances[2], np.float32)
    distance[0, 0], distance[5, 5] = 1e3, np.nan
    sigma = lattice.at(distance)
    np.testing.assert_allclose(sigma[-1, -1] / lattice.distances[2], lattice.share[2, -1, -1], rtol=1e-5)
    np.testing.assert_allclose(sigma[0, 0] / 1e3, lattice.share[-1, 0, 0], rtol=1e-5)
    assert np.isnan(sigma[5, 5]) and np.isfinite(sigma).sum() == sigma.size - 1


def test_places_that_a_camera_does_not_see_take_nothing_from_the_others():
    """Corners beyond the fold of a lens: with the lattice's NaN in sums, no pixel had a standard deviation."""
    share = np.full((LEVELS, ROWS, COLUMNS), 0.02)
    share[:, :2, :3] = np.nan
    share[0] = np.nan  # too near for one of the cameras
    sigma = DepthSigmaLattice(np.geomspace(0.5, 4.0, LEVELS), share).at(np.full((60, 80), 1.5, np.float32))
    np.testing.assert_allclose(sigma, 0.03, rtol=1e-5)


def test_an_unknown_covariance_gives_no_number():
    rig = make_rig()
    lattice = depth_sigma_lattice(rig, Covariance(("left.fx",), np.array([[np.nan]])), rectify(rig), 0.5, 4.0)
    assert np.isnan(lattice.share).all()
