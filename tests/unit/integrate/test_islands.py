"""Cells that only weak edges hold, whose levels no coarse grid knows."""

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg
from scipy.sparse.csgraph import connected_components

from treadlight.integrate import islands as module
from treadlight.integrate.islands import _MOST_CELLS, _STRONG, islands_of
from treadlight.integrate.kernels import Stencil, multiply
from treadlight.integrate.multigrid import Solver, System

WHOLE, CUT = 1000.0, 0.01


def stencil_of(w_theta, w_z, data):
    empty = np.empty((0, 0), data.dtype)
    return Stencil(w_z, w_theta, empty, empty, data)


def field_with(masks, shape, periodic=False):
    """Whole edges but for those between a mask and what is around it, as (w_theta, w_z, data)."""
    w = np.full((2, *shape), WHOLE)
    for mask in masks:
        for axis in range(2):
            w[axis][mask != np.roll(mask, -1, axis)] = CUT
    if not periodic:
        w[0, -1] = 0
    w[1, :, -1] = 0
    return w[0], w[1], np.full(shape, 0.1)


def block(shape, rows, columns):
    mask = np.zeros(shape, bool)
    mask[rows, columns] = True
    return mask


def partition(islands, size):
    label = np.full(size, -1)
    for k, (first, last) in enumerate(zip(islands.first[:-1], islands.first[1:], strict=True)):
        label[islands.cells[first:last]] = k
    return label


def components_of(w_theta, w_z):
    """The same by scipy: label of each cell's component and its size."""
    n, m = w_theta.shape
    sides = (w_theta, np.roll(w_theta, 1, 0), w_z, np.roll(w_z, 1, 1))
    strongest = np.maximum.reduce(sides)
    index = np.arange(n * m).reshape(n, m)
    pairs = []
    for axis, w in enumerate((w_theta, w_z)):
        either = np.maximum(strongest, np.roll(strongest, -1, axis))
        strong = (w > 0) & (w >= _STRONG * either)
        pairs.append(np.stack([index[strong], np.roll(index, -1, axis)[strong]]))
    a, b = np.concatenate(pairs, axis=1)
    graph = sp.coo_array((np.ones(len(a)), (a, b)), shape=(n * m, n * m))
    label = connected_components(graph, directed=False)[1]
    return label, np.bincount(label)[label]


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_islands_are_the_components_that_strong_edges_join(rng, monkeypatch, periodic, share):
    monkeypatch.setattr(module, "_CELLS_PER_ISLAND", 1)
    shape = (61, 43)
    w = np.where(rng.random((2, *shape)) < share, WHOLE, CUT) * rng.uniform(0.5, 1, (2, *shape))
    if not periodic:
        w[0, -1] = 0
    w[1, :, -1] = 0
    found = partition(islands_of(stencil_of(w[0], w[1], np.ones(shape))), w[0].size)
    label, size = components_of(*w)
    small = (size > 1) & (size <= _MOST_CELLS)
    np.testing.assert_array_equal(found >= 0, small)
    together = {(a, b) for a, b in zip(found[small], label[small], strict=True)}
    assert len(together) == len(set(found[small])) == len(set(label[small]))


def test_an_island_across_the_turns_end_is_one():
    shape = (40, 40)
    mask = block(shape, [38, 39, 0, 1], slice(3, 6))
    islands = islands_of(stencil_of(*field_with([mask], shape, periodic=True)))
    assert sorted(islands.cells) == list(np.flatnonzero(mask))


def test_a_correction_sets_an_island_to_its_level_at_once():
    shape = (40, 40)
    mask = block(shape, slice(7, 10), slice(4, 6))
    stencil = stencil_of(*field_with([mask], shape))
    islands = islands_of(stencil)
    # The island stands 5 mm above what is around it, which its data do not ask for.
    level = (mask.sum() * 0.1 + 10 * CUT) * 5.0
    rhs = np.where(mask, level / mask.sum(), 0.0)
    x = np.zeros(shape)
    islands.correct(stencil, x, rhs)
    np.testing.assert_allclose(x, np.where(mask, 5.0, 0.0), rtol=1e-12, atol=0)


def test_islands_stand_at_their_level_before_the_first_iteration():
    shape = (40, 40)
    mask = block(shape, slice(7, 10), slice(4, 6))
    solver = Solver(System(*field_with([mask], shape)))
    residual = np.empty(shape)
    multiply(solver._levels[0].stencil, np.where(mask, 5.0, 0.0), residual)
    found, _ = solver.solve(residual, 1e-9, 0)
    np.testing.assert_allclose(found, np.where(mask, 5.0, 0.0), atol=1e-9)


def test_what_nothing_holds_stays_where_it_is():
    shape = (40, 40)
    mask = block(shape, slice(4, 6), slice(4, 6))
    w_theta, w_z, data = field_with([mask], shape)
    w_theta[w_theta == CUT], w_z[w_z == CUT], data[mask] = 0, 0, 0
    islands = islands_of(stencil_of(w_theta, w_z, data))
    x, rhs = np.where(mask, 3.0, 1.0), 0.1 * ~mask
    islands.correct(stencil_of(w_theta, w_z, data), x, rhs)
    np.testing.assert_array_equal(x, np.where(mask, 3.0, 1.0))


def test_the_smallest_stay_out_where_there_would_be_too_many(rng):
    shape = (200, 200)
    w = np.where(rng.random((2, *shape)) < 0.4, WHOLE, CUT)
    w[0, -1], w[1, :, -1] = 0, 0
    found = islands_of(stencil_of(w[0], w[1], np.ones(shape)))
    sizes = np.diff(found.first)
    assert 0 < len(sizes) <= w[0].size // 64
    _, size = components_of(*w)
    every = np.bincount(size, minlength=_MOST_CELLS + 1) // np.maximum(
        np.arange(max(size.max(), _MOST_CELLS) + 1), 1
    )
    assert every[sizes.min() - 1 : _MOST_CELLS + 1].sum() > w[0].size // 64


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("tie", [CUT, CUT / 3])
def test_islands_that_only_each_other_hold_spoil_nothing(rng, count, tie):
    """No data and no edge around: the level of all of them is not known."""
    shape = (40, 40)
    patch = block(shape, slice(10, 16), slice(5, 5 + 3 * count))
    w_theta, w_z, data = field_with([patch], shape)
    w_theta[w_theta == CUT], w_z[w_z == CUT], data[patch] = 0, 0, 0
    for k in range(1, count):
        w_z[10:16, 4 + 3 * k] = tie
    truth = np.where(patch, 0.0, rng.normal(size=shape))
    system = System(w_theta, w_z, data)
    solver = Solver(system)
    assert len(solver._islands.first) == count + 1
    residual = np.empty(shape)
    multiply(solver._levels[0].stencil, truth, residual)
    found, _ = solver.solve(residual, 1e-6)
    np.testing.assert_allclose(found[~patch], truth[~patch], atol=1e-4)
    assert np.ptp(found[patch]) < 1e-6
    assert np.abs(found[patch]).max() < 1


@pytest.mark.parametrize("periodic", [False, True])
def test_many_islands_take_few_iterations(rng, periodic):
    """Three cells of an even column, which coarse cells take for what is beside them."""
    shape = (160, 120)
    masks = [
        block(shape, slice(row, row + 3), slice(column, column + 1))
        for row in range(4, 150, 12)
        for column in range(4, 110, 12)
    ]
    system = System(*field_with(masks, shape, periodic))
    truth = rng.normal(0, 1, shape)
    for mask in masks:
        truth[mask] += rng.normal(0, 5)
    n = truth.size
    index = np.arange(n).reshape(shape)
    matrix = sp.diags_array(system.data.ravel()).tocsc()
    for axis, w in enumerate((system.w_theta, system.w_z)):
        jump = sp.coo_array(
            (
                np.r_[np.full(n, 1.0), np.full(n, -1.0)],
                (np.r_[:n, :n], np.r_[np.roll(index, -1, axis).ravel(), index.ravel()]),
            ),
            shape=(n, n),
        ).tocsc()
        matrix += jump.T @ sp.diags_array(w.ravel()) @ jump
    residual = (matrix @ truth.ravel()).reshape(shape)
    direct = scipy.sparse.linalg.spsolve(matrix.tocsc(), residual.ravel()).reshape(shape)
    found, iterations = Solver(system).solve(residual.copy(), 1e-4)
    assert np.abs(found - direct).max() < 1e-3
    assert iterations <= 12
