"""What a user's module leaves as it was: working folder, standard streams, handlers of signals, environment."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from hil.plugins.first_instants import ENDING

STREAMS: Final = {0: "standard input", 1: "standard output", 2: "standard error"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessState:
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
