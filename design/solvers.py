"""The packages of ``hilrig[design]``: cvxpy, Clarabel, SCS and python-control, which only a synthesis imports."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from design.errors import DesignError

INSTALL = "pip install 'hilrig[design]'"


def solver(package: str) -> Any:
    """Return a package of the extra ``design``.

    Args:
        package: as it is imported.

    Raises:
        DesignError: it is not installed, with the command that installs it.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        raise DesignError(f"this design needs {package}, which is not installed: {INSTALL}") from None
