from itertools import pairwise

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg

from treadlight import threads
from treadlight.integrate import kernels
from treadlight.integrate.coarsening import prolong, restrict_defect
from treadlight.integrate.kernels import multiply, relax_lines, relax_points
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


@pytest.mark.parametrize("shape", [(61, 40), (64, 31)])
@pytest.mark.parametrize("periodic", [False, True])
def test_the_same_heights_on_any_number_of_cores(rng, monkeypatch, shape, periodic):
    # Otherwise one core takes so small a grid as a whole.
    monkeypatch.setattr(kernels, "_LEAST_CELLS", 1)
    system = weights_of_four_decades(rng, *shape, periodic)
    residual = rng.normal(size=shape)
    before = threads.cores()
    found = []
    try:
        for count in (1, 2, 3):
            threads.use_cores(count)
            found.append(Solver(system).solve(residual.copy(), 1e-6)[0])
    finally:
        threads.use_cores(before)
    assert all(np.array_equal(found[0], other) for other in found)


def restricted(level, coarse_shape, fine):
    out = np.empty(coarse_shape)
    restrict_defect(level.stencil, np.zeros_like(fine), fine, out)
    return out


def test_the_defect_is_what_the_heights_leave_of_the_right_hand_side(rng):
    for level in Solver(weights_of_four_decades(rng, 33, 40, True))._levels[:-1]:
        x, rhs, product = rng.normal(size=(3, *level.x.shape))
        multiply(level.stencil, x, product)
        shape = [(size + 1) // 2 for size in x.shape]
        out = np.empty(shape)
        restrict_defect(level.stencil, x, rhs, out)
        expected = restricted(level, shape, rhs - product)
        np.testing.assert_allclose(out, expected, rtol=0, atol=1e-12 * np.abs(product).max())


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


def sides_of(stencil, j):
    """What the cells of column j are coupled to in the columns to its left and right, (2, n)."""
    n, m = stencil.data.shape
    left, right = stencil.right[:, j - 1].copy(), np.zeros(n)
    if j + 1 < m:
        right += stencil.right[:, j]
    if stencil.below_right.size:
        left += stencil.below_left[:, j] + np.roll(stencil.below_right[:, j - 1], 1)
        if j + 1 < m:
            right += stencil.below_right[:, j] + np.roll(stencil.below_left[:, j + 1], 1)
    return np.array([left, right])


def interpolated(level, coarse):
    """P times coarse values: odd columns solved for as if those beside them were constant."""
    stencil, fine = level.stencil, prolonged(level, coarse)
    m = fine.shape[1]
    for j in range(1, m, 2):
        sides = sides_of(stencil, j)
        along = stencil.below[:-1, j]
        diagonal = sides.sum(axis=0) + stencil.data[:, j]
        diagonal[:-1] += along
        diagonal[1:] += along
        line = np.diag(diagonal) - np.diag(along, 1) - np.diag(along, -1)
        closing = stencil.below[-1, j]
        line[[0, -1], [0, -1]] += closing
        line[[0, -1], [-1, 0]] -= closing
        follow = np.linalg.solve(line, sides.T)
        beside = fine[:, [j - 1, min(j + 1, m - 1)]]
        fine[:, j] = (follow * beside).sum(axis=1)
    return fine


@pytest.mark.parametrize("shape", SHAPES)
def test_coarse_matrices_are_the_galerkin_products(rng, shape):
    levels = Solver(weights_of_four_decades(rng, *shape, True))._levels
    for fine, coarse in pairwise(levels):
        x, y = rng.normal(size=(2, *coarse.x.shape))
        product, found = np.empty(fine.x.shape), np.empty(x.shape)
        multiply(fine.stencil, interpolated(fine, x), product)
        multiply(coarse.stencil, x, found)
        expected = np.sum(product * interpolated(fine, y))
        scale = np.abs(product * interpolated(fine, y)).sum()
        assert np.sum(found * y) == pytest.approx(expected, abs=1e-10 * scale)


@pytest.mark.parametrize("shape", SHAPES)
def test_relaxing_forth_and_back_is_symmetric(rng, shape):
    for level in Solver(weights_of_four_decades(rng, *shape, True))._levels:
        relaxed = []
        a, b = rng.normal(size=(2, *level.x.shape))
        n, m = level.x.shape
        follow = np.empty((n, m // 2))
        for rhs in (a, b):
            x = np.zeros_like(rhs)
            relax_points(level.stencil, x, rhs, False)
            relax_lines(level.stencil, level.ring, x, rhs, follow)
            relax_lines(level.stencil, level.ring, x, rhs, follow)
            relax_points(level.stencil, x, rhs, True)
            relaxed.append(x)
        assert np.sum(relaxed[0] * b) == pytest.approx(np.sum(relaxed[1] * a), rel=1e-9)


@pytest.mark.parametrize("periodic", [False, True])
def test_a_relaxed_odd_column_has_no_defect(rng, periodic):
    system = weights_of_four_decades(rng, 41, 18, periodic)
    level = Solver(system)._levels[0]
    x, rhs = rng.normal(size=(2, 41, 18))
    relax_lines(level.stencil, level.ring, x, rhs, np.empty((41, 9)))
    defect = rhs.ravel() - as_matrix(system) @ x.ravel()
    assert np.abs(defect.reshape(41, 18)[:, 1::2]).max() < 1e-9


def test_strips_cut_off_on_both_sides_take_no_more_iterations(rng):
    """A wall's cells, rigid along theta, between edges that are as good as cut."""
    w = np.full((2, 200, 60), 300.0)
    for strip in (7, 20, 33, 45):
        w[1, :, strip - 1 : strip + 1] = 1e-4
        w[0, :, strip] = 5e3
    w[0, -1], w[1, :, -1] = 0, 0
    data = np.full((200, 60), 3e-3)
    data[::50] = 100.0
    _, iterations = Solver(System(w[0], w[1], data)).solve(rng.normal(size=(200, 60)), 1e-6)
    assert iterations < 15


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
