"""A small true tread: crown, two circumferential grooves, a slot, a sipe, texture."""

import numpy as np
import pytest

from treadlight.evaluate.truth import Profile

RADIUS = 355.0
STEP = 0.4


def tread(theta, z, rng, radius=RADIUS):
    """Radius of the tread on (theta x z) cells, mm."""
    along = (theta * radius)[:, None]
    r = radius - z[None, :] ** 2 / 2000 + rng.normal(0, 0.02, (len(theta), len(z)))
    groove = np.abs(np.abs(z) - 14) < 4
    slot = (np.abs(along - 20) < 3) & (np.abs(z) < 10)[None, :]
    sipe = (np.abs(along + 20) < 0.5) & (np.abs(z) < 10)[None, :]
    r = np.where(groove[None, :], radius - 8.0, r)
    r = np.where(slot, radius - 7.0, r)
    return np.where(sipe, radius - 3.0, r)


def grid(arc_mm=90.0, width_mm=60.0, start=0.3):
    n, m = round(arc_mm / STEP), round(width_mm / STEP)
    theta = start + (np.arange(n) - n / 2) * STEP / RADIUS
    return theta, (np.arange(m) - m / 2) * STEP


@pytest.fixture
def truth(rng):
    theta, z = grid(start=0.0)
    return Profile(theta, z, tread(theta, z, rng))


@pytest.fixture
def whole_turn(rng):
    """A small whole turn, 30 mm in radius, whose seam runs through a top."""
    n = 471
    theta = -np.pi + np.arange(n) * 2 * np.pi / n
    z = (np.arange(100) - 50) * STEP
    return Profile(theta, z, tread(theta, z, rng, radius=30.0))
