"""Too little memory is one plain sentence, said before a library can crash."""

import subprocess
import sys

import pytest

from treadlight.errors import sentence_of


def run_within(mib: int, *arguments: str) -> subprocess.CompletedProcess:
    limit = f"import resource as r; r.setrlimit(r.RLIMIT_AS, ({mib << 20}, {mib << 20}))"
    main = "import sys; from treadlight.cli import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-c", f"{limit}\n{main}", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@pytest.mark.parametrize("mib", [120, 300, 500, 800, 1200])
@pytest.mark.parametrize("command", ["check", "detect-laser-pixels", "integrate"])
def test_a_small_address_space_is_one_sentence_and_status_1(command, mib):
    done = run_within(mib, command, "--threads", "1")
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        f"treadlight {command}: The address space is limited to {mib} MiB (ulimit -v), and 1"
        " thread takes 1600 MiB before any image is read. Raise the limit."
    ]


def test_fewer_threads_need_less():
    assert run_within(1700, "status", "--threads", "8").returncode == 1
    assert "lower --threads" in run_within(1700, "status", "--threads", "8").stderr
    assert run_within(1700, "status", "--help", "--threads", "1").returncode == 0


def test_an_array_that_does_not_fit_is_one_sentence():
    assert sentence_of(MemoryError("Unable to allocate 4 TiB")).startswith("Not enough memory.")
