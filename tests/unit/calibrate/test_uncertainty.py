"""How the camera's covariance reaches what depends on it."""

import numpy as np

from treadlight.calibrate.uncertainty import camera_jacobian, joint_covariance


def test_jacobian_of_a_known_function(bench):
    covariance = np.diag([4.0, 4.0, 1.0, 1.0, 1e-4, 0, 0, 0, 0])

    def function(camera):
        return np.array([camera.matrix[0, 0] * 3 + camera.distortion[0], camera.matrix[1, 2] ** 2])

    jacobian = camera_jacobian(bench.camera, covariance, function)
    expected = np.zeros((2, 9))
    expected[0, 0], expected[0, 4] = 3, 1
    expected[1, 3] = 2 * bench.camera.matrix[1, 2]
    assert np.allclose(jacobian, expected, atol=1e-6)


def test_jacobian_by_parameters_that_were_held_is_zero(bench):
    jacobian = camera_jacobian(bench.camera, np.zeros((9, 9)), lambda camera: np.ones(3))
    assert jacobian.shape == (3, 9)
    assert not jacobian.any()


def test_joint_covariance_is_that_of_samples(rng):
    root = rng.normal(size=(9, 9))
    camera = root @ root.T
    own, jacobian = np.diag([0.5, 2.0]), rng.normal(size=(2, 9))
    joint = joint_covariance(camera, [(own, jacobian)])
    draws = rng.normal(size=(200_000, 9)) @ root.T
    part = draws @ jacobian.T + rng.normal(size=(200_000, 2)) * np.sqrt([0.5, 2.0])
    sampled = np.cov(np.column_stack([draws, part]).T)
    assert np.allclose(joint, sampled, atol=0.03 * np.abs(joint).max())
