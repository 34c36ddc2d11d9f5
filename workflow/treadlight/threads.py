"""Work shared among cores: by compiled kernels and by what calls them.

Kernels release the interpreter's lock and are called for some of their rows at a time. Compiled
once and without a loop of their own over threads, they take half the time to compile.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import TypeVar

# For a core to take while another is still at a longer one.
_RANGES = 8

T = TypeVar("T")

_allowed = os.cpu_count() or 1
_here = threading.local()


def use_cores(count: int) -> None:
    """Share work among so many cores from now on, in the whole process."""
    global _allowed
    _allowed = max(1, count)


def cores() -> int:
    """How many cores work may be shared among; one where it is shared already."""
    return getattr(_here, "cores", _allowed)


def share(work: Callable[[T], object], items: Iterable[T]) -> None:
    """Do the work on every item, in any order.

    With several items, what the work calls shares nothing among cores itself. When this returns,
    or raises, none of it is going on.

    Raises
    ------
    Exception
        The first one, in the order of the items, that the work raises.
    """
    items = list(items)
    if cores() == 1 or len(items) < 2:
        deque(map(work, items), maxlen=0)
        return
    futures = [_pool(cores()).submit(work, item) for item in items]
    try:
        for future in futures:
            future.result()
    finally:
        for future in futures:
            future.cancel()
        wait(futures)


def by_ranges(kernel: Callable[..., object], count: int, least: int, *arguments: object) -> None:
    """Call kernel(first, last, *arguments) for consecutive ranges that cover range(count).

    Parameters
    ----------
    kernel : callable
        Compiled, without the interpreter's lock; what it leaves must not depend on the ranges.
    count : int
    least : int
        As in `ranges`.
    """
    share(lambda part: kernel(*part, *arguments), ranges(count, least))


def ranges(count: int, least: int) -> list[tuple[int, int]]:
    """Consecutive (first, last) that cover range(count), some for every core.

    Parameters
    ----------
    count : int
    least : int
        A range begins at a multiple of it; it takes far longer than the call, some 50 us.
    """
    length = count if cores() == 1 else -(-count // (_RANGES * cores()))
    length = max(1, -(-length // least)) * least
    return [(first, min(first + length, count)) for first in range(0, count, length)]


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """Threads that wait: to start them takes longer than many a kernel."""
    return ThreadPoolExecutor(count, initializer=_stay_alone)


def _stay_alone() -> None:
    _here.cores = 1


# A forked process has none of the threads.
os.register_at_fork(after_in_child=_pool.cache_clear)
