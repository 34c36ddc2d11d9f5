"""The report's figures as PNG files; the same arrays give the same bytes."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from PIL import Image

matplotlib.use("Agg")
from matplotlib.figure import Figure

_WIDTH_IN = 11.0
_DPI = 110
_NO_DATA = "#d9d9d9"
_INK = "#333333"


@dataclass(frozen=True)
class Map:
    """An unrolled map of one capture.

    Attributes
    ----------
    title : str
    values : (n, m) float
        Along theta and z; NaN = no data.
    theta_deg, z_mm : (float, float)
        Outer borders of the map.
    """

    title: str
    values: np.ndarray
    theta_deg: tuple[float, float]
    z_mm: tuple[float, float]


def colour_limits(maps: Sequence[Map]) -> tuple[float, float]:
    """One colour scale for all maps: from their 1st to their 99.5th percentile."""
    values = np.concatenate([m.values[np.isfinite(m.values)].ravel() for m in maps])
    if not values.size:
        return 0.0, 1.0
    low, high = np.percentile(values, [1, 99.5])
    return float(low), float(high) if high > low else float(low) + 1.0


def map_figure(maps: Sequence[Map], label: str, radius_mm: float, colours: str) -> bytes:
    """Unrolled maps below each other, with one colour scale and axes in degrees and mm.

    Parameters
    ----------
    maps : sequence of Map
    label : str
        Of the colour bar, with its unit.
    radius_mm : float
        Turns degrees into mm of arc on the upper axis.
    colours : str
        matplotlib's name of the colour map.
    """
    limits = colour_limits(maps)
    heights = [_panel_height(m, radius_mm) for m in maps]
    figure = Figure(figsize=(_WIDTH_IN, sum(heights) + 1.1 * len(maps)), layout="constrained")
    axes = figure.subplots(len(maps), 1, squeeze=False, height_ratios=heights)[:, 0]
    scale = matplotlib.colormaps[colours].with_extremes(bad=_NO_DATA)
    for ax, one in zip(axes, maps, strict=True):
        image = ax.imshow(
            one.values.T,
            origin="lower",
            aspect="auto",
            interpolation="nearest",
            extent=(*one.theta_deg, *one.z_mm),
            cmap=scale,
            vmin=limits[0],
            vmax=limits[1],
        )
        ax.set_title(one.title, loc="left", fontsize=10)
        ax.set_xlabel("angle about the axis (degrees)")
        ax.set_ylabel("along the axis (mm)")
        mm = np.radians(1.0) * radius_mm
        arc = ax.secondary_xaxis("top", functions=(lambda d, s=mm: d * s, lambda x, s=mm: x / s))
        arc.set_xlabel("arc on the tread (mm)", fontsize=8)
        arc.tick_params(labelsize=8)
    figure.colorbar(image, ax=list(axes), label=label, fraction=0.03, pad=0.01)
    return _png(figure)


def _panel_height(one: Map, radius_mm: float) -> float:
    """Inches: true to scale where that stays readable."""
    arc = np.radians(one.theta_deg[1] - one.theta_deg[0]) * radius_mm
    return float(np.clip(0.9 * _WIDTH_IN * (one.z_mm[1] - one.z_mm[0]) / arc, 1.6, 4.5))


def section_figure(
    sections: Sequence[tuple[str, np.ndarray, np.ndarray]], label: str, title: str
) -> bytes:
    """Curves over the axial position, one per capture.

    Parameters
    ----------
    sections : sequence of (name, z, values)
        z and values (m,) mm.
    label, title : str
    """
    figure = Figure(figsize=(_WIDTH_IN, 3.6), layout="constrained")
    ax = figure.subplots()
    for (name, z, values), colour in zip(sections, _shades(len(sections)), strict=True):
        ax.plot(z, values, label=name, color=colour, linewidth=1.1)
    _finish(ax, "along the axis (mm)", label, title)
    return _png(figure)


def trend_figure(
    regions: Sequence[tuple[str, np.ndarray, np.ndarray, np.ndarray, float | None]],
    unit: str,
    label: str,
    title: str,
) -> bytes:
    """Depth over mileage per region, with its standard uncertainty and its trend line.

    Parameters
    ----------
    regions : sequence of (name, mileage, depth, depth_std, slope)
        Arrays (n,); slope in depth per mileage through the middle of the points, None = no
        line.
    unit : str
        Of the mileage.
    """
    figure = Figure(figsize=(_WIDTH_IN, 3.6), layout="constrained")
    ax = figure.subplots()
    for (name, mileage, depth, std, slope), colour in zip(
        regions, _shades(len(regions)), strict=True
    ):
        ax.errorbar(mileage, depth, yerr=std, fmt="o", color=colour, label=name, capsize=3)
        known = np.isfinite(depth)
        if slope is not None and known.sum() > 1:
            middle = mileage[known].mean()
            ends = np.array([mileage[known].min(), mileage[known].max()])
            ax.plot(ends, depth[known].mean() + slope * (ends - middle), color=colour, linewidth=1)
    _finish(ax, f"mileage ({unit})", label, title)
    return _png(figure)


def box_figure(
    groups: Sequence[tuple[str, np.ndarray, np.ndarray]], x: str, label: str, title: str
) -> bytes:
    """Box and whiskers per group; whiskers reach 1.5 times the box, circles are beyond.

    Parameters
    ----------
    groups : sequence of (name, values, rejected)
        Arrays (n,) and (m,); the rejected ones are crosses, at the upper border if they are
        further off than that.
    x, label, title : str
    """
    figure = Figure(figsize=(_WIDTH_IN, 3.6), layout="constrained")
    ax = figure.subplots()
    ax.boxplot(
        [values for _, values, _ in groups],
        tick_labels=[name for name, _, _ in groups],
        flierprops={"markersize": 4},
        medianprops={"color": matplotlib.colormaps["viridis"](0.3)},
    )
    values = np.concatenate([values for _, values, _ in groups])
    top = 1.1 * float(values.max(initial=0.0)) or 1.0
    for place, (_, _, rejected) in enumerate(groups, start=1):
        height = np.minimum(rejected, top)
        where = np.full(len(height), place)
        (crosses,) = ax.plot(where, height, "x", color="#c03030", clip_on=False)
        crosses.set_in_layout(False)
    ax.set_ylim(0, top)
    _finish(ax, x, label, title)
    return _png(figure)


def _shades(count: int) -> list[Any]:
    scale = matplotlib.colormaps["viridis"]
    return [scale(k / max(1, count - 1) * 0.85) for k in range(count)]


def _finish(ax: Any, x: str, y: str, title: str) -> None:
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.set_title(title, loc="left", fontsize=10)
    ax.grid(color="#e5e5e5", linewidth=0.6)
    ax.set_axisbelow(True)
    if ax.get_legend_handles_labels()[1]:
        ax.legend(fontsize=8, frameon=False)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    ax.tick_params(colors=_INK)


def thumbnail(one: Map) -> bytes:
    """A small picture of a map, no axes."""
    low, high = colour_limits([one])
    level = np.clip((one.values.T - low) / (high - low), 0, 1)
    picture = matplotlib.colormaps["viridis"].with_extremes(bad=_NO_DATA)(
        np.ma.masked_invalid(level)[::-1]
    )
    buffer = io.BytesIO()
    Image.fromarray((255 * picture[..., :3]).astype(np.uint8)).save(buffer, "PNG")
    return buffer.getvalue()


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    # Neither version nor clock may change the bytes.
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return buffer.getvalue()
