"""Whether a process may take the address space that the libraries reserve."""

import resource

from treadlight.errors import MachineError

# Libraries and compiled kernels reserve far more than they use, and crash where they cannot:
# OpenBLAS, LLVM and OpenMP have no error for it. Peaks of every stage on the smallest archive,
# with a tenth to spare.
_LIBRARIES_MB = 1500
_THREAD_MB = 100


def require_address_space(threads: int) -> None:
    """Hold the limit of the shell (``ulimit -v``) against what any command takes.

    Raises
    ------
    MachineError
        The limit is so low that the libraries would crash instead of saying so.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    needed = _LIBRARIES_MB + _THREAD_MB * max(threads, 1)
    if limit != resource.RLIM_INFINITY and limit < needed << 20:
        take, remedy = (
            ("1 thread takes", "Raise the limit.")
            if threads <= 1
            else (f"{threads} threads take", "Raise the limit, or lower --threads.")
        )
        raise MachineError(
            f"The address space is limited to {limit >> 20} MiB (ulimit -v), and {take} {needed}"
            f" MiB before any image is read. {remedy}"
        )
