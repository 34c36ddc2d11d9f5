"""Peaks across the laser line and their zero crossings in sub-pixels, compiled."""

import math

import numpy as np

from treadlight.compiling import kernel

PEAKS = 4
"""Candidates kept per row: the line, and up to three reflections or neighbouring stripes."""

# Second peaks below this share of the first do not make a row ambiguous.
RIVAL_SHARE = 0.2
# Zero crossings are found to this: far below what any line shows.
_TOLERANCE_PX, _MOST_SECANTS = 1e-5, 40
# Full width at half maximum of a Gaussian, in sigmas.
FWHM = 2.3548
# The core of the line: filters of this many nodes (1.5 sigma) see nothing of its flanks.
_CORE_NODES = 3
# Wide and core filter may differ by this many standard deviations of the core's.
_DISAGREEMENT_SIGMA = 3.0


@kernel(allocates=True)
def find_peaks(across, threshold, apart):
    """Columns of the strongest local maxima of each row.

    4 bytes read and about 3 operations per pixel.

    Parameters
    ----------
    across : (h, w) float32
        Smoothed intensity.
    threshold : float
        Peaks below do not count.
    apart : float
        Of peaks closer than this, px, the weaker is dropped.

    Returns
    -------
    (h, PEAKS) int32
        Strongest first, -1 where there are fewer.
    """
    h, w = across.shape
    found = np.full((h, PEAKS), -1, np.int32)
    for v in range(h):
        row = across[v]
        for u in range(1, w - 1):
            value = row[u]
            if value < threshold or value < row[u - 1] or value <= row[u + 1]:
                continue
            _insert(found[v], row, u, apart)
    return found


@kernel
def _insert(found, row, u, apart):
    """Put the peak at column `u` into the list, strongest first; rivals too close give way."""
    for k in range(len(found)):
        if found[k] >= 0 and abs(found[k] - u) < apart and row[found[k]] >= row[u]:
            return
    kept = 0
    for k in range(len(found)):
        if found[k] >= 0 and abs(found[k] - u) >= apart:
            found[kept] = found[k]
            kept += 1
    found[kept:] = -1
    place = 0
    while place < len(found) and found[place] >= 0 and row[found[place]] >= row[u]:
        place += 1
    if place == len(found):
        return
    for k in range(len(found) - 1, place, -1):
        found[k] = found[k - 1]
    found[place] = u


@kernel(allocates=True)
def with_integral(weights, node_px):
    """Filters (m, n) at the nodes from the middle to one past the last, and their integrals.

    (2, m, n + 2): what lies between is linear in the first, and its integral from the middle, px,
    quadratic.
    """
    count, nodes = weights.shape
    taps = np.zeros((2, count, nodes + 2))
    for m in range(count):
        for k in range(nodes + 1):
            if k < nodes:
                taps[0, m, k + 1] = weights[m, k]
            mean = 0.5 * (taps[0, m, k] + taps[0, m, k + 1])
            taps[1, m, k + 1] = taps[1, m, k] + node_px * mean
    return taps


@kernel
def _integral(x, weight, integral, node_px):
    """Of the filter from its middle to x >= 0, px."""
    last = len(weight) - 1
    at = min(x / node_px, float(last))
    k = min(int(at), last - 1)
    share = at - k
    rise = weight[k] + 0.5 * share * (weight[k + 1] - weight[k])
    return integral[k] + node_px * share * rise


@kernel
def filter_response(row, centre, weight, integral, nodes, node_px):
    """Antisymmetric filter at a sub-pixel centre: positive where the light lies to the right.

    A pixel counts by the filter's mean over it: one that only its middle is weighed by would
    feel where in its pixel a narrow line is.
    """
    reach = (nodes + 1) * node_px + 0.5
    low = max(0, math.ceil(centre - reach))
    high = min(len(row) - 1, math.floor(centre + reach))
    total = 0.0
    before = _integral(abs(low - 0.5 - centre), weight, integral, node_px)
    for u in range(low, high + 1):
        after = _integral(abs(u + 0.5 - centre), weight, integral, node_px)
        total += (after - before) * row[u]
        before = after
    return total


@kernel
def _gain(centre, weight, integral, nodes, node_px):
    """Root of the sum of the squared weights at a centre."""
    reach = (nodes + 1) * node_px + 0.5
    total = 0.0
    low = math.ceil(centre - reach)
    before = _integral(abs(low - 0.5 - centre), weight, integral, node_px)
    for u in range(low, math.floor(centre + reach) + 1):
        after = _integral(abs(u + 0.5 - centre), weight, integral, node_px)
        total += (after - before) ** 2
        before = after
    return math.sqrt(total)


@kernel
def zero_crossing(row, start, weight, integral, nodes, node_px, search):
    """Where the filter's response falls through zero within `search` px of `start`.

    Returns the position and the slope of the response there (per px, negative), or NaN.
    """
    low, high = start - search, start + search
    at_low = filter_response(row, low, weight, integral, nodes, node_px)
    at_high = filter_response(row, high, weight, integral, nodes, node_px)
    if not (at_low > 0.0 and at_high < 0.0):
        return np.nan, np.nan
    # The Illinois method: secants that cannot leave the bracket.
    centre, side = start, 0
    for _ in range(_MOST_SECANTS):
        before = centre
        centre = (low * at_high - high * at_low) / (at_high - at_low)
        if abs(centre - before) < _TOLERANCE_PX:
            break
        response = filter_response(row, centre, weight, integral, nodes, node_px)
        if response > 0.0:
            low, at_low = centre, response
            at_high = 0.5 * at_high if side > 0 else at_high
            side = 1
        else:
            high, at_high = centre, response
            at_low = 0.5 * at_low if side < 0 else at_low
            side = -1
    step = 0.5 * node_px
    ahead = filter_response(row, centre + step, weight, integral, nodes, node_px)
    behind = filter_response(row, centre - step, weight, integral, nodes, node_px)
    return centre, (ahead - behind) / (2 * step)


@kernel
def _crossing_with_std(row, start, taps, std_px, nodes, node_px, search, noise):
    weight, integral = taps[0, nodes - 1], taps[1, nodes - 1]
    centre, slope = zero_crossing(row, start, weight, integral, nodes, node_px, search)
    if np.isnan(centre) or not slope < 0.0:
        return np.nan, np.inf
    additive = noise * _gain(centre, weight, integral, nodes, node_px) / -slope
    return centre, math.sqrt(std_px[nodes - 1] ** 2 + additive**2)


@kernel
def _best_crossing(row, start, taps, std_px, nodes, node_px, search, noise):
    """The crossing of the filter with the least variance; of the core where the flanks mislead.

    The wide filters weigh the line's flanks, which a wall's reflection spoils first: where
    wide and core disagree by more than their noise allows, the core is right (a Hausman test).
    """
    core, core_std = _crossing_with_std(
        row, start, taps, std_px, _CORE_NODES, node_px, search, noise
    )
    best, best_std = core, core_std
    for m in range(_CORE_NODES + 1, nodes + 1):
        centre, spread = _crossing_with_std(row, start, taps, std_px, m, node_px, search, noise)
        if spread < best_std:
            best, best_std = centre, spread
    if not np.isnan(core) and abs(best - core) > _DISAGREEMENT_SIGMA * core_std:
        return core, core_std
    return best, best_std


@kernel
def _half_width(row, centre, level, direction):
    """Distance from the centre to where the row falls below `level`, px, linear between."""
    u = math.floor(centre) if direction < 0 else math.ceil(centre)
    while 0 <= u < len(row) and row[u] >= level:
        u += direction
    if u < 0 or u >= len(row):
        return abs(u - centre)
    inner = u - direction
    if inner < 0 or inner >= len(row) or row[inner] <= row[u]:
        return abs(u - centre)
    share = (row[inner] - level) / (row[inner] - row[u])
    return max(0.0, abs(inner - centre + direction * min(max(share, 0.0), 1.0)))


@kernel(allocates=True)
def refine_peaks(smooth, found, saturated, weights, std_px, node_px, sigma_px, noise):
    """Sub-pixel position, its standard deviation, width, strength and skew of found peaks.

    About 20 filter evaluations of 8 sigma taps per peak; nothing per pixel.

    Each peak takes the widest filter that stays on its own side of the nearest rival, since
    a rival's flank inside the filter would pull the position.
    """
    h, w = smooth.shape
    shape = found.shape
    u_out = np.full(shape, np.nan, np.float32)
    std_out = np.full(shape, np.nan, np.float32)
    width_out = np.full(shape, np.nan, np.float32)
    strength_out = np.full(shape, np.nan, np.float32)
    skew_out = np.full(shape, np.nan, np.float32)
    clipped_out = np.zeros(shape, np.bool_)
    all_nodes = len(std_px)
    taps = with_integral(weights, node_px)
    for v in range(h):
        row = smooth[v]
        kept = 0
        for k in range(shape[1]):
            at = found[v, k]
            if at < 0:
                break
            clear = min(float(at), float(w - 1 - at))
            search = 1.5 * sigma_px
            for other in range(shape[1]):
                rival = found[v, other]
                if rival < 0 or other == k or row[rival] < RIVAL_SHARE * row[at]:
                    continue
                half = 0.5 * abs(rival - at)
                clear = min(clear, half)
                search = min(search, 0.5 * half)
            nodes = min(all_nodes, max(_CORE_NODES, int(clear / node_px) - 1))
            centre, spread = _best_crossing(
                row, float(at), taps, std_px, nodes, node_px, search, noise
            )
            if np.isnan(centre):
                continue
            level = 0.5 * row[at]
            left = _half_width(row, centre, level, -1)
            right = _half_width(row, centre, level, 1)
            u_out[v, kept] = centre
            std_out[v, kept] = spread
            width_out[v, kept] = (left + right) / FWHM
            strength_out[v, kept] = row[at]
            skew_out[v, kept] = (left - right) / max(left + right, 1e-6)
            reach = max(1, int(sigma_px))
            for u in range(max(0, at - reach), min(w, at + reach + 1)):
                clipped_out[v, kept] |= saturated[v, u]
            kept += 1
    return u_out, std_out, width_out, strength_out, skew_out, clipped_out
