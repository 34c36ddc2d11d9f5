"""A whole rendered archive: the calibration and every measurement, with truth."""

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from treadlight import store
from treadlight.archive.manifest import FORMAT
from treadlight.errors import ConfigError
from treadlight.simulate import calibration, laser, plan, sensor
from treadlight.simulate.random import stream
from treadlight.simulate.render import Scene, render_leds
from treadlight.simulate.rig import BEAM_COS_POWER, make_rig
from treadlight.simulate.settings import NOMINAL_RADIUS_MM, TREAD_WIDTH_MM, SimulationSettings
from treadlight.simulate.tire import (
    HeightField,
    field_step_mm,
    height_field,
    make_tire,
    mounted_profile,
)
from treadlight.simulate.write import CaptureWriter

RECORD = "simulation.json"
# Rendered rows that are held at once, of all LEDs together.
_BAND_PIXELS = 48_000_000
_HALO_PX = 2
# Green and blue see a little of a red laser.
_LEAK = (0.008, 0.02, 1.0)
_HIGHLIGHT_PEAK = 0.9

Say = Callable[[str], None]


class Simulation:
    """Renders the captures of one archive; each can be rendered alone and comes out the same."""

    def __init__(self, settings: SimulationSettings):
        self.settings = settings
        self.sim = make_rig(settings)
        self.measurements = plan.measurements(settings, self.sim)
        self.pattern = sensor.fixed_pattern(settings.seed, settings.size_px)
        self.exposures = plan.exposures(self.sim)

    @property
    def ids(self) -> list[str]:
        """Ids of the captures, the calibration first."""
        return [plan.calibration_id(self.settings), *(m.id for m in self.measurements)]

    def write(self, capture: str, out: Path, say: Say) -> None:
        """Render one capture, by id, into the archive folder `out`."""
        say(f"{capture}: rendering")
        writer = CaptureWriter(out / capture)
        if capture == plan.calibration_id(self.settings):
            self._write_calibration(writer)
        else:
            measurement = next(m for m in self.measurements if m.id == capture)
            self._write_measurement(measurement, writer, say)

    def field(self, measurement: plan.Measurement) -> HeightField:
        """The tire's surface at a measurement, as it is mounted there."""
        tire = make_tire(self.settings.seed, measurement.tire)
        wear_mm = self.settings.wear_mm_per_100mi * measurement.mileage / 100
        step = field_step_mm(self.settings.pixel_mm)
        field = height_field(tire, wear_mm, step, sector=measurement.sector)
        return field.with_radial(measurement.mounting.radius_change_mm)

    def scene(self, measurement: plan.Measurement, field: HeightField | None = None) -> Scene:
        """The tire before the rig."""
        tire = make_tire(self.settings.seed, measurement.tire)
        field = field or self.field(measurement)
        return Scene(self.sim, field, measurement.mounting, tire.tile)

    def _rng(self, capture: str, *names: object) -> np.random.Generator:
        return stream(self.settings.seed, "frame", capture, *names)

    def _expose(self, light: np.ndarray, exposure_s: float, rng: np.random.Generator) -> np.ndarray:
        scale = np.float32(plan.GAIN_PER_S * exposure_s)
        return sensor.expose(scale * sensor.blur(light), self.pattern, rng)

    def laser_frame(
        self, stripe: np.ndarray, exposure_s: float, rng: np.random.Generator
    ) -> np.ndarray:
        """Counts (h, w, 3) uint16, blue first, of a laser stripe (h, w) float32."""
        light = stripe * laser.speckle(self.sim, rng)
        channels = [self._expose(np.float32(leak) * light, exposure_s, rng) for leak in _LEAK]
        return np.stack(channels, axis=-1)

    def led_frames(
        self, scene: Scene, encoder_deg: float, capture: str, view: int
    ) -> list[np.ndarray]:
        """Counts (h, w) uint16 of one field of view, by LED."""
        width, height = self.settings.size_px
        count = self.settings.leds
        frames = [np.empty((height, width), np.uint16) for _ in range(count)]
        rngs = [self._rng(capture, "led", view, k) for k in range(count)]
        scale = np.float32(plan.GAIN_PER_S * self.exposures.led)
        band = max(16, _BAND_PIXELS // (width * count))
        for first in range(0, height, band):
            last = min(first + band, height)
            low, high = max(first - _HALO_PX, 0), min(last + _HALO_PX, height)
            light = render_leds(scene, encoder_deg, (low, high))
            for frame, rng, image in zip(frames, rngs, light, strict=True):
                seen = scale * sensor.blur(image)[first - low : last - low]
                frame[first:last] = sensor.expose(seen, self.pattern[first:last], rng)
        return frames

    def _write_measurement(
        self, measurement: plan.Measurement, writer: CaptureWriter, say: Say
    ) -> None:
        name, times = measurement.id, self.exposures
        field = self.field(measurement)
        scene = self.scene(measurement, field)
        for view, encoder in enumerate(measurement.view_encoders_deg):
            say(f"{name}: view {view + 1} of {len(measurement.view_encoders_deg)}")
            row = {"kind": "led", "pose": view, "encoder_deg": encoder, "exposure_s": times.led}
            for k, counts in enumerate(self.led_frames(scene, encoder, name, view)):
                writer.image(f"led/fov{view:02d}/{k:02d}.png", counts, led=k, **row)
        count = len(measurement.section_encoders_deg)
        for section, encoder in enumerate(measurement.section_encoders_deg):
            say(f"{name}: laser section {section + 1} of {count}")
            rng = self._rng(name, "laser", section)
            stripe = laser.render_laser(scene, encoder)
            stripe = laser.add_ghosts(stripe, self.settings.scan, rng)
            counts = self.laser_frame(stripe, times.laser, rng)
            row = {"pose": section, "encoder_deg": encoder, "exposure_s": times.laser}
            writer.image(f"laser/{section:03d}.png", counts, kind="laser", **row)
        writer.image("dark.png", sensor.dark_frame(self.pattern, self._rng(name)), kind="dark")
        self._write_surfaces(measurement, field, writer)
        mileage = {"value": measurement.mileage, "unit": "mi"}
        facts = {
            **self._facts("measurement", name, measurement.captured_at),
            "tire": {
                "id": measurement.tire,
                "size": "215/70R16",
                "nominal_radius_mm": NOMINAL_RADIUS_MM,
                "tread_width_mm": TREAD_WIDTH_MM,
            },
            "mileage": mileage,
        }
        mounting = asdict(measurement.mounting)
        hub_z_mm = mounting.pop("hub_z_mm")
        truth = {
            **self._true_rig(),
            "mounting": mounting,
            "exposure_s": {"led": times.led, "laser": times.laser},
            "hub_z_mm": hub_z_mm,
            "mounting_note": "X_T = Rx(tilt0) Ry(tilt1) Rz(rotation) X_tire + (ecc0, ecc1, hub_z"
            " + axial); r_tire + radius_change",
        }
        writer.publish(facts, truth)

    def _write_surfaces(
        self, measurement: plan.Measurement, field: HeightField, writer: CaptureWriter
    ) -> None:
        """truth/profile.npz, and truth/wear.npz of all but a tire's first measurement."""
        grid = plan.true_grid(self.settings, measurement)
        r = mounted_profile(field, measurement.mounting, grid.theta, grid.z)
        writer.arrays("profile", theta=grid.theta, z=grid.z, r=r)
        first = next(m for m in self.measurements if m.tire == measurement.tire)
        if first is measurement:
            return
        grid = plan.true_grid(self.settings, first)
        radial = first.mounting.radius_change_mm
        fields = (self.field(first), field.with_radial(radial))
        before, after = (mounted_profile(f, first.mounting, grid.theta, grid.z) for f in fields)
        writer.arrays("wear", theta=grid.theta, z=grid.z, wear=before - after)

    def _write_calibration(self, writer: CaptureWriter) -> None:
        sim, times, name = self.sim, self.exposures, plan.calibration_id(self.settings)
        for pose, board_pose in enumerate(sim.board_poses):
            light = calibration.render_board(sim, sim.board, board_pose)
            counts = self._expose(light, times.board, self._rng(name, "board", pose))
            row = {"pose": pose, "exposure_s": times.board}
            writer.image(f"board/{pose:02d}.png", counts, kind="board", **row)
        for pose, board_pose in enumerate(sim.board_poses):
            stripe = calibration.render_board_laser(sim, sim.board, board_pose)
            rng = self._rng(name, "board_laser", pose)
            counts = self.laser_frame(stripe, times.board_laser, rng)
            row = {"pose": pose, "exposure_s": times.board_laser}
            writer.image(f"board_laser/{pose:02d}.png", counts, kind="board_laser", **row)
        for pose, encoder in enumerate(sim.axis_encoders_deg):
            light = calibration.render_board(sim, sim.axis_board, sim.axis_board_pose(encoder))
            counts = self._expose(light, times.axis_board, self._rng(name, "axis_board", pose))
            row = {"pose": pose, "encoder_deg": encoder, "exposure_s": times.axis_board}
            writer.image(f"axis_board/{pose:02d}.png", counts, kind="axis_board", **row)
        light = calibration.render_board(sim, sim.board, sim.reference_pose)
        counts = self._expose(light, times.board, self._rng(name, "reference_board"))
        row = {"exposure_s": times.board}
        writer.image("reference_board.png", counts, kind="reference_board", **row)
        for k in range(self.settings.leds):
            self._write_led(k, writer)
        writer.image("dark.png", sensor.dark_frame(self.pattern, self._rng(name)), kind="dark")
        writer.publish(self._calibration_facts(), {**self._true_rig(), **self._true_targets()})

    def _write_led(self, k: int, writer: CaptureWriter) -> None:
        """The balls and the card under one LED."""
        sim, times, name = self.sim, self.exposures, plan.calibration_id(self.settings)
        scale = np.float32(plan.GAIN_PER_S * times.balls)
        light = scale * sensor.blur(calibration.render_balls(sim, k))
        light = calibration.add_highlights(light, sim, k, _HIGHLIGHT_PEAK)
        counts = sensor.expose(light, self.pattern, self._rng(name, "balls", k))
        row: dict[str, Any] = {"led": k, "exposure_s": times.balls}
        writer.image(f"balls/{k:02d}.png", counts, kind="balls", **row)
        light = calibration.render_card(sim, k)
        counts = self._expose(light, times.card, self._rng(name, "card", k))
        row = {"led": k, "exposure_s": times.card}
        writer.image(f"card/{k:02d}.png", counts, kind="card", **row)

    def _facts(self, kind: str, name: str, captured_at: str) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "kind": kind,
            "capture": name,
            "captured_at": captured_at,
            "rig": plan.rig_id(self.settings),
            "camera": {
                "size_px": list(self.settings.size_px),
                "encoding": "linear",
                "black_level": sensor.BLACK_LEVEL,
                "white_level": sensor.WHITE_LEVEL,
            },
            "laser": {"scan": self.settings.scan, "channel": "red"},
            "leds": self.settings.leds,
        }

    def _calibration_facts(self) -> dict[str, Any]:
        sim = self.sim
        name = plan.calibration_id(self.settings)
        board, axis_board = (
            {"inner_corners": list(b.inner_corners), "square_mm": b.square_mm}
            for b in (sim.board, sim.axis_board)
        )
        return {
            **self._facts("calibration", name, plan.CALIBRATED_AT),
            "board": board,
            "axis_board": axis_board,
            "balls": {
                "count": len(sim.ball_centres),
                "diameter_mm": sim.ball_diameter_mm,
                "centre_height_mm": 0.5 * sim.ball_diameter_mm,
            },
            "card": {"albedo": calibration.CARD_ALBEDO},
        }

    def _true_rig(self) -> dict[str, Any]:
        sim = self.sim
        planes = {
            name: [*plane.normal, plane.offset]
            for name, plane in (("laser", sim.laser_plane), ("reference", sim.reference_plane))
        }
        return {
            "rig": plan.rig_id(self.settings),
            "conventions": "frames of capture-format.md; planes: A x + B y + C z + D = 0 in {C};"
            " lengths mm",
            "camera": {
                "matrix": sim.camera.matrix,
                "distortion": sim.camera.distortion,
                "size_px": list(sim.camera.size_px),
            },
            "laser_plane": {
                "coefficients": planes["laser"],
                "source": sim.laser_source,
                "fwhm_mm": sim.laser_fwhm_mm,
            },
            "axis": {"direction": sim.axis.direction, "point": sim.axis.point},
            "reference_plane": {"coefficients": planes["reference"]},
            "leds": [
                {
                    "led": led.number,
                    "position": led.position,
                    "intensity": led.intensity,
                    "beam_direction": beam,
                    "beam_cos_power": BEAM_COS_POWER,
                }
                for led, beam in zip(sim.rig.leds, sim.beams, strict=True)
            ],
        }

    def _true_targets(self) -> dict[str, Any]:
        poses = [{"pose": k, "board_to_camera": p} for k, p in enumerate(self.sim.board_poses)]
        return {
            "board_poses": poses,
            "axis_board_to_T": self.sim.axis_board_to_tire,
            "ball_centres": self.sim.ball_centres,
        }


def write_archive(settings: SimulationSettings, out: Path, *, force: bool, say: Say) -> bool:
    """Render what an archive folder lacks.

    The settings are kept beside the captures, so that a second run knows what is there.

    Returns
    -------
    bool
        Whether anything was rendered.

    Raises
    ------
    ConfigError
        The folder holds an archive of other settings, or something else.
    """
    record = json.loads(json.dumps(asdict(settings)))
    if out.exists() and any(out.iterdir()):
        _check_ours(out, record, force)
    if force:
        _remove_rendered(out)
    simulation = Simulation(settings)
    missing = [name for name in simulation.ids if not (out / name / "capture.yaml").is_file()]
    store.write_json(out / RECORD, {"settings": record, "captures": simulation.ids})
    for name in missing:
        simulation.write(name, out, say)
    return bool(missing)


def _check_ours(out: Path, record: dict[str, Any], force: bool) -> None:
    path = out / RECORD
    if not path.is_file():
        raise ConfigError(
            f"{out}: is not empty and was not made by simulate. Name another folder for OUT."
        )
    if not force and store.read_json(path)["settings"] != record:
        raise ConfigError(
            f"{path}: the archive there was made with other settings. Name another folder, or add"
            " --force to render it anew."
        )


def _remove_rendered(out: Path) -> None:
    if (out / RECORD).is_file():
        for name in store.read_json(out / RECORD)["captures"]:
            shutil.rmtree(out / name, ignore_errors=True)
