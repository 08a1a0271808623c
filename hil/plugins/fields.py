"""The keys of a plug-in's table: their types, defaults, and what the docstring says of them."""

from __future__ import annotations

import dataclasses
import inspect
import re
import types
import typing
from dataclasses import dataclass

import msgspec
from docstring_parser import ParseError
from docstring_parser.google import parse

from hil.plugins import registry

_WORDS: typing.Final[dict[object, str]] = {
    bool: "true or false", int: "whole number", float: "number", str: "text", typing.Any: "any value",
}  # fmt: skip
_PLURALS: typing.Final = {
    "whole number": "whole numbers", "number": "numbers", "text": "texts", "table": "tables", "matrix": "matrices",
    "any value": "any values",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
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
    meanings = _meanings(cls)
    hints = typing.get_type_hints(cls)
    found = [] if isinstance(cls, type) else [("uri", "")]
    if isinstance(cls, type) and issubclass(cls, msgspec.Struct):
        for f in msgspec.structs.fields(cls):
            default = "" if f.required else _default(f.default_factory() if f.default is msgspec.NODEFAULT else f.default)
            found.append((f.name, default))
    elif dataclasses.is_dataclass(cls):
        for g in dataclasses.fields(cls):
            if not g.init:
                continue
            if g.default is not dataclasses.MISSING:
                found.append((g.name, _default(g.default)))
            elif g.default_factory is not dataclasses.MISSING:
                found.append((g.name, _default(g.default_factory())))
            else:
                found.append((g.name, ""))
    return tuple(
        Field(name=name, type=_type(hints.get(name)), default=default, meaning=meanings.get(name, ""))
        for name, default in found
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
        table = next((c for c in classes if dataclasses.is_dataclass(c) or issubclass(c, msgspec.Struct)), None)
        if table is not None and typing.get_origin(hint) is not typing.ClassVar:
            found[f"{name}.N" if typing.get_origin(hint) in (tuple, list) else name] = table
    return found


def about(group: registry.Group, name: str) -> str:
    """Return what the docstring of a plug-in says, without its arguments.

    Raises:
        HilError: if there is no such plug-in.
    """
    text = inspect.getdoc(registry.load(group, name)) or ""
    try:
        doc = parse(text)
    except ParseError:  # a user's plug-in, in a style of its own
        return text
    return "\n\n".join(filter(None, (doc.short_description, doc.long_description)))


def _meanings(cls: object) -> dict[str, str]:
    found: dict[str, str] = {}
    for base in reversed(inspect.getmro(cls)) if isinstance(cls, type) else (cls,):
        try:
            doc = parse(base.__doc__ or "")
        except ParseError:
            continue
        for param in doc.params:
            for name in param.arg_name.split(", "):
                found[name] = " ".join((param.description or "").split())
    return found


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
