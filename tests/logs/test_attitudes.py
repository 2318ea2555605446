"""Test of the conversion of logged attitudes to `scipy.spatial.transform.Rotation`."""

import numpy as np
import pytest
import scipy

from drake_quad.logs.attitudes import rotation_matrices


@pytest.mark.parametrize("shape", [(3,), (0, 3), (1, 3), (1000, 3)])
def test_rotations_of_roll_pitch_and_yaw_equal_those_of_scipy(shape):
    attitude = np.random.default_rng(1).uniform(-7.0, 7.0, size=shape)
    expected = scipy.spatial.transform.Rotation.from_euler("ZYX", attitude[..., ::-1])
    assert rotation_matrices(attitude).single == expected.single
    np.testing.assert_allclose(rotation_matrices(attitude).as_matrix(), expected.as_matrix(), atol=1e-14)
