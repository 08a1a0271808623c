"""What is driven: the plants of a rig, each propagated exactly through time in plain floats.

A plant is a frozen dataclass of parameters. It names its signals (``inputs``, ``outputs``, ``states``), gives the
linear model that a designer sees (``model()``), and starts a running plant (``start(rng)``), which advances by whole
nanoseconds under a held input, and measures.

Importing this package costs nothing: each name brings its module when it is first used, so a run pays for its own plant alone.
"""

from __future__ import annotations

from importlib import import_module

with open(f"{__path__[0]}/__init__.pyi", encoding="utf-8") as _face:
    _HOMES = {words[3]: words[1] for words in map(str.split, _face) if words[0:1] + words[4:5] == ["from", "as"]}
"""Module of each public name, as `__init__.pyi` has them."""

__all__ = sorted(_HOMES)  # noqa: PLE0605


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
