"""Light interpolated over tiles of pixels, held against the light at every point."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from treadlight.photometric.height_field import angle
from treadlight.photometric.light_tiles import add_terms, tiles_of

RADIUS = 350.0


def point_light(place: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A lobe about the LED's way to the axis, and nothing behind it; points phi, z, r in {V}."""
    phi, z, r = points.T
    away = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1) - place
    distance = np.linalg.norm(away, axis=-1)
    facing = -(away @ place) / distance / np.linalg.norm(place)
    return 7e4 * np.maximum(facing, 0) ** 1.5 / distance**2


def interpolated(points: np.ndarray, width: int | None, place: np.ndarray) -> np.ndarray:
    """1 / irradiance of all points as `view_kernels.observe` adds it up, row by row."""
    tiles = tiles_of(points, width)
    terms = tiles.terms(point_light(place, tiles.places))
    rows, columns = tiles.shape
    wide = len(points) if width is None else width
    across = -(-wide // columns)
    found = np.empty(len(points), np.float32)
    for row in range(-(-len(points) // wide)):
        here = slice(row * wide, min((row + 1) * wide, len(points)))
        own = row // rows * across + np.arange(wide) // columns
        own = own[: len(found[here])]
        places = ((points[here] - tiles.middle[own]) / tiles.half[own]).T.astype(np.float32)
        first = row // rows * across
        add_terms(terms[first : first + across], columns, places, found[here])
    return found


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    width=st.integers(1, 70),
    depth=st.floats(0, 9),
    pitch=st.floats(0.005, 0.1),
)
def test_light_between_the_places_that_are_asked_is_what_an_led_sends(seed, width, depth, pitch):
    """Over grooves as deep as any tire's; some pixels see nothing."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:45, :width]
    r = RADIUS - depth * (np.sin(0.3 * u + 0.2 * v) > 0.5)
    points = np.stack([0.1 + v * pitch / RADIUS, u * pitch - 40, r], axis=-1).reshape(-1, 3)
    points = points[: len(points) - width // 3]
    lost = rng.random(len(points)) < 0.1
    points[lost] = np.nan
    place = np.array([RADIUS + 250, *rng.uniform(-200, 200, 2)])
    found = interpolated(points, width, place)
    exact = 1 / point_light(place, points[~lost])
    np.testing.assert_allclose(found[~lost], exact, rtol=1e-6)
    assert np.isnan(found[lost]).all()


def test_points_anywhere_are_tiles_by_themselves():
    rng = np.random.default_rng(1)
    points = np.column_stack(
        [rng.uniform(-0.4, 0.4, 300), rng.uniform(-99, 99, 300), rng.uniform(330, 370, 300)]
    )
    place = np.array([600.0, 80, -120])
    found = interpolated(points, None, place)
    np.testing.assert_allclose(found, 1 / point_light(place, points), rtol=1e-6)


def test_a_tile_that_sees_nothing_or_lies_behind_an_led_has_no_light():
    points = np.full((16 * 32, 3), np.nan)
    assert np.isnan(interpolated(points, 32, np.array([600.0, 0, 0]))).all()
    points[:] = [0.0, 0.0, RADIUS]
    assert not np.isfinite(interpolated(points, 32, np.array([RADIUS - 50, 0, 0]))).any()


@pytest.mark.parametrize("radius", [1e-3, 350.0])
def test_an_angle_is_that_of_the_arc_tangent(radius):
    phi = np.linspace(-1.5, 1.5, 3001)
    for x, y, expected in zip(radius * np.cos(phi), radius * np.sin(phi), phi, strict=True):
        assert angle(x, y, radius) == pytest.approx(expected, abs=2e-15)
