"""Compiled building blocks of the renderers: lens, height field, ray march, reflection.

A height field is passed as three arrays: `grid` (n_theta, n_z) float32, radii in mm in the
tire's own frame {B} (z along its axis); `envelope` (2, n_z), radii of a convex
body of revolution around it, and the largest radius near each z; and `meta`, whose entries are
named below.
"""

import numpy as np

from treadlight.compiling import kernel

# Entries of `meta`.
THETA0, INV_STEP_THETA, Z0, INV_STEP_Z, RADIAL, R_MAX, R_MIN, WRAPS, STEP_MM = range(9)
OUTSIDE = -1.0e9
_TWO_PI = 2 * np.pi


@kernel
def undistorted(u, v, lens):
    """Ray (x, y, 1) of a pixel; `lens` is fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    xd = (u - lens[2]) / lens[0]
    yd = (v - lens[3]) / lens[1]
    x, y = xd, yd
    # The lens bends by under 1 %, so each pass gains two digits or more.
    for _ in range(6):
        r2 = x * x + y * y
        radial = 1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
        dx = 2.0 * lens[6] * x * y + lens[7] * (r2 + 2.0 * x * x)
        dy = lens[6] * (r2 + 2.0 * y * y) + 2.0 * lens[7] * x * y
        x, y = (xd - dx) / radial, (yd - dy) / radial
    return x, y


@kernel
def ray(u, v, lens, rotation):
    """Unit direction in {B} of the ray of an image point."""
    x, y = undistorted(u, v, lens)
    scale = 1.0 / np.sqrt(x * x + y * y + 1.0)
    dx = (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]) * scale
    dy = (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]) * scale
    dz = (rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]) * scale
    return dx, dy, dz


@kernel
def fast_atan2(y, x):
    """atan2 to 2e-8 rad (Abramowitz and Stegun 4.4.49); the library's is a slow call."""
    ax, ay = abs(x), abs(y)
    steep = ay > ax
    a = ax / ay if steep else ay / max(ax, 1e-300)
    s = a * a
    p = -0.0161657367 + s * 0.0028662257
    p = 0.0429096138 + s * p
    p = -0.0752896400 + s * p
    p = 0.1065626393 + s * p
    p = -0.1420889944 + s * p
    p = 0.1999355085 + s * p
    p = -0.3333314528 + s * p
    angle = a + a * s * p
    if steep:
        angle = 0.5 * np.pi - angle
    if x < 0:
        angle = np.pi - angle
    return -angle if y < 0 else angle


@kernel
def surface(grid, meta, theta, z):
    """Radius of the surface, mm, bilinear in the grid; OUTSIDE where there is none."""
    n, m = grid.shape
    b = (z - meta[Z0]) * meta[INV_STEP_Z]
    if not 0.0 <= b < m - 1:
        return OUTSIDE
    turn = (theta - meta[THETA0]) / _TWO_PI
    a = (turn - np.floor(turn)) * _TWO_PI * meta[INV_STEP_THETA]
    i = int(a)
    if meta[WRAPS] > 0:
        i = min(i, n - 1)
        i1 = i + 1 if i + 1 < n else 0
    else:
        if i >= n - 1:
            return OUTSIDE
        i1 = i + 1
    j = int(b)
    fa, fb = a - i, b - j
    low = grid[i, j] + fb * (grid[i, j + 1] - grid[i, j])
    high = grid[i1, j] + fb * (grid[i1, j + 1] - grid[i1, j])
    return low + fa * (high - low) + meta[RADIAL]


@kernel
def envelope_at(envelope, meta, z):
    """Radius of the envelope at z, mm; OUTSIDE beside the tire."""
    j = int(np.floor((z - meta[Z0]) * meta[INV_STEP_Z] + 0.5))
    if j < 0 or j >= envelope.shape[1]:
        return OUTSIDE
    return envelope[0, j] + meta[RADIAL]


@kernel
def is_inside(grid, envelope, meta, x, y, z, r):
    """Whether a point at radius r lies in the tire; looks the surface up only where it may."""
    j = int(np.floor((z - meta[Z0]) * meta[INV_STEP_Z] + 0.5))
    if j < 0 or j >= envelope.shape[1] or r > envelope[1, j] + meta[RADIAL]:
        return False
    return r < surface(grid, meta, fast_atan2(y, x), z)


@kernel
def gap(grid, meta, x, y, z):
    """Height of a point over the surface, along r, mm."""
    return np.sqrt(x * x + y * y) - surface(grid, meta, fast_atan2(y, x), z)


@kernel
def enter_cylinder(ox, oy, dx, dy, radius):
    """Ray parameter at which a ray from outside enters r = radius; -1 where it never does."""
    a = dx * dx + dy * dy
    b = ox * dx + oy * dy
    c = ox * ox + oy * oy - radius * radius
    discriminant = b * b - a * c
    if discriminant <= 0.0:
        return -1.0
    return (-b - np.sqrt(discriminant)) / a


@kernel
def first_hit(grid, envelope, meta, o, dx, dy, dz):
    """Ray parameter of the first surface point that a ray from outside meets; -1 if none.

    (dx, dy, dz) is of unit length. The march takes grid steps under the envelope of the
    tread and longer ones above it, then halves the step that crossed the surface.
    """
    t = enter_cylinder(o[0], o[1], dx, dy, meta[R_MAX])
    if t < 0.0:
        return -1.0
    step = meta[STEP_MM]
    end = enter_cylinder(o[0], o[1], dx, dy, meta[R_MIN])
    end = end if end > 0.0 else t + 200.0
    before = t
    while t < end + 2.0 * step:
        x, y, z = o[0] + t * dx, o[1] + t * dy, o[2] + t * dz
        r = np.sqrt(x * x + y * y)
        over = r - envelope_at(envelope, meta, z)
        if over > 1.0e6:
            over = 2.0 * step
        if over <= 0.0 and is_inside(grid, envelope, meta, x, y, z, r):
            return _refine(grid, meta, o, dx, dy, dz, before, t)
        before = t
        t += max(step, 0.5 * over)
    return -1.0


@kernel
def _refine(grid, meta, o, dx, dy, dz, low, high):
    for _ in range(10):
        t = 0.5 * (low + high)
        if gap(grid, meta, o[0] + t * dx, o[1] + t * dy, o[2] + t * dz) > 0.0:
            low = t
        else:
            high = t
    return 0.5 * (low + high)


@kernel
def is_lit(grid, envelope, meta, x, y, z, lx, ly, lz):
    """Whether nothing of the tire stands between a surface point and a light.

    (lx, ly, lz) is the unit vector to the light. The envelope is convex, so a ray that is
    above it and moving away from it never comes back.
    """
    step = meta[STEP_MM]
    t = step
    last = -1.0e9
    while t < 200.0:
        px, py, pz = x + t * lx, y + t * ly, z + t * lz
        top = envelope_at(envelope, meta, pz)
        if top == OUTSIDE:
            return True
        r = np.sqrt(px * px + py * py)
        over = r - top
        if over > 0.02 and over > last:
            return True
        if over <= 0.0 and is_inside(grid, envelope, meta, px, py, pz, r):
            return False
        last = over
        # What stands further off than the surface's own texture is a block, wide against a step.
        t += step if t < 4.0 * step else 2.0 * step
    return True


@kernel
def normal_at(grid, meta, theta, z, r):
    """Outward unit normal in the local basis (r, theta, z), from central differences."""
    h = 0.5 * meta[STEP_MM]
    a = h / r
    up, down = surface(grid, meta, theta + a, z), surface(grid, meta, theta - a, z)
    right, left = surface(grid, meta, theta, z + h), surface(grid, meta, theta, z - h)
    st = (up - down) / (2.0 * h) if min(up, down) > 0.0 else 0.0
    sz = (right - left) / (2.0 * h) if min(right, left) > 0.0 else 0.0
    scale = 1.0 / np.sqrt(1.0 + st * st + sz * sz)
    return scale, -st * scale, -sz * scale


@kernel
def reflect(albedo, alpha2, f0, nl, nv, nh, vh):
    """pi times BRDF times n.l: a Lambertian base under a GGX microfacet gloss.

    Cook and Torrance's form with the GGX distribution and its height-correlated Smith term
    (Walter et al. 2007; Heitz 2014) and Schlick's Fresnel factor.

    Parameters
    ----------
    albedo : of the diffuse base
    alpha2 : square of the GGX roughness
    f0 : reflectance at normal incidence
    nl, nv, nh, vh : cosines between normal, light, view and half vector, nl and nv above 0
    """
    grazing = 1.0 - vh
    g2 = grazing * grazing
    fresnel = f0 + (1.0 - f0) * g2 * g2 * grazing
    spread = nh * nh * (alpha2 - 1.0) + 1.0
    density = alpha2 / (spread * spread)
    smith_l = nl * np.sqrt(alpha2 + (1.0 - alpha2) * nv * nv)
    smith_v = nv * np.sqrt(alpha2 + (1.0 - alpha2) * nl * nl)
    return nl * (albedo + density * fresnel * 0.5 / (smith_l + smith_v))


@kernel
def value_noise(tile, x, y, period):
    """Smooth noise of a lattice of random numbers; x comes back to itself after `period`."""
    i, j = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - i, y - j
    fx, fy = fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy)
    rows, columns = tile.shape
    i0, i1 = (i % period) % rows, ((i + 1) % period) % rows
    j0, j1 = j % columns, (j + 1) % columns
    low = tile[i0, j0] + fy * (tile[i0, j1] - tile[i0, j0])
    high = tile[i1, j0] + fy * (tile[i1, j1] - tile[i1, j0])
    return low + fx * (high - low)
