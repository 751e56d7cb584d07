import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mazebot.common.maths.frames import (
    LINK_FROM_OPTICAL,
    SE2,
    SE3,
    Array,
    PlanarCovariance,
    inverse_matrix,
    pose_matrix,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_rpy,
    rotation_from_vector,
    transform_matrix,
    wrap_angle,
)

angle = st.floats(-10.0, 10.0)
length = st.floats(-50.0, 50.0)
pose = st.builds(SE2, length, length, angle)
turn = st.builds(rotation_from_rpy, angle, angle, angle)
rigid = st.builds(transform_matrix, turn, st.tuples(length, length, length))


@given(pose, pose)
def test_composition_agrees_with_matrices(a: SE2, b: SE2) -> None:
    assert np.allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-9)


@given(
    st.lists(st.floats(-3.0, 3.0), min_size=9, max_size=9),
    st.tuples(length, length),
    st.floats(0.0, 10.0),
    st.tuples(length, length, angle),
)
def test_a_planar_covariance_moves_and_spreads_as_matrices_do(
    numbers: list[float],
    aside: tuple[float, float],
    variance: float,
    by_error: tuple[float, float, float],
) -> None:
    root = np.array(numbers).reshape(3, 3)
    before = root @ root.T
    assert np.array_equal(
        PlanarCovariance.from_matrix(before).matrix(), np.triu(before) + np.triu(before, 1).T
    )
    by_pose = np.eye(3)
    by_pose[:2, 2] = aside
    expected = by_pose @ before @ by_pose.T + variance * np.outer(by_error, by_error)
    after = PlanarCovariance.from_matrix(before).moved(*aside).spread(variance, *by_error)
    assert np.allclose(after.matrix(), expected, rtol=1e-9, atol=1e-7)


@given(rigid, rigid)
def test_spatial_composition_agrees_with_matrices(a: Array, b: Array) -> None:
    composed = SE3.from_matrix(a) @ SE3.from_matrix(b)
    assert np.allclose(pose_matrix(composed), a @ b, atol=1e-9)


@given(rigid, st.tuples(length, length, length))
def test_a_vector_turns_as_by_its_matrix_and_back(
    a: Array, vector: tuple[float, float, float]
) -> None:
    frame = SE3.from_matrix(a)
    assert np.allclose(frame.rotate(*vector), a[:3, :3] @ vector, atol=1e-9)
    assert np.allclose(frame.rotate_back(*vector), a[:3, :3].T @ vector, atol=1e-9)


@given(pose)
def test_a_pose_and_its_inverse_cancel(a: SE2) -> None:
    assert np.allclose((a @ a.inverse()).matrix(), np.eye(4), atol=1e-9)


@given(angle, st.floats(-1.5, 1.5), angle)
def test_quaternions_and_rotations_are_inverse(roll: float, pitch: float, yaw: float) -> None:
    rotation = rotation_from_rpy(roll, pitch, yaw)
    assert np.allclose(
        rotation_from_quaternion(*quaternion_from_rotation(rotation)), rotation, atol=1e-9
    )


@given(angle, angle, angle)
def test_a_vector_turns_about_itself_by_its_length(x: float, y: float, z: float) -> None:
    rotation, vector = rotation_from_vector(x, y, z), np.array([x, y, z])
    assert np.allclose(rotation @ vector, vector, atol=1e-12)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    length_rad = float(np.sqrt((vector * vector).sum()))
    assert math.isclose(np.trace(rotation), 1.0 + 2.0 * math.cos(length_rad), abs_tol=1e-12)
    assert np.allclose(rotation_from_vector(0.3, 0.0, 0.0), rotation_from_rpy(0.3, 0.0, 0.0))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turns_have_a_quaternion(axis: int) -> None:
    rpy = [0.0, 0.0, 0.0]
    rpy[axis] = math.pi
    rotation = rotation_from_rpy(*rpy)
    assert np.allclose(
        rotation_from_quaternion(*quaternion_from_rotation(rotation)), rotation, atol=1e-9
    )


def test_the_optical_axis_looks_forward_and_its_x_to_the_right() -> None:
    assert np.allclose(LINK_FROM_OPTICAL[:3, 2], [1, 0, 0], atol=1e-12)
    assert np.allclose(LINK_FROM_OPTICAL[:3, 0], [0, -1, 0], atol=1e-12)


def test_inverse_matrix() -> None:
    matrix = transform_matrix(rotation_from_rpy(0.1, -0.2, 3.0), (1.0, -2.0, 0.5))
    assert np.allclose(matrix @ inverse_matrix(matrix), np.eye(4), atol=1e-12)


@given(angle)
def test_wrapped_angles_are_the_same_direction(a: float) -> None:
    wrapped = wrap_angle(a)
    assert -math.pi <= wrapped < math.pi
    assert math.isclose(math.cos(wrapped), math.cos(a), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(a), abs_tol=1e-9)
