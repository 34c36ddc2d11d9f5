"""What of the views tells cuts, where several views lie on the same rows."""

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.integrate.cues import read_cues
from treadlight.integrate.gather import POOR_FIT, ViewField

ROWS, COLUMNS = 40, 30


def field(rng, sees):
    """A view of noisy slopes whose left half does not fit and tilts; it sees what is asked."""
    shape = (ROWS, COLUMNS)
    slope = 0.01 * rng.standard_normal((2, *shape))
    slope[:, :, 10:13] += 0.2
    flags = np.zeros((3, *shape))
    flags[POOR_FIT, :, :15] = 1.0
    material = np.full((3, *shape), 0.2)
    return ViewField(
        np.arange(ROWS),
        np.where(sees, slope, np.nan).astype(np.float32),
        np.where(sees, 1e-4, np.nan * slope).astype(np.float32),
        np.where(sees, material, np.nan).astype(np.float32),
        np.where(sees, flags, 0).astype(np.float32),
        np.ones(ROWS, np.float32),
    )


def test_a_view_that_sees_nothing_of_a_cell_does_not_weaken_what_others_see(rng):
    grid = CylinderGrid(0.005 * np.arange(ROWS), 0.5 * np.arange(COLUMNS), 100.0)
    sighted = field(rng, np.ones((ROWS, COLUMNS), bool))
    blind = field(rng, np.zeros((ROWS, COLUMNS), bool))
    alone = read_cues([sighted], 16.0, grid)
    found = read_cues([sighted, blind], 16.0, grid)
    np.testing.assert_array_equal(found.poor[:, :15], 1.0)
    np.testing.assert_allclose(found.tilted, alone.tilted)
    np.testing.assert_allclose(found.dark, alone.dark)
