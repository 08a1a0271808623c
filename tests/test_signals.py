"""What tests start takes signals as in a terminal, though a script's `&` ignores SIGINT and SIGQUIT, `nohup` SIGHUP."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CHILD = """
import signal
assert signal.getsignal(signal.SIGINT) is signal.default_int_handler and signal.getsignal(signal.SIGHUP) == signal.SIG_DFL
assert signal.getsignal(signal.SIGQUIT) == signal.SIG_DFL
assert not signal.pthread_sigmask(signal.SIG_BLOCK, [])
"""
PARENT = f"""
import subprocess, sys
from tests.conftest import signals_of_a_terminal
signals_of_a_terminal()
sys.exit(subprocess.run([sys.executable, "-c", {CHILD!r}]).returncode)
"""


def test_children_of_tests_take_signals_though_we_were_started_to_ignore_them() -> None:
    ignoring = ["sh", "-c", 'trap "" INT HUP QUIT; exec "$@"', "sh", sys.executable, "-c"]
    top = Path(__file__).parents[1]
    assert subprocess.run([*ignoring, CHILD], cwd=top, capture_output=True).returncode == 1
    done = subprocess.run([*ignoring, PARENT], cwd=top, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
