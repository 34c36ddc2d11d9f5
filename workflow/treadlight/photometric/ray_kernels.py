"""Where viewing rays meet a height field, compiled; `scene` says what is what.

A ray walks by half a cell from the largest radius on, to the first step below the surface. Steps
that stay above the highest surface around them (`SurfacePatch.tops`) meet nothing and are left
out; so are those above all that the rays of a square of neighbouring pixels could meet. What a ray
meets depends on itself alone.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.height_field import atan, crossings, sample, top

# Cells along a side of the blocks whose tops are known.
BLOCKS = (8, 64)
# Pixels along a side of the squares whose rays start together; they have to stay within so many
# cells of the middle one's, and to see at most so many a side on their last way to the surface.
_SQUARE, _CLOSE, _WIDEST = 4, 4.0, 32.0
# Cells that rays between others are allowed to lie beside them at the same radius: far more than
# lenses and grids bend over a square.
_BEND = 1.0
_MAX_STEPS = 4096
# Fewer steps are not worth asking whether they can be left out.
_FEW = 2.0
# Heights over the surface are found to a nanometre: far less than its single precision.
_TOLERANCE_MM, _MAX_REFINEMENTS = 1e-6, 24


@kernel
def squares(width, pixels):
    """How many rows and columns of squares there are among pixels of so many a row."""
    rows = (pixels + width - 1) // width
    return (rows + _SQUARE - 1) // _SQUARE, (width + _SQUARE - 1) // _SQUARE


@kernel
def cast(
    first, last, r, tops, phi_0, step_phi, z_0, step_z, r_min, r_max, cell,
    origin, directions, width, found,
):  # fmt: skip
    """First hits of rays, as `scene.cast` gives them, into found (n, 3).

    Of squares first to last - 1, row by row; see `squares`.
    """
    across = squares(width, len(directions))[1]
    field = (phi_0, step_phi, z_0, step_z, r_min, r_max, cell)
    for square in range(first, last):
        row, column = square // across * _SQUARE, square % across * _SQUARE
        level = _clear_level(r, tops, field, origin, directions, width, row, column)
        for v in range(row, row + _SQUARE):
            begin, end = v * width + column, min((v + 1) * width, len(directions))
            for k in range(begin, min(begin + _SQUARE, end)):
                _cast_one(r, tops, field, origin, directions[k], level, found[k])


@kernel
def _clear_level(r, tops, field, origin, directions, width, row, column):
    """A radius above which no ray of a square meets the surface; infinite if none is known."""
    first = row * width + column
    last = first + (_SQUARE - 1) * width
    if column + _SQUARE > width or last + _SQUARE > len(directions):
        return np.inf
    middle = first + _SQUARE // 2 * (width + 1)
    place, span, steps, known = _enter(field, origin, directions[middle])
    if not known:
        return np.inf
    corners = (
        _enter(field, origin, directions[first]),
        _enter(field, origin, directions[first + _SQUARE - 1]),
        _enter(field, origin, directions[last]),
        _enter(field, origin, directions[last + _SQUARE - 1]),
    )
    reach = _reach(place, span, corners)
    if not reach <= _CLOSE:
        return np.inf
    advance = _cells_per_step(place, field[4], span, steps)
    begin = _first_doubtful(tops, place, span, steps, advance, reach)
    level, low = _level(place, begin * (span / steps)), field[4]
    at, _, _ = _first_below(r, tops, place, span, steps, advance, begin)
    if at >= 0:
        low = max(low, _level(place, at * (span / steps)))
    return min(level, max(low, _highest(r, corners, level, low)))


@kernel
def _reach(place, span, corners):
    """How many cells off the middle one's the rays of a square are, at any radius."""
    reach = 0.0
    row, column, _ = _at(place, 0.0)
    last_row, last_column, _ = _at(place, span)
    for corner, its_span, _, known in corners:
        if not known:
            return np.inf
        its_row, its_column, _ = _at(corner, 0.0)
        reach = max(reach, abs(its_row - row), abs(its_column - column))
        its_row, its_column, _ = _at(corner, its_span)
        reach = max(reach, abs(its_row - last_row), abs(its_column - last_column))
    return reach + _BEND


@kernel
def _first_doubtful(tops, place, span, steps, cells_per_step, reach):
    """Number of the first step from which rays so many cells beside might meet something."""
    near, far = (BLOCKS[0] - reach) / cells_per_step, (BLOCKS[1] - reach) / cells_per_step
    step, fall = span / steps, _fall(place, span, steps)
    i = 0
    while i < steps:
        row, column, level = _at(place, i * step)
        clear = min((level - top(tops[1], BLOCKS[1], row, column)) / fall, far)
        if not clear >= 1.0:
            clear = min((level - top(tops[0], BLOCKS[0], row, column)) / fall, near)
        if not clear >= 1.0:
            break
        i += int(min(clear, steps))
    return min(i, steps)


@kernel
def _highest(r, corners, level, low):
    """Highest surface that the rays of a square pass over from one radius down to another.

    Infinite where these are too many cells, or none can be told.
    """
    first_row = first_column = np.inf
    last_row = last_column = -np.inf
    for corner, _, _, _ in corners:
        for radius in (level, low):
            t, _ = crossings(corner[4], 0.0, corner[7], corner[8], radius)
            if math.isnan(t):
                return np.inf
            row, column, _ = _at(corner, t)
            first_row, last_row = min(first_row, row), max(last_row, row)
            first_column, last_column = min(first_column, column), max(last_column, column)
    if max(last_row - first_row, last_column - first_column) > _WIDEST:
        return np.inf
    highest = -np.inf
    j = max(int(first_column - _BEND), 0)
    end = min(int(last_column + _BEND) + 2, r.shape[1])
    for i in range(max(int(first_row - _BEND), 0), min(int(last_row + _BEND) + 2, r.shape[0])):
        for value in r[i, j:end]:
            highest = value if value > highest else highest
    return highest


@kernel
def _cast_one(r, tops, field, origin, ray, level, found):
    """First hit of a ray, which meets nothing above a radius."""
    place, span, steps, _ = _enter(field, origin, ray)
    if span < 0.0:
        return
    advance = _cells_per_step(place, field[4], span, steps)
    begin = _last_above(place, span, steps, level)
    at, above, below = _first_below(r, tops, place, span, steps, advance, begin)
    if at < 0 or (at > 0 and math.isnan(above)):
        return
    step = span / steps
    t = 0.0 if at == 0 else _meet(r, place, (at - 1) * step, above, at * step, below)
    _, _, _, _, start, phi, z, radial, tangential, dz = place
    x, y = start + t * radial, t * tangential
    found[0] = phi + math.atan(y / x)
    found[1] = z + t * dz
    found[2] = math.sqrt(x * x + y * y)


@kernel
def _enter(field, origin, ray):
    """A ray from the largest radius on.

    Its place (see `_at`), the parameter at which it ends, negative if it never enters, its steps
    until there, and whether it reaches the least radius.
    """
    phi_0, step_phi, z_0, step_z, r_min, r_max, cell = field
    x0, y0, zc = origin
    dx, dy, dz = ray
    enter, leave = crossings(x0, y0, dx, dy, r_max)
    bottom, _ = crossings(x0, y0, dx, dy, r_min)
    reaches = not math.isnan(bottom)
    # At the latest where it is nearest to the axis: until there a ray only descends.
    span = (bottom if reaches else 0.5 * (enter + leave)) - enter
    # The local frame at the entry keeps angles small.
    ex, ey, z = x0 + enter * dx, y0 + enter * dy, zc + enter * dz
    c, s = ex / r_max, ey / r_max
    radial, tangential = c * dx + s * dy, c * dy - s * dx
    phi, rows, columns = math.atan2(ey, ex), 1.0 / step_phi, 1.0 / step_z
    place = (
        (phi - phi_0) * rows, rows, (z - z_0) * columns, dz * columns, r_max, phi, z,
        radial, tangential, dz,
    )  # fmt: skip
    if not enter > 0.0:
        return place, -1.0, 1, False
    lateral = span * math.sqrt(tangential * tangential + dz * dz)
    return place, span, min(_MAX_STEPS, 4 + int(2.0 * lateral / cell)), reaches


@kernel(inline="always")
def _at(place, t):
    """Row, column and radius of a ray's point."""
    row, rows, column, columns, start, _, _, radial, tangential, _ = place
    x, y = start + t * radial, t * tangential
    return row + rows * atan(y / x), column + columns * t, math.sqrt(x * x + y * y)


@kernel(inline="always")
def _level(place, t):
    """Radius of a ray's point."""
    x, y = place[4] + t * place[7], t * place[8]
    return math.sqrt(x * x + y * y)


@kernel(inline="always")
def _fall(place, span, steps):
    """How much a ray descends in a step, at most: it falls ever more slowly."""
    return abs(place[7]) * span / steps


@kernel
def _last_above(place, span, steps, level):
    """Number of the last step above a radius, 0 if there is none."""
    t, _ = crossings(place[4], 0.0, place[7], place[8], level)
    return int(min(t / span, 1.0) * steps) if t > 0.0 and span > 0.0 else 0


@kernel(inline="always")
def _gap(r, place, t):
    """Height of a ray's point over the surface below it, mm."""
    row, column, level = _at(place, t)
    return level - sample(r, row, column)


@kernel
def _cells_per_step(place, r_min, span, steps):
    """How many rows or columns a ray advances in a step, at most; infinite where nobody knows."""
    _, rows, _, columns, start, _, _, radial, tangential, _ = place
    x, y = start - span * abs(radial), span * abs(tangential)
    if not (x > y and r_min > 0.0):
        return np.inf
    turn = (abs(tangential) * start + abs(radial) * y) / (r_min * r_min)
    # The series of the arc tangent rises faster than itself, by this.
    ratio2 = (y / x) ** 2
    turn *= 1.0 + ratio2 * ratio2 * ratio2 * ratio2 * ratio2
    return max(turn * rows, abs(columns)) * (span / steps)


@kernel
def _first_below(r, tops, place, span, steps, cells_per_step, begin):
    """Number of the first step from one on that is at or below the surface, -1 if none is.

    With the ray's heights over the surface a step before and there.
    """
    near, far = BLOCKS[0] / cells_per_step, BLOCKS[1] / cells_per_step
    step, fall = span / steps, _fall(place, span, steps)
    i, last, before = begin, -1, np.nan
    while i <= steps:
        row, column, level = _at(place, i * step)
        gap = level - sample(r, row, column)
        if gap <= 0.0:
            if last != i - 1:
                before = _gap(r, place, (i - 1) * step)
            return i, before, gap
        last, before = i, gap
        i += 1
        # What lies ahead is asked only where there is room to leave steps out.
        if not gap < 2.0 * _FEW * fall:
            if math.isnan(gap) and _is_gone(r, place, row, column):
                break
            clear = min((level - top(tops[1], BLOCKS[1], row, column)) / fall, far)
            if not clear >= _FEW:
                clear = min((level - top(tops[0], BLOCKS[0], row, column)) / fall, near)
            if clear >= _FEW:
                i += int(min(clear, steps)) - 1
    return -1, np.nan, np.nan


@kernel
def _is_gone(r, place, row, column):
    """Whether a ray has left the grid for good."""
    tangential, dz = place[8], place[9]
    beside = row < 0.0 if tangential < 0.0 else row > r.shape[0] - 1
    return beside or (column < 0.0 if dz < 0.0 else column > r.shape[1] - 1)


@kernel
def _meet(r, place, low, above, high, below):
    """The ray's parameter at the surface, between a point above and one below (Illinois)."""
    t = high
    side = 0
    for _ in range(_MAX_REFINEMENTS):
        t = (low * below - high * above) / (below - above)
        gap = _gap(r, place, t)
        if abs(gap) < _TOLERANCE_MM:
            break
        if gap > 0.0:
            low, above = t, gap
            below = 0.5 * below if side > 0 else below
            side = 1
        else:
            # Where the surface is unknown, the point counts as below it: its edge is looked for.
            high, below = t, gap if gap <= 0.0 else -above
            above = 0.5 * above if side < 0 else above
            side = -1
    return t
