from itertools import pairwise

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg

from treadlight import threads
from treadlight.integrate.coarsening import prolong, restrict_defect
from treadlight.integrate.kernels import multiply, smooth
from treadlight.integrate.multigrid import Solver, System


def weights_of_four_decades(rng, n, m, periodic):
    """Edges over four decades with cut walls, and laser rows: what a robust solve meets."""
    w = 1000.0 * 10 ** rng.uniform(-1, 1, (2, n, m))
    w[1, :, 5::12] *= 1e-3
    w[0, 7::17, :] *= 1e-2
    if not periodic:
        w[0, -1] = 0
    w[1, :, -1] = 0
    data = np.full((n, m), 1e-2)
    data[::11] = 80.0
    return System(w[0], w[1], data)


def as_matrix(system):
    n, m = system.data.shape
    index = np.arange(n * m).reshape(n, m)
    matrix = sp.diags(system.data.ravel()).tocoo()
    for axis, weight in enumerate((system.w_theta, system.w_z)):
        a, b, w = index.ravel(), np.roll(index, -1, axis).ravel(), weight.ravel()
        rows, columns = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
        matrix = matrix + sp.coo_matrix(
            (np.concatenate([w, w, -w, -w]), (rows, columns)), shape=matrix.shape
        )
    return matrix.tocsc()


@pytest.mark.parametrize(
    ("n", "m", "periodic"),
    [(64, 48, False), (97, 53, True), (96, 31, True), (41, 7, False), (5, 9, True)],
)
def test_heights_agree_with_the_direct_solve_to_a_micrometre(rng, n, m, periodic):
    system = weights_of_four_decades(rng, n, m, periodic)
    truth = rng.normal(0, 3, (n, m))
    matrix = as_matrix(system)
    residual = (matrix @ truth.ravel()).reshape(n, m)
    direct = scipy.sparse.linalg.spsolve(matrix, residual.ravel()).reshape(n, m)
    for precision in (np.float64, np.float32):
        rounded = System(*(w.astype(precision) for w in (system.w_theta, system.w_z, system.data)))
        start = residual.astype(precision)
        found, iterations = Solver(rounded).solve(start, tolerance_mm=1e-5)
        assert np.max(np.abs(found - direct)) < 1e-3
        assert iterations < 100


def test_iterations_do_not_grow_with_the_grid(rng):
    counts = []
    for size in (32, 64, 128, 256):
        w = np.full((2, size, size), 100.0)
        w[0, -1] = 0
        w[1, :, -1] = 0
        data = np.zeros((size, size))
        data[size // 2, size // 2] = 1.0
        system = System(w[0], w[1], data)
        counts.append(Solver(system).solve(rng.normal(size=(size, size)), 1e-6)[1])
    assert max(counts) <= min(counts) + 6


def test_the_same_heights_on_one_core_and_two(rng):
    system = weights_of_four_decades(rng, 61, 40, True)
    residual = rng.normal(size=(61, 40))
    before = threads.cores()
    found = []
    try:
        for count in (1, 2):
            threads.use_cores(count)
            found.append(Solver(system).solve(residual.copy(), 1e-6)[0])
    finally:
        threads.use_cores(before)
    assert all(np.array_equal(found[0], other) for other in found)


def restricted(level, coarse_shape, fine):
    out = np.empty(coarse_shape)
    restrict_defect(level.stencil, np.zeros_like(fine), fine, out)
    return out


def prolonged(level, coarse):
    fine = np.zeros(level.x.shape)
    prolong(level.stencil, coarse, fine)
    return fine


SHAPES = [(21, 14), (26, 19), (33, 40), (64, 31)]


@pytest.mark.parametrize("shape", SHAPES)
def test_restriction_is_the_transpose_of_prolongation(rng, shape):
    levels = Solver(weights_of_four_decades(rng, *shape, True))._levels
    for fine, coarse in pairwise(levels):
        x, y = rng.normal(size=coarse.x.shape), rng.normal(size=fine.x.shape)
        left = np.sum(prolonged(fine, x) * y)
        assert left == pytest.approx(np.sum(x * restricted(fine, x.shape, y)), rel=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_coarse_matrices_are_the_galerkin_products(rng, shape):
    levels = Solver(weights_of_four_decades(rng, *shape, True))._levels
    for fine, coarse in pairwise(levels):
        x = rng.normal(size=coarse.x.shape)
        product, found = np.empty(fine.x.shape), np.empty(x.shape)
        multiply(fine.stencil, prolonged(fine, x), product)
        multiply(coarse.stencil, x, found)
        expected = restricted(fine, x.shape, product)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("shape", SHAPES)
def test_smoothing_forth_and_back_is_symmetric(rng, shape):
    for level in Solver(weights_of_four_decades(rng, *shape, True))._levels:
        swept = []
        a, b = rng.normal(size=(2, *level.x.shape))
        for rhs in (a, b):
            x = np.zeros_like(rhs)
            smooth(level.stencil, x, rhs, False)
            smooth(level.stencil, x, rhs, True)
            swept.append(x)
        assert np.sum(swept[0] * b) == pytest.approx(np.sum(swept[1] * a), rel=1e-9)


def test_single_precision_keeps_what_data_add_to_strong_edges(rng):
    """A level known to 1 mm only, under edges known to a tenth of a micrometre."""
    n, m = 48, 40
    w = np.full((2, n, m), 1e8, np.float32)
    w[0, -1], w[1, :, -1] = 0, 0
    data = np.full((n, m), 1.0, np.float32)
    found, _ = Solver(System(w[0], w[1], data)).solve(np.full((n, m), 0.5, np.float32), 1e-4)
    np.testing.assert_allclose(found, 0.5, atol=1e-3)


def test_a_cell_without_any_equation_keeps_its_start(rng):
    system = weights_of_four_decades(rng, 20, 15, False)
    for w in (system.w_theta, system.w_z):
        w[9:11, 6:9] = 0
    system.data[10, 7] = 0
    system.w_z[10, 6] = 0
    residual = rng.normal(size=(20, 15))
    residual[10, 7] = 0
    found, _ = Solver(system).solve(residual, 1e-6)
    assert found[10, 7] == 0
    assert np.isfinite(found).all()
