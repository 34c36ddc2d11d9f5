"""Where viewing rays meet a height field, compiled; `scene` says what is what.

A ray walks by half a cell from the largest radius on, to the first step below the surface. Steps
that stay above the highest surface around them (`SurfacePatch.tops`) meet nothing and are left
out; so are those above all that the rays of a square of neighbouring pixels could meet. What a ray
meets depends on itself alone.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.height_field import angle, atan, crossings, sample, top

# Cells along a side of the blocks whose tops are known.
BLOCKS = (8, 64)
# Pixels along a side of the squares whose rays start together; they have to stay within so many
# cells of the middle one's, and to see at most so many a side on their last way to the surface.
_SQUARE, _CLOSE, _WIDEST = 4, 4.0, 32.0
_LANES, _MIDDLE = _SQUARE * _SQUARE, _SQUARE // 2 * (_SQUARE + 1)
_CORNERS = (0, _SQUARE - 1, _LANES - _SQUARE, _LANES - 1)
# Cells that rays between others are allowed to lie beside them at the same radius: far more than
# lenses and grids bend over a square.
_BEND = 1.0
_MAX_STEPS = 4096
# Fewer steps are not worth asking whether they can be left out.
_FEW = 2.0
# Heights over the surface are found to a nanometre: far less than its single precision.
_TOLERANCE_MM, _MAX_REFINEMENTS = 1e-6, 24

# Of the rays of a square, side by side: their directions in {V}, where they enter (row and column
# of the grid, columns per unit of the parameter, angle, z, and the direction along and across the
# radius there), their ends and steps, and what they meet. After `_tell`, `_ROW` holds the radius.
_DX, _DY, _DZ, _ROW, _COLUMN, _COLUMNS, _PHI, _Z, _RADIAL, _TANGENTIAL = range(10)
_SPAN, _STEPS, _KNOWN, _BEGIN, _HIT, _RAY = range(10, 16)


@kernel
def squares(width, pixels):
    """How many rows and columns of squares there are among pixels of so many a row."""
    rows = (pixels + width - 1) // width
    return (rows + _SQUARE - 1) // _SQUARE, (width + _SQUARE - 1) // _SQUARE


@kernel(allocates=True)
def cast(
    first, last, r, tops, phi_0, step_phi, z_0, step_z, r_min, r_max, cell,
    origin, directions, width, found,
):  # fmt: skip
    """First hits of rays, as `scene.cast` gives them, into found (n, 3).

    Of squares first to last - 1, row by row; see `squares`.
    """
    across = squares(width, len(directions))[1]
    field = (phi_0, step_phi, z_0, step_z, r_min, r_max, cell)
    rays = np.empty((_RAY, _LANES))
    for square in range(first, last):
        row, column = square // across * _SQUARE, square % across * _SQUARE
        _take(directions, width, row, column, rays)
        _enter(field, origin, rays)
        whole = row * width + width * (_SQUARE - 1) < len(directions) and column + _SQUARE <= width
        _begin(rays, r_max, _clear_level(r, tops, field, rays) if whole else np.inf)
        for lane in range(_LANES):
            rays[_HIT, lane] = _hit(r, tops, field, rays, lane)
        _tell(rays, r_max)
        _give(rays, width, row, column, found)


@kernel
def _take(directions, width, row, column, rays):
    """Directions of a square's rays; of pixels beside the image those of its last ones."""
    for lane in range(_LANES):
        v, u = row + lane // _SQUARE, column + lane % _SQUARE
        k = min(v * width + min(u, width - 1), len(directions) - 1)
        rays[_DX, lane], rays[_DY, lane], rays[_DZ, lane] = directions[k]


@kernel
def _enter(field, origin, rays):
    """All rays of a square from the largest radius on, side by side: their places there.

    `_SPAN` is the parameter at which one ends, negative if it never enters, `_STEPS` how many
    steps lie until there, `_KNOWN` is 1 if it reaches the least radius.
    """
    phi_0, step_phi, z_0, step_z, r_min, r_max, cell = field
    x0, y0, zc = origin[0], origin[1], origin[2]
    rows, columns, per_radius, per_cell = 1.0 / step_phi, 1.0 / step_z, 1.0 / r_max, 2.0 / cell
    beyond = x0 * x0 + y0 * y0
    high, low = beyond - r_max * r_max, beyond - r_min * r_min
    for k in range(_LANES):
        dx, dy, dz = rays[_DX, k], rays[_DY, k], rays[_DZ, k]
        a, b = dx * dx + dy * dy, x0 * dx + y0 * dy
        inverse, top_disc, low_disc = 1.0 / a, b * b - a * high, b * b - a * low
        reaches = low_disc >= 0.0
        enter = (-b - math.sqrt(top_disc)) * inverse
        # At the latest where it is nearest to the axis: until there a ray only descends.
        span = (-b - math.sqrt(max(low_disc, 0.0))) * inverse - enter
        # The local frame at the entry keeps angles small.
        ex, ey, z = x0 + enter * dx, y0 + enter * dy, zc + enter * dz
        c, s = ex * per_radius, ey * per_radius
        radial, tangential = c * dx + s * dy, c * dy - s * dx
        phi = angle(ex, ey, r_max)
        rays[_PHI, k], rays[_Z, k] = phi, z
        rays[_ROW, k], rays[_COLUMN, k] = (phi - phi_0) * rows, (z - z_0) * columns
        rays[_COLUMNS, k] = dz * columns
        rays[_RADIAL, k], rays[_TANGENTIAL, k] = radial, tangential
        enters = enter > 0.0
        rays[_SPAN, k] = span if enters else -1.0
        rays[_KNOWN, k] = 1.0 if enters & reaches else 0.0
        steps = span * math.sqrt(tangential * tangential + dz * dz) * per_cell
        steps = steps if steps < _MAX_STEPS - 4.0 else _MAX_STEPS - 4.0
        rays[_STEPS, k] = 4.0 + math.floor(steps) if enters else 1.0


@kernel
def _begin(rays, r_max, level):
    """Number of each ray's last step above a radius, 0 if there is none."""
    for k in range(_LANES):
        radial, tangential, span = rays[_RADIAL, k], rays[_TANGENTIAL, k], rays[_SPAN, k]
        a, b = radial * radial + tangential * tangential, r_max * radial
        t = (-b - math.sqrt(b * b - a * (r_max * r_max - level * level))) / a
        share = t / span
        share = share if share < 1.0 else 1.0
        there = (t > 0.0) & (span > 0.0)
        rays[_BEGIN, k] = math.floor(share * rays[_STEPS, k]) if there else 0.0


@kernel
def _tell(rays, r_max):
    """Phi, z and r of the rays' hits; NaN of those without."""
    for k in range(_LANES):
        t = rays[_HIT, k]
        x, y = r_max + t * rays[_RADIAL, k], t * rays[_TANGENTIAL, k]
        radius = math.sqrt(x * x + y * y)
        rays[_PHI, k] += angle(x, y, radius)
        rays[_Z, k] += t * rays[_DZ, k]
        rays[_ROW, k] = radius


@kernel
def _give(rays, width, row, column, found):
    for lane in range(_LANES):
        v, u = row + lane // _SQUARE, column + lane % _SQUARE
        k = v * width + u
        if u < width and k < len(found):
            hit = found[k]
            hit[0], hit[1], hit[2] = rays[_PHI, lane], rays[_Z, lane], rays[_ROW, lane]


@kernel(inline="always")
def _place(field, rays, lane):
    """A ray as `_at` takes it: its place at the entry and where it goes."""
    return (
        rays[_ROW, lane], 1.0 / field[1], rays[_COLUMN, lane], rays[_COLUMNS, lane], field[5],
        rays[_RADIAL, lane], rays[_TANGENTIAL, lane], rays[_DZ, lane],
    )  # fmt: skip


@kernel
def _clear_level(r, tops, field, rays):
    """A radius above which no ray of a square meets the surface; infinite if none is known."""
    known = 1.0
    for lane in _CORNERS:
        known = min(known, rays[_KNOWN, lane])
    if not min(known, rays[_KNOWN, _MIDDLE]) > 0.0:
        return np.inf
    place, span = _place(field, rays, _MIDDLE), rays[_SPAN, _MIDDLE]
    steps = rays[_STEPS, _MIDDLE]
    reach = _reach(field, rays)
    if not reach <= _CLOSE:
        return np.inf
    advance = _cells_per_step(place, field[4], span, steps)
    begin = _first_doubtful(tops, place, span, steps, advance, reach)
    level, low = _level(place, begin * (span / steps)), field[4]
    at, _, _ = _first_below(r, tops, place, span, steps, advance, begin)
    if at >= 0:
        low = max(low, _level(place, at * (span / steps)))
    return min(level, max(low, _highest(r, field, rays, level, low)))


@kernel
def _reach(field, rays):
    """How many cells off the middle one's the rays of a square are, at any radius."""
    reach = 0.0
    middle, last = _place(field, rays, _MIDDLE), rays[_SPAN, _MIDDLE]
    row, column, _ = _at(middle, 0.0)
    last_row, last_column, _ = _at(middle, last)
    for lane in _CORNERS:
        corner = _place(field, rays, lane)
        its_row, its_column, _ = _at(corner, 0.0)
        reach = max(reach, abs(its_row - row), abs(its_column - column))
        its_row, its_column, _ = _at(corner, rays[_SPAN, lane])
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
def _highest(r, field, rays, level, low):
    """Highest surface that the rays of a square pass over from one radius down to another.

    Infinite where these are too many cells, or none can be told.
    """
    first_row = first_column = np.inf
    last_row = last_column = -np.inf
    for lane in _CORNERS:
        corner = _place(field, rays, lane)
        for radius in (level, low):
            t, _ = crossings(corner[4], 0.0, corner[5], corner[6], radius)
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
def _hit(r, tops, field, rays, lane):
    """The parameter at which a ray meets the surface first; NaN if it never does."""
    span, steps = rays[_SPAN, lane], rays[_STEPS, lane]
    if span < 0.0:
        return np.nan
    place = _place(field, rays, lane)
    advance = _cells_per_step(place, field[4], span, steps)
    at, above, below = _first_below(r, tops, place, span, steps, advance, int(rays[_BEGIN, lane]))
    if at < 0 or (at > 0 and math.isnan(above)):
        return np.nan
    step = span / steps
    return 0.0 if at == 0 else _meet(r, place, (at - 1) * step, above, at * step, below)


@kernel(inline="always")
def _at(place, t):
    """Row, column and radius of a ray's point."""
    row, rows, column, columns, start, radial, tangential, _ = place
    x, y = start + t * radial, t * tangential
    return row + rows * atan(y / x), column + columns * t, math.sqrt(x * x + y * y)


@kernel(inline="always")
def _level(place, t):
    """Radius of a ray's point."""
    x, y = place[4] + t * place[5], t * place[6]
    return math.sqrt(x * x + y * y)


@kernel(inline="always")
def _fall(place, span, steps):
    """How much a ray descends in a step, at most: it falls ever more slowly."""
    return abs(place[5]) * span / steps


@kernel(inline="always")
def _gap(r, place, t):
    """Height of a ray's point over the surface below it, mm."""
    row, column, level = _at(place, t)
    return level - sample(r, row, column)


@kernel
def _cells_per_step(place, r_min, span, steps):
    """How many rows or columns a ray advances in a step, at most; infinite where nobody knows."""
    _, rows, _, columns, start, radial, tangential, _ = place
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
    tangential, dz = place[6], place[7]
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
