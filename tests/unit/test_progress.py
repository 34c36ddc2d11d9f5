"""How long jobs say how far they are."""

import os
import subprocess
import sys

import pytest

from treadlight.commands.common import TERMINAL, progress

SAY = "from treadlight.commands.common import say; say('views: 3 of 17')"


def test_items_pass_and_their_number_is_said(capsys):
    assert list(progress(range(4), "views", every_s=0)) == [0, 1, 2, 3]
    assert capsys.readouterr().err.splitlines()[-1] == "views: 3 of 4"


def test_with_a_count_items_are_made_one_at_a_time(capsys):
    made = []
    items = (made.append(k) or k for k in range(3))
    passing = progress(items, "views", 3, every_s=0)
    assert next(passing) == 0
    assert made == [0]
    assert list(passing) == [1, 2]
    assert "views: 2 of 3" in capsys.readouterr().err


@pytest.mark.parametrize(("set_to", "shown"), [("1", 1), ("", 0)])
def test_a_line_goes_to_the_log_and_to_the_terminal_if_asked(tmp_path, set_to, shown):
    """A job whose stderr is its log, in a terminal of its own."""
    log = tmp_path / "log"
    job = f'{sys.executable} -c "{SAY}" 2> {log}'
    terminal = f"import pty; pty.spawn(['sh', '-c', {job!r}])"
    done = subprocess.run(
        [sys.executable, "-c", terminal],
        env=os.environ | {TERMINAL: set_to},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=True,
    )
    assert log.read_text() == "views: 3 of 17\n"
    assert done.stdout.count("views: 3 of 17") == shown
