import os
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from treadlight import threads


@pytest.fixture(autouse=True)
def two_cores():
    before = threads.cores()
    threads.use_cores(2)
    yield
    threads.use_cores(before)


@given(count=st.integers(0, 500), least=st.integers(1, 40), cores=st.integers(1, 5))
def test_ranges_cover_every_item_once_in_multiples(count, least, cores):
    threads.use_cores(cores)
    parts = threads.ranges(count, least)
    assert [k for first, last in parts for k in range(first, last)] == list(range(count))
    assert all(first % least == 0 for first, _ in parts)
    assert all(last - first >= least for first, last in parts[:-1])


def test_a_kernel_is_called_for_all_of_its_items():
    out = np.zeros(1000)

    def kernel(first, last, step):
        out[first:last] += step

    threads.by_ranges(kernel, len(out), 7, 2.0)
    assert (out == 2).all()


def test_shared_work_shares_nothing_itself():
    inside = []

    def work(item):
        inside.append(threads.cores())
        threads.share(inside.append, [1, 1])

    threads.share(work, range(4))
    assert inside == [1] * 12
    assert threads.cores() == 2


def test_nothing_goes_on_after_the_first_error():
    started, going = [], threading.Event()

    def work(item):
        if item == 0:
            going.wait(5)
            raise ValueError("item 0")
        started.append(item)
        going.set()
        time.sleep(0.2)
        started.append(item)

    with pytest.raises(ValueError, match="item 0"):
        threads.share(work, range(20))
    seen = list(started)
    time.sleep(0.3)
    assert started == seen
    assert len(seen) % 2 == 0
    assert len(seen) < 38


def test_a_forked_process_shares_too():
    threads.share(time.sleep, [0, 0])
    child = os.fork()
    if child == 0:
        done = []
        threads.share(done.append, range(8))
        os._exit(0 if sorted(done) == list(range(8)) else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
