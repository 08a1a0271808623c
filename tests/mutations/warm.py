"""Runs of pytest that are forked from one process with the libraries of others: a run need not import them again.

Nothing of ours is imported before a fork, so that each run sees its own fault.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import resource
import select
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

LIBRARIES = (
    "can", "cantools.database", "click.testing", "docstring_parser", "hypothesis.extra.numpy", "joblib", "mcap.reader", "msgspec",
    "numpy.random", "pytest", "_pytest.doctest", "_pytest.assertion.rewrite", "pytest_timeout", "rich.progress", "scipy.linalg",
    "scipy.optimize", "scipy.signal", "scipy.sparse.linalg", "scipy.stats", "xdist.plugin", "zstandard",
)  # fmt: skip
"""None of them starts a thread, so that a fork has all of the process."""


class Warm:
    """The process that runs are forked from.

    Args:
        folder: working folder of the runs.
        env: environment of the runs.
    """

    def __init__(self, folder: Path, env: Mapping[str, str]) -> None:
        pipe = subprocess.PIPE
        self._out = folder.parent / "out"
        self._server = subprocess.Popen([sys.executable, "-m", __name__], cwd=folder, env=env, stdin=pipe, stdout=pipe, text=True)
        self.pid = self._server.pid

    def start(self, words: Sequence[str], env: Mapping[str, str], limits: Mapping[int, int]) -> None:
        """Start pytest with words, more environment, and limits of its process; `end` must follow."""
        asked = {"words": [*words], "env": {**env}, "limits": [*limits.items()], "out": str(self._out)}
        assert self._server.stdin is not None
        print(json.dumps(asked), file=self._server.stdin, flush=True)

    def end(self, wall_s: float | None = None) -> tuple[int, str] | None:
        """Return status and output of the run that was started; None where it has not ended after so many s."""
        assert self._server.stdout is not None
        if not select.select([self._server.stdout], [], [], wall_s)[0]:
            return None
        return int(self._server.stdout.readline()), self._out.read_text(errors="replace")

    def close(self) -> None:
        """End the process."""
        self._server.communicate()


def _serve() -> None:
    for name in LIBRARIES:
        with suppress(ImportError):
            importlib.import_module(name)
    gc.freeze()
    for line in sys.stdin:
        asked = json.loads(line)
        pid = os.fork()
        if not pid:
            _run(asked["words"], asked["env"], asked["limits"], asked["out"])
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)


def _run(words: list[str], env: dict[str, str], limits: list[tuple[int, int]], out: str) -> None:
    status = 3
    try:
        os.setsid()
        os.environ |= env
        files = os.open(os.devnull, os.O_RDONLY), os.open(out, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        for number, file in enumerate((files[0], files[1], files[1])):
            os.dup2(file, number)
        os.closerange(3, max(files) + 1)
        sys.stdin, sys.stdout, sys.stderr = (open(number, mode) for number, mode in enumerate("rww"))  # noqa: SIM115
        for what, limit in limits:
            resource.setrlimit(what, (limit, limit))
        import pytest

        status = int(pytest.main(words))
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(status)


if __name__ == "__main__":
    _serve()
