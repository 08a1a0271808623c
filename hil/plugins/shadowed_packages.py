"""Whether `design`, `plants` and `transport` are ours: a module of that name in somebody's folder takes their place."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from hil.errors import HilError

OURS: Final = ("design", "plants", "transport")
ROOT: Final = Path(__file__).resolve().parents[2]
"""The folder that holds hil and its three packages: a checkout, or `site-packages`."""
OUR_FOLDERS: Final = tuple(f"{ROOT / name}/" for name in ("hil", *OURS))

REMEDY: Final = "rename it, or start Python from another folder or with python -P (pytest: --import-mode=importlib)"


def shadows() -> dict[str, str]:
    """Return the files that stand in the place of our packages, by package; what is missing is an empty text."""
    found = {}
    for name in OURS:
        try:
            spec = find_spec(name)
        except ValueError:  # a module without a spec, such as one that a test has put there
            spec = None
        origin = spec.origin if spec is not None else None
        if origin is None or Path(origin).resolve().parent != ROOT / name:
            found[name] = origin or ""
    return found


def refuse_shadowed_packages() -> None:
    """Refuse to go on with somebody else's `design`, `plants` or `transport`.

    Raises:
        HilError: a line for each file that shadows one of ours, with what helps.
    """
    found = shadows()
    if found:
        lines = [f"{path or 'no module'} shadows hilrig's package {name!r}" for name, path in found.items()]
        raise HilError("\n".join([*lines, REMEDY]))


def is_ours(made: object) -> bool:
    """Return whether the class of an object stands in our own packages, under its name."""
    cls = type(made)
    module = sys.modules.get(cls.__module__)
    found = getattr(module, cls.__qualname__, None)
    file = getattr(module, "__file__", None)
    return found is cls and str(file).startswith(OUR_FOLDERS)
