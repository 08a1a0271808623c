"""``hil`` in a process of its own that is forked from one with its modules: a tenth of the cost of a fresh start.

For tests of what a command does. What comes before its first line (signals in the first instants, the path, which modules are
imported, how a user's module ends its process) is asked of a fresh Python.
"""

from __future__ import annotations

import atexit
import functools
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.waiting import LIMIT_S

ROOT = Path(__file__).parents[1]
MODULES = (
    "can", "design.controllers", "design.networked_loop.certify", "hil.cli.log_files", "hil.cli.run", "hil.cli.page_text",
    "hil.compose", "hil.compose.stored_gains", "hil.log.read", "hil.log.write.mcap_sink",
    "hil.measure.tracking", "hil.session.replay.replay", "hil.runtime.real.supervisor", "hil.session", "numpy.random",
    "plants.dc_motor", "hil.api.pytest_plugin", "hil.api.assertions", "rich.progress",
)  # fmt: skip
"""What the commands of tests import; none of them starts a thread, so a fork has all of the process."""


def hil_command(
    *words: str, cwd: Path, env: Mapping[str, str] | None = None, timeout: float = LIMIT_S, program: str = "hil",
    terminal: str = "", errors_too: bool = False, absent: Iterable[str] = (), reader_left: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Run ``hil WORDS`` as `subprocess.run` would, with both outputs captured and no standard input.

    Args:
        words: the command and its arguments.
        cwd: its working folder.
        env: its environment; that of this process by default.
        timeout: after which it is killed, s.
        program: "pytest" for pytest in its place.
        terminal: device that takes standard output in place of a file; it is the controlling one of its process.
        errors_too: standard error goes there, too.
        reader_left: standard output is a pipe that nobody reads any more.
        absent: packages of which it can import nothing, as if they were not installed.

    Raises:
        subprocess.TimeoutExpired: it took longer.
    """
    with tempfile.NamedTemporaryFile() as out, tempfile.NamedTemporaryFile() as err:
        given = dict(os.environ if env is None else env)
        asked = {"program": program, "words": words, "cwd": str(cwd), "env": given, "timeout": timeout}
        asked |= {"out": terminal or ("" if reader_left else out.name), "err": (errors_too and terminal) or err.name}
        asked |= {"own_session": bool(terminal), "absent": [*absent]}
        server = _server()
        assert server.stdin is not None and server.stdout is not None
        print(json.dumps(asked), file=server.stdin, flush=True)
        status = json.loads(server.stdout.readline())
        texts = [file.read().decode(errors="replace") for file in (out, err)]
    if status is None:
        raise subprocess.TimeoutExpired([program, *words], timeout, *texts)
    return subprocess.CompletedProcess([program, *words], status, *texts)


@functools.cache
def _server() -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    server = subprocess.Popen([sys.executable, "-m", __name__], cwd=ROOT, stdin=pipe, stdout=pipe, text=True)
    atexit.register(server.communicate)  # it ends with its standard input
    return server


def _serve() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "asammdf", None)  # for which python-can loads pandas; no command of tests writes MF4
        for module in MODULES:
            importlib.import_module(module)
    for line in sys.stdin:
        asked = json.loads(line)
        pid = os.fork()
        if not pid:
            _become(asked)
        watch = threading.Timer(asked["timeout"], os.kill, (pid, signal.SIGKILL))
        watch.start()
        _, status = os.waitpid(pid, 0)
        late = watch.finished.is_set()
        watch.cancel()
        watch.join()  # a fork has one thread
        print(json.dumps(None if late else os.waitstatus_to_exitcode(status)), flush=True)


class Absent:
    """What nothing can be imported of."""

    def __init__(self, names: Iterable[str]) -> None:
        self.names = {*names}
        if there := self.names & {*sys.modules}:
            raise RuntimeError(f"{sorted(there)}: loaded already, by {__name__}.MODULES")

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def _become(asked: dict[str, Any]) -> None:
    """Be ``python -m hil WORDS`` or pytest, from its first line to the end of its process."""
    from hil.__main__ import main

    status: Any = 1
    try:
        if asked["own_session"]:
            os.setsid()  # the terminal that it opens next is its own
        os.chdir(asked["cwd"])
        os.environ.clear()
        os.environ.update(asked["env"])
        for number, name in enumerate((os.devnull, asked["out"], asked["err"])):
            if name:
                opened = os.open(name, os.O_RDWR if number else os.O_RDONLY)  # a terminal that may not be read is nobody's own
            else:
                read, opened = os.pipe()
                os.close(read)
            os.dup2(opened, number)
            os.close(opened)
        sys.stdin, sys.stdout, sys.stderr = (open(number, mode) for number, mode in enumerate("rww"))  # noqa: SIM115
        sys.meta_path.insert(0, Absent(asked["absent"]))  # type: ignore[arg-type]
        sys.argv = [asked["program"], *asked["words"]]
        sys.path[0] = asked["cwd"]
        sys.path[1:1] = filter(None, asked["env"].get("PYTHONPATH", "").split(os.pathsep))
        status = main() if asked["program"] == "hil" else pytest.main()
    except SystemExit as end:
        status = end.code
    except BaseException:  # as Python says it of what no handler caught
        sys.excepthook(*sys.exc_info())
    finally:
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            if stream is not None and not stream.closed:
                stream.flush()
        os._exit(status if isinstance(status, int) else int(status is not None))


if __name__ == "__main__":
    _serve()
