"""One table of TOML to the class that it fills, field by field, every fault with its path.

A field takes tables whatever its annotation wraps them in: `X | None`, lists, dicts and unions of them.
"""

from __future__ import annotations

import collections.abc
import functools
import json
import math
import re
import types
import typing
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, Final

import msgspec

from hil.errors import HilError, nearest
from hil.experiment.table import Seconds, Table, plug_in_of
from hil.experiment.tables import HIDDEN, Experiment, Links, Network
from hil.plugins import registry
from hil.plugins.fields import is_table, keys_of
from hil.plugins.user_plugins import FieldFault

_UNIONS: Final = (typing.Union, types.UnionType)
_LISTS: Final = (list, tuple, set, frozenset, collections.abc.Sequence, collections.abc.Collection, collections.abc.Set)
_DICTS: Final = (dict, collections.abc.Mapping, collections.abc.MutableMapping)
IN_NETWORK = {"law": "network.sc.law", **{key: f"network.{key}" for key in Network.__struct_encode_fields__}}


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
    keys = {cls: {each.key for each in keys_of(cls)} for cls in classes}
    if not classes or (frame_of(hint, raw) is not None and not any(raw.keys() & known for known in keys.values())):
        return None
    found: type = max(classes, key=lambda cls: (len(raw.keys() & keys[cls]), not keys[cls] - raw.keys()))
    return found


def tag_of(cls: type) -> tuple[str, str | int] | None:
    """Return the key by which a union of structs knows its members and what it says of this one, None for a class without."""
    config = cls.__struct_config__ if issubclass(cls, msgspec.Struct) else None
    return None if config is None or config.tag_field is None or config.tag is None else (config.tag_field, config.tag)


def _tagged(cls: type, raw: Mapping[str, Any]) -> bool:
    tag = tag_of(cls)
    return tag is None or raw.get(tag[0]) == tag[1]


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


INFINITE = "is not a finite number"
LARGEST, SMALLEST = 1e30, 1e-100
"""No quantity of a rig is larger, or smaller and not 0; products of some that are would leave what a double holds."""


def _hook(kind: type, value: object) -> object:
    if kind is Seconds:
        return Seconds.parse(value)
    raise NotImplementedError(kind)


def joined(path: str, rest: str) -> str:
    """Return the path of a field below a table."""
    return f"{path}.{rest}" if path and not rest.startswith("[") else path + rest


def fault_at(path: str, error: BaseException) -> str:
    """Return the fault with its path: that of the field, where the error names one.

    >>> fault_at("plant", ValueError("is too large"))
    'plant: is too large'
    """
    if isinstance(error, FieldFault):
        return f"{joined(path, error.field)}: {error.message}"
    return f"{path}: {error}" if path else str(error)


def _dimensions(hint: Any) -> int:
    """Return of how many dimensions an array of numbers is that a field takes, 0 where it takes something else.

    >>> _dimensions(tuple[tuple[float, ...], ...]), _dimensions(tuple[float, ...] | None), _dimensions(tuple[str, ...])
    (2, 1, 0)
    """
    args = typing.get_args(hint)
    if typing.get_origin(hint) is not tuple:
        return max((_dimensions(each) for each in args if typing.get_origin(each) is tuple), default=0)
    if len(args) != 2 or args[1] is not ...:
        return 0
    inner = _dimensions(args[0])
    return 1 + inner if inner or args[0] in (float, int) else 0


def form(hint: Any) -> str:
    """Return how an array is written in an experiment file, nothing for what is no array.

    >>> form(tuple[tuple[float, ...], ...] | None), form(float)
    ('[[number, ...], ...]', '')
    """
    args = typing.get_args(hint)
    if typing.get_origin(hint) is tuple:
        return f"[{form(args[0]) or _word(args[0])}, ...]" if len(args) == 2 and args[1] is ... else ""
    if isinstance(hint, type) and issubclass(hint, tuple):  # a NamedTuple: its fields in their order
        fields = typing.get_type_hints(hint)
        return f"[{', '.join(json.dumps(name) if kind is str else name for name, kind in fields.items())}]" if fields else ""
    return next(filter(None, map(form, args)), "")


_TYPES: Final = {
    "float": "a number", "int": "a whole number", "str": "text", "bool": "true or false", "array": "a list", "object": "a table",
    "null": "nothing",
}  # fmt: skip
"""What msgspec calls a type, in the words of a file."""


def _in_words(message: str) -> str:
    """Return a message of msgspec with its types in words.

    >>> _in_words("expected `int | null`, got `str`")
    'expected a whole number or nothing, got text'
    """
    return re.sub(r"`([a-z |]+)`", lambda found: " or ".join(_TYPES.get(t, f"`{t}`") for t in found[1].split(" | ")), message)


def _word(kind: Any) -> str:
    return {float: "number", int: "integer", str: '"text"', bool: "true or false"}.get(kind, "value")


def _table_word(hint: Any) -> str:
    """Return what is said of a missing field that takes a table: so, and which keys that has to have."""
    tables = [*filter(is_table, choices(hint))]
    needs = [each.key for cls in tables[:1] for each in keys_of(cls) if each.default is None]
    return (" table" if tables or plug_in_of(hint) else "") + (f"; it has {' and '.join(needs)}" if needs else "")


def infinite_faults(value: Any, path: str) -> Iterator[str]:
    """Yield the numbers that are not finite, or beyond what any field holds, wherever they stand."""
    if isinstance(value, float) and not math.isfinite(value):
        yield f"{path}: {value} {INFINITE}"
    elif isinstance(value, float) and abs(value) > LARGEST:
        yield f"{path}: {value} is beyond {LARGEST:g}"
    elif isinstance(value, float) and 0.0 < abs(value) < SMALLEST:
        yield f"{path}: {value} is below {SMALLEST:g} and not 0"
    elif isinstance(value, int) and value.bit_length() > 64:
        yield f"{path}: an integer of {value.bit_length()} bits, at most 64 are allowed"
    elif isinstance(value, dict):
        for k, v in value.items():
            yield from infinite_faults(v, joined(path, str(k)))
    elif isinstance(value, list):
        for i, v in enumerate(value):
            yield from infinite_faults(v, f"{path}[{i}]")


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
    """What fields of a class take; to evaluate it is a third of what it takes to read an experiment."""
    return typing.get_type_hints(cls, include_extras=issubclass(cls, msgspec.Struct))


class TableCheck:
    """Fills classes from tables, and keeps the faults of all of them.

    Args:
        folder: where the files of numbers stand that fields name; None: no file is read.
        plug_in: makes what a plug-in's table says, by its group; a fault is kept here.
        objects: what stands for the table of a plug-in, by its path, whether or not the file has that table.
    """

    def __init__(
        self, folder: str | None = ".", plug_in: Callable[[registry.Group, Any, str], Any] | None = None,
        objects: Collection[str] = (),
    ) -> None:  # fmt: skip
        self.faults: list[str] = []
        self._folder, self._plug_in, self._objects = folder, plug_in, objects

    def table(self, cls: type, raw: dict[str, Any], path: str, given: dict[str, Any]) -> Any:
        """Convert one table into ``cls``; ``given`` holds fields that were made elsewhere (None: faulty there)."""
        tag = tag_of(cls)
        hints = _hints(cls)
        fields = {each.key: each.name for each in keys_of(cls)}
        required = [each.key for each in keys_of(cls) if each.default is None]
        before, values, broken = len(self.faults), dict(given), set(given)
        objects = {key: None for key in fields if key not in raw and joined(path, key) in self._objects}
        for key, value in (raw | objects).items():
            at = joined(path, key)
            if tag == (key, value):
                continue
            if key not in fields:
                names = [name for name in fields if cls is not Experiment or name not in HIDDEN]
                inner = [IN_NETWORK[key]] if cls in (Experiment, Links, Network) and key in IN_NETWORK else []
                there = f"; there are {', '.join(names)}" if names else "; it has none"
                self.faults.append(f"{at}: unknown field{nearest(inner[0] if inner else key, inner or names) or there}")
                continue
            count = len(self.faults)
            converted = self._value(hints[fields[key]], value, at)
            if len(self.faults) == count:
                values[fields[key]] = converted
            else:
                broken.add(key)
        if issubclass(cls, Table):
            values = cls.completed(values)
        for key in required:
            if fields[key] not in values and key not in broken:
                self.faults.append(f"{joined(path, key)}: missing{_table_word(hints[fields[key]])}")
        if issubclass(cls, Table):
            faulty_fields = {fault.partition(": ")[0] for fault in self.faults[before:]}  # what is wrong is not also missing
            missing_or_wrong = (joined(path, fault) for fault in cls.faults(values))
            self.faults += [fault for fault in missing_or_wrong if fault.partition(": ")[0] not in faulty_fields]
        if len(self.faults) > before or any(v is None for v in given.values()):
            return None
        try:
            return cls(**values)
        except (ValueError, TypeError) as e:
            self.faults.append(fault_at(path, e))
            return None

    def _entries(self, frame: tuple[Any, list[Any]], value: dict[str, Any] | list[Any], path: str) -> Any:
        """Fill the tables of a list or of a dict, however deep they stand."""
        outer, kinds = frame
        if isinstance(value, dict):
            made = [self._value(kind, entry, joined(path, key)) for kind, (key, entry) in zip(kinds, value.items())]
            return msgspec.convert(dict(zip(value, made)), outer, dec_hook=_hook)
        return msgspec.convert([self._value(kind, v, f"{path}[{i}]") for i, (kind, v) in enumerate(zip(kinds, value))], outer)

    def _value(self, hint: Any, value: Any, path: str) -> Any:
        args, mark = typing.get_args(hint), plug_in_of(hint)
        if mark is not None and self._plug_in is not None:
            return self._plug_in(mark.group, value, path)
        if isinstance(value, dict) and self._folder is not None and (dimensions := _dimensions(hint)):
            try:
                from hil.files.arrays import numbers_from_file  # with the readers of three formats

                value = numbers_from_file(value, path.rpartition(".")[2], self._folder, dimensions)
            except HilError as e:
                self.faults.append(f"{path}: {e}")
                return None
        if isinstance(value, dict) and (kind := table_for(hint, value)) is not None:
            return self.table(kind, value, path, {})
        try:
            if isinstance(value, dict | list) and holds_tables(hint) and (frame := frame_of(hint, value)) is not None:
                return self._entries(frame, value, path)
            if typing.get_origin(hint) is tuple and isinstance(value, list) and len(args) == 2 and args[1] is ...:
                return tuple(self._value(args[0], v, f"{path}[{i}]") for i, v in enumerate(value))
            return msgspec.convert(value, hint, dec_hook=_hook)
        except TypeError as e:  # msgspec takes no union of two classes; and a value of an own class may be anything
            word = "a table" if holds_tables(hint) else _word(hint)
            self.faults.append(f"{path}: expected {word}, got {value!r:.60}" if not isinstance(value, dict) else f"{path}: {e}")
            return None
        except (msgspec.ValidationError, ValueError) as e:
            message, _, where = str(e).partition(" - at `$")
            if message.startswith("Invalid enum value"):
                words = [w for part in (hint, *args) if typing.get_origin(part) is typing.Literal for w in typing.get_args(part)]
                message += f", expected one of {', '.join(map(str, words))}{nearest(value, map(str, words))}" if words else ""
            if not where and isinstance(value, str | int | float):
                shown = str(value).lower() if isinstance(value, bool) else f"{'text ' * isinstance(value, str)}{value!r:.60}"
                message = re.sub(r"got `\w+`$", lambda _: f"got {shown}", message)
            if message.startswith("Expected `array") and (written := form(hint)):
                message += f"; it is written {written}"
            path += where.rstrip("`")
            cause = e.__cause__  # what a class of its own said of its values
            text = f"{path}: {message[0].lower()}{_in_words(message[1:])}"
            self.faults.append(fault_at(path, cause) if isinstance(cause, FieldFault) else text)
            return None
