"""The benchmark's own formulas: what it holds renders against must be right itself."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

hemisphere = SimpleNamespace(**runpy.run_path(str(Path(__file__).with_name("hemisphere.py"))))


def tilted_about_x(angles):
    """Normals (n, 3) tilted by angles from the view."""
    return np.column_stack([0 * angles, np.sin(angles), np.cos(angles)])


@pytest.mark.parametrize("alpha", [15, 40, 120])
def test_both_lobes_have_one_width_at_half_height(alpha):
    """Light from the camera: the gloss falls to a half where cos^alpha does, but for masking."""
    half = np.arccos(0.5 ** (1 / alpha))
    n, light = tilted_about_x(np.array([0.0, half])), np.array([[0.0, 0, 1]])
    top, side = hemisphere.blinn_phong(n, light, 0, alpha)[0]
    assert side / top == pytest.approx(0.5)
    top, side = hemisphere.microfacet(n, light, 0, alpha)[0]
    assert top == pytest.approx(hemisphere.WHOLE)
    # Masking and 1 / n.v, which belong to microfacets, shift it a little.
    assert side / top == pytest.approx(0.5, abs=0.06)


def test_microfacets_have_the_longer_tail():
    n, light = tilted_about_x(np.radians([40.0])), np.array([[0.0, 0, 1]])
    tail = hemisphere.microfacet(n, light, 0, 40)[0, 0]
    assert tail > 100 * hemisphere.blinn_phong(n, light, 0, 40)[0, 0]


@pytest.mark.parametrize("lobe", [hemisphere.blinn_phong, hemisphere.microfacet])
def test_no_light_from_behind_and_diffuse_light_is_lamberts(lobe):
    n = tilted_about_x(np.radians([0.0, 50]))
    light = tilted_about_x(np.radians([-45.0]))
    seen = lobe(n, light, 1e9, 40)[0]
    assert seen[1] == 0
    assert seen[0] == pytest.approx(hemisphere.WHOLE * np.cos(np.radians(45)))


@pytest.mark.parametrize("layout", ["rings", "spread"])
def test_sixteen_lights_between_the_zenith_angles_told(layout):
    light = hemisphere.lights(layout)
    assert light.shape == (16, 3)
    np.testing.assert_allclose(np.linalg.norm(light, axis=1), 1)
    zenith = np.degrees(np.arccos(light[:, 2]))
    low, high = (15, 35) if layout == "rings" else (10, 70)
    assert zenith.min() == pytest.approx(low)
    assert zenith.max() == pytest.approx(high)
    # Well distributed: no side of the view is without light.
    assert np.abs(np.mean(light[:, :2], axis=0)).max() < 0.12


def test_normals_are_those_of_eighty_pixels_across():
    n, inside = hemisphere.normals()
    assert inside.sum() == len(n) == pytest.approx(np.pi * 40**2, rel=0.01)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1)
    full = np.full((*inside.shape, 3), np.nan)
    full[inside] = n
    assert full[12, 50, 1] > 0.9  # the top row faces upwards
    assert full[50, 88, 0] > 0.9  # the right column faces right


def test_a_picture_is_cut_into_its_images():
    picture = np.zeros((400, 400, 3), np.uint16)
    picture[100:200, 200:300] = 65535
    found = hemisphere.tiles(picture)
    assert found.shape == (16, 100, 100)
    assert list(found.mean(axis=(1, 2))) == [0] * 6 + [1] + [0] * 9
    with pytest.raises(ValueError, match="16 bits"):
        hemisphere.tiles(picture.astype(np.uint8))


@pytest.mark.parametrize(
    "wrong", [lambda x: np.minimum(x, 0.8), lambda x: x**1.01, lambda x: x + 1e-4]
)
def test_a_render_that_is_not_eq_5_1_is_noticed(wrong):
    """Clipped, another gamma, or ambient light; rounding to 16 bits is none of these."""
    n, _ = hemisphere.normals()
    formula = hemisphere.blinn_phong(n, hemisphere.lights("rings"), 0.1, 40)
    largest, mean = hemisphere.departure(hemisphere.quantised(formula), formula)
    assert largest <= 0.5 + 1e-6
    assert abs(mean) < 0.01
    largest, mean = hemisphere.departure(wrong(formula), formula)
    assert largest > 1


def test_full_counts_are_saturated():
    found = hemisphere.quantised(np.array([0.0, 0.5, 0.99999, 1.0, 2.0]))
    np.testing.assert_array_equal(np.isnan(found), [False, False, False, True, True])


def test_angles_are_exact_where_a_cosine_would_round():
    truth = np.array([[0.0, 0, 1]])
    assert hemisphere.angles(tilted_about_x(np.array([1e-6])), truth)[0] == pytest.approx(
        np.degrees(1e-6), rel=1e-3
    )
    assert np.isnan(hemisphere.angles(np.full((1, 3), np.nan), truth)[0])
