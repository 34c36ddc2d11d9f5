"""A small bench rendered from first principles: rays, planes, mirrors; no code of the package
but `Camera`, so that the calibration is held against something else."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from treadlight.geometry import Axis, Camera, Plane

SUPER = 3


@dataclass
class Bench:
    """A rig whose every part is known. Lengths mm, frame {C}."""

    size_px: tuple[int, int] = (240, 320)
    focal: float = 1000.0
    inner: tuple[int, int] = (7, 5)
    square_mm: float = 22.0
    ball_radius: float = 10.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(7))

    @cached_property
    def camera(self) -> Camera:
        width, height = self.size_px
        matrix = np.array(
            [[self.focal, 0, width / 2 + 3.0], [0, self.focal, height / 2 - 4.0], [0, 0, 1]]
        )
        return Camera(matrix, np.array([-0.08, 0.05, 0.0004, -0.0003, 0.0]), self.size_px)

    @cached_property
    def axis(self) -> Axis:
        return Axis.through(np.array([0.02, 0.9995, -0.025]), np.array([6.0, 0.0, 1000.0]))

    @cached_property
    def laser_plane(self) -> Plane:
        normal = np.array([0.96, 0.02, 0.28])
        normal /= np.linalg.norm(normal)
        return Plane(normal, -float(normal @ [0.0, 0.0, 800.0]))

    @cached_property
    def reference_plane(self) -> Plane:
        normal = np.array([0.02, -0.015, -1.0])
        normal /= np.linalg.norm(normal)
        return Plane(normal, 800.0)

    @cached_property
    def leds(self) -> np.ndarray:
        angle = np.arange(6) * (2 * np.pi / 6)
        height = 450 + 8 * np.sin(3 * angle)
        return np.column_stack([220 * np.cos(angle) + 3, 210 * np.sin(angle) - 5, height])

    @cached_property
    def led_power(self) -> np.ndarray:
        return np.array([1.2, 0.8, 1.0, 0.9, 1.1, 1.0])

    @cached_property
    def ball_centres(self) -> np.ndarray:
        x, y = np.meshgrid([-62.0, 1.0, 60.0], [-85.0, -28.0, 30.0, 88.0])
        jitter = np.random.default_rng(11).uniform(-5, 5, (12, 2))
        lateral = np.column_stack([x.ravel(), y.ravel()]) + jitter
        n, d = self.reference_plane.normal, self.reference_plane.offset - self.ball_radius
        z = -(lateral @ n[:2] + d) / n[2]
        return np.column_stack([lateral, z])

    @cached_property
    def rays(self) -> np.ndarray:
        """(h * SUPER, w * SUPER, 3) unit rays of the subpixels."""
        width, height = self.size_px
        # Jittered, or edges along the pixel grid would come out in steps.
        shape = (2, height * SUPER, width * SUPER)
        jitter = np.random.default_rng(12).uniform(0, 1, shape)
        v, u = (np.mgrid[: height * SUPER, : width * SUPER] + jitter) / SUPER - 0.5
        rays = self.camera.rays(np.column_stack([u.ravel(), v.ravel()]))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays.reshape(height * SUPER, width * SUPER, 3)

    def shrink(self, fine: np.ndarray, noise: float = 0.002) -> np.ndarray:
        width, height = self.size_px
        fine = gaussian_filter(fine.astype(np.float32), 0.6 * SUPER)
        image = fine.reshape(height, SUPER, width, SUPER).mean(axis=(1, 3))
        return np.clip(image + self.rng.normal(0, noise, image.shape), 0, 1).astype(np.float32)

    def board_albedo(self, rotation, translation, inner=None, square=None) -> np.ndarray:
        inner, square = inner or self.inner, square or self.square_mm
        normal = rotation[:, 2]
        points = self.rays * ((normal @ translation) / (self.rays @ normal))[..., None]
        local = (points - translation) @ rotation / square
        x, y = local[..., 0], local[..., 1]
        on_board = (np.abs(x - (inner[0] - 1) / 2) < inner[0] / 2 + 1) & (
            np.abs(y - (inner[1] - 1) / 2) < inner[1] / 2 + 1
        )
        squares = (x > -1) & (x < inner[0]) & (y > -1) & (y < inner[1])
        dark = squares & ((np.floor(x) + np.floor(y)) % 2 == 0)
        return np.where(on_board, np.where(dark, 0.12, 0.75), 0.01)

    def board(self, rotation, translation, **board) -> np.ndarray:
        return self.shrink(self.board_albedo(rotation, translation, **board))

    def board_laser(self, rotation, translation) -> np.ndarray:
        normal = rotation[:, 2]
        points = self.rays * ((normal @ translation) / (self.rays @ normal))[..., None]
        sheet = np.exp(-0.5 * (self.laser_plane.distance(points) / 1.1) ** 2)
        return self.shrink(0.9 * sheet * self.board_albedo(rotation, translation))

    def poses(self, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Boards about 800 mm away, tilted by up to 35 degrees, centred in the view."""
        middle = np.array([self.inner[0] - 1, self.inner[1] - 1, 0]) / 2 * self.square_mm
        rng, found = np.random.default_rng(5), []
        for k in range(count):
            tilt = Rotation.from_euler("xyz", [*rng.uniform(-35, 35, 2), 0], degrees=True)
            upright = Rotation.from_euler("z", 90 + rng.uniform(-8, 8), degrees=True)
            rotation = (tilt * upright).as_matrix()
            centre = np.array([*rng.uniform(-12, 12, 2), 800 + 15 * (k % 5 - 2)])
            found.append((rotation, centre - rotation @ middle))
        return found

    def reference_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """The board in the reference plane, z away from the camera."""
        z = -self.reference_plane.normal
        x = np.cross([1.0, 0.0, 0.0], z)
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(z, x), z], axis=1)
        middle = np.array([self.inner[0] - 1, self.inner[1] - 1, 0]) / 2 * self.square_mm
        centre = np.array([0.0, 0.0, -self.reference_plane.offset / self.reference_plane.normal[2]])
        return rotation, centre - rotation @ middle

    def turned(self, pose, angle: float) -> tuple[np.ndarray, np.ndarray]:
        """A pose after the hub turned by `angle`."""
        turn = Rotation.from_rotvec(angle * self.axis.direction).as_matrix()
        rotation, translation = pose
        return turn @ rotation, turn @ (translation - self.axis.point) + self.axis.point

    def radiance_of_plane(self, points: np.ndarray, led: int) -> np.ndarray:
        """Of an albedo-1 card: power cos / d^2, with a beam of cos^1.5 about -z."""
        to_led = self.leds[led] - points
        squared = np.sum(to_led**2, axis=-1)
        cosine = to_led @ self.reference_plane.normal / np.sqrt(squared)
        beam = (-to_led[..., 2] / np.sqrt(squared)) ** 2
        return self.led_power[led] * 150_000 * beam**0.75 * np.maximum(cosine, 0) / squared

    def card(self, led: int, albedo: float = 0.18) -> np.ndarray:
        points = self.reference_plane.intersect(self.rays / self.rays[..., 2:])
        return self.shrink(albedo * self.radiance_of_plane(points, led), noise=0.001)

    def balls(self, led: int) -> np.ndarray:
        rays = self.rays
        points = self.reference_plane.intersect(rays / rays[..., 2:])
        light = 0.04 * self.radiance_of_plane(points, led)
        for centre in self.ball_centres:
            part = self._window(centre, 4.5)
            self._shadow(light[part], points[part], centre, led)
        for centre in self.ball_centres:
            part = self._window(centre, 1.3)
            self._mirror(light[part], rays[part], centre, led)
        return self.shrink(np.minimum(light, 60.0))

    def _window(self, centre: np.ndarray, radii: float) -> tuple[slice, slice]:
        """The subpixels within some radii of a ball."""
        u, v = self.camera.project(centre) * SUPER
        reach = radii * self.ball_radius * self.focal / centre[2] * SUPER
        return (
            slice(max(0, int(v - reach)), int(v + reach)),
            slice(max(0, int(u - reach)), int(u + reach)),
        )

    def _shadow(self, light, points, centre, led) -> None:
        to_led = self.leds[led] - points
        to_led /= np.linalg.norm(to_led, axis=-1, keepdims=True)
        offset = points - centre
        along = np.sum(offset * to_led, axis=-1)
        gap = np.sum(offset**2, axis=-1) - along**2
        light[(gap < self.ball_radius**2) & (along < 0)] = 0.0

    def _mirror(self, light, rays, centre, led) -> None:
        along = rays @ centre
        inside = along**2 - centre @ centre + self.ball_radius**2
        hit = inside > 0
        rays = rays[hit]
        points = (along[hit] - np.sqrt(inside[hit]))[:, None] * rays
        normal = (points - centre) / self.ball_radius
        mirrored = rays - 2 * np.sum(rays * normal, axis=1, keepdims=True) * normal
        to_led = self.leds[led] - points
        to_led /= np.linalg.norm(to_led, axis=1, keepdims=True)
        lamp = 60.0 * np.exp((np.sum(mirrored * to_led, axis=1) - 1) / (0.5 * np.radians(5) ** 2))
        slope = mirrored @ self.reference_plane.normal
        reach = -self.reference_plane.distance(points) / slope
        seen = points + reach[:, None] * mirrored
        card = np.where(
            (slope < 0) & (np.linalg.norm(seen[:, :2], axis=1) < 400),
            0.025 * self.radiance_of_plane(seen, led),
            0.0005,
        )
        light[hit] = card + lamp


@pytest.fixture(scope="session")
def bench() -> Bench:
    return Bench()


@pytest.fixture(autouse=True)
def same_noise_in_any_order(bench):
    """Each test sees the noise that it sees when it runs alone."""
    bench.rng = np.random.default_rng(7)


class CaptureWriter:
    """Writes a calibration capture of a bench."""

    def __init__(self, folder: Path, bench: Bench, scan: str = "rows", encoding: str = "linear"):
        self.folder, self.bench, self.encoding = folder, bench, encoding
        self.rows: list[str] = []
        self.facts = {
            "format": "tread-capture/1",
            "kind": "calibration",
            "capture": folder.name,
            "captured_at": "2020-01-30T08:00:00Z",
            "rig": "test-bench",
            "camera": {
                "size_px": list(bench.size_px),
                "encoding": encoding,
                "black_level": 0,
                "white_level": 65535 if encoding == "linear" else 255,
            },
            "laser": {"scan": scan, "channel": "red"},
            "leds": len(bench.leds),
            "board": {"inner_corners": list(bench.inner), "square_mm": bench.square_mm},
            "axis_board": {"inner_corners": list(bench.inner), "square_mm": bench.square_mm},
            "balls": {
                "count": len(bench.ball_centres),
                "diameter_mm": 2 * bench.ball_radius,
                "centre_height_mm": bench.ball_radius,
            },
            "card": {"albedo": 0.18},
        }
        folder.mkdir(parents=True)

    def add(self, kind: str, image: np.ndarray, pose="", led="", encoder="") -> None:
        name = f"{kind}-{len(self.rows):03d}.png"
        if self.encoding == "linear":
            counts = np.round(image * 65535).astype(np.uint16)
        else:
            high = 1.055 * np.maximum(image, 1e-9) ** (1 / 2.4) - 0.055
            curve = np.where(image <= 0.0031308, 12.92 * image, high)
            counts = np.repeat(np.round(curve * 255).astype(np.uint8)[..., None], 3, axis=2)
        cv2.imwrite(str(self.folder / name), counts)
        self.rows.append(f"{name},{kind},{pose},{led},{encoder},0.02,")

    def finish(self) -> Path:
        (self.folder / "capture.yaml").write_text(yaml.safe_dump(self.facts))
        header = "file,kind,pose,led,encoder_deg,exposure_s,sha256"
        (self.folder / "frames.csv").write_text("\n".join([header, *self.rows]) + "\n")
        return self.folder


@pytest.fixture(scope="session")
def capture_writer():
    return CaptureWriter


@pytest.fixture(scope="session")
def ball_images(bench) -> list[np.ndarray]:
    bench.rng = np.random.default_rng(8)
    return [bench.balls(led) for led in range(len(bench.leds))]


@pytest.fixture(scope="session")
def calibration_capture(bench, ball_images, tmp_path_factory) -> Path:
    """A whole calibration capture, linear, 16 bit, laser across rows."""
    bench.rng = np.random.default_rng(9)
    writer = CaptureWriter(tmp_path_factory.mktemp("captures") / "bench-cal", bench)
    for pose, (rotation, translation) in enumerate(bench.poses(8)):
        writer.add("board", bench.board(rotation, translation), pose=pose)
        writer.add("board_laser", bench.board_laser(rotation, translation), pose=pose)
    writer.add("reference_board", bench.board(*bench.reference_pose()))
    for degrees in (-16, -9, 0, 7, 15):
        pose = bench.turned(bench.reference_pose(), np.radians(degrees))
        writer.add("axis_board", bench.board(*pose), encoder=degrees + 40)
    for led, image in enumerate(ball_images):
        writer.add("balls", image, led=led)
        writer.add("card", bench.card(led), led=led)
    return writer.finish()
