"""Specular photometric stereo with the region's material as a prior: the pipeline's default."""

from treadlight.photometric import map_report
from treadlight.photometric.black_level import excess_black_level, give_back_black_level
from treadlight.photometric.material import Material, fit, learn_material
from treadlight.photometric.observations import Estimate, Observations, estimate_of

# Cost per degree of freedom that other starts are not asked to lower: fits in a wrong lobe leave
# tens to hundreds. A material is learned with none, since that compares costs.
_ENOUGH = 3.0


def map_normals(
    observations: Observations, *, material: Material | None = None, width: int | None = None
) -> Estimate:
    """The most probable normal, strengths and shininess of each pixel.

    The full model of eq. 5.1, its lobe of the shape that suits the region (`Material`), is fitted
    to all usable LEDs (Levenberg and Marquardt), with the region's distribution of (alpha,
    k_d / k_s) as a prior and Geman and McClure's function of the residuals, which are weighed by
    the sensor's noise and the model's usual misfit. LEDs in a shadow that nobody knew of, or lit
    by a neighbour, count little. Where a fit explains too little it starts again from the best few
    of many directions, each with the usual material: from one start it can end in the wrong lobe.

    Parameters
    ----------
    observations : Observations
    material : Material, optional
        By default learned from these observations, and so is whether too high a black level was
        taken out of them (`excess_black_level`).
    width : int, optional
        The pixels are those of an image, row by row, with so many in a row: most are then fitted
        from where the one above ended, and only those that this does not explain from others.

    Returns
    -------
    Estimate
        few_leds: fewer than four usable LEDs, no normal. poor_fit: no LED shows light, or the
        normal faces away from the camera; no normal. The covariance is that of the posterior
        (Laplace's approximation).
    """
    if material is None:
        observations = give_back_black_level(observations, excess_black_level(observations))
        material = learn_material(observations)
    found = fit(observations, material, _ENOUGH, width)
    return estimate_of(
        found[:, : map_report.RESIDUAL + 1],
        found[:, map_report.LEDS],
        found[:, map_report.CXX : map_report.CXX + 6],
    )
