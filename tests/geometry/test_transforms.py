"""Group axioms of rotations and transforms, and the paper's angles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from binocal.geometry import SE3, so3

unit = st.floats(-1, 1, allow_nan=False)
directions = st.tuples(unit, unit, unit).filter(lambda v: np.linalg.norm(v) > 0.1)
angles = st.one_of(st.floats(0, np.pi), st.floats(0, 1e-9), st.floats(np.pi - 1e-9, np.pi))


def rotation_vector(direction, angle):
    direction = np.array(direction)
    return direction / np.linalg.norm(direction) * angle


@given(directions, angles)
def test_log_inverts_exp_near_zero_and_near_pi(direction, angle):
    R = so3.exp(rotation_vector(direction, angle))
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
    assert np.abs(so3.exp(so3.log(R)) - R).max() < 1e-14
    assert so3.angle_rad(R) == pytest.approx(angle, abs=1e-14, rel=1e-12)


@given(directions, angles, directions, angles)
def test_transforms_form_a_group(d1, a1, d2, a2):
    T_a_b = SE3(so3.exp(rotation_vector(d1, a1)), np.array(d2))
    T_b_c = SE3(so3.exp(rotation_vector(d2, a2)), np.array(d1))
    points = np.array([[0.1, -0.2, 0.3], [1, 2, 3]])
    assert np.allclose((T_a_b @ T_b_c).apply(points), T_a_b.apply(T_b_c.apply(points)), atol=1e-12)
    assert np.allclose((T_a_b @ T_a_b.inverse()).matrix, np.eye(4), atol=1e-12)


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3))
def test_paper_angles_round_trip(gamma, lam, mu):
    R = so3.from_paper_angles(gamma, lam, mu)
    assert np.allclose(so3.from_paper_angles(*so3.to_paper_angles(R)), R, atol=1e-12)


def test_paper_angles_are_passive_rotations():
    # eq. 5 takes the vector along X to (cos, -sin): the axes turn, not the vector
    assert np.allclose(so3.from_paper_angles(0, 0, np.pi / 2) @ [1, 0, 0], [0, -1, 0])
    assert np.allclose(so3.from_paper_angles(np.pi / 2, 0, 0) @ [0, 1, 0], [0, 0, -1])


def test_a_transform_is_frozen_and_checked():
    T = SE3.identity()
    with pytest.raises(ValueError, match="read-only"):
        T.R[0, 0] = 2
    with pytest.raises(ValueError, match="not a rotation"):
        SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3))


def test_mean_rotation_lies_between():
    R = so3.exp(np.array([[0.1, 0, 0], [0.3, 0, 0]]))
    assert np.allclose(so3.log(so3.mean(R)), [0.2, 0, 0], atol=1e-12)


def test_projection_to_a_rotation_is_the_nearest_one_near_and_far():
    rng = np.random.default_rng(0)
    R = so3.exp(rng.standard_normal((5, 3)))
    for size in (0.0, 1e-12, 1e-9, 1e-3):
        M = R + size * rng.standard_normal(R.shape)
        U, _, Vt = np.linalg.svd(M)
        assert np.abs(so3.project_to_rotation(M) - U @ Vt).max() < 1e-14
    turned = so3.project_to_rotation(-R)  # a reflection is no rotation, however orthogonal
    assert np.allclose(np.linalg.det(turned), 1.0)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-4, 0.0099, 0.0101, 1.0, 3.1])
def test_inverse_left_jacobian_is_the_slope_of_the_logarithm(angle_rad):
    # central differences with h = 1e-6 leave 1e-9
    rng = np.random.default_rng(0)
    w = rng.standard_normal((4, 3))
    w *= angle_rad / np.linalg.norm(w, axis=1, keepdims=True)
    slopes = []
    for i in range(3):
        d = np.zeros(3)
        d[i] = 1e-6
        slopes.append((so3.log(so3.exp(d) @ so3.exp(w)) - so3.log(so3.exp(-d) @ so3.exp(w))) / 2e-6)
    np.testing.assert_allclose(so3.inverse_left_jacobian(w), np.stack(slopes, axis=-1), atol=1e-8)


def test_paper_angles_are_pitch_yaw_and_roll_of_the_right_camera():
    """Turns about the camera's own axes, in this order: the convention that the command line prints."""
    pitch, yaw, roll = 0.2, -0.3, 0.4
    turn = so3.exp(np.array([pitch, 0, 0])) @ so3.exp(np.array([0, yaw, 0])) @ so3.exp(np.array([0, 0, roll]))
    np.testing.assert_allclose(so3.to_paper_angles(turn.T), (pitch, yaw, roll), atol=1e-12)
