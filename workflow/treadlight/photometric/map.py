"""Specular photometric stereo with the region's material as a prior: the pipeline's default."""

from treadlight.photometric import map_kernels
from treadlight.photometric.material import Material, fit, learn_material
from treadlight.photometric.observations import Estimate, Observations, estimate_of


def map_normals(observations: Observations, *, material: Material | None = None) -> Estimate:
    """The most probable normal, strengths and shininess of each pixel.

    The full model of eq. 5.1 is fitted to all usable LEDs (Levenberg and Marquardt), with the
    region's distribution of (alpha, k_d / k_s) as a prior and Geman and McClure's function of the
    residuals, which are weighed by the sensor's noise and the model's usual misfit. LEDs in a
    shadow that nobody knew of, or lit by a neighbour, count little. It starts from the best few
    of many directions, each with the usual material: from one start the fit can end in the wrong
    lobe.

    Parameters
    ----------
    observations : Observations
    material : Material, optional
        By default learned from these observations.

    Returns
    -------
    Estimate
        few_leds: fewer than four usable LEDs, no normal. poor_fit: no LED shows light, or the
        normal faces away from the camera; no normal. The covariance is that of the posterior
        (Laplace's approximation).
    """
    if material is None:
        material = learn_material(observations)
    found = fit(observations, material)
    return estimate_of(
        found[:, : map_kernels.RESIDUAL + 1],
        found[:, map_kernels.LEDS],
        found[:, map_kernels.CXX : map_kernels.CXX + 6],
    )
