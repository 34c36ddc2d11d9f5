import numpy as np
import pytest

from treadlight.laser import Candidates, LineModel, select_path
from treadlight.laser.path import cheapest_path

MODEL = LineModel(2.0, 0.0, 1e-3, 0.1, 0.1, 1.0, np.eye(3), np.ones(3), np.zeros(4))


def candidates(u, strength, width=None):
    u = np.asarray(u, np.float32)
    strength = np.where(np.isfinite(u), strength, np.nan).astype(np.float32)
    width = np.full(u.shape, 2.0) if width is None else np.asarray(width, float)
    nothing = np.zeros(u.shape, np.float32)
    flags = np.zeros(len(u), np.uint8)
    return Candidates(u, nothing, width, strength, nothing, flags, nothing > 0)


def test_path_stays_on_the_line_where_a_reflection_is_brighter():
    line, ghost = np.full(60, 40.0), np.full(60, 55.0)
    u = np.column_stack(
        [line, np.where((np.arange(60) > 20) & (np.arange(60) < 26), ghost, np.nan)]
    )
    found = candidates(u, [1.0, 1.6])
    assert np.all(select_path(found, MODEL) == 0)


def test_path_follows_a_groove_wall():
    u = np.where((np.arange(80) // 20) % 2 == 0, 40.0, 33.0)[:, None]
    assert np.all(select_path(candidates(u, [1.0]), MODEL) == 0)


def test_implausible_speck_of_a_row_is_left_empty_and_dark_rows_are_empty():
    u = np.full((60, 1), 40.0)
    u[30] = 80.0
    u[45:50] = np.nan
    width = np.full((60, 1), 2.0)
    width[30] = 0.002
    path = select_path(candidates(u, [1.0], width), MODEL)
    assert path[30] == -1
    assert np.all(path[45:50] == -1)
    assert np.all(np.delete(path, [30, *range(45, 50)]) == 0)


@pytest.mark.parametrize("seed", range(5))
def test_compiled_path_is_as_cheap_as_an_exhaustive_search(seed):
    rng = np.random.default_rng(seed)
    own, u = rng.uniform(0, 3, (5, 2)), rng.uniform(0, 12, (5, 2))
    own[2, 1] = np.inf

    def cost(states):
        total, last = 0.0, None
        for v, k in enumerate(states):
            here = None if k < 0 else u[v, k]
            total += 6.0 if k < 0 else own[v, k]
            if v and here is not None and last is not None:
                total += min(0.5 * ((here - last) / 2) ** 2, 4.0)
            elif (here is None) != (last is None):
                total += 2.0
            last = here
        return total

    every = np.stack(np.meshgrid(*[[-1, 0, 1]] * 5), -1).reshape(-1, 5)
    # Before the first row there is an empty one.
    best = min(cost(s) for s in every)
    found = cheapest_path(own, u, 2.0, 4.0, 6.0)
    assert cost(found) == pytest.approx(best)
