"""What a user's module must leave as it was: working folder, streams, handlers of signals, environment, the process itself.

A call that would end, copy or replace the process is an error of that module: ``os._exit(0)`` ends a run, a worker of a sweep or
a whole pytest without a word and with status 0; a fork returns to hil twice. This is no sandbox: it says what a module does by
mistake. What it does on purpose, `hil.cli.guard` sees.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from functools import wraps
from typing import Any, Final, NamedTuple, Protocol

from hil.plugins.first_instants import ENDING

STREAMS: Final = {0: "standard input", 1: "standard output", 2: "standard error"}


class ProcessState(NamedTuple):
    """What other code of this process leans on."""

    folder: str | None
    files: Mapping[int, tuple[int, int] | None]
    streams: Mapping[str, Any]
    handlers: Mapping[int, Any]
    blocked: frozenset[int]
    environment: Mapping[str, str]

    @classmethod
    def now(cls) -> ProcessState:
        """Return how this process is at present."""
        return cls(
            folder=_folder(),
            files={number: _file(number) for number in STREAMS},
            streams={"stdout": sys.stdout, "stderr": sys.stderr},
            handlers={number: signal.getsignal(number) for number in ENDING},
            blocked=frozenset(signal.pthread_sigmask(signal.SIG_BLOCK, ())),
            environment=dict(os.environ),
        )

    def changes(self) -> list[str]:
        """Return what is not as it was, each as a clause with its remedy's name; variables that were added are no change."""
        now = ProcessState.now()
        gone = sorted(self.environment.keys() - now.environment.keys())
        said: list[str | bool] = [
            self.folder != now.folder and "it changes the working folder (os.chdir)",
            *(self.files[n] != now.files[n] and f"it closes or replaces {what}" for n, what in STREAMS.items()),
            *(self.streams[name] is not now.streams[name] and f"it replaces sys.{name}" for name in self.streams),
            *(
                self.handlers[n] != now.handlers[n] and f"it changes the handler of {signal.Signals(n).name}"
                for n in self.handlers
            ),
            bool((now.blocked - self.blocked) & {*ENDING}) and "it blocks signals that end hil",
            bool(gone) and f"it removes {gone[0]}{' and others' * (len(gone) > 1)} from the environment",
        ]
        return [each for each in said if isinstance(each, str)]

    def restore(self) -> None:
        """Put back what can be put back; a descriptor that was closed cannot."""
        if self.folder is not None and self.folder != _folder():
            os.chdir(self.folder)
        sys.stdout, sys.stderr = self.streams["stdout"], self.streams["stderr"]
        signal.pthread_sigmask(signal.SIG_SETMASK, self.blocked)
        if threading.current_thread() is threading.main_thread():  # no other may set handlers
            for number, handler in self.handlers.items():
                if handler is not None:
                    signal.signal(number, handler)
        os.environ.update({name: value for name, value in self.environment.items() if name not in os.environ})


def _or_none(ask: Callable[[], Any]) -> Any:
    try:
        return ask()
    except OSError:
        return None


def _folder() -> str | None:
    return _or_none(os.getcwd)  # type: ignore[no-any-return]


def _file(number: int) -> tuple[int, int] | None:
    about = _or_none(lambda: os.fstat(number))
    return None if about is None else (about.st_dev, about.st_ino)


CALLS: Final = ("_exit", "abort", "fork", "forkpty", "execv", "execve")
REMEDY: Final = "would end, copy or replace the process of hil itself: raise an exception, or start another with subprocess"


def refuse_calls_from(prefix: str) -> None:
    """Let these calls raise a RuntimeError where a module of such a name, or a file beside one, makes them.

    Args:
        prefix: of the names of modules.
    """
    for name in CALLS:
        call = getattr(os, name)
        if not isinstance(getattr(call, "__wrapped__", None), type(os.getpid)):  # not yet
            setattr(os, name, _refusing(call, prefix))


def _refusing(call: Callable[..., Any], prefix: str) -> Callable[..., Any]:
    @wraps(call)
    def refuse(*arguments: Any, **named: Any) -> Any:
        frame = sys._getframe()
        while frame.f_back is not None and frame.f_globals.get("__name__") in ("os", __name__):  # os.execvp and its kin
            frame = frame.f_back
        files = [str(module.__file__) for name, module in sys.modules.items() if name.startswith(prefix)]
        if os.path.dirname(frame.f_code.co_filename) in map(os.path.dirname, files):
            raise RuntimeError(f"os.{call.__name__} {REMEDY}")
        return call(*arguments, **named)

    return refuse


class Watch(Protocol):
    """Receives what it cannot see from outside."""

    def begin(self, module: str) -> None:
        """Watch from here: the first line of a module, named by its file, is next."""
        ...

    def stopping(self) -> None:
        """A signal was heeded: what ends now ends in order, and closes its log."""
        ...


class _Unwatched:
    def begin(self, module: str) -> None:
        pass

    def stopping(self) -> None:
        pass


WATCH: Final[ContextVar[Watch]] = ContextVar("who watches this process", default=_Unwatched())  # noqa: B039 (it has no state)
