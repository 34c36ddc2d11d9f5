"""How kernels are compiled: what numba is told, and that what makes arrays says so."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from llvmlite import binding

import treadlight
from treadlight import compiling

_KINDS = "empty", "zeros", "ones", "full"


def kernels():
    """Name, whether it says that it allocates, and the definition of every kernel."""
    for path in Path(treadlight.__file__).parent.rglob("*.py"):
        for node in ast.parse(path.read_text()).body:
            if not isinstance(node, ast.FunctionDef):
                continue
            for decorator in map(ast.unparse, node.decorator_list):
                if decorator.split("(")[0] == "kernel":
                    yield node.name, "allocates=True" in decorator, node


def called(node):
    return {ast.unparse(c.func).split(".")[-1] for c in ast.walk(node) if isinstance(c, ast.Call)}


def makes_array(expression):
    return any(
        ast.unparse(c.func) in {f"np.{kind}{like}" for kind in _KINDS for like in ("", "_like")}
        for c in ast.walk(expression)
        if isinstance(c, ast.Call)
    )


def returns_new_array(node):
    new = {
        name.id
        for n in ast.walk(node)
        if isinstance(n, ast.Assign) and makes_array(n.value)
        for target in n.targets
        for name in ast.walk(target)
        if isinstance(name, ast.Name)
    }
    values = [n.value for n in ast.walk(node) if isinstance(n, ast.Return) and n.value is not None]
    used = {n.id for value in values for n in ast.walk(value) if isinstance(n, ast.Name)}
    return bool(new & used) or any(map(makes_array, values))


def returns_slice(node):
    values = [n.value for n in ast.walk(node) if isinstance(n, ast.Return) and n.value is not None]
    return any(isinstance(n, ast.Slice) for value in values for n in ast.walk(value))


def test_what_takes_arrays_from_a_kernel_that_makes_them_says_so():
    """References are not counted elsewhere: such an array would never be freed."""
    found = list(kernels())
    assert len(found) > 150
    makers = {name for name, _, node in found if returns_new_array(node)}
    assert {"find_peaks", "with_integral", "starts_desk"} <= makers
    silent = {name for name, allocates, node in found if not allocates}
    careless = {name for name, _, node in found if name in silent and called(node) & makers}
    assert not careless
    assert not silent & makers
    handed_on = {name for name, _, node in found if name in silent and returns_slice(node)}
    assert not handed_on


def test_a_kernel_that_makes_an_array_unsaid_does_not_compile():
    @compiling.kernel
    def makes(n):
        return np.zeros(n)

    with pytest.raises(Exception, match="array"):
        makes.compile("float64[:](int64)")


def test_division_by_zero_raises_nothing():
    @compiling.kernel
    def divide(a, b):
        return a / b

    assert divide(1.0, 0.0) == np.inf
    assert np.isnan(divide(0.0, 0.0))


def test_the_widest_vectors_are_used_where_there_are_any():
    wide = binding.get_host_cpu_features().get("avx512f", False)
    assert compiling.cpu_features().endswith(",-prefer-256-bit") == wide


@pytest.mark.parametrize(
    ("said", "kept", "features"),
    [
        ({}, str(compiling.kernel_cache()), compiling.cpu_features()),
        ({"NUMBA_CACHE_DIR": "here", "NUMBA_CPU_FEATURES": "+sse2"}, "here", "+sse2"),
        ({"NUMBA_CPU_NAME": "generic"}, str(compiling.kernel_cache()), ""),
    ],
)
def test_kernels_are_compiled_and_kept_as_the_environment_says_if_it_does(said, kept, features):
    code = (
        "from treadlight.photometric import map_kernels; from numba import config;"
        "print(config.CACHE_DIR, config.CPU_FEATURES, sep='\\n')"
    )
    ours = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    done = subprocess.run(
        [sys.executable, "-c", code], env=ours | said, capture_output=True, text=True, check=True
    )
    assert done.stdout.split("\n")[:2] == [kept, features]
