"""Synthesis and analysis of networked controllers as jump-linear systems.

::

    closed_loop -> mjls -> (second_moment, bounded_real) -> certificate
                     \\-> tracking (h2, hinf, mixed synthesis; ccl for comparison; bounds)
    rates -> semi_markov -> (stability, robust_feedback, delayed_hinf, fault_tolerant) -> certificate -> lmi.exact

Names are re-exported lazily: a process that keeps time imports `design.controllers` and pays for nothing else.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module


def exports(package: str, folder: str) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package; its `__init__.pyi` has the module of each public name.

    Args:
        package: its name.
        folder: where it stands.
    """
    with open(f"{folder}/__init__.pyi", encoding="utf-8") as face:
        homes = {words[3]: words[1] for words in map(str.split, face) if words[0:1] + words[4:5] == ["from", "as"]}
    names = sorted(homes)

    def attribute(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(homes[name]), name)

    return attribute, lambda: sorted({*vars(sys.modules[package]), *names}), names


__getattr__, __dir__, __all__ = exports(__name__, __path__[0])
