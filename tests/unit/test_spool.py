"""Arrays in files: they hold what is written, also once their memory was handed back."""

import os

import numpy as np
import psutil
import pytest

from treadlight.spool import Spool


def test_content_survives_that_the_memory_is_handed_back(tmp_path, rng):
    spool = Spool(tmp_path / "new")
    values = spool.empty((3, 1000), np.float32)
    values[:] = truth = rng.random((3, 1000), dtype=np.float32)
    spool.release()
    np.testing.assert_array_equal(values, truth)


def test_memory_is_handed_back(tmp_path):
    size = 64 << 20
    spool = Spool(tmp_path)
    values = spool.empty((size,), np.uint8)
    values[:] = 1
    resident = psutil.Process().memory_info().rss
    spool.release()
    assert resident - psutil.Process().memory_info().rss > 0.9 * size


def test_nothing_is_left_in_the_folder(tmp_path):
    values = Spool(tmp_path).empty((10,), np.float64)
    values[:] = 0
    assert os.listdir(tmp_path) == []


def test_a_full_disk_is_an_error_and_no_crash(tmp_path):
    with pytest.raises(OSError, match=r"(File too large|No space left)"):
        Spool(tmp_path).empty((1 << 55,), np.uint8)
