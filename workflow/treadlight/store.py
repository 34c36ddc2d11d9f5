"""The only writer and reader of products: zarr stores, JSON, CSV and HTML files.

A zarr product is written to a temporary sibling and published by rename; its root metadata
carries a digest of all its content, so that a store that is damaged, incomplete or half
written is never read as if it were whole.
"""

import csv
import errno
import glob
import hashlib
import io
import json
import os
import shutil
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr
import zarrs
from zarr.codecs import BloscCodec

from treadlight.errors import StoreError
from treadlight.geometry import (
    Axis,
    Camera,
    CylinderGrid,
    Illumination,
    Led,
    Plane,
    Rig,
    Vignetting,
)
from treadlight.rounding import keep_bits
from treadlight.spool import IN_MEMORY, Memory, Spool
from treadlight.threads import cores, share

ROOT_METADATA = "zarr.json"
PROVENANCE_SUFFIX = ".provenance.json"
CHUNK = 256
_SHARD = 1024
# Level 2 packs twice as fast as blosc's default, and noise by 2 % less.
_LEVEL = 2
_CONVENTIONS = "CF-1.11"
_HOST = socket.gethostname()
_OWNER = f"{_HOST}-{os.getpid()}"

# Reads and packs in half of the time that zarr's own pipeline takes.
zarr.config.set(
    {
        "codec_pipeline.path": f"{zarrs.__name__}.{zarrs.ZarrsCodecPipeline.__name__}",
        "threading.max_workers": cores(),
    }
)


def write_store(
    path: Path,
    dataset: xr.Dataset,
    *,
    title: str,
    source: str,
    memory: Memory | Spool = IN_MEMORY,
) -> None:
    """Publish a dataset as a sharded zarr 3 store at `path` (the store's folder).

    Parameters
    ----------
    path : Path
    dataset : xarray.Dataset
        Every variable needs the attributes ``units`` and ``long_name``.
    title, source : str
        Of the root; `source` is the capture's (or calibration's, or tire's) id.
    memory : Memory or Spool
        Where large variables lie: handed back after each.

    Raises
    ------
    ValueError
        A variable lacks an attribute: a defect of the caller.
    """
    for name, variable in dataset.variables.items():
        missing = {"units", "long_name"} - set(variable.attrs)
        if missing:
            raise ValueError(f"{title}: variable {name!r} lacks {sorted(missing)}.")
    root = {"title": title, "source": source, "Conventions": _CONVENTIONS}
    dataset = _with_strings(dataset.assign_attrs({**dataset.attrs, **root}))
    encoding = {name: _encoding(variable) for name, variable in dataset.variables.items()}
    with _temporary_sibling(path) as temporary:
        # Several threads would lay chunks into a shard as they are ready.
        with zarr.config.set({"threading.max_workers": 1}):
            for part in _parts(dataset):
                told = {name: encoding[name] for name in part.variables}
                part.to_zarr(temporary, mode="a", zarr_format=3, consolidated=False, encoding=told)
                memory.release()
        group = zarr.open_group(temporary, mode="r+", use_consolidated=False)
        group.attrs["content_digest"] = content_digest(temporary)
        provenance_of(path).unlink(missing_ok=True)
        publish(temporary, path)


def _parts(dataset: xr.Dataset) -> Iterator[xr.Dataset]:
    """What is written after each other: the coordinates, then each variable."""
    yield dataset.drop_vars(list(dataset.data_vars))
    for name in dataset.data_vars:
        yield dataset[[name]].drop_vars(list(dataset.coords), errors="ignore")


@contextmanager
def _temporary_sibling(path: Path) -> Iterator[Path]:
    """A hidden name beside a product for this process alone; what is left there is deleted."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _clear_leftovers(path)
    temporary = path.with_name(f".{path.name}.writing.{_OWNER}")
    try:
        yield temporary
    finally:
        _remove(temporary)


def _clear_leftovers(path: Path) -> None:
    """Delete what killed processes left beside a product; others may be writing it just now."""
    for state in ("writing", "old"):
        for left in path.parent.glob(f".{glob.escape(path.name)}.{state}*"):
            host, _, pid = left.name.rpartition(f".{state}")[2].lstrip(".").rpartition("-")
            if not pid or (host == _HOST and pid.isdigit() and not _lives(int(pid))):
                _remove(left)


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return pid != os.getpid()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _with_strings(dataset: xr.Dataset) -> xr.Dataset:
    """Texts of fixed length as texts of any length: zarr 3 specifies only the latter."""
    fixed = {n: v.astype(object) for n, v in dataset.variables.items() if v.dtype.kind == "U"}
    return dataset.assign({n: (v.dims, v.values, v.attrs) for n, v in fixed.items()})


def _encoding(variable: xr.Variable) -> dict[str, Any]:
    if not variable.ndim:
        return {}
    chunks = tuple(min(CHUNK, max(size, 1)) for size in variable.shape)
    shards = tuple(
        chunk * min(_SHARD // CHUNK, max(1, -(-size // chunk)))
        for chunk, size in zip(chunks, variable.shape, strict=True)
    )
    encoding: dict[str, Any] = {
        "chunks": chunks,
        "shards": shards,
        "compressors": BloscCodec(cname="zstd", clevel=_LEVEL, shuffle="bitshuffle"),
    }
    if np.issubdtype(variable.dtype, np.floating):
        encoding["_FillValue"] = np.nan
    return encoding


def publish(temporary: Path, path: Path) -> None:
    """Move a finished folder into place; the old one is moved aside first, then deleted."""
    aside = path.with_name(f".{path.name}.old.{_OWNER}")
    _remove(aside)
    while True:
        with suppress(FileNotFoundError):
            os.rename(path, aside)
        try:
            os.rename(temporary, path)
            break
        except OSError as error:
            # Another process published between the two renames: its folder goes aside as well.
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            _remove(aside)
    _remove(aside)


def content_digest(path: Path) -> str:
    """SHA-256 over the names and bytes of all files of a store but its root metadata."""
    digest = hashlib.sha256()
    names = sorted(
        name
        for name in _files(path)
        if not (name == ROOT_METADATA or name.startswith(".snakemake"))
    )
    found: dict[str, bytes] = {}

    def add(name: str) -> None:
        found[name] = hashlib.sha256((path / name).read_bytes()).digest()

    share(add, names)
    for name in names:
        digest.update(name.encode() + b"\0")
        digest.update(found[name])
    root = json.loads((path / ROOT_METADATA).read_text())
    root["attributes"].pop("content_digest", None)
    digest.update(json.dumps(root, sort_keys=True).encode())
    return digest.hexdigest()


def _files(path: Path) -> Iterable[str]:
    for folder, _, names in os.walk(path):
        for name in names:
            yield (Path(folder) / name).relative_to(path).as_posix()


def open_store(path: Path) -> xr.Dataset:
    """Open a product, lazily, after its content was held against its digest.

    Raises
    ------
    StoreError
        The store is missing, incomplete or damaged.
    """
    path = store_folder(path)
    check_content(path)
    return xr.open_zarr(path, consolidated=False, chunks=None)


def check_content(path: Path) -> None:
    """Hold a store (its folder) against its digest.

    Raises
    ------
    StoreError
        It is missing, incomplete or damaged.
    """
    if not (path / ROOT_METADATA).is_file():
        raise StoreError(f"{path}: there is no such product. Run the stage that writes it.")
    claimed = _root_attributes(path).get("content_digest")
    if claimed is None or claimed != content_digest(path):
        raise StoreError(f"{path}: its content does not match its digest. Delete it and run again.")


def grid_of(surface: xr.Dataset) -> CylinderGrid:
    """The grid that a surface.zarr or profile.zarr lies on."""
    radius = float(surface.attrs["nominal_radius_mm"])
    return CylinderGrid(surface["theta"].to_numpy(), surface["z"].to_numpy(), radius)


def load_rows(surface: xr.Dataset, rows: np.ndarray) -> xr.Dataset:
    """Neighbouring rows of a grid, which may run past the last one to the first.

    zarr would be slow to pick them one by one.
    """
    seams = np.flatnonzero(np.diff(rows) != 1) + 1
    spans = [slice(part[0], part[-1] + 1) for part in np.split(rows, seams) if len(part)]
    loaded = [surface.isel(theta=span).load() for span in spans or [slice(0)]]
    return loaded[0] if len(loaded) == 1 else xr.concat(loaded, "theta")


def store_folder(path: Path) -> Path:
    """The folder of a store that was named by it or by its root zarr.json."""
    return path.parent if path.name == ROOT_METADATA else path


def refused_reason(path: Path) -> str | None:
    """Why a product (store or JSON) is refused, or None if it is not (CSV never is)."""
    path = store_folder(path)
    if path.suffix == ".json":
        reason = read_json(path).get("refused")
    elif path.is_file():
        return None
    else:
        reason = _root_attributes(path).get("refused")
    return str(reason) if reason else None


def _root_attributes(path: Path) -> dict[str, Any]:
    root = read_json(path / ROOT_METADATA)
    attributes = root.get("attributes") if isinstance(root, dict) else None
    if not isinstance(attributes, dict):
        raise StoreError(f"{path / ROOT_METADATA}: is damaged. Delete it and run again.")
    return attributes


def write_refused(path: Path, reason: str, *, title: str, source: str) -> None:
    """Publish a valid, empty product that says in one sentence why it is empty."""
    path = store_folder(path)
    if path.suffix == ".json":
        write_json(path, {"refused": reason})
    else:
        write_store(path, xr.Dataset(attrs={"refused": reason}), title=title, source=source)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Publish a JSON file; NaN becomes null, keys keep their order."""
    text = json.dumps(_plain(content), indent=1, allow_nan=False, ensure_ascii=False)
    write_text(path, text + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON product.

    Raises
    ------
    StoreError
        It is missing or damaged.
    """
    try:
        content = json.loads(_read_checked(path))
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: cannot be read ({error}). Delete it and run again.") from None
    if not isinstance(content, dict):
        raise StoreError(f"{path}: is damaged. Delete it and run again.")
    return content


def _read_checked(path: Path) -> str:
    """The text of a product, held against the digest in its provenance where there is one."""
    data = path.read_bytes()
    try:
        told = json.loads(provenance_of(path).read_bytes())["product_digest"]
    except (OSError, ValueError, LookupError, TypeError):
        told = None
    if told is not None and told != hashlib.sha256(data).hexdigest():
        raise StoreError(f"{path}: its content does not match its digest. Delete it and run again.")
    return data.decode("utf-8")


def provenance_of(path: Path) -> Path:
    """Where it stands what a product (store's folder, or file) was made from."""
    return path.with_name(path.name + PROVENANCE_SUFFIX)


def read_csv(path: Path) -> list[dict[str, str]]:
    """Read a CSV product, one dict of texts per row.

    Raises
    ------
    StoreError
        It is missing or damaged.
    """
    try:
        return list(csv.DictReader(io.StringIO(_read_checked(path)), strict=True))
    except (OSError, ValueError, csv.Error) as error:
        raise StoreError(f"{path}: cannot be read ({error}). Delete it and run again.") from None


def write_text(path: Path, text: str) -> None:
    """Publish a text file atomically."""
    with _temporary_sibling(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
        # What was told of the old product does not hold for the new one.
        provenance_of(path).unlink(missing_ok=True)
        os.replace(temporary, path)


def variable(
    dims: tuple[str, ...], values: np.ndarray, units: str, long_name: str, **attrs: Any
) -> xr.Variable:
    """A CF variable."""
    return xr.Variable(dims, values, {"units": units, "long_name": long_name, **attrs})


def keep_bits_of(variable: xr.Variable, bits: int) -> None:
    """Round a variable's values in place to so many bits of the mantissa, and say so."""
    keep_bits(variable.values, bits)
    # As the netCDF library names it.
    variable.attrs["_QuantizeBitRoundNumberOfSignificantBits"] = bits


def flag_attrs(names: Iterable[str]) -> dict[str, Any]:
    """CF attributes of a variable of bit flags: flag k is bit k."""
    names = list(names)
    return {"flag_masks": [1 << k for k in range(len(names))], "flag_meanings": " ".join(names)}


def read_rig(path: Path) -> Rig:
    """The rig of a calibration.json.

    Raises
    ------
    StoreError
        The file is missing or damaged.
    """
    content = read_json(path)
    try:
        return _rig(content)
    except (LookupError, TypeError, ValueError) as error:
        raise StoreError(f"{path}: is damaged ({error}). Delete it and run again.") from None


def _rig(content: dict[str, Any]) -> Rig:
    camera = content["camera"]
    covariance = content.get("covariance") or {"order": [], "matrix": []}
    return Rig(
        camera=Camera(
            np.array(camera["matrix"], float),
            np.array(camera["distortion"], float),
            (camera["size_px"][0], camera["size_px"][1]),
        ),
        laser_plane=_plane(content.get("laser_plane")),
        axis=_axis(content.get("axis")),
        reference_plane=_plane(content.get("reference_plane")),
        leds=tuple(
            Led(led["led"], np.array(led["position"], float), float(led["intensity"]))
            for led in content.get("leds") or ()
        ),
        covariance_order=tuple(covariance["order"]),
        covariance=np.array(covariance["matrix"], float) if covariance["order"] else None,
    )


def _plane(content: dict[str, Any] | None) -> Plane | None:
    if content is None:
        return None
    coefficients = np.array(content["coefficients"], float)
    return Plane(coefficients[:3], float(coefficients[3]))


def _axis(content: dict[str, Any] | None) -> Axis | None:
    if content is None:
        return None
    return Axis(np.array(content["direction"], float), np.array(content["point"], float))


def read_illumination(path: Path, rig: Rig) -> Illumination:
    """The LEDs of a calibration with their maps of an illumination.zarr.

    Raises
    ------
    StoreError
        The store is damaged, or belongs to another calibration.
    """
    dataset = open_store(path)
    if rig.reference_plane is None or "radiant_intensity" not in dataset:
        raise StoreError(f"{path}: holds no illumination. The calibration has no LEDs.")
    if list(dataset["led"].values) != [led.number for led in rig.leds]:
        raise StoreError(f"{path}: its LEDs are not the calibration's. Run the calibration again.")
    maps = dataset["radiant_intensity"].values
    step = int(dataset["u"].values[1] - dataset["u"].values[0])
    lens = Vignetting(*(float(value) for value in dataset["vignetting"].values))
    return Illumination(rig.leds, rig.reference_plane, rig.camera, maps, step, lens)
