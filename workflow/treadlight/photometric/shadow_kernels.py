"""Which LEDs the surface hides from points of it, compiled; `scene` says what is what.

A ray to an LED walks by one cell. For the pixels of a tile together it is first found out where on
their way to an LED they could meet anything at all: elsewhere none of them need look. Where one
looks, steps that stay above the highest surface around them are left out, and of pixels that are
finer than the surface's cells only the corners of squares look as long as they agree. On a full
rig's view a pixel takes 0.4 us for 16 LEDs, 2 us where most of them graze a groove's walls.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.height_field import atan, cos_sin, crossings, sample, top

# Cells along a side of the blocks whose highest surface is known.
BLOCK = 8
# Pixels of a tile; neighbours that lie further apart than so many cells look each for itself.
_TILE_ROWS, _TILE_COLUMNS, _WIDEST_CELLS = 16, 32, 64
# Pixels along a side of the squares that are judged by their corners, and of their quarters; how
# many cells wide these are at the most.
_SQUARE, _HALF, _SQUARE_CELLS = 4, 2, 2.0
# Of a corner at which nobody has looked, and of squares whose corners do not agree.
_UNKNOWN = -1
_MAX_STEPS = 4096


@kernel
def tiles(width, pixels):
    """How many rows and columns of tiles there are among pixels of so many a row."""
    rows = (pixels + width - 1) // width
    return (rows + _TILE_ROWS - 1) // _TILE_ROWS, (width + _TILE_COLUMNS - 1) // _TILE_COLUMNS


@kernel
def lit(
    first, last, r, r_std, obstacles, tops, crests, phi_0, step_phi, z_0, step_z, r_max, cell,
    points, leds, width, image, out,
):  # fmt: skip
    """Whether LEDs reach points, as `scene.lit` gives it, into out (n_leds, n) of false.

    Of tiles first to last - 1, row by row; see `tiles`. Points that are no `image` do not speak
    for those between them.
    """
    across = tiles(width, len(points))[1]
    field = (r, r_std, phi_0, 1.0 / step_phi, z_0, 1.0 / step_z, r_max, cell)
    for tile in range(first, last):
        row, column = tile // across * _TILE_ROWS, tile % across * _TILE_COLUMNS
        _lit_tile(field, obstacles, tops, crests, points, leds, width, image, row, column, out)


@kernel(allocates=True)
def _lit_tile(field, obstacles, tops, crests, points, leds, width, image, row, column, out):
    """A tile's pixels, square by square where they need look.

    Corners of squares are asked once for all squares that they belong to, those beyond the tile's
    last row and column too.
    """
    bounds = _bounds(field, points, width, row, column, _TILE_ROWS + 1, _TILE_COLUMNS + 1)
    if math.isnan(bounds[0]):
        return
    rows = (min(_TILE_ROWS, (len(points) - 1) // width + 1 - row) + 1) // _HALF
    columns = (min(_TILE_COLUMNS, width - column) + 1) // _HALF
    close = np.empty((2, rows, columns), np.bool_)
    for i in range(rows):
        for j in range(columns):
            v, u = row + i * _HALF, column + j * _HALF
            close[0, i, j] = image and _are_near(field, points, width, v, u, _SQUARE)
            close[1, i, j] = image and _are_near(field, points, width, v, u, _HALF)
    corners = np.empty((rows + 2, columns + 2), np.int8)
    for m in range(len(leds)):
        near, far = _doubtful(field, obstacles, crests, bounds, leds[m])
        if near >= far:
            _light(points, width, row, column, _TILE_ROWS, _TILE_COLUMNS, out[m])
            continue
        ask = (field, tops, crests, leds[m], near, far)
        corners[:] = _UNKNOWN
        for i in range(0, rows, 2):
            for j in range(0, columns, 2):
                _lit_square(ask, points, width, row, column, i, j, close, corners, out[m])


@kernel
def _light(points, width, row, column, rows, columns, out):
    """What is known of a rectangle of pixels is lit."""
    for v in range(row, row + rows):
        first = v * width + column
        for k in range(first, min(len(points), first + columns, (v + 1) * width)):
            out[k] = points[k, 2] > 0.0


@kernel
def _lit_square(ask, points, width, row, column, i, j, close, corners, out):
    """A square of the tile at a row and column, by its corners or by those of its quarters.

    Corners that are about a cell apart and agree speak for all between. i and j count quarters.
    """
    told = _UNKNOWN
    if close[0, i, j]:
        told = _told(ask, points, width, row, column, i, j, 2, corners)
    if told == 0:
        return
    if told == 1:
        _light(points, width, row + i * _HALF, column + j * _HALF, _SQUARE, _SQUARE, out)
        return
    for a in range(i, min(i + 2, close.shape[1])):
        for b in range(j, min(j + 2, close.shape[2])):
            _lit_quarter(ask, points, width, row, column, a, b, close[1, a, b], corners, out)


@kernel
def _lit_quarter(ask, points, width, row, column, i, j, close, corners, out):
    """Its pixels each by itself where its corners do not speak for it."""
    told = _UNKNOWN
    if close:
        told = _told(ask, points, width, row, column, i, j, 1, corners)
    if told == 0:
        return
    v, u = row + i * _HALF, column + j * _HALF
    if told == 1:
        _light(points, width, v, u, _HALF, _HALF, out)
        return
    for y in range(v, v + _HALF):
        first = y * width + u
        for k in range(first, min(len(points), first + _HALF, (y + 1) * width)):
            out[k] = _is_lit(ask, points[k])


@kernel
def _told(ask, points, width, row, column, i, j, side, corners):
    """Whether all corners of a square are lit (1) or dark (0); unknown if they do not agree.

    `corners` holds what is known of all corners of the tile already.
    """
    lit_corners = 0
    for a in range(i, i + side + 1, side):
        for b in range(j, j + side + 1, side):
            if corners[a, b] == _UNKNOWN:
                k = _pixel(width, len(points), row + a * _HALF, column + b * _HALF)
                corners[a, b] = _is_lit(ask, points[k])
            lit_corners += corners[a, b]
    if lit_corners == 0:
        return 0
    return 1 if lit_corners == 4 else _UNKNOWN


@kernel(inline="always")
def _pixel(width, pixels, row, column):
    """The pixel of a row and column, or of the last ones."""
    return min(row, (pixels - 1) // width) * width + min(column, width - 1)


@kernel
def _are_near(field, points, width, row, column, side):
    """Whether a square's corners lie hardly further apart than cells; never if one is not known."""
    cell, count = field[-1], len(points)
    first = _pixel(width, count, row, column)
    if first >= count:
        return False
    phi, z, height = points[first]
    for i in range(2):
        for j in range(2):
            k = _pixel(width, count, row + i * side, column + j * side)
            if k >= count:
                return False
            apart = max(abs(points[k, 0] - phi) * height, abs(points[k, 1] - z))
            if not apart <= _SQUARE_CELLS * cell:
                return False
    return True


@kernel
def _is_lit(ask, point):
    """Whether a point sees the LED: only between two shares of the way anything could hide it."""
    field, tops, crests, led, near, far = ask
    phi, z, height = point
    if not height > 0.0:
        return False
    c, s = cos_sin(phi)
    radial, tangential = c * led[0] + s * led[1] - height, c * led[1] - s * led[0]
    return not _blocked(
        field, tops, crests, phi, z, height, radial, tangential, led[2] - z, near, far
    )


@kernel
def _bounds(field, points, width, row, column, rows, columns):
    """What holds of all known points of a tile: NaN if there are none.

    Middle and half extent of phi and of z, least and most height, least variance.
    """
    _, r_std, phi_0, per_phi, z_0, per_z, _, _ = field
    phi_low = z_low = low = variance = np.inf
    phi_high = z_high = high = -np.inf
    for v in range(row, row + rows):
        first = v * width + column
        for k in range(first, min(len(points), first + columns, (v + 1) * width)):
            phi, z, height = points[k]
            if not height > 0.0:
                continue
            phi_low, phi_high = min(phi_low, phi), max(phi_high, phi)
            z_low, z_high = min(z_low, z), max(z_high, z)
            low, high = min(low, height), max(high, height)
            variance = min(variance, _variance(r_std, (phi - phi_0) * per_phi, (z - z_0) * per_z))
    return (
        0.5 * (phi_low + phi_high), 0.5 * (phi_high - phi_low),
        0.5 * (z_low + z_high), 0.5 * (z_high - z_low), low, high, variance,
    )  # fmt: skip


@kernel(inline="always")
def _variance(r_std, row, column):
    std = sample(r_std, row, column)
    return 0.0 if math.isnan(std) else std * std


@kernel
def _doubtful(field, obstacles, crests, bounds, led):
    """Between which shares of their way to an LED points within bounds could meet the surface.

    (0, 1) if nothing is known, (1, 0) if they meet nothing.

    All of a share t lie within the bounds' extent about the middle one's point, since rays to one
    place draw nearer. Their least radius is that of the lowest and most turned away: its square
    (1-t)^2 h^2 + 2 t (1-t) h g + t^2 L^2, where g is the LED's distance along the point's radius
    and L that from the axis, rises with t and h if g > h.
    """
    _, _, phi_0, per_phi, z_0, per_z, r_max, cell = field
    phi, half_phi, z, half_z, low, high, variance = bounds
    c, s = cos_sin(phi)
    along, across = c * led[0] + s * led[1], c * led[1] - s * led[0]
    facing = along * math.cos(half_phi) - abs(across) * math.sin(half_phi)
    # A little more, for what angles are rounded by.
    rows, columns = half_phi * per_phi + 1.0, half_z * per_z + 0.1
    if not (facing > high and max(rows, columns) <= _WIDEST_CELLS):
        return 0.0, 1.0
    distance2 = led[0] * led[0] + led[1] * led[1]
    # Where all go one way along the axis, nothing is above what lies ahead.
    upwards, one_way = led[2] > z, abs(led[2] - z) > half_z
    ahead = crests[1] if upwards else crests[0]
    back = -columns if upwards else columns + 1.0
    # About one block along the way at a time.
    share = BLOCK * cell / max(math.sqrt(across * across + (led[2] - z) ** 2), cell)
    near, far = 1.0, 0.0
    t = 0.0
    while t < 1.0:
        left = 1.0 - t
        level2 = left * left * low * low + 2.0 * t * left * low * facing + t * t * distance2
        z_t = z + t * (led[2] - z)
        nearest = min(max(int((z_t - z_0) * per_z + back), 0), len(ahead) - 1)
        highest = max(ahead[nearest], 0.0) if one_way else r_max
        if level2 > highest * highest:
            break
        end = min(t + share, 1.0)
        # Lower points turn further about the axis.
        turn = atan(t * across / (left * high + t * along))
        turn_end = atan(end * across / ((1.0 - end) * low + end * along))
        first, last = min(turn, turn_end), max(turn, turn_end)
        z_end = z + end * (led[2] - z)
        hides = _may_hide(
            obstacles,
            (phi + first - phi_0) * per_phi - rows, (phi + last - phi_0) * per_phi + rows,
            (min(z_t, z_end) - z_0) * per_z - columns, (max(z_t, z_end) - z_0) * per_z + columns,
            math.sqrt(level2) + 0.5 * cell, variance,
        )  # fmt: skip
        if hides:
            near, far = min(near, t), end
        t = end
    return near, far


@kernel
def _may_hide(obstacles, row, last_row, column, last_column, level, variance):
    """Whether any surface of these rows and columns could stand above a level and its doubt."""
    tops, stds = obstacles
    first_i = max(math.floor(row) // BLOCK, 0)
    first_j = max(math.floor(column) // BLOCK, 0)
    last_i = min(math.floor(last_row) // BLOCK, tops.shape[0] - 1)
    last_j = min(math.floor(last_column) // BLOCK, tops.shape[1] - 1)
    for i in range(first_i, last_i + 1):
        for j in range(first_j, last_j + 1):
            depth = tops[i, j] - level
            if depth > 0.0:
                std = stds[i, j]
                if depth > 2.0 * math.sqrt(variance + std * std):
                    return True
    return False


@kernel
def _blocked(field, tops, crests, phi, z, height, radial, tangential, dz, near, far):
    """Whether the surface hides the light at (radial, tangential, dz) from a point.

    It is looked for between two shares of the way. `tops` are those of the blocks around each, so
    that a ray above one meets nothing within a block of cells.
    """
    r, r_std, phi_0, per_phi, z_0, per_z, r_max, cell = field
    _, leave = crossings(height, 0.0, radial, tangential, max(r_max, height))
    # Nothing is above the highest point.
    if not leave > 0.0:
        return False
    first_row, first_column, columns = (phi - phi_0) * per_phi, (z - z_0) * per_z, dz * per_z
    var = _variance(r_std, first_row, first_column)
    span = min(leave, 1.0)
    lateral = span * math.sqrt(tangential * tangential + dz * dz)
    steps = min(_MAX_STEPS, 1 + int(lateral / cell))
    ahead = crests[1] if dz > 0 else crests[0]
    first = max(1, math.floor(near / span * steps))
    last = min(steps, math.ceil(far / span * steps))
    fall = max(-radial * span / steps, 0.0)
    # A row is narrower below, by no more than an eighth.
    leap = BLOCK - 2.0 if lateral <= steps * cell else 0.0
    step, half = span / steps, 0.5 * cell
    turn, bend = _turn(height, radial, tangential, span)
    turn, bend = turn * per_phi, bend * per_phi
    # The square of the radius, which spares its root.
    slope, curve = 2.0 * height * radial, radial * radial + tangential * tangential
    i = first - 1
    while i < last:
        i += 1
        t = i * step
        column = first_column + t * columns
        level2 = height * height + t * (slope + t * curve)
        # A rising ray that is above all that lies ahead meets nothing any more.
        nearest = min(max(int(column) + (dz <= 0), 0), len(ahead) - 1)
        crest = max(ahead[nearest], 0.0)
        if radial > 0.0 and level2 > crest * crest:
            return False
        row = first_row + t * (turn + t * bend)
        hurdle = max(top(tops, BLOCK, row, column) - half, 0.0)
        if hurdle * hurdle <= level2:
            clear = (math.sqrt(level2) - hurdle) / fall if fall > 0.0 else leap
            i += int(min(leap, clear))
            continue
        obstacle = max(sample(r, row, column) - half, 0.0)
        # The roots only where half a step alone is exceeded.
        if obstacle * obstacle > level2:
            std = r_std[int(row), int(column)]
            if obstacle - math.sqrt(level2) > 2.0 * math.sqrt(var + std * std):
                return True
    return False


@kernel(inline="always")
def _turn(height, radial, tangential, span):
    """How a ray turns about the axis, as t (turn + t bend): to a hundredth of a cell over a tread.

    Exact at half and at all of its span.
    """
    middle = atan(0.5 * span * tangential / (height + 0.5 * span * radial))
    end = atan(span * tangential / (height + span * radial))
    return (4.0 * middle - end) / span, (2.0 * end - 4.0 * middle) / (span * span)
