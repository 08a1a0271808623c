"""The keys of a plug-in's table: their types, defaults, and what the docstring says of them."""

from __future__ import annotations

import dataclasses
import inspect
import re
import types
import typing
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, TypeGuard

import msgspec

from hil.plugins import registry

if TYPE_CHECKING:
    from docstring_parser import Docstring

_WORDS: typing.Final[dict[object, str]] = {
    bool: "true or false", int: "whole number", float: "number", str: "text", typing.Any: "any value",
}  # fmt: skip
_PLURALS: typing.Final = {
    "whole number": "whole numbers", "number": "numbers", "text": "texts", "table": "tables", "matrix": "matrices",
    "any value": "any values",
}  # fmt: skip


class Key(typing.NamedTuple):
    """One key of a table, as a program sees it.

    Args:
        name: of the class's field.
        key: in a file.
        default: makes what stands there where a file says nothing; None: it must say something.
    """

    name: str
    key: str
    default: Callable[[], object] | None


def is_table(hint: object) -> TypeGuard[type]:
    """Return whether a type is a class that a table of a file fills: a dataclass or a `msgspec.Struct`."""
    return isinstance(hint, type) and (dataclasses.is_dataclass(hint) or issubclass(hint, msgspec.Struct))


@cache
def keys_of(cls: Any) -> tuple[Key, ...]:
    """Return the keys of a class that a table fills."""
    if issubclass(cls, msgspec.Struct):
        return tuple(Key(f.name, f.encode_name, _maker(f, msgspec.NODEFAULT)) for f in msgspec.structs.fields(cls))
    return tuple(Key(f.name, f.name, _maker(f, dataclasses.MISSING)) for f in dataclasses.fields(cls) if f.init)


def _maker(field: Any, missing: object) -> Callable[[], object] | None:
    if field.default is not missing:
        return lambda: field.default
    made: Callable[[], object] | None = None if field.default_factory is missing else field.default_factory
    return made


class Field(msgspec.Struct, frozen=True, kw_only=True):
    """One key of a table.

    Args:
        name: the key.
        type: in words, of what a file may say.
        default: as a file writes it; nothing for a key that must be given, ``None`` for one that is not set.
        meaning: what the docstring of its class says of it.
    """

    name: str
    type: str
    default: str
    meaning: str


def fields_of(cls: object) -> tuple[Field, ...]:
    """Return the keys that a table of this class takes.

    Args:
        cls: a dataclass of parameters, a table of an experiment, or the function that opens a link (its only key is the URI).

    >>> from transport import ConstantAge
    >>> [(f.name, f.type) for f in fields_of(ConstantAge)]
    [('age', 'whole number')]
    """
    said: dict[str, str] = {}
    for base in reversed(inspect.getmro(cls)) if isinstance(cls, type) else (cls,):
        doc = parsed(base.__doc__ or "")
        said |= {} if doc is None else meanings(doc)
    hints = typing.get_type_hints(cls)
    found = [] if isinstance(cls, type) else [("uri", "")]
    if is_table(cls):
        found = [(each.name, "" if each.default is None else _default(each.default())) for each in keys_of(cls)]
    return tuple(
        Field(name=name, type=_type(hints.get(name)), default=default, meaning=said.get(name, "")) for name, default in found
    )


def tables_of(cls: object) -> dict[str, type]:
    """Return the keys of a class whose values are tables themselves, with the class of each; `.N` behind a list of tables.

    >>> from transport.laws.packet import PacketLaw
    >>> {name: found.__name__ for name, found in tables_of(PacketLaw).items()}
    {'loss': 'GilbertElliott'}
    >>> from design.controllers.wall import Wall
    >>> sorted(tables_of(Wall))
    ['materials.N', 'pattern']
    """
    found = {}
    for name, hint in typing.get_type_hints(cls).items():
        classes = [each for each in (hint, *typing.get_args(hint)) if isinstance(each, type)]
        table = next(filter(is_table, classes), None)
        if table is not None and typing.get_origin(hint) is not typing.ClassVar:
            found[f"{name}.N" if typing.get_origin(hint) in (tuple, list) else name] = table
    return found


def about(group: registry.Group, name: str) -> str:
    """Return what the docstring of a plug-in says, without its arguments.

    Raises:
        HilError: if there is no such plug-in.
    """
    text = inspect.getdoc(registry.load(group, name)) or ""
    doc = parsed(text)
    return text if doc is None else described(doc)


def parsed(text: str) -> Docstring | None:
    """Return a docstring in its parts; None for one in another style, such as of a user's plug-in."""
    from docstring_parser import ParseError  # which no run needs
    from docstring_parser.google import parse

    try:
        return parse(text)
    except ParseError:
        return None


def described(doc: Docstring) -> str:
    """Return what a docstring says, without its arguments."""
    return "\n\n".join(filter(None, (doc.short_description, doc.long_description)))


def meanings(doc: Docstring) -> dict[str, str]:
    """Return what a docstring says of each argument, as one line."""
    return {name: " ".join((param.description or "").split()) for param in doc.params for name in param.arg_name.split(", ")}


def _type(hint: object) -> str:
    """Return in words what a file may say for a type."""
    args = typing.get_args(hint)
    origin = typing.get_origin(hint)
    if origin is typing.Literal:
        return _either([repr(each) for each in args])
    if origin in (typing.Union, types.UnionType):
        return _either([_type(each) for each in args if each is not types.NoneType])
    if origin in (tuple, list):
        if origin is tuple and args[-1] is not ...:
            return f"[{', '.join(map(_type, args))}]"
        inner = _type(args[0])
        return {"list of numbers": "matrix", "matrix": "list of matrices"}.get(inner, f"list of {_several(inner)}")
    if origin is dict:
        return f"table of {_several(_type(args[1]))}"
    if hint in _WORDS:
        return _WORDS[hint]
    if isinstance(hint, type):
        return f"[{', '.join(hint._fields)}]" if hasattr(hint, "_fields") else "table"
    return re.sub(r"\b(?:[A-Za-z_]\w*\.)+(\w)", r"\1", str(hint))


def _several(word: str) -> str:
    return f"lists{word.removeprefix('list')}" if word.startswith("list ") else _PLURALS.get(word, word)


def _either(words: list[str]) -> str:
    found = list(dict.fromkeys(words))
    return found[0] if len(found) == 1 else f"{', '.join(found[:-1])} or {found[-1]}"


def _default(value: object) -> str:
    """Return a default as a file writes it, ``None`` for a key that is not set."""
    if isinstance(value, bool):
        return str(value).lower()
    if type(value) in (tuple, list):
        return f"[{', '.join(map(_default, value))}]"  # type: ignore[call-overload]
    return repr(value)
