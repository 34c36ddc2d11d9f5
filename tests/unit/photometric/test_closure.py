"""The height around loops tells how wrong normals are."""

import numpy as np
import pytest

from treadlight.photometric.closure import covariance_scale

RADIUS = 100.0


def field(rng, std, told, size=(120, 100)):
    """Normals of a wavy cylinder with errors of `std`, whose covariance says `told`."""
    v, u = np.mgrid[: size[0], : size[1]] * 0.1
    theta, z = u / RADIUS, v
    p = 0.1 * np.cos(u) * np.sin(v) + std * rng.standard_normal(size)
    q = 0.1 * np.sin(u) * np.cos(v) + std * rng.standard_normal(size)
    normal = np.stack([np.ones(size), -p, -q], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    cov = np.zeros((*size, 3))
    cov[..., 0] = cov[..., 2] = told**2
    return normal, cov, theta, z, np.full(size, RADIUS)


def test_errors_three_times_as_large_as_told_are_found(rng):
    assert covariance_scale(*field(rng, 0.03, 0.01)) == pytest.approx(3, rel=0.1)


def test_honest_errors_stay_as_they_are(rng):
    assert covariance_scale(*field(rng, 0.02, 0.02)) == pytest.approx(1, abs=0.1)
    assert covariance_scale(*field(rng, 0.01, 0.03)) == 1.0


def test_steps_do_not_count(rng):
    """A tenth of the normals is far off, as at groove walls: the scale hardly moves."""
    normal, cov, theta, z, r = field(rng, 0.02, 0.02)
    normal[:, 40:50] = [0.5, 0.0, np.sqrt(0.75)]
    assert covariance_scale(normal, cov, theta, z, r) < 1.3


def test_few_loops_prove_nothing(rng):
    normal, cov, theta, z, r = field(rng, 0.03, 0.01)
    normal[:, 10:] = np.nan
    normal[12:] = np.nan
    assert covariance_scale(normal, cov, theta, z, r) == 1.0
    small = field(rng, 0.03, 0.01, size=(3, 3))
    assert covariance_scale(*small) == 1.0
