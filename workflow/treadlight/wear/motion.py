"""The motion that takes a remounted tire into the frame of its first capture."""

from dataclasses import dataclass

import numpy as np

from treadlight.compiling import kernel
from treadlight.geometry.axis import wrap_angle
from treadlight.threads import by_ranges

PARAMETERS = (
    "rotation_rad",
    "axial_mm",
    "tilt_x_rad",
    "tilt_y_rad",
    "offset_x_mm",
    "offset_y_mm",
    "radial_mm",
)


@dataclass(frozen=True)
class Motion:
    """X' = Rz(rotation) Rx(tilt_x) Ry(tilt_y) X + (offset_x, offset_y, axial), r' = r + radial.

    x is theta = 0, y is theta = pi/2, z the rig's axis; mm and rad.

    Attributes
    ----------
    values : (7,) float64
        In the order of PARAMETERS.
    """

    values: np.ndarray

    @classmethod
    def none(cls) -> "Motion":
        return cls(np.zeros(len(PARAMETERS)))

    def normalised(self) -> "Motion":
        """The same motion with a rotation in [-pi, pi)."""
        values = self.values.copy()
        values[0] = wrap_angle(values[0])
        return Motion(values)

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) float64."""
        rotation, _, tilt_x, tilt_y = self.values[:4]
        c, s = np.cos([rotation, tilt_x, tilt_y]), np.sin([rotation, tilt_x, tilt_y])
        rz = np.array([[c[0], -s[0], 0], [s[0], c[0], 0], [0, 0, 1]])
        rx = np.array([[1, 0, 0], [0, c[1], -s[1]], [0, s[1], c[1]]])
        ry = np.array([[c[2], 0, s[2]], [0, 1, 0], [-s[2], 0, c[2]]])
        return rz @ rx @ ry

    @property
    def shift(self) -> np.ndarray:
        """(3,) float64, mm."""
        return self.values[[4, 5, 1]]

    def apply(
        self, theta: np.ndarray, z: np.ndarray, r: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where points of the moved tire come to lie: theta (rad), z, r (mm), any equal shapes."""
        point = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)
        x, y, z = np.moveaxis(point @ self.matrix.T + self.shift, -1, 0)
        return np.arctan2(y, x), z, np.hypot(x, y) + self.values[6]

    def undo(
        self, theta: np.ndarray, z: np.ndarray, r: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The inverse of `apply`."""
        r = r - self.values[6]
        point = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)
        x, y, z = np.moveaxis((point - self.shift) @ self.matrix, -1, 0)
        return np.arctan2(y, x), z, np.hypot(x, y)

    def jacobian(
        self, theta: np.ndarray, z: np.ndarray, r: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How a moved point shifts with each parameter, to first order in tilts and offsets.

        Parameters
        ----------
        theta, z, r : (n,) float
            After the motion; rad, mm, mm.

        Returns
        -------
        d_theta, d_z, d_r : (n, 7) float64
            rad, mm and mm per unit of each parameter.
        """
        nil, one = np.zeros_like(theta), np.ones_like(theta)
        cos, sin = np.cos(theta), np.sin(theta)
        # Tilts turn the tire before the rotation does.
        cos_0, sin_0 = np.cos(theta - self.values[0]), np.sin(theta - self.values[0])
        d_r = [nil, nil, -z * sin_0, z * cos_0, cos, sin, one]
        d_theta = [one, nil, -z * cos_0 / r, -z * sin_0 / r, -sin / r, cos / r, nil]
        d_z = [nil, one, r * sin_0, -r * cos_0, nil, nil, nil]
        return np.stack(d_theta, axis=-1), np.stack(d_z, axis=-1), np.stack(d_r, axis=-1)


@kernel
def _resample(
    first,
    last,
    source,
    source_std,
    theta_0,
    step_theta,
    z_0,
    step_z,
    theta,
    z,
    start,
    matrix,
    shift,
    radial,
    moved,
    moved_std,
):
    rows = source.shape[0]
    middle = theta_0 + 0.5 * (rows - 1) * step_theta
    for i in range(first, last):
        cos, sin = np.cos(theta[i]), np.sin(theta[i])
        for j in range(z.size):
            radius = start[j]
            # The place on the source depends on the radius by a tilt only (1e-3), so the second
            # step is exact to a micrometre even across a wall.
            for step in range(3):
                x = (radius - radial) * cos - shift[0]
                y = (radius - radial) * sin - shift[1]
                a = z[j] - shift[2]
                x_0 = matrix[0, 0] * x + matrix[1, 0] * y + matrix[2, 0] * a
                y_0 = matrix[0, 1] * x + matrix[1, 1] * y + matrix[2, 1] * a
                z_source = matrix[0, 2] * x + matrix[1, 2] * y + matrix[2, 2] * a
                turn = np.arctan2(y_0, x_0) - middle
                turn -= 2 * np.pi * np.floor(turn / (2 * np.pi) + 0.5)
                row = turn / step_theta + 0.5 * (rows - 1)
                column = (z_source - z_0) / step_z
                found = _linear(source, row, column) if step < 2 else _cubic(source, row, column)
                if np.isnan(found):
                    break
                radius += found - np.sqrt(x_0 * x_0 + y_0 * y_0)
            else:
                moved[i, j] = radius
                moved_std[i, j] = _linear(source_std, row, column)


@kernel
def _linear(source, row, column):
    """Mean of the finite ones of four neighbours, if they carry most of the weight."""
    rows, columns = source.shape
    if not (-0.5 <= row <= rows - 0.5 and -0.5 <= column <= columns - 0.5):
        return np.nan
    i, j = int(np.floor(row)), int(np.floor(column))
    total, weight = 0.0, 0.0
    for di in range(2):
        for dj in range(2):
            value = source[min(max(i + di, 0), rows - 1), min(max(j + dj, 0), columns - 1)]
            w = abs(1 - di - (row - i)) * abs(1 - dj - (column - j))
            if not np.isnan(value):
                total += w * value
                weight += w
    return total / weight if weight > 0.5 else np.nan


@kernel
def _cubic(source, row, column):
    """Catmull-Rom on smooth ground (Keys 1981, a = -1/2); across steps and gaps linear."""
    rows, columns = source.shape
    i, j = int(np.floor(row)), int(np.floor(column))
    if i < 1 or j < 1 or i > rows - 3 or j > columns - 3:
        return _linear(source, row, column)
    low, high = np.inf, -np.inf
    total = 0.0
    for di in range(-1, 3):
        line = 0.0
        for dj in range(-1, 3):
            value = source[i + di, j + dj]
            if np.isnan(value):
                return _linear(source, row, column)
            low, high = min(low, value), max(high, value)
            line += _keys(column - j - dj) * value
        total += _keys(row - i - di) * line
    # A cubic overshoots at a step by a tenth of it: more than wear.
    return total if high - low < 1.0 else _linear(source, row, column)


@kernel
def _keys(x):
    x = abs(x)
    if x < 1:
        return (1.5 * x - 2.5) * x * x + 1
    return ((-0.5 * x + 2.5) * x - 4) * x + 2 if x < 2 else 0.0


def resample(
    source: np.ndarray,
    source_std: np.ndarray,
    source_theta: np.ndarray,
    source_z: np.ndarray,
    motion: Motion,
    theta: np.ndarray,
    z: np.ndarray,
    nominal_radius_mm: float,
) -> tuple[np.ndarray, np.ndarray]:
    """A moved surface on another grid, by the exact inverse of the motion at each cell.

    Parameters
    ----------
    source, source_std : (n, m) float
        r and its uncertainty, mm, on evenly spaced rows `source_theta` (rad; they may pass pi, and
        repeat rows of a whole turn) and columns `source_z` (mm).
    motion : Motion
    theta, z : (k,), (l,) float
        Wanted cells, rad and mm.
    nominal_radius_mm : float
        Where the search for each cell's radius starts.

    Returns
    -------
    r, r_std : (k, l) float32
        mm; NaN where the source has nothing.
    """
    step_theta = (source_theta[-1] - source_theta[0]) / (len(source_theta) - 1)
    step_z = (source_z[-1] - source_z[0]) / (len(source_z) - 1)
    moved, moved_std = np.full((2, len(theta), len(z)), np.nan, np.float32)
    by_ranges(
        _resample,
        len(theta),
        1,
        np.ascontiguousarray(source, np.float32),
        np.ascontiguousarray(source_std, np.float32),
        float(source_theta[0]),
        float(step_theta),
        float(source_z[0]),
        float(step_z),
        np.ascontiguousarray(theta, np.float64),
        np.ascontiguousarray(z, np.float64),
        np.full(len(z), nominal_radius_mm),
        motion.matrix,
        motion.shift,
        float(motion.values[6]),
        moved,
        moved_std,
    )
    return moved, moved_std
