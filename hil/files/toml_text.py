"""TOML read and written: no text costs more than a fraction of a second, and every fault is one error with one message."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Any, Final

import msgspec
import numpy as np

DEEPEST: Final = 32
"""Levels of tables and of arrays, and parts of a dotted key. No experiment has more than six."""

_MOST_DIGITS: Final = 400
_LONG_NUMBER: Final = re.compile(rf"(?<![\d_])\d[\d_]{{{_MOST_DIGITS},}}")
_OPENING: Final = re.compile(r"[\"'#]")
_STRING: Final = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*', re.DOTALL
)


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Python's parser takes a time quadratic in the parts of a dotted key, and its integers of more than 4300 digits are no
    TOML error; both are refused before it sees them.

    Args:
        text: the whole text.

    Raises:
        tomllib.TOMLDecodeError: not TOML.
        ValueError: TOML that no experiment needs: a key, an array or an inline table of more than `DEEPEST` levels, a number
            of more than 400 digits.

    >>> parse_toml("a.b = 1")
    {'a': {'b': 1}}
    """
    bare = _without_strings(text)
    if _LONG_NUMBER.search(bare):
        raise ValueError(f"a number has more than {_MOST_DIGITS} digits")
    for number, line in enumerate(bare.split("\n"), 1):
        parts = max(key.count(".") for key in re.split(r"[=,{}\[\]]", line)) + 1
        if parts > DEEPEST:
            raise ValueError(f"nested too deeply: the key of line {number} has {parts} parts, at most {DEEPEST} are allowed")
    depth = deepest = 0
    for bracket in re.findall(r"[\[{\]}]", bare):
        depth = depth + 1 if bracket in "[{" else max(depth - 1, 0)
        deepest = max(deepest, depth)
    if deepest > DEEPEST:
        raise ValueError(f"nested too deeply: {deepest} levels, at most {DEEPEST} are allowed")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _without_strings(text: str) -> str:
    """The text with every string as `s` and without comments, up to a string that does not end: no TOML comes behind it."""
    kept, at = [], 0
    while opening := _OPENING.search(text, at):
        kept.append(text[at : opening.start()])
        string = _STRING.match(text, opening.start())
        if string is None:
            return "".join(kept)
        kept.append("" if opening.group() == "#" else "s" + "\n" * string.group().count("\n"))
        at = string.end()
    kept.append(text[at:])
    return "".join(kept)


def toml_value(value: Any) -> str:
    """Return a value in TOML notation, arrays of numpy as lists.

    Raises:
        TypeError: TOML has no such value; the text is the name of its class.

    >>> toml_value({"dist": "gamma", "tail of a": 2.0, "p": [1, True]})
    '{ dist = "gamma", "tail of a" = 2.0, p = [1, true] }'
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        plain = value.encode("utf-8", "backslashreplace").decode()
        return msgspec.json.encode(plain).decode().replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, Mapping):
        keys = {key: str(key) if re.fullmatch(r"[A-Za-z0-9_-]+", str(key)) else toml_value(str(key)) for key in value}
        return f"{{ {', '.join(f'{keys[key]} = {toml_value(entry)}' for key, entry in value.items())} }}"
    raise TypeError(type(value).__name__)


def toml_lines(table: Mapping[str, Any]) -> str:
    """Return a line for each entry of a table whose keys are bare; what is None is left out."""
    return "".join(f"{key} = {toml_value(value)}\n" for key, value in table.items() if value is not None)
