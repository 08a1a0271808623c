"""A signal is raised as an exception in the main thread, never inside an import, where a handler may swallow it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from importlib.metadata import entry_points
from pathlib import Path

import pytest

import hil.__main__

SWALLOWS = """
import time
print("importing", flush=True)
end = time.monotonic() + {seconds}
while time.monotonic() < end:
    try:
        time.sleep(end - time.monotonic())
    except BaseException:
        print("swallowed", flush=True)
"""
WAITS = """
import time
from hil.cli.guard import signals_as_exceptions
from hil.errors import Terminated
try:
    with signals_as_exceptions():
        import swallows
        time.sleep(60)
except Terminated as e:
    raise SystemExit(e.status)
except KeyboardInterrupt:
    raise SystemExit(130)
"""


@pytest.mark.parametrize(
    ("number", "status", "signals"),
    [(signal.SIGINT, 130, 1), (signal.SIGINT, 130, 3), (signal.SIGTERM, 143, 1), (signal.SIGHUP, 129, 3)],
)
def test_a_signal_inside_an_import_is_raised_after_it(tmp_path: Path, number: int, status: int, signals: int) -> None:
    (tmp_path / "swallows.py").write_text(SWALLOWS.format(seconds=0.3))
    path = {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    with subprocess.Popen([sys.executable, "-c", WAITS], stdout=subprocess.PIPE, text=True, env=os.environ | path) as process:
        assert process.stdout is not None and process.stdout.readline() == "importing\n"
        for _ in range(signals):
            process.send_signal(number)
            time.sleep(0.02)
        assert process.communicate(timeout=120)[0] == ""
    assert process.returncode == status


def test_an_import_without_an_end_is_ended(tmp_path: Path) -> None:
    (tmp_path / "swallows.py").write_text(SWALLOWS.format(seconds=30))
    path = {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    with subprocess.Popen([sys.executable, "-c", WAITS], stdout=subprocess.PIPE, text=True, env=os.environ | path) as process:
        assert process.stdout is not None and process.stdout.readline() == "importing\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "swallowed\n"  # it was raised there, where this one passes over it
        process.kill()


DELETES = """
import time
from hil.cli.guard import signals_as_exceptions
from hil.errors import Terminated
class Slow:
    def __del__(self):
        print("deleting", flush=True)
        time.sleep(1.0)  # longer than an import may take
        print("deleted", flush=True)
try:
    with signals_as_exceptions():
        Slow()
        {then}
except Terminated as e:
    raise SystemExit(e.status)
time.sleep(60)
"""


@pytest.mark.parametrize("then", ["time.sleep(60)", "pass"])
def test_a_signal_inside_a_del_is_raised_after_it(then: str) -> None:
    """Python prints what a `__del__` raises and drops it: the command would run on."""
    with subprocess.Popen([sys.executable, "-c", DELETES.format(then=then)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "deleting\n"
        process.send_signal(signal.SIGHUP)
        assert process.communicate(timeout=120)[0] == "deleted\n"
    assert process.returncode == 129


AT_THE_END = """
import ctypes, os, signal, sys
class Late:
    def __del__(self, kill=os.kill, pid=os.getpid(), number={number}):
        kill(pid, number)
sys.kept = ctypes.py_object(Late())  # goes when the interpreter does
sys.argv = ["hil", "--version"]
from hil.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGQUIT])
def test_a_signal_behind_the_end_of_a_command_does_not_change_its_status(number: int) -> None:
    done = subprocess.run([sys.executable, "-c", AT_THE_END.format(number=int(number))], capture_output=True, timeout=120)
    assert done.returncode == 0 and b"hil" in done.stdout and not done.stderr


BEFORE_THE_COMMAND_LINE = """
import os, runpy, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "click":
            os.kill(os.getpid(), {number})
sys.meta_path.insert(0, Finder())
sys.argv = ["hil", "vcan", "--", "true"]
runpy.run_module("hil", run_name="__main__")
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_while_the_command_line_is_imported_ends_it_without_a_word(number: int) -> None:
    program = BEFORE_THE_COMMAND_LINE.format(number=int(number))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, b"", b"")


def test_a_signal_that_is_ignored_stays_so_while_the_command_line_is_imported() -> None:
    program = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)" + BEFORE_THE_COMMAND_LINE.format(number=2)
    program = program.replace('"vcan", "--", "true"', '"--version"')
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, b"")


def test_the_console_command_heeds_signals_first() -> None:
    [command] = [each for each in entry_points(group="console_scripts") if each.name == "hil"]
    assert command.load() is hil.__main__.main
