"""Sections of surfaces that are known, without images."""

import numpy as np
import pytest

from treadlight.cylinder import Sections
from treadlight.geometry import Axis, Camera, Plane, Rig

NOMINAL = 300.0


@pytest.fixture
def rig():
    camera = Camera(
        np.array([[900.0, 0, 95.5], [0, 900.0, 127.5], [0, 0, 1]]), np.zeros(5), (192, 256)
    )
    normal = np.array([0.966, -0.01, 0.258]) / np.linalg.norm([0.966, -0.01, 0.258])
    return Rig(camera, Plane(normal, -207.0), Axis.through([0.01, 1, -0.02], [3, 20, 1100]))


@pytest.fixture
def grooved():
    """r(theta, z) with one circumferential groove 8 mm deep, 10 mm wide, and a crown."""

    def r(theta, z):
        crown = NOMINAL - 0.0005 * z**2 + 0.2 * np.cos(theta)
        return np.where(np.abs(z - 12) < 5, crown - 8.0, crown)

    return r


@pytest.fixture
def sections_of():
    """Sections of a surface at encoder angles (rad), with noise and missing lines."""

    def make(surface, encoder, *, noise=0.02, pitch=0.5, half=45.0, rng=None):
        encoder = np.asarray(encoder, float)
        z = np.tile(np.arange(-half, half, pitch), (len(encoder), 1))
        # A tilted sheet: the section leans by half a degree over its length.
        theta = 1e-4 * z - encoder[:, None]
        r = surface(theta, z)
        if rng is not None:
            r = r + noise * rng.standard_normal(r.shape)
        theta = (theta + np.pi) % (2 * np.pi) - np.pi
        whole = np.zeros(r.shape, int)
        return Sections(
            encoder, theta, z, r, np.full(r.shape, noise), whole, whole.astype(np.uint8)
        )

    return make
