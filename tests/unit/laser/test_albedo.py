import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from treadlight.laser import detect_section, learn_line_model
from treadlight.laser.albedo import places_at_edges

ROWS, WIDTH, NOISE, FINE = 400, 96, 3e-4, 8


def lines_at_edges(u, edge, sigma, rng, blur=0.0):
    """Stripes on half the albedo beyond `edge`, as pixels see both through a lens."""
    x = (np.arange(WIDTH * FINE) - 0.5 * (FINE - 1)) / FINE
    light = 0.5 * np.exp(-0.5 * ((x - u[:, None]) / sigma) ** 2)
    light *= np.where(x > edge[:, None], 0.5, 1.0)
    if blur:
        light = gaussian_filter1d(light, blur * FINE, axis=1)
    seen = light.reshape(len(u), WIDTH, FINE).mean(axis=2)
    return (seen + NOISE * rng.standard_normal(seen.shape)).astype(np.float32)


def stretches(rng, sigma):
    """Courses of the line and of edges that last for twenty rows."""
    u = 48 + np.linspace(0, 3, ROWS)
    return u, u + np.repeat(rng.uniform(-1.2, 1.2, ROWS // 20), 20) * sigma


@pytest.mark.parametrize("sigma", [1.2, 2.0, 4.0])
def test_an_edge_along_the_line_does_not_draw_it_to_the_bright_side(rng, sigma):
    u, edge = stretches(rng, sigma)
    even = lines_at_edges(u, np.full(ROWS, np.inf), sigma, rng)
    dark = np.zeros(even.shape, bool)
    model = learn_line_model([(even, dark)])
    light = lines_at_edges(u, edge, sigma, rng)
    found = detect_section(light, dark, model)
    place, _ = places_at_edges(light, found.u[:, 0], sigma, NOISE)
    proven = np.isfinite(place)
    assert proven.mean() > 0.5
    assert np.sqrt(np.mean((found.u[proven, 0] - u[proven]) ** 2)) < 0.02 * sigma
    centroid = light @ np.arange(WIDTH) / light.sum(axis=1)
    assert np.sqrt(np.mean((centroid - u)[proven] ** 2)) > 0.1 * sigma


@pytest.mark.parametrize("blur", [0.0, 0.3])
def test_the_deviation_is_that_of_the_error(rng, blur):
    u, edge = stretches(rng, 2.0)
    light = lines_at_edges(u, edge, 2.0, rng, blur)
    place, std = places_at_edges(light, np.rint(u).astype(np.float32), 2.0, NOISE)
    found = np.isfinite(place)
    assert (np.isfinite(std) == found).all()
    assert found.mean() > 0.5
    assert 0.2 < np.sqrt(np.mean(((place - u) / std)[found] ** 2)) < 1.5


@pytest.mark.parametrize("sigma", [0.77, 0.9, 1.2, 2.0, 4.0])
@pytest.mark.parametrize("speckle", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("grain", [0.6, 1.5])
def test_where_no_edge_is_hardly_any_is_found(rng, sigma, speckle, grain):
    u = 48 + np.linspace(0, 3, ROWS)
    light = lines_at_edges(u, np.full(ROWS, np.inf), sigma, rng)
    noise = gaussian_filter(rng.standard_normal(light.shape), grain)
    light = light * np.maximum(0, 1 + speckle * noise / noise.std())
    place, _ = places_at_edges(light.astype(np.float32), u.astype(np.float32), sigma, NOISE)
    assert np.isfinite(place).mean() < 0.03


def test_one_row_alone_shows_no_edge(rng):
    u = np.full(ROWS, 48.3)
    for rows, expected in ((1, 0), (9, 9)):
        edge = np.full(ROWS, np.inf)
        edge[100 : 100 + rows] = 48.8
        light = lines_at_edges(u, edge, 2.0, rng)
        place, _ = places_at_edges(light, u.astype(np.float32), 2.0, NOISE)
        assert abs(np.isfinite(place).sum() - expected) <= 0.25 * rows


def test_rows_that_are_not_to_be_looked_at_show_nothing(rng):
    u, edge = stretches(rng, 2.0)
    light = lines_at_edges(u, edge, 2.0, rng)
    place, std = places_at_edges(light, np.full(ROWS, np.nan, np.float32), 2.0, NOISE)
    assert np.isnan(place).all()
    assert np.isnan(std).all()


def test_an_image_narrower_than_the_stripe_shows_nothing(rng):
    u = np.full(ROWS, 2.0)
    light = lines_at_edges(u, u + 0.5, 2.0, rng)[:, :5]
    place, _ = places_at_edges(light, u.astype(np.float32), 2.0, NOISE)
    assert np.isnan(place).all()
