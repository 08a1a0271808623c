"""What runs inside a loop. Importing this room imports numpy and nothing heavier, because a process that keeps time does.

Each name brings its module when it is first used: a process pays for the controller that it runs, and for no other.
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
