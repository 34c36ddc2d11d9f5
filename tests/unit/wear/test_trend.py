import csv
import io
import itertools

import numpy as np
import pytest

from treadlight.errors import ConfigError
from treadlight.geometry import CylinderGrid
from treadlight.tread import find_regions, fit_reference
from treadlight.wear import (
    Alignment,
    Motion,
    RegionTally,
    Stay,
    WearSettings,
    convert_mileage,
    csv_text,
    region_names,
    tally_rows,
    trend_rows,
)
from treadlight.wear.tally import Tally, common_share, deeper_groove
from treadlight.wear.trend import COLUMNS, fit_rate

GRID = CylinderGrid.whole_turn((-40.0, 40.0), 1.0, 100.0)


def tread(depths=(8.0, 6.0)):
    """Two grooves at -15 and 15 mm below tops at r = 108, runout of 0.2 mm."""
    r = np.full(GRID.shape, 108.0)
    for centre, depth in zip((-15.0, 15.0), depths, strict=True):
        r[:, np.abs(GRID.z - centre) < 4] -= depth
    return r + 0.2 * np.cos(GRID.theta)[:, None]


def stays(wears, miles, noise=0.02, rng=None):
    """Captures whose ribs have lost so much, with Gaussian noise."""
    rng = rng or np.random.default_rng(7)
    first = tread() + noise * rng.standard_normal(GRID.shape)
    std = np.full(GRID.shape, noise)
    regions = find_regions(first, GRID)
    reference = fit_reference(first, std, GRID, regions)
    classes = regions.classify(first, GRID.theta)
    found = []
    for k, (loss, mileage) in enumerate(zip(wears, miles, strict=True)):
        floor = regions.groove_of_column > 0
        r = first if k == 0 else tread() + noise * rng.standard_normal(GRID.shape)
        r = r - np.where(floor, 0.0, loss)
        tallies = {name: RegionTally() for name in region_names(regions)}
        cuts = (0, 100, GRID.shape[0])
        for a, b in itertools.pairwise(cuts):
            rows = slice(a, b)
            tally_rows(
                tallies,
                r[rows],
                (first - r)[rows],
                np.sqrt(2) * std[rows],
                std[rows],
                classes[rows],
                GRID.theta[rows],
                regions,
                reference,
            )
        alignment = Alignment.identity()
        if k:
            alignment = Alignment(Motion.none(), np.diag([0, 0, 0, 0, 0, 0, 1e-3**2]), 1.0, 2e-3)
        found.append(Stay(f"c{k}", mileage, alignment, tallies))
    return found, reference


def rows_of(wears, miles, unit="mi", settings=None, **kwargs):
    captures, reference = stays(wears, miles, **kwargs)
    rows = trend_rows("t", unit, captures, reference, settings or WearSettings())
    return {(row["capture"], row["region"]): row for row in rows}


def test_regions_depth_and_wear_are_what_was_cut():
    rows = rows_of([0.0, 0.12], [100.0, 200.0])
    regions = [region for capture, region in rows if capture == "c0"]
    assert regions == ["tread", "rib-1", "rib-2", "rib-3", "groove-1", "groove-2"]
    # A rib counts from its deeper neighbour: the middle one from 8 mm, not 6.
    for region, depth in (("rib-1", 8.0), ("rib-2", 8.0), ("rib-3", 6.0)):
        assert abs(rows["c0", region]["depth_mm"] - depth) < 0.02
        later = rows["c1", region]
        assert abs(later["depth_mm"] - depth + 0.12) < 0.02
        assert abs(later["wear_mm"] - 0.12) < 0.005
        assert later["wear_p05_mm"] < later["wear_p50_mm"] < later["wear_p95_mm"]
    assert abs(rows["c1", "groove-2"]["depth_mm"] - 5.88) < 0.02
    assert abs(rows["c1", "groove-1"]["wear_mm"]) < 0.005
    assert rows["c1", "groove-1"]["status"] == "not_detected"
    assert abs(rows["c1", "tread"]["wear_mm"] - 0.12) < 0.005


def test_the_first_capture_has_no_wear_and_no_rate():
    row = rows_of([0.0], [100.0])["c0", "tread"]
    assert row["status"] == "first"
    assert row["wear_mm"] == 0.0
    assert row["wear_std_mm"] == 0.0
    assert np.isnan(row["rate_mm_per_1000km"])
    assert np.isnan(row["projected_mileage"])


def test_two_captures_are_indicative_with_an_interval_from_wear_std_alone():
    row = rows_of([0.0, 0.12], [100.0, 200.0])["c1", "rib-1"]
    assert row["status"] == "indicative"
    assert np.isnan(row["rate_r2"])
    assert abs(row["rate_mm_per_1000km"] - 0.12 / 0.1609344) < 0.03
    assert abs(row["rate_mils_per_1000mi"] - 1.2 / 0.0254) < 2
    left = row["depth_mm"] - 1.6
    assert abs(row["projected_mileage"] - 200 - left / row["wear_mm"] * 100) < 1
    assert row["projected_low"] < row["projected_mileage"] < row["projected_high"]


def test_three_even_intervals_are_valid():
    rows = rows_of([0.0, 0.1, 0.2, 0.3], [0.0, 1000.0, 2000.0, 3000.0], unit="km")
    assert [rows[f"c{k}", "rib-2"]["status"] for k in range(4)] == [
        "first",
        "indicative",
        "indicative",
        "valid",
    ]
    last = rows["c3", "rib-2"]
    assert abs(last["rate_mm_per_1000km"] - 0.1) < 0.005
    assert last["rate_r2"] > 0.99
    assert abs(last["projected_mileage"] - (3000 + 6.1 / 0.1 * 1000)) < 3000


def test_an_uneven_course_is_not_valid():
    rows = rows_of([0.0, 0.3, 0.05, 0.35], [0.0, 1000.0, 2000.0, 3000.0])
    assert rows["c3", "rib-1"]["status"] == "indicative"
    assert rows["c3", "rib-1"]["rate_r2"] < 0.95


def test_wear_under_two_sigma_is_not_detected_and_not_projected():
    row = rows_of([0.0, 0.001], [100.0, 200.0])["c1", "rib-1"]
    assert row["status"] == "not_detected"
    assert np.isnan(row["projected_mileage"])


def test_repeats_at_the_first_mileage_give_no_rate():
    rows = rows_of([0.0, 0.0, 0.2], [100.0, 100.0, 200.0])
    assert np.isnan(rows["c1", "rib-1"]["rate_mm_per_1000km"])
    assert rows["c1", "rib-1"]["status"] == "not_detected"
    assert rows["c2", "rib-1"]["status"] == "indicative"
    assert rows["c1", "rib-1"]["mileage"] == 100.0


def test_break_in_is_left_out_of_the_rate():
    settings = WearSettings(break_in_km=500.0)
    rows = rows_of([0.0, 0.5, 0.6], [0.0, 1000.0, 2000.0], unit="km", settings=settings)
    assert np.isnan(rows["c1", "rib-1"]["rate_mm_per_1000km"])
    assert abs(rows["c2", "rib-1"]["rate_mm_per_1000km"] - 0.1) < 0.01


def test_the_uncertainty_of_a_mean_never_falls_below_what_cells_share():
    """Alignment (1 um), unexplained floors (2 um): noise over root n would be 0.1 um."""
    row = rows_of([0.0, 0.12], [100.0, 200.0])["c1", "rib-1"]
    assert row["wear_std_mm"] > np.hypot(1e-3, 2e-3)
    assert row["wear_std_mm"] < 0.02


def test_tally_agrees_with_numpy(rng):
    values, std = rng.normal(0.5, 0.1, 40_000), np.full(40_000, 0.1)
    theta, z = rng.uniform(-np.pi, np.pi, 40_000), rng.uniform(-5, 5, 40_000)
    tally = Tally()
    for part in np.array_split(np.arange(40_000), 7):
        tally.add(values[part], std[part], theta[part], z[part])
    mean, spread = tally.mean_and_spread()
    assert abs(mean - values.mean()) < 1e-3
    assert abs(spread - values.std()) < 1e-3
    np.testing.assert_allclose(
        tally.quantiles((0.05, 0.5, 0.95)), np.quantile(values, (0.05, 0.5, 0.95)), atol=2e-3
    )
    # Independent cells: the tiles scatter as root n says, and share next to nothing.
    assert 0.5 * 5e-4 < tally.std_of_mean(0.0) < 2 * 5e-4
    assert common_share([tally]) == 1.0


def test_outliers_do_not_move_a_tallys_mean(rng):
    values = np.concatenate([rng.normal(0.1, 0.02, 9_900), np.full(100, 5.0)])
    tally = Tally()
    tally.add(values, values * 0, values * 0, values * 0)
    assert abs(tally.mean_and_spread()[0] - 0.1) < 2e-3


def test_the_least_value_is_of_cells_that_belong_to_the_region(rng):
    tally, place = Tally(), np.zeros(5000)
    values = rng.normal(7.0, 0.05, 5000)
    values[:3] = 1.0  # a stone's hole is no tread depth
    tally.add(values, place + 0.05, place, place)
    assert tally.least() == pytest.approx(values[3:].min(), abs=0.02)
    assert np.isnan(Tally().least())


def test_an_empty_tally_is_nan_and_no_crash():
    tally = Tally()
    assert np.isnan(tally.quantiles((0.5,))).all()
    assert np.isnan(tally.mean_and_spread()).all()
    assert np.isnan(tally.std_of_mean(1.0))
    assert not tally.mean_design(Alignment.identity()).any()
    assert common_share([]) == 1.0


def test_common_share_sees_errors_that_go_together(rng):
    theta = rng.uniform(-np.pi, np.pi, 50_000)
    tiles = np.floor((theta % (2 * np.pi)) / np.deg2rad(10)).astype(int) % 36
    level = rng.normal(0, 0.1, 36)
    for common, low, high in ((0.0, 0.0, 0.02), (1.0, 0.3, 0.9)):
        tally = Tally()
        values = common * level[tiles] + rng.normal(0, 0.1, 50_000)
        std = np.full(50_000, 0.1 * np.sqrt(1 + common**2))
        tally.add(values, std, theta, theta)
        assert low <= common_share([tally]) <= high


def test_rates_need_two_mileages():
    assert fit_rate([]).intervals == 0
    assert np.isnan(fit_rate([(100.0, 0.1, 0.01)]).mm_per_km)
    two = fit_rate([(0.0, 0.0, 0.0), (1000.0, 0.1, 0.02)])
    assert abs(two.mm_per_km - 1e-4) < 1e-12
    assert 0 < two.std_mm_per_km <= 2e-5


def test_mileages_are_converted_both_ways():
    assert convert_mileage(100.0, "mi", "km") == pytest.approx(160.9344)
    assert convert_mileage(160.9344, "km", "mi") == pytest.approx(100.0)
    assert convert_mileage(3.0, "km", "km") == 3.0


def test_csv_has_the_contracts_columns_and_no_nan():
    captures, reference = stays([0.0, 0.12], [100.0, 200.0])
    text = csv_text(trend_rows("t", "mi", captures, reference, WearSettings()))
    rows = list(csv.DictReader(io.StringIO(text)))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == 12
    assert "nan" not in text
    assert rows[0]["rate_r2"] == ""
    assert float(rows[6]["wear_mm"]) == pytest.approx(0.12, abs=5e-3)


def test_without_grooves_depth_is_unknown_but_wear_is_not():
    grid = GRID
    r = np.full(grid.shape, 108.0)
    regions = find_regions(r, grid)
    reference = fit_reference(r, None, grid, regions)
    assert deeper_groove(regions, reference, 1) is None
    tallies = {name: RegionTally() for name in region_names(regions)}
    assert list(tallies) == ["tread", "rib-1"]
    std = np.full(grid.shape, 0.01)
    classes = regions.classify(r, grid.theta)
    tally_rows(tallies, r, std * 10, std, std, classes, grid.theta, regions, reference)
    stay = Stay("c", 1.0, Alignment(Motion.none(), np.zeros((7, 7))), tallies)
    row = trend_rows("t", "km", [stay, stay], reference, WearSettings())[2]
    assert np.isnan(row["depth_mm"])
    assert abs(row["wear_mm"] - 0.1) < 1e-3
    assert np.isnan(row["projected_mileage"])


@pytest.mark.parametrize("values", [{"wear_limit_mm": -1}, {"break_in_km": "x"}])
def test_settings_out_of_range_are_named(values):
    with pytest.raises(ConfigError, match=next(iter(values))):
        WearSettings(**values)
