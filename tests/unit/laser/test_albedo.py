import numpy as np
import pytest

from treadlight.laser import detect_section, learn_line_model
from treadlight.laser.albedo import places_at_edges

ROWS = 400


def half_beyond(frame, edge):
    """The frame with half the albedo in all columns from `edge` (rows,) on."""
    light, saturated = frame
    beyond = np.arange(light.shape[1]) > edge[:, None]
    return np.where(beyond, 0.5, 1.0).astype(np.float32) * light, saturated


@pytest.mark.parametrize("sigma", [1.2, 2.0, 4.0])
def test_an_edge_along_the_line_does_not_draw_it_to_the_bright_side(stripes, rng, sigma):
    u = 48 + np.linspace(0, 2, ROWS)
    clean = [stripes(u + k / 4, sigma=sigma, speckle=0, noise=3e-4, rng=rng) for k in range(4)]
    model = learn_line_model(clean)
    offset = np.repeat(rng.uniform(-1.2, 1.2, ROWS // 20), 20) * sigma
    error = detect_section(*half_beyond(clean[0], u + offset), model).u[:, 0] - u
    # Rows that share light with others beyond an end of their edge.
    inner = (np.arange(ROWS) % 20 > 5) & (np.arange(ROWS) % 20 < 14)
    assert np.sqrt(np.mean(error[inner] ** 2)) < 0.05 * sigma


def test_the_deviation_covers_the_error(stripes, rng):
    u = 48 + np.linspace(0, 2, ROWS)
    frame = half_beyond(stripes(u, speckle=0, noise=1e-3, rng=rng), u + 0.7)
    place, std = places_at_edges(frame[0], u.astype(np.float32), 2.0, 1e-3)
    found = np.isfinite(place)
    assert found.mean() > 0.9
    assert np.mean(np.abs(place - u)[found] < 2 * std[found]) > 0.9
    assert np.median(std[found]) < 0.1


def test_where_no_edge_is_nothing_is_found(stripes, rng):
    u = (48 + np.linspace(0, 2, ROWS)).astype(np.float32)
    even, _ = stripes(u, speckle=0, rng=rng)
    grainy, _ = stripes(u, speckle=0.3, rng=rng)
    for light in (even, grainy):
        place, _ = places_at_edges(light, u, 2.0, 1e-3)
        assert np.isfinite(place).mean() < 0.01
    beside, _ = places_at_edges(even, np.full(ROWS, np.nan, np.float32), 2.0, 1e-3)
    assert np.isnan(beside).all()


def test_a_stripe_at_the_border_has_too_few_pixels(stripes, rng):
    u = np.full(ROWS, 1.0)
    frame = half_beyond(stripes(u, speckle=0, rng=rng), u + 0.6)
    place, _ = places_at_edges(frame[0], u.astype(np.float32), 1.0, 1e-3)
    assert np.isnan(place).all()
