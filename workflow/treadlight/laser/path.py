"""Which candidate of each row is the line: the cheapest path along the rows."""

import numpy as np

from treadlight.compiling import kernel
from treadlight.laser.detection import Candidates, LineModel

# Costs are natural logarithms of likelihood ratios.
# A step as it occurs at a groove wall: a tread has some ten walls in several hundred rows.
_STEP_COST = 4.0
# Leaving a row empty although it has a candidate: dearer than a step to and from it, so that
# rows are dropped only where their candidates are implausible in themselves.
_EMPTY_COST = 6.0


def select_path(found: Candidates, model: LineModel) -> np.ndarray:
    """Index of the candidate that is the line, row by row, -1 where none is (Viterbi's algorithm).

    A candidate costs the logarithm of how much weaker it is than the row's strongest and how
    far its width is from the line's; a move between rows costs its square in widths of the
    line, at most a step's price. An empty row forgets the position.

    Parameters
    ----------
    found : Candidates
    model : LineModel

    Returns
    -------
    (lines,) int8
    """
    strongest = np.nanmax(np.where(np.isfinite(found.strength), found.strength, 0), axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        weaker = np.log(strongest[:, None] / found.strength)
        broader = np.abs(np.log(np.hypot(found.width, model.blur_px) / model.sigma_px))
    own = np.where(np.isfinite(found.u), weaker + broader, np.inf)
    return cheapest_path(
        own.astype(np.float64), found.u.astype(np.float64), model.sigma_px, _STEP_COST, _EMPTY_COST
    )


@kernel(allocates=True)
def cheapest_path(own, u, sigma_px, step_cost, empty_cost):
    """Viterbi over rows; the state after the last peak is the empty row.

    Parameters
    ----------
    own : (lines, peaks) float64
        Cost of each candidate, inf where there is none.
    u : (lines, peaks) float64
        Positions, px.
    sigma_px, step_cost, empty_cost : float

    Returns
    -------
    (lines,) int8
        -1 for an empty row.
    """
    lines, peaks = own.shape
    total = np.full(peaks + 1, np.inf)
    total[peaks] = 0.0
    back = np.full((lines, peaks + 1), peaks, np.int8)
    for v in range(lines):
        now = np.full(peaks + 1, np.inf)
        for k in range(peaks + 1):
            if k < peaks and not own[v, k] < np.inf:
                continue
            for j in range(peaks + 1):
                if not total[j] < np.inf:
                    continue
                move = 0.5 * step_cost
                if k < peaks and j < peaks:
                    off = (u[v, k] - u[v - 1, j]) / sigma_px
                    move = min(0.5 * off * off, step_cost)
                elif k == peaks and j == peaks:
                    move = 0.0
                if total[j] + move < now[k]:
                    now[k] = total[j] + move
                    back[v, k] = j
            if k < peaks:
                now[k] += own[v, k]
            elif own[v].min() < np.inf:
                now[k] += empty_cost
        total = now
    chosen = np.full(lines, -1, np.int8)
    state = np.argmin(total)
    for v in range(lines - 1, -1, -1):
        chosen[v] = state if state < peaks else -1
        state = back[v, state]
    return chosen
