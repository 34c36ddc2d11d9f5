"""A rib whose slots repeat, and a stretch of it that no view sees."""

import numpy as np
import pytest
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate import FirstSurface, LaserSections, ViewNormals, integrate_capture
from treadlight.integrate.gather import view_field
from treadlight.integrate.laser import laser_cells
from treadlight.integrate.slots import close_cuts

RADIUS = 300.0
STEP = 0.5
LASER_STD = 0.1
TILT_STD = np.radians(1.5)
SLOT_MM = 6.0
PITCH_MM = 30.0
HALF_MM = 2.0
LEAN = 1.0
GROOVE = (14.0, 3.0)
HIDDEN = slice(340, 460)


@pytest.fixture(scope="module")
def grid():
    return CylinderGrid.sector((0.1, 0.1 + 400 / RADIUS), (-20.0, 20.0), STEP, RADIUS)


@pytest.fixture(scope="module")
def places(grid):
    return np.meshgrid(grid.theta, grid.z, indexing="ij")


def in_slot(theta, z, wider=0.0):
    along = (theta - 0.1) * RADIUS - LEAN * z
    off = np.abs((along + PITCH_MM / 2) % PITCH_MM - PITCH_MM / 2)
    return (off < HALF_MM + wider) & (np.abs(z) < 10)


def true_radius(theta, z):
    r = RADIUS - 0.002 * z**2 - 8.0 * (np.abs(z - GROOVE[0]) < GROOVE[1])
    return r - SLOT_MM * in_slot(theta, z)


@pytest.fixture(scope="module")
def views(places):
    theta, z = places
    rng = np.random.default_rng(3)
    p = rng.normal(0, TILT_STD, theta.shape)
    q = -0.004 * z + rng.normal(0, TILT_STD, theta.shape)
    poor = in_slot(theta, z)
    p = np.where(in_slot(theta, z, STEP), 0.4, p)
    normal = np.stack([np.ones_like(p), -p, -q], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal[np.abs(np.abs(z - GROOVE[0]) - GROOVE[1]) < 0.6] = np.nan
    covariance = np.zeros((*p.shape, 3))
    covariance[..., [0, 2]] = TILT_STD**2
    none = np.zeros(p.shape, bool)
    whole = (normal, covariance, RADIUS - 0.002 * z**2, theta, z)
    parts = (slice(0, HIDDEN.start), slice(HIDDEN.stop, None))
    return [
        ViewNormals(*(v[rows] for v in whole), np.full((*p.shape, 3), 0.3)[rows], none[rows],
                    none[rows], poor[rows])
        for rows in parts
    ]  # fmt: skip


def make_sections(grid, surface):
    at = 0.1 + np.arange(4.0, 398.0, 11.0) / RADIUS
    theta = at[:, None] + 0 * grid.z
    z = np.broadcast_to(grid.z, theta.shape)
    r = surface(theta, z) + np.random.default_rng(4).normal(0, LASER_STD, theta.shape)
    return LaserSections(r, theta, z, np.full(r.shape, LASER_STD), -at, 1.0)


def first_surface(grid, sections):
    nearest = np.abs(grid.theta[:, None] - sections.theta[:, 0]).argmin(axis=1)
    return FirstSurface(sections.r[nearest], np.full(grid.shape, LASER_STD))


@pytest.fixture(scope="module")
def profile(grid, views):
    sections = make_sections(grid, true_radius)
    return integrate_capture(iter(views), sections, first_surface(grid, sections), grid, 0)


def test_slots_go_on_where_no_view_looks(profile, places):
    theta, z = places
    rib = np.abs(z) < 8
    # A wall is where its edge is to within a cell.
    clear = ndimage.uniform_filter(in_slot(theta, z).astype(float), 3)
    floor, top = clear > 0.99, clear < 0.01
    for part in (floor, top):
        error = (profile.r - true_radius(theta, z))[HIDDEN][(part & rib)[HIDDEN]]
        assert np.mean(np.abs(error) < 0.5) > 0.9


def test_where_the_pattern_is_another_there_is_no_radius_in_doubt(grid, views):
    """In the stretch that no view sees the slots lean the other way."""
    first, last = grid.theta[[HIDDEN.start, HIDDEN.stop - 1]]

    def surface(theta, z):
        hidden = (theta >= first) & (theta <= last)
        return np.where(hidden, true_radius(theta, -z), true_radius(theta, z))

    sections = make_sections(grid, surface)
    r = integrate_capture(iter(views), sections, first_surface(grid, sections), grid, 0).r
    rib = np.abs(grid.z) < 8
    assert np.isnan(r[HIDDEN][:, rib]).mean() > 0.02
    seen = np.ones(len(grid.theta), bool)
    seen[HIDDEN.start - 20 : HIDDEN.stop + 20] = False
    assert np.isfinite(r[seen][:, rib]).all()


def test_unsure_points_on_floors_of_grooves_stay(grid, views):
    """Beside a cut a line that is spread out lies on its lips; a groove's floor has none."""
    sections = make_sections(grid, true_radius)
    unsure = np.full(sections.r.shape, 6 * LASER_STD)
    surface = first_surface(grid, sections)
    laser = laser_cells(
        sections.r, sections.theta, sections.z, unsure, np.zeros((2, *grid.shape)), grid
    )
    floor = np.abs(grid.z - GROOVE[0]) < GROOVE[1]
    # The slots run into the groove, and look broken there.
    fields = [view_field([view], grid) for view in views]
    for field in fields:
        field.flags[:, :, floor] = field.flags[:, :, np.abs(grid.z).argmin()][..., None]
    closed = close_cuts(
        fields, surface.r, LASER_STD, laser, lambda r: (RADIUS - r) / 8 * floor, 22.0, 1.0, grid
    )
    on_floor = floor[laser.column]
    assert closed.on_tread[on_floor].mean() > 0.95
    assert closed.on_tread[~on_floor].mean() < 0.95
