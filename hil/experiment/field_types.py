"""Which tables a field takes, whatever its annotation wraps them in: `X | None`, lists, dicts and unions of them."""

from __future__ import annotations

import collections.abc
import dataclasses
import types
import typing
from collections.abc import Mapping
from typing import Any, Final

import msgspec

_UNIONS: Final = (typing.Union, types.UnionType)
_LISTS: Final = (list, tuple, set, frozenset, collections.abc.Sequence, collections.abc.Collection, collections.abc.Set)
_DICTS: Final = (dict, collections.abc.Mapping, collections.abc.MutableMapping)


def is_table(hint: Any) -> bool:
    """Return whether a type is a class that a table of a file fills: a dataclass or a `msgspec.Struct`."""
    return isinstance(hint, type) and (dataclasses.is_dataclass(hint) or issubclass(hint, msgspec.Struct))


def choices(hint: Any) -> list[Any]:
    """Return the members of a union, else the type alone; a generic class stands for its plain one."""
    hint = getattr(hint, "__supertype__", hint)  # of a NewType
    origin = typing.get_origin(hint)
    if origin is typing.Annotated:
        return choices(typing.get_args(hint)[0])
    if origin in _UNIONS:
        return [each for member in typing.get_args(hint) for each in choices(member)]
    return [origin if is_table(origin) else hint]


def holds_tables(hint: Any) -> bool:
    """Return whether a table stands somewhere in what a field takes.

    >>> holds_tables(list[float]), holds_tables(dict[str, float] | None)
    (False, False)
    """
    return any(is_table(each) or any(holds_tables(arg) for arg in typing.get_args(each)) for each in choices(hint))


def table_for(hint: Any, raw: Mapping[str, Any]) -> type | None:
    """Return the class that a table of these keys fills: of several, the one that knows most of them."""
    classes = [each for each in choices(hint) if is_table(each) and _tagged(each, raw)]
    if not classes or (frame_of(hint, raw) is not None and not any(set(raw) & keys_of(cls) for cls in classes)):
        return None
    found: type = max(classes, key=lambda cls: (len(set(raw) & keys_of(cls)), not keys_of(cls) - set(raw)))
    return found


def tag_of(cls: type) -> tuple[str, str | int] | None:
    """Return the key by which a union of structs knows its members and what it says of this one, None for a class without."""
    config = cls.__struct_config__ if issubclass(cls, msgspec.Struct) else None
    return None if config is None or config.tag_field is None or config.tag is None else (config.tag_field, config.tag)


def _tagged(cls: type, raw: Mapping[str, Any]) -> bool:
    tag = tag_of(cls)
    return tag is None or raw.get(tag[0]) == tag[1]


def keys_of(cls: Any) -> set[str]:
    """Return the keys of a table."""
    if issubclass(cls, msgspec.Struct):
        return set(cls.__struct_encode_fields__)
    return {f.name for f in dataclasses.fields(cls) if f.init}


def frame_of(hint: Any, value: Mapping[str, Any] | list[Any]) -> tuple[Any, list[Any]] | None:
    """Return what a field takes for a list or a dict, with anything in it, and the type of every entry.

    Args:
        hint: the field's annotation.
        value: what the file has.

    Returns:
        None where the field takes no list, or no dict.

    >>> frame_of(dict[str, list[float]] | None, {"a": [1.0]})
    (dict[str, typing.Any], [list[float]])
    """
    for each in choices(hint):
        origin, args = typing.get_origin(each), typing.get_args(each)
        if isinstance(value, Mapping) and origin in _DICTS:
            return dict[args[0], Any], [args[1]] * len(value)  # type: ignore[valid-type]
        if isinstance(value, list) and origin in _LISTS:
            if origin is tuple and not (len(args) == 2 and args[1] is ...):
                return (tuple[(Any,) * len(args)], [*args, *[Any] * len(value)][: len(value)])  # type: ignore[misc]
            return origin[(Any, ...)] if origin is tuple else origin[Any], [args[0]] * len(value)
    return None
