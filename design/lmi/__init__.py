"""Linear matrix inequalities: programs, proof in exact fractions; and the solvers that only a synthesis imports."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from design.errors import NotInstalled

INSTALL = "pip install 'hilrig[design]'"


def solver(package: str) -> Any:
    """Return a package of the extra ``design``: cvxpy, Clarabel, SCS or python-control.

    Args:
        package: as it is imported.

    Raises:
        NotInstalled: it is not installed, with the command that installs it.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        raise NotInstalled(f"this needs {package}, which is not installed: {INSTALL}") from None


def check_solvers() -> None:
    """Raise NotInstalled where one of them is missing: before long work, and not in its midst."""
    for package in ("cvxpy", "clarabel", "scs", "control"):
        solver(package)
