import numpy as np
import pytest

from treadlight.tread import find_regions, radial_harmonics, void_ratio


def test_harmonics_of_a_known_radius_come_back(rng):
    theta = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    r = 350 + 0.4 * np.cos(theta - 1) + 0.1 * np.sin(3 * theta) + rng.normal(0, 0.01, 720)
    r[100:130] = np.nan
    found = radial_harmonics(theta, r, 5)
    np.testing.assert_allclose(found.amplitude_mm, [0.4, 0, 0.1, 0, 0], atol=3 * found.std_mm)
    assert found.std_mm == pytest.approx(0.01 * np.sqrt(2 / 690), rel=0.1)
    assert found.peak_to_peak_mm == pytest.approx(np.ptp(r[np.isfinite(r)]), abs=0.06)


def test_a_sector_has_no_harmonics():
    theta = np.linspace(0, 5.0, 700)
    assert radial_harmonics(theta, np.full(700, 350.0), 5) is None


def test_the_void_ratio_counts_grooves_and_slots(treads, grids):
    """Two grooves of 10 mm and slots over a quarter of the rest."""
    tread, grid = treads[2], grids["sector"]
    r = tread.radius(grid.theta, grid.z)
    regions = find_regions(r, grid)
    share, std = void_ratio(r, grid.theta, regions)
    width = grid.z[-1] - grid.z[0]
    expected = (20 + 0.25 * (width - 20)) / width
    assert share == pytest.approx(expected, abs=std)
    assert 0 < std < 0.1
    assert np.isnan(void_ratio(np.full_like(r, np.nan), grid.theta, regions)).all()
