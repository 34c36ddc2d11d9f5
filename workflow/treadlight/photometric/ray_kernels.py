"""Where viewing rays meet a height field, compiled; `scene` says what is what.

A ray walks by half a cell from the largest radius on. Steps that stay above the highest surface
around them (`SurfacePatch.tops`) meet nothing and are left out. A pixel takes some 15 steps of 40
operations and reads some 100 cells, nearly all of which its neighbours have read.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.height_field import atan, crossings, sample, top

# Cells along a side of the blocks whose tops are known.
BLOCKS = (8, 64)
_MAX_STEPS = 4096
# Heights over the surface are found to a nanometre: far less than its single precision.
_TOLERANCE_MM, _MAX_REFINEMENTS = 1e-6, 24


@kernel
def cast(
    first, last, r, tops, phi_0, step_phi, z_0, step_z, r_min, r_max, cell,
    origin, directions, found,
):  # fmt: skip
    """First hits of rays first to last - 1, as `scene.cast` gives them, into found (n, 3)."""
    for k in range(first, last):
        _cast_one(
            r, tops, phi_0, step_phi, z_0, step_z, r_min, r_max, cell,
            origin, directions[k], found[k],
        )  # fmt: skip


@kernel
def _cast_one(r, tops, phi_0, step_phi, z_0, step_z, r_min, r_max, cell, origin, ray, found):
    x0, y0, zc = origin
    dx, dy, dz = ray
    enter, leave = crossings(x0, y0, dx, dy, r_max)
    if not enter > 0.0:
        return
    bottom, _ = crossings(x0, y0, dx, dy, r_min)
    # At the latest where it is nearest to the axis: until there a ray only descends.
    end = 0.5 * (enter + leave) if math.isnan(bottom) else bottom
    # The local frame at the entry keeps angles small.
    ex, ey, z = x0 + enter * dx, y0 + enter * dy, zc + enter * dz
    phi = math.atan2(ey, ex)
    c, s = ex / r_max, ey / r_max
    radial, tangential = c * dx + s * dy, c * dy - s * dx
    span = end - enter
    lateral = span * math.sqrt(tangential * tangential + dz * dz)
    steps = min(_MAX_STEPS, 4 + int(2.0 * lateral / cell))
    place = (phi_0, step_phi, z_0, step_z, r_max, phi, z, radial, tangential, dz)
    at = _first_below(r, tops, place, span, steps, _cells_per_step(place, r_min, span, steps))
    if at < 0:
        return
    low, high = span * max(at - 1, 0) / steps, span * at / steps
    above = _gap(r, place, low)
    if at > 0 and math.isnan(above):
        return
    t = high if at == 0 else _meet(r, place, low, above, high)
    x, y = r_max + t * radial, t * tangential
    found[0] = phi + math.atan2(y, x)
    found[1] = z + t * dz
    found[2] = math.hypot(x, y)


@kernel(inline="always")
def _at(place, t):
    """Row, column and radius of a ray's point."""
    phi_0, step_phi, z_0, step_z, start, phi, z, radial, tangential, dz = place
    x, y = start + t * radial, t * tangential
    row = (phi + atan(y / x) - phi_0) / step_phi
    return row, (z + t * dz - z_0) / step_z, math.sqrt(x * x + y * y)


@kernel(inline="always")
def _gap(r, place, t):
    """Height of a ray's point over the surface below it, mm."""
    row, column, level = _at(place, t)
    return level - sample(r, row, column)


@kernel
def _cells_per_step(place, r_min, span, steps):
    """How many rows or columns a ray advances in a step, at most; infinite where nobody knows."""
    _, step_phi, _, step_z, start, _, _, radial, tangential, dz = place
    x, y = start - span * abs(radial), span * abs(tangential)
    if not (x > y and r_min > 0.0):
        return np.inf
    turn = (abs(tangential) * start + abs(radial) * y) / (r_min * r_min)
    # The series of the arc tangent rises faster than itself, by this.
    turn *= 1.0 + (y / x) ** 10
    return max(turn / step_phi, abs(dz) / step_z) * span / steps


@kernel
def _first_below(r, tops, place, span, steps, cells_per_step):
    """Number of the first step at or below the surface, -1 if there is none.

    A ray falls ever more slowly: never by more in a step than in the first.
    """
    near, far = BLOCKS[0] / cells_per_step, BLOCKS[1] / cells_per_step
    fall = abs(place[7]) * span / steps
    i = 0
    while i <= steps:
        row, column, level = _at(place, span * i / steps)
        clear = min((level - top(tops[1], BLOCKS[1], row, column)) / fall, far)
        if not clear >= 2.0:
            clear = min((level - top(tops[0], BLOCKS[0], row, column)) / fall, near)
        if clear >= 2.0:
            i += int(min(clear, steps))
            continue
        if level - sample(r, row, column) <= 0.0:
            return i
        i += 1
    return -1


@kernel
def _meet(r, place, low, above, high):
    """The ray's parameter at the surface, between a point above and one below (Illinois)."""
    below = _gap(r, place, high)
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
