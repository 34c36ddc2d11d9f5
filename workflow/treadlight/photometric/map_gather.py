"""What a block of pixels saw, laid side by side for the kernels of `map_kernels`."""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.map_lanes import (
    BRIGHT,
    DARK,
    HX,
    HY,
    HZ,
    LANES,
    LED,
    LIGHT,
    LX,
    LY,
    LZ,
    ONE,
    SHARP,
    ZERO,
)


@kernel
def gather(seen, pixels, leds, look):
    """The LEDs of some pixels; lanes beyond see nothing. `look` is room for their views."""
    intensity, lights, views, usable, noise = seen
    count, first = len(pixels), pixels[0]
    last = first + count
    if count < LANES:
        leds[:] = look[:] = ZERO
    for k in range(count):
        at = pixels[k]
        look[k], look[LANES + k], look[2 * LANES + k] = views[at, 0], views[at, 1], views[at, 2]
    for m in range(intensity.shape[0]):
        led = leds[m * LED : (m + 1) * LED]
        led[DARK : DARK + LANES] = np.float32(np.inf)
        if pixels[count - 1] == last - 1:
            _take_run(
                intensity[m, first:last], lights[m, 0, first:last], lights[m, 1, first:last],
                lights[m, 2, first:last], usable[m, first:last], noise[m, first:last], led,
            )  # fmt: skip
        else:
            _take_some(intensity[m], lights[m], usable[m], noise[m], pixels, led)
        _drop_unknown(led)
        _add_halfway(led, look)


@kernel
def _take_run(intensity, x, y, z, usable, noise, led):
    """One LED of pixels that lie side by side, an array at a time, which vectorises."""
    for k in range(len(intensity)):
        led[LIGHT + k] = intensity[k]
    for k in range(len(intensity)):
        led[LX + k], led[LY + k], led[LZ + k] = x[k], y[k], z[k]
    for k in range(len(intensity)):
        led[DARK + k] = noise[k] * noise[k]
    for k in range(len(intensity)):
        led[DARK + k] = led[DARK + k] if usable[k] else np.float32(np.inf)


@kernel
def _take_some(intensity, lights, usable, noise, pixels, led):
    """One LED of pixels anywhere."""
    for k in range(len(pixels)):
        at = pixels[k]
        led[LIGHT + k] = intensity[at]
        led[LX + k], led[LY + k], led[LZ + k] = lights[0, at], lights[1, at], lights[2, at]
        led[DARK + k] = noise[at] * noise[at] if usable[at] else np.float32(np.inf)


@kernel
def _drop_unknown(led):
    """What is not usable or not known has no direction and no light, and is infinitely noisy."""
    for k in range(LANES):
        light, lx, dark = led[LIGHT + k], led[LX + k], led[DARK + k]
        known = (light == light) & (lx == lx) & (dark < np.float32(np.inf))
        led[LX + k] = lx if known else ZERO
        led[LY + k] = led[LY + k] if known else ZERO
        led[LZ + k] = led[LZ + k] if known else ZERO
        led[LIGHT + k] = light if known else ZERO
        led[DARK + k] = dark if known else np.float32(np.inf)


@kernel
def _add_halfway(led, look):
    """The halfway vectors of an LED, and 1 / intensity where that is worth something."""
    for k in range(LANES):
        lx, ly, lz = led[LX + k], led[LY + k], led[LZ + k]
        hx, hy, hz = lx + look[k], ly + look[LANES + k], lz + look[2 * LANES + k]
        scale = ONE / math.sqrt(max(hx * hx + hy * hy + hz * hz, np.float32(1e-12)))
        # Of an LED that is not used, any unit vector.
        used = lx * lx + ly * ly + lz * lz > 0
        led[HX + k], led[HY + k] = hx * scale if used else ZERO, hy * scale if used else ZERO
        led[HZ + k] = hz * scale if used else ONE
        i = led[LIGHT + k]
        bright = i * i > np.float32(9.0) * led[DARK + k]
        led[BRIGHT + k] = ONE / i if bright and i > 0 else ZERO


@kernel
def sharpen(leds, misfit2, brightest):
    """How exact the LEDs are if the model misfits by so much, as `Material` defines it."""
    brightest[:] = ZERO
    for m in range(len(leds) // LED):
        light = leds[m * LED + LIGHT :]
        for k in range(LANES):
            brightest[k] = max(brightest[k], light[k])
    for m in range(len(leds) // LED):
        led = leds[m * LED : (m + 1) * LED]
        for k in range(LANES):
            power = led[LIGHT + k] * led[LIGHT + k] + brightest[k] * brightest[k]
            variance = led[DARK + k] + misfit2 * np.float32(0.5) * power
            led[SHARP + k] = ONE / math.sqrt(max(variance, np.float32(1e-30)))


@kernel
def count_usable(usable, first, count):
    """How many LEDs are usable at pixels from `first` on, into count (n,) uint8."""
    count[:] = 0
    for m in range(usable.shape[0]):
        row = usable[m, first : first + len(count)]
        for k in range(len(count)):
            count[k] += np.uint8(row[k])
