"""How a Python process of ours starts: no folder of the user stands on its path before what is installed."""

from __future__ import annotations

import sys
from typing import Final

PYTHON: Final = (sys.executable, "-P")
"""Python that does not look into its working folder, where a ``pickle.py`` would stand before the standard library's."""


def python_module(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module that is installed.

    Args:
        module: its full name.
        arguments: what follows.

    >>> python_module("hil", "--version")[1:]
    ['-P', '-m', 'hil', '--version']
    """
    return [*PYTHON, "-m", module, *arguments]
