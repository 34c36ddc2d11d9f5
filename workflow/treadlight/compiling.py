"""How kernels are compiled and where they are kept."""

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import treadlight

_PACKAGE = Path(treadlight.__file__).parent


def kernel(
    function: Callable[..., Any] | None = None, *, allocates: bool = False, **options: Any
) -> Any:
    """Decorator: compiled by numba, kept, and run without the interpreter's lock.

    References to arrays are not counted. Numba counts them at every call and slice, by an atomic
    step that cores take in turns: kernels of few operations on shared arrays spent two thirds of
    their time in it. What makes an array, or is handed one that a kernel made, has to say so.
    A division by zero is infinite or NaN, as numpy's is, and raises nothing.

    Parameters
    ----------
    function : callable, optional
    allocates : bool
        It, or what it calls, makes arrays that it works with or returns.
    **options
        Of `numba.njit`, such as ``inline="always"``.
    """
    from numba import njit

    _tell_numba()
    usual: dict[str, Any] = {
        "cache": True,
        "nogil": True,
        "error_model": "numpy",
        "_nrt": allocates,
    }
    decorate = njit(**usual | options)
    return decorate if function is None else decorate(function)


@cache
def _tell_numba() -> None:
    """Where kernels are kept and what they may use, unless numba's environment says it.

    Not by that environment: jobs on other machines would inherit it.
    """
    import numba

    config: Any = numba.config
    config.CACHE_DIR = config.CACHE_DIR or str(kernel_cache())
    if config.CPU_FEATURES is None:
        config.CPU_FEATURES = cpu_features()


def kernel_cache() -> Path:
    """Where compiled kernels are kept: one folder per state of the code that compiles any.

    numba looks at the file of the calling kernel alone, so a changed kernel in another module
    would live on in its callers.
    """
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        text = path.read_bytes()
        if b"treadlight.compiling import kernel" in text:
            digest.update(text)
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    if not os.access(home if home.exists() else home.parent, os.W_OK):
        home = Path(tempfile.gettempdir())
    return home / "treadlight" / f"kernels-{digest.hexdigest()[:16]}"


def cpu_features() -> str:
    """This machine's, as LLVM names them, and none of its vectors left unused.

    LLVM keeps to half of the widest registers by default, for the sake of code that needs them
    only now and then. Wider vectors change no result: no sum is reordered.
    """
    from numba.core.codegen import get_host_cpu_features

    features = str(get_host_cpu_features())
    return f"{features},-prefer-256-bit" if "+avx512f" in features.split(",") else features
