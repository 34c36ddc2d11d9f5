"""A disk that fails at any call of the store: products stay whole, nothing half-written shows."""

import errno
import os
import sys
from contextlib import contextmanager

import numpy as np
import pytest
import xarray as xr

from treadlight import store
from treadlight.cli import main
from treadlight.commands import common
from treadlight.errors import StoreError

_CALLS = ("open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "shutil.rmtree")
_fault = {"left": None, "code": 0, "below": ""}


def _fail(event, arguments):
    if _fault["left"] is None or event not in _CALLS:
        return
    if not any(_fault["below"] in str(argument) for argument in arguments[:2]):
        return
    if event == "open" and not _writes(arguments):
        return
    _fault["left"] -= 1
    if _fault["left"] < 0:
        raise OSError(_fault["code"], os.strerror(_fault["code"]), str(arguments[0]))


def _writes(arguments):
    _, mode, flags = arguments
    return bool(set(mode or "") & set("wax+")) or bool((flags or 0) & (os.O_WRONLY | os.O_RDWR))


sys.addaudithook(_fail)


@contextmanager
def failing(code, below, after):
    """Every call that writes below a folder fails, once `after` such calls went well."""
    _fault.update(left=after, code=code, below=str(below))
    try:
        yield
    finally:
        _fault["left"] = None


def dataset(value):
    r = np.full((40, 30), float(value))
    return xr.Dataset({"r": store.variable(("theta", "z"), r, "mm", "radius")})


def write(path, value):
    store.write_store(path, dataset(value), title="T", source="s")


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES, errno.EIO])
@pytest.mark.parametrize("after", range(0, 14, 2))
def test_a_store_is_the_old_or_the_new_one_whenever_the_disk_fails(tmp_path, code, after):
    path = tmp_path / "a.zarr"
    write(path, 1)
    failed = False
    with failing(code, tmp_path, after):
        try:
            write(path, 2)
        except OSError:
            failed = True
    found = float(store.open_store(path).r[0, 0]) if path.exists() else None
    assert found in ((1.0, None) if failed else (2.0,))
    write(path, 2)
    assert float(store.open_store(path).r[0, 0]) == 2.0
    assert os.listdir(tmp_path) == ["a.zarr"]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES, errno.EIO])
@pytest.mark.parametrize("after", range(4))
def test_a_text_is_the_old_or_the_new_one_whenever_the_disk_fails(tmp_path, code, after):
    path = tmp_path / "a.json"
    store.write_json(path, {"x": 1})
    with failing(code, tmp_path, after):
        try:
            store.write_json(path, {"x": 2})
        except OSError:
            assert store.read_json(path) == {"x": 1}
    store.write_json(path, {"x": 2})
    assert store.read_json(path) == {"x": 2}
    assert os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES, errno.EIO])
def test_a_full_disk_is_one_sentence_and_no_refusal(tmp_path, capsys, code):
    """A refused product would outlive the trouble: the job fails instead, and runs again."""
    out = tmp_path / "out" / "inventory.json"
    (tmp_path / "c").mkdir()
    with failing(code, tmp_path / "out", 0):
        status = main(["inspect", str(tmp_path / "c"), "--out", str(out)])
    assert status == 1
    said = capsys.readouterr().err.strip().splitlines()
    assert os.strerror(code) in said[-1]
    assert "Traceback" not in "".join(said)
    assert not out.exists()


@pytest.mark.parametrize("error", [MemoryError(), OSError(errno.ENOSPC, "full"), StoreError("x.")])
def test_trouble_of_the_machine_refuses_nothing(tmp_path, error):
    class Arguments:
        command, settings, code = "x", "{}", ""

    def work():
        raise error

    with pytest.raises(type(error)):
        common.run_stage(
            Arguments(), inputs=[], outputs=[tmp_path / "a.json"], title="", source="", work=work
        )
    assert not (tmp_path / "a.json").exists()


@pytest.mark.parametrize("error", [ZeroDivisionError("x"), np.linalg.LinAlgError("singular")])
def test_what_nobody_foresaw_refuses_one_product_in_one_line(tmp_path, error):
    class Arguments:
        command, settings, code = "x", "{}", ""

    def work():
        raise error

    status = common.run_stage(
        Arguments(), inputs=[], outputs=[tmp_path / "a.json"], title="", source="", work=work
    )
    assert status == 0
    reason = store.refused_reason(tmp_path / "a.json")
    assert type(error).__name__ in reason
    assert "\n" not in reason


def test_a_json_product_that_differs_from_its_provenance_is_damaged(tmp_path):
    class Arguments:
        command, settings, code = "x", "{}", ""

    path = tmp_path / "camera.json"
    store.write_json(path, {"fx": 2580.0})
    common.write_provenance(Arguments(), [], [path])
    assert store.read_json(path) == {"fx": 2580.0}
    path.write_bytes(path.read_bytes().replace(b"2580", b"2581"))
    with pytest.raises(StoreError, match=r"does not match its digest\. Delete it and run again"):
        store.read_json(path)
