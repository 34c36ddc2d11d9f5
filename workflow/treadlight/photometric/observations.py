"""What an estimator of normals takes and gives: the same for every method."""

from dataclasses import dataclass

import numpy as np

# Fewer equations than this leave the gloss model's normal, strength and width undetermined.
MIN_LEDS = 4
# An angle cannot be more uncertain than this, whatever a linear propagation says.
WORST_RAD2 = (np.pi / 2) ** 2

FLAGS = ("outside", "shadowed", "saturated", "few_leds", "poor_fit")
OUTSIDE, SHADOWED, SATURATED, FEW_LEDS, POOR_FIT = (np.uint8(1 << k) for k in range(5))


@dataclass(frozen=True)
class Observations:
    """Pixels seen under each LED; all vectors in one frame, which the result then has too.

    Attributes
    ----------
    intensity : (n_leds, n) float32
        I / (E exposure): a white Lambertian surface that faces the LED shows 1.
    lights : (n_leds, n, 3) float32
        Unit vectors from the scene point to the LED.
    views : (n, 3) float32
        Unit vectors from the scene point to the camera.
    usable : (n_leds, n) bool
        False where an LED is saturated, in cast shadow or missing at this pixel.
    noise : (n_leds, n) float32
        Standard deviation of `intensity` where it is dark (read-out and quantisation).
    """

    intensity: np.ndarray
    lights: np.ndarray
    views: np.ndarray
    usable: np.ndarray
    noise: np.ndarray

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The fields in order, in one memory layout and type: a kernel is then compiled once.

        Of the lights (n_leds, 3, n), so that neighbours' components lie side by side. What lies so
        already is not copied.
        """
        return (
            np.ascontiguousarray(self.intensity, np.float32),
            np.ascontiguousarray(np.moveaxis(self.lights, 2, 1), np.float32),
            np.ascontiguousarray(self.views, np.float32),
            np.ascontiguousarray(self.usable, np.bool_),
            np.ascontiguousarray(self.noise, np.float32),
        )


@dataclass(frozen=True)
class Estimate:
    """What a method found at each pixel; NaN (0 in counts) where there is no normal.

    Attributes
    ----------
    normal : (n, 3) float32
        Unit normals in the frame of the observations.
    k_d, k_s, alpha : (n,) float32
        Of eq. 5.1 (without n.l on the gloss); where the region's lobe has longer tails than eq.
        5.1's, alpha is that of the Blinn-Phong lobe as sharp at its peak.
    residual : (n,) float32
        Mean relative rerendering error, eq. 5.30 as a mean over the LEDs used whose
        intensity is above three sigma of the noise.
    leds_used : (n,) uint8
    flags : (n,) uint8
        Bits of `FLAGS` that the method itself can know: few_leds.
    covariance : (n, 6) float32
        Of the normal's components (xx, xy, xz, yy, yz, zz), rad2; of rank two.
    """

    normal: np.ndarray
    k_d: np.ndarray
    k_s: np.ndarray
    alpha: np.ndarray
    residual: np.ndarray
    leds_used: np.ndarray
    flags: np.ndarray
    covariance: np.ndarray


def estimate_of(
    columns: np.ndarray, used: np.ndarray, covariance: np.ndarray, fewest: int = MIN_LEDS
) -> Estimate:
    """What a kernel found, as every method gives it.

    Parameters
    ----------
    columns : (n, 7) float
        Normal, k_d, k_s, alpha, residual; NaN where there is no normal.
    used : (n,)
        LEDs used.
    covariance : (n, 6) float
        Of the normal's components, rad2.
    fewest : int
        With fewer LEDs the flag is few_leds, else poor_fit where there is no normal.
    """
    columns = columns.astype(np.float32, copy=False)
    nothing = ~np.isfinite(columns[:, 0])
    flags = np.where(used < fewest, FEW_LEDS, np.where(nothing, POOR_FIT, np.uint8(0)))
    return Estimate(
        normal=columns[:, :3],
        k_d=columns[:, 3],
        k_s=columns[:, 4],
        alpha=columns[:, 5],
        residual=columns[:, 6],
        leds_used=used.astype(np.uint8),
        flags=flags.astype(np.uint8),
        covariance=np.clip(covariance, -WORST_RAD2, WORST_RAD2).astype(np.float32, copy=False),
    )
