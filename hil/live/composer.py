"""The process beside a run in which changes are checked, solved and certified: the run does not wait for it."""

from __future__ import annotations

import os
import signal
import threading
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from hil.compose.changed import changed
from hil.compose.loop import Loop
from hil.errors import HilError
from hil.runtime.real.scheduling import die_with_parent


class Composer:
    """Composes changed loops, one at a time, in a process of its own; it is started at the first.

    Use it as a context manager: leaving it ends the process at once.
    """

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._process: Any = None
        self._pipe: Any = None

    def __enter__(self) -> Composer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process, whatever it does."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.join()
            self._pipe.close()

    def changed(self, loop: Loop, k: int, path: str, value: object) -> Loop:
        """Return what `hil.compose.changed.changed` does.

        Raises:
            HilError: as there, or the process ended.
        """
        with self._turn:
            if self._process is None:
                self._start()
            try:
                self._pipe.send((loop, k, path, value))
                answer = self._pipe.recv()
            except (EOFError, OSError) as error:
                self.close()
                raise HilError(f"{path}: the process that certifies it ended; change it again") from error
        if isinstance(answer, HilError):
            raise answer
        found: Loop = answer
        return found

    def _start(self) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, os.getpid()), name="certificates", daemon=True)
        self._process.start()
        theirs.close()


def _serve(pipe: Connection, parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: the parent ends this process
    die_with_parent(parent)
    os.nice(5)
    while True:
        try:
            loop, k, path, value = pipe.recv()
        except EOFError:
            return
        answer: object
        try:
            answer = changed(loop, k, path, value)
        except HilError as error:
            answer = HilError(str(error))  # one that every process can read
        pipe.send(answer)
