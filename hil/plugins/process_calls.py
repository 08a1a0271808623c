"""Calls with which a user's module would end, copy or replace the process that runs it: each is an error of that module.

``os._exit(0)`` ends a run, a worker of a sweep or a whole pytest without a word and with status 0; a fork returns to hil twice.
This is no sandbox: it says what a module does by mistake. What it does on purpose, `hil.cli.guard` sees.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import wraps
from typing import Any, Final

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
