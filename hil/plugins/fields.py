"""The keys of a plug-in's table: their types, defaults, and what the docstring says of them."""

from __future__ import annotations

import dataclasses
import inspect
import re
import typing
from dataclasses import dataclass

import msgspec
from docstring_parser import ParseError
from docstring_parser.google import parse

from hil.plugins import registry


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One key of a table.

    Args:
        name: the key.
        type: as Python writes it, without our own module names.
        default: in Python notation; nothing for a key that must be given.
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
    [('age', 'int')]
    """
    meanings = _meanings(cls)
    hints = typing.get_type_hints(cls)
    found = [] if isinstance(cls, type) else [("uri", "")]
    if isinstance(cls, type) and issubclass(cls, msgspec.Struct):
        for f in msgspec.structs.fields(cls):
            default = "" if f.required else repr(f.default_factory() if f.default is msgspec.NODEFAULT else f.default)
            found.append((f.name, default))
    elif dataclasses.is_dataclass(cls):
        for g in dataclasses.fields(cls):
            if not g.init:
                continue
            if g.default is not dataclasses.MISSING:
                found.append((g.name, repr(g.default)))
            elif g.default_factory is not dataclasses.MISSING:
                found.append((g.name, repr(g.default_factory())))
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
    text = hint.__name__ if isinstance(hint, type) and not typing.get_args(hint) else str(hint)
    return re.sub(r"\b(?:[A-Za-z_]\w*\.)+(\w)", r"\1", text)
