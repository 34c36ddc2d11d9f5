"""Non-linear iterative photometric stereo: the full Blinn-Phong model, fitted per pixel."""

import numpy as np

from treadlight.photometric import nips_kernel as kernel
from treadlight.photometric.dps import dps
from treadlight.photometric.observations import Estimate, Observations, estimate_of
from treadlight.threads import by_ranges

_CHUNK_PX = 1 << 16
_LEAST_PX = 128


def nips(observations: Observations) -> Estimate:
    """Normals, k_d, k_s and alpha of the least sum of (I_m - eq. 5.1)2 over the usable LEDs.

    The rival of the dissertation's section 5.4, which describes it no closer than as
    non-linear iteration on a parameterised model from initial values that decide its success
    (sections 2.4 and 5.1). Here: Levenberg-Marquardt from the normal of `dps`, alpha = 10, and
    half of the brightest LED's light for each of k_d and k_s; alpha stays in [1, 1024], k_d and
    k_s are not negative, and the normal faces the camera. An LED behind the surface counts: the
    model says that it gives no light. Where gloss rules, `dps` is tens of degrees off and many
    fits end in a wrong lobe.

    Parameters
    ----------
    observations : Observations

    Returns
    -------
    Estimate
        few_leds: fewer than five usable LEDs (there are five unknowns), no normal. poor_fit:
        `dps` finds no normal to start from or no LED shows light; no normal.
    """
    total = observations.intensity.shape[1]
    out = np.empty((total, kernel.RESULTS))
    start = dps(observations).normal.astype(np.float64)
    for first in range(0, total, _CHUNK_PX):
        part = slice(first, first + _CHUNK_PX)
        # In double precision all through, as a baseline; a chunk at a time.
        by_ranges(
            kernel.fit_pixels,
            len(start[part]),
            _LEAST_PX,
            np.ascontiguousarray(observations.intensity[:, part], np.float64),
            np.ascontiguousarray(observations.lights[:, part], np.float64),
            np.ascontiguousarray(observations.views[part], np.float64),
            np.ascontiguousarray(observations.usable[:, part], np.bool_),
            np.ascontiguousarray(observations.noise[:, part], np.float64),
            start[part],
            out[part],
        )
    usable = observations.usable & np.isfinite(observations.intensity)
    used = usable.sum(axis=0).astype(np.uint8)
    return estimate_of(
        out[:, : kernel.RESIDUAL + 1], used, out[:, kernel.CXX :], fewest=kernel.UNKNOWNS
    )
