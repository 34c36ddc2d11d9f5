"""Areal parameters against analytic surfaces and against surfalize, an independent package."""

import dataclasses

import numpy as np
import pytest
from scipy import ndimage
from surfalize import Surface

from treadlight.export import areal_parameters, scale_limited

STEP = 0.1


@pytest.fixture
def rough(rng):
    """A rough surface, longer along the second axis, mm."""
    z = ndimage.gaussian_filter(rng.normal(0, 1, (180, 220)), (4, 7))
    return 0.02 * z / z.std() + 0.002 * rng.normal(0, 1, z.shape)


def test_heights_gradient_and_area_are_those_of_surfalize(rough):
    found = areal_parameters(rough, (STEP, STEP))
    # surfalize counts in micrometres.
    other = Surface(1e3 * rough, 1e3 * STEP, 1e3 * STEP)
    assert 1e3 * found.sa == pytest.approx(other.Sa(), rel=1e-9)
    assert 1e3 * found.sq == pytest.approx(other.Sq(), rel=1e-9)
    assert 1e3 * found.sz == pytest.approx(other.Sz(), rel=1e-9)
    assert found.ssk == pytest.approx(other.Ssk(), rel=1e-9)
    assert found.sku == pytest.approx(other.Sku(), rel=1e-9)
    assert found.sdq == pytest.approx(other.Sdq(), rel=1e-9)
    assert 100 * found.sdr == pytest.approx(other.Sdr(), rel=1e-6)


def test_correlation_lengths_are_those_of_surfalize(rough):
    found = areal_parameters(rough, (STEP, STEP))
    other = Surface(1e3 * rough, 1e3 * STEP, 1e3 * STEP)
    assert 1e3 * found.sal == pytest.approx(other.Sal(), rel=0.03)
    assert found.str_ == pytest.approx(other.Str(), rel=0.05)
    assert found.str_ < 0.7


def test_a_cosine_has_its_textbook_parameters():
    """Sq = a / sqrt 2, Sa = 2 a / pi, Sku = 1.5, Sdq = 2 pi a / (L sqrt 2)."""
    x = np.arange(400) * 0.02
    z = np.tile(0.05 * np.cos(2 * np.pi * x / 1.0), (200, 1))
    found = areal_parameters(z, (0.02, 0.02))
    assert found.sq == pytest.approx(0.05 / np.sqrt(2), rel=1e-6)
    assert found.sa == pytest.approx(0.1 / np.pi, rel=1e-3)
    assert found.sz == pytest.approx(0.1, rel=1e-3)
    assert found.ssk == pytest.approx(0, abs=1e-6)
    assert found.sku == pytest.approx(1.5, rel=1e-6)
    assert found.sdq == pytest.approx(2 * np.pi * 0.05 / np.sqrt(2), rel=2e-3)
    # The autocorrelation is a cosine, too: 0.2 at arccos(0.2) / 2 pi of the wave.
    assert found.sal == pytest.approx(np.arccos(0.2) / (2 * np.pi), rel=0.02)
    assert np.isnan(found.str_)


def test_missing_cells_hardly_change_anything(rough, rng):
    holed = rough.copy()
    holed[rng.random(rough.shape) < 0.05] = np.nan
    holed[60:80, 90:130] = np.nan
    whole, part = (areal_parameters(z, (STEP, STEP)) for z in (rough, holed))
    for field in dataclasses.fields(whole):
        expected, found = getattr(whole, field.name), getattr(part, field.name)
        loose = 0.3 if field.name in ("ssk", "sz", "str_") else 0.06
        assert found == pytest.approx(expected, rel=loose, abs=0.06), field.name


def test_too_little_or_nothing_has_no_parameters():
    assert areal_parameters(np.full((20, 20), np.nan), (1, 1)) is None
    assert areal_parameters(np.ones((20, 20)), (1, 1)) is None
    assert areal_parameters(np.random.default_rng(0).normal(size=(5, 5)), (1, 1)) is None


@pytest.mark.parametrize(("wave", "share"), [(2.5, 0.5), (8.0, 0.5), (20.0, 0.115)])
def test_filters_pass_half_of_a_wave_of_their_nesting_index(wave, share):
    """ISO 16610-61: the Gaussian passes exp(-pi (alpha L / wave)^2), half at L."""
    x = np.arange(600) * 0.1
    z = np.tile(np.cos(2 * np.pi * x / wave), (300, 1))
    s_filter = 2.5 if wave == 2.5 else 0.3
    found = scale_limited(z, (0.1, 0.1), s_filter, 60.0 if wave == 2.5 else 8.0)
    middle = found[150, 200:400]
    basis = np.column_stack(
        [np.cos(2 * np.pi * x / wave), np.sin(2 * np.pi * x / wave), np.ones_like(x)]
    )[200:400]
    amplitude = np.hypot(*np.linalg.lstsq(basis, middle, rcond=None)[0][:2])
    assert amplitude == pytest.approx(share, abs=0.02)


def test_slope_and_offset_leave_nothing_and_holes_stay_holes(rng):
    i, j = np.indices((100, 100))
    z = 3 + 0.01 * i - 0.02 * j
    z[40:50, 40:50] = np.nan
    found = scale_limited(z, (0.1, 0.1), 0.5, 4.0)
    assert np.isnan(found[40:50, 40:50]).all()
    assert np.nanmax(np.abs(found[20:-20, 20:-20])) < 0.02
