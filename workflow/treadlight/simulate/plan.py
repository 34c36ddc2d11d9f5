"""When each frame of an archive is taken: encoder angles, exposures, dates."""

from dataclasses import dataclass

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.geometry.axis import wrap_angle
from treadlight.simulate.random import stream
from treadlight.simulate.render import (
    ALBEDO,
    CARD_ALBEDO,
    F0,
    REFERENCE_DISTANCE_MM,
    ROUGHNESS,
)
from treadlight.simulate.rig import BEAM_COS_POWER, TREAD_DISTANCE_MM, SimulatedRig
from treadlight.simulate.settings import NOMINAL_RADIUS_MM, SimulationSettings
from treadlight.simulate.tire import Mounting, make_mounting

# Light of 1 fills the sensor in a tenth of a second.
GAIN_PER_S = 10.0
_OVERLAPPING_SECTIONS = 3
# Beyond this angle from the middle the tread is seen too flat to be of use.
_WIDEST_VIEW_DEG = 60.0
_VIEW_SPACING = 0.83
_SEEN_Z_MM = 118.0
_JITTER_DEG = 0.1


@dataclass(frozen=True)
class Measurement:
    """One measurement of a tire.

    Attributes
    ----------
    id, tire, captured_at : str
    mileage : float
        Miles.
    mounting : Mounting
    section_encoders_deg, view_encoders_deg : tuple of float
        As the encoder reads them.
    sector : (float, float) or None
        Of the tire in {B}, rad, that the frames can show; None is the whole turn.
    """

    id: str
    tire: str
    captured_at: str
    mileage: float
    mounting: Mounting
    section_encoders_deg: tuple[float, ...]
    view_encoders_deg: tuple[float, ...]
    sector: tuple[float, float] | None


def calibration_id(settings: SimulationSettings) -> str:
    return f"{rig_id(settings)}-2026-01"


def rig_id(settings: SimulationSettings) -> str:
    return f"sim-{settings.seed}"


CALIBRATED_AT = "2026-01-05T08:00:00Z"


def measurements(settings: SimulationSettings, sim: SimulatedRig) -> list[Measurement]:
    """Every measurement of the archive."""
    return [
        _measurement(settings, sim, f"t{tire + 1}", number)
        for tire in range(settings.tires)
        for number in range(len(settings.mileages))
    ]


def _measurement(
    settings: SimulationSettings, sim: SimulatedRig, tire: str, number: int
) -> Measurement:
    mileage = settings.mileages[number]
    rng = stream(settings.seed, "measurement", tire, number)
    mounting = make_mounting(rng, sim.hub_z_mm)
    sector = _tire_sector(settings, tire)
    if sector is None:
        middle, width = float(rng.uniform(-180, 180)), 360.0
    else:
        on_rig = np.degrees(0.5 * (sector[0] + sector[1])) + mounting.rotation_deg
        middle = float(-np.degrees(wrap_angle(np.radians(on_rig)))) + rng.uniform(-1, 1)
        width = float(settings.sector_deg or 0.0)
    sections = _section_encoders(settings, middle, width, rng)
    views = _view_encoders(settings, middle, width, rng)
    return Measurement(
        id=f"{tire}-{mileage:05.0f}" if mileage == int(mileage) else f"{tire}-{mileage:08.2f}",
        tire=tire,
        captured_at=f"2026-{1 + number // 2 % 12:02d}-{10 + 14 * (number % 2):02d}T10:00:00Z",
        mileage=mileage,
        mounting=mounting,
        section_encoders_deg=sections,
        view_encoders_deg=views,
        sector=None if sector is None else _with_margin(sector, settings),
    )


def view_width_deg(settings: SimulationSettings) -> float:
    """What one field of view shows of the circumference."""
    across = settings.across_px * settings.pixel_mm
    return float(min(np.degrees(across / NOMINAL_RADIUS_MM), _WIDEST_VIEW_DEG))


def _tire_sector(settings: SimulationSettings, tire: str) -> tuple[float, float] | None:
    """The sector that all measurements of a tire look at, {B}, rad."""
    if settings.whole_turn:
        return None
    middle = stream(settings.seed, "sector", tire).uniform(-np.pi, np.pi)
    half = 0.5 * float(np.radians(settings.sector_deg or 0.0))
    return float(middle - half), float(middle + half)


def _with_margin(
    sector: tuple[float, float], settings: SimulationSettings
) -> tuple[float, float] | None:
    """All that a frame of the sector can show or cast a shadow; None if that is all there is."""
    margin = np.radians(0.5 * view_width_deg(settings) + 8)
    first, last = sector[0] - margin, sector[1] + margin
    return (first, last) if last - first < np.radians(350) else None


def _section_encoders(
    settings: SimulationSettings, middle: float, width: float, rng: np.random.Generator
) -> tuple[float, ...]:
    count = settings.sections
    if settings.whole_turn and count:
        angles = middle + width / count * np.arange(count + _OVERLAPPING_SECTIONS)
    else:
        angles = middle + width * (np.arange(count) + 0.5 - 0.5 * count) / max(count, 1)
    step = width / max(count, 1)
    return _read(angles + min(_JITTER_DEG, 0.1 * step) * rng.uniform(-1, 1, len(angles)))


def _view_encoders(
    settings: SimulationSettings, middle: float, width: float, rng: np.random.Generator
) -> tuple[float, ...]:
    seen = view_width_deg(settings)
    if settings.whole_turn:
        count = settings.views
        count = int(np.ceil(360 / (_VIEW_SPACING * seen))) if count is None else count
        angles = middle + 360 / max(count, 1) * np.arange(count)
    else:
        reach = max(width - seen, 0.0)
        count = settings.views
        count = int(np.ceil(reach / (_VIEW_SPACING * seen))) + 1 if count is None else count
        angles = middle + reach * (np.linspace(-0.5, 0.5, count) if count > 1 else np.zeros(count))
    return _read(angles + 3 * _JITTER_DEG * rng.uniform(-1, 1, count))


def _read(angles: np.ndarray) -> tuple[float, ...]:
    """Encoder readings have three decimals."""
    return tuple(np.round(angles, 3).tolist())


def true_grid(settings: SimulationSettings, measurement: Measurement) -> CylinderGrid:
    """The grid of truth/profile.npz: pixel steps over what the frames show."""
    z = (-_SEEN_Z_MM, _SEEN_Z_MM)
    if settings.whole_turn:
        return CylinderGrid.whole_turn(z, settings.pixel_mm, NOMINAL_RADIUS_MM)
    half = 0.5 * view_width_deg(settings)
    views = np.array(measurement.view_encoders_deg)
    ends = np.concatenate([views - half, views + half, measurement.section_encoders_deg])
    theta = np.radians((float((-ends).min()), float((-ends).max())))
    return CylinderGrid.sector((theta[0], theta[1]), z, settings.pixel_mm, NOMINAL_RADIUS_MM)


@dataclass(frozen=True)
class Exposures:
    """Exposure time of each kind of frame, s."""

    led: float
    laser: float
    board: float
    board_laser: float
    axis_board: float
    balls: float
    card: float


def exposures(sim: SimulatedRig) -> Exposures:
    """Times that fill the sensor well; a few highlights on the tire saturate."""
    middle = np.array([0, 0, TREAD_DISTANCE_MM])
    irradiance = max(
        led.intensity * REFERENCE_DISTANCE_MM**2 / float(np.sum((led.position - middle) ** 2))
        for led in sim.rig.leds
    )
    # A GGX lobe seen in its middle returns F0 / (4 alpha^2), a Lambertian surface its albedo.
    card_light = _brightest_card(sim)
    gloss = F0 / (4 * ROUGHNESS**2)
    return Exposures(
        led=_time(0.95, irradiance * (ALBEDO + gloss)),
        laser=_time(0.45, ALBEDO + 0.4 * gloss),
        board=_time(0.75, 0.9),
        board_laser=_time(0.45, 0.8),
        axis_board=_time(0.75, 0.5),
        balls=_time(0.06, card_light),
        card=_time(0.85, card_light),
    )


def _brightest_card(sim: SimulatedRig) -> float:
    """Largest light that the card in the reference plane sends back under any LED."""
    size = np.array(sim.camera.size_px) - 1
    u, v = np.meshgrid(np.linspace(0, size[0], 15), np.linspace(0, size[1], 15))
    points = sim.reference_plane.intersect(sim.camera.rays(np.column_stack([u.ravel(), v.ravel()])))
    brightest = 0.0
    for led, beam in zip(sim.rig.leds, sim.beams, strict=True):
        to_led = led.position - points
        distance = np.linalg.norm(to_led, axis=1)
        cosine = np.maximum(-(to_led @ beam) / distance, 0)
        facing = to_led @ sim.reference_plane.normal / distance
        spread = cosine**BEAM_COS_POWER * (REFERENCE_DISTANCE_MM / distance) ** 2
        brightest = max(brightest, float(np.max(led.intensity * spread * facing)))
    return CARD_ALBEDO * brightest


def _time(level: float, light: float) -> float:
    return float(f"{level / (GAIN_PER_S * light):.2g}")
