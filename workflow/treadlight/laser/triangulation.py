"""Where the viewing rays of the laser line meet the laser plane."""

import numpy as np

from treadlight.geometry import Rig


def triangulate_pixels(
    u: np.ndarray, u_std: np.ndarray, scan: str, rig: Rig
) -> tuple[np.ndarray, np.ndarray]:
    """Points of the laser line, and how they move with one standard deviation of u (eq. 3.6).

    Parameters
    ----------
    u, u_std : (sections, lines, peaks) float
        Position across the line and its standard deviation, px; NaN where there is none.
    scan : str
        ``rows``: u is a column and `line` a row of the image; ``columns``: the reverse.
    rig : Rig
        With a laser plane, unless there is no section.

    Returns
    -------
    points : (sections, lines, peaks, 3) float64
        {C} at the section's encoder angle, mm.
    deviation : (sections, lines, peaks, 3) float64
        Displacement along the laser plane for u + u_std, mm.
    """
    if not u.size:
        return np.empty((*u.shape, 3)), np.empty((*u.shape, 3))
    plane, camera = rig.laser_plane, rig.camera
    assert plane is not None
    line = np.broadcast_to(np.arange(u.shape[1], dtype=float)[None, :, None], u.shape)
    known = np.isfinite(u)
    across, along, spread = u[known].astype(float), line[known], u_std[known].astype(float)

    def meet(position: np.ndarray) -> np.ndarray:
        pair = (position, along) if scan == "rows" else (along, position)
        return plane.intersect(camera.rays(np.column_stack(pair)))

    points = np.full((*u.shape, 3), np.nan)
    deviation = np.full((*u.shape, 3), np.nan)
    points[known] = meet(across)
    # Half a pixel either side: the derivative is smooth over a pixel, the step well above eps.
    per_px = meet(across + 0.5) - meet(across - 0.5)
    deviation[known] = per_px * spread[:, None]
    return points, deviation
