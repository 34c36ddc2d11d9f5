"""Whether a view's normals agree with any surface: the height gained around small loops."""

import numpy as np

# Errors of neighbouring pixels go together (blur, texture): loops must be wider than that.
_SIDE_PX = 4
_LOOPS = 40_000
_FEWEST = 200
_MAD_TO_STD = 1.4826


def covariance_scale(
    normal: np.ndarray, normal_cov: np.ndarray, theta: np.ndarray, z: np.ndarray, r: np.ndarray
) -> float:
    """How many times larger the normals' errors are than their standard deviations say.

    Slopes of a surface add up to nothing around a closed loop; slopes with errors do not. The
    robust spread of that height over loops four pixels wide, against what the covariances
    predict, shows the part of the error that no pixel's own fit can see, such as texture
    within it or a gloss of another shape.

    Parameters
    ----------
    normal, normal_cov : (h, w, 3) float
        In the basis (r, theta, z); see `ViewNormals`.
    theta, z, r : (h, w) float
        The scene points, rad, mm, mm.

    Returns
    -------
    float
        At least 1; 1 where fewer than 200 loops are whole.
    """
    vertices = _loops(normal.shape[:2])
    n = normal[vertices].astype(np.float64)
    cov = normal_cov[vertices].astype(np.float64)
    radius = r[vertices].astype(np.float64).mean(axis=0)
    along = radius * np.unwrap(theta[vertices].astype(np.float64), axis=0)
    axial = z[vertices].astype(np.float64)
    # The trapezoid rule gives a vertex half the way between its two neighbours.
    d_along, d_axial = _half_way(along), _half_way(axial)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = -np.sum((n[..., 1] * d_along + n[..., 2] * d_axial) / n[..., 0], axis=0)
        variance = np.sum(_variance(n, cov, d_along, d_axial), axis=0)
        ratio = np.abs(height) / np.sqrt(variance)
    ratio = ratio[np.isfinite(ratio)]
    if ratio.size < _FEWEST:
        return 1.0
    return max(1.0, _MAD_TO_STD * float(np.median(ratio)))


def _loops(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns (16, n) of square loops' vertices, evenly spread over an image."""
    side = range(_SIDE_PX)
    corner = [(0, k) for k in side] + [(k, _SIDE_PX) for k in side]
    corner += [(_SIDE_PX, _SIDE_PX - k) for k in side] + [(_SIDE_PX - k, 0) for k in side]
    rows, columns = (max(0, size - _SIDE_PX) for size in shape)
    step = max(1, int(np.sqrt(rows * columns / _LOOPS)))
    v, u = np.mgrid[:rows:step, :columns:step]
    offsets = np.array(corner)
    return offsets[:, :1] + v.ravel(), offsets[:, 1:] + u.ravel()


def _half_way(place: np.ndarray) -> np.ndarray:
    return 0.5 * (np.roll(place, -1, axis=0) - np.roll(place, 1, axis=0))


def _variance(
    n: np.ndarray, cov: np.ndarray, d_along: np.ndarray, d_axial: np.ndarray
) -> np.ndarray:
    """Variance of (n_t d_along + n_z d_axial) / n_r, with n_r = sqrt(1 - n_t2 - n_z2)."""
    n_r, n_t, n_z = np.moveaxis(n, -1, 0)
    gain = (n_t * d_along + n_z * d_axial) / n_r**3
    by_t, by_z = d_along / n_r + gain * n_t, d_axial / n_r + gain * n_z
    return by_t**2 * cov[..., 0] + 2 * by_t * by_z * cov[..., 1] + by_z**2 * cov[..., 2]
