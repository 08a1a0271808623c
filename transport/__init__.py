"""Packets, the links that carry them, and the network laws that delay and lose them.

Importing the package costs nothing: each name brings its module when it is first used; python-can and zenoh are imported by
the link that needs them, numpy by the network laws.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

with open(f"{__path__[0]}/__init__.pyi", encoding="utf-8") as _face:
    _HOMES = {words[3]: words[1] for words in map(str.split, _face) if words[0:1] + words[4:5] == ["from", "as"]}
"""Module of each public name, as `__init__.pyi` has them."""

__all__ = sorted([*_HOMES, "dbc_path"])  # noqa: PLE0605


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def dbc_path() -> Path:
    """Return the DBC file that names every signal of every frame, for `cantools` and other CAN tools.

    >>> dbc_path().name
    'hilrig.dbc'
    """
    return Path(__file__).with_name("hilrig.dbc")
