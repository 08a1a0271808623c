"""The package python-control of ``hilrig[design]``, which only a conversion imports."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from plants.errors import PlantError

INSTALL = "pip install 'hilrig[design]'"


def python_control() -> Any:
    """Return python-control.

    Raises:
        PlantError: it is not installed, with the command that installs it.
    """
    try:
        return import_module("control")
    except ModuleNotFoundError as error:
        if error.name != "control":
            raise
        raise PlantError(f"a model of python-control needs the package control, which is not installed: {INSTALL}") from None
