"""What a caller hands to a function of ``import hil``, beside what its signature says: one error in the caller's words.

Only the kinds of the arguments are looked at, as the annotations state them; what a value means is checked where it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from inspect import Parameter, Signature, signature
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, SimpleNamespace, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from design.errors import DesignError
from hil.errors import HilError, nearest
from hil.experiment.tables import Experiment
from plants.errors import PlantError
from transport.links import TransportError

P = ParamSpec("P")
R = TypeVar("R")

WORDS: dict[Any, str] = {
    str: "text", Path: "a path", int: "a whole number", float: "a number", bool: "True or False", NoneType: "None",
    Mapping: "a dict", Sequence: "a list", Callable: "a function",
}  # fmt: skip
SOURCE: dict[Any, str] = {
    str: "the name of an experiment", Path: "the path of its file", Experiment: "what load_experiment returned",
}  # fmt: skip
"""What an experiment may be named by."""


def checked_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that refuses arguments of other kinds than its annotations, and does what it did with all others.

    Raises:
        HilError: with the function, the parameter, what it was given and what it expects.
    """
    named = signature(function)
    own = {name: hint for name, hint in function.__annotations__.items() if name != "return"}
    hints: dict[str, Any] = {}

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        __tracebackhide__ = True  # pytest shows the line of the test, not this function
        if not hints:
            hints.update(get_type_hints(SimpleNamespace(__annotations__=own), globalns=vars(_module(function))))
        _refuse_unknown(function.__name__, named, kwargs)
        for name, value in named.bind(*args, **kwargs).arguments.items():
            kind = named.parameters[name].kind
            if kind is not Parameter.VAR_KEYWORD:
                for each in value if kind is Parameter.VAR_POSITIONAL else (value,):
                    check_kind(f"hil.{function.__name__}: {name}", each, hints[name], several=kind is Parameter.VAR_POSITIONAL)
        try:
            return function(*args, **kwargs)
        except (DesignError, PlantError, TransportError) as error:  # of packages that know nothing of hil
            raise HilError(str(error)) from error

    return called


def _refuse_unknown(name: str, named: Signature, kwargs: Mapping[str, Any]) -> None:
    """Refuse an argument that the function lacks, with the nearest that it has; changes of an experiment are looked at later."""
    changes = any(each.kind is Parameter.VAR_KEYWORD for each in named.parameters.values())
    own = [key for key in named.parameters if not changes or named.parameters[key].kind is Parameter.KEYWORD_ONLY]
    keys = [*Experiment.__struct_encode_fields__] if changes else []
    for key in kwargs:
        hint = "" if key in named.parameters or key in keys else nearest(key, own)
        if hint and hint == nearest(key, [*own, *keys]) != nearest(key, keys):
            raise HilError(f"hil.{name}: no argument is called {key!r}{hint}")


def _module(function: Callable[..., Any]) -> Any:
    import sys

    return sys.modules[function.__module__]


def check_kind(what: str, value: Any, hint: Any, *, several: bool = False) -> None:
    """Refuse a value of another kind than an annotation names.

    Args:
        what: function and parameter.
        value: what it was given.
        hint: the annotation.
        several: whether the parameter takes each as an argument of its own.

    Raises:
        HilError: with what it was given and what it expects.
    """
    if _fits(value, hint):
        return
    among = _members(hint)
    words = [_words(each, among) for each in among]
    expected = words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
    more = "; hand over each as an argument of its own" if several and isinstance(value, Mapping | list | tuple | set) else ""
    raise HilError(f"{what}: {_shown(value)}; expected {expected}{more}")


def _members(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _fits(value: Any, hint: Any) -> bool:
    """Return whether a value is of one of the kinds that an annotation names; of what is inside it text alone is asked for."""
    for each in _members(hint):
        kind = get_origin(each) or each
        if kind in (Any, object):
            return True
        if kind is Literal:
            fits = isinstance(value, str) and value in get_args(each)
        elif kind in (int, float):
            fits = isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)
        elif kind is Sequence:
            fits = isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes)
            fits = fits and (get_args(each) != (str,) or all(isinstance(one, str) for one in value))
        else:
            fits = isinstance(value, kind)
        if fits:
            return True
    return False


def _words(hint: Any, among: tuple[Any, ...]) -> str:
    kind = get_origin(hint) or hint
    if kind is Literal:
        return " or ".join(map(repr, get_args(hint)))
    if Experiment in among and kind in SOURCE:
        return SOURCE[kind]
    if kind is Sequence and get_args(hint) == (str,):
        return "a list of text"
    return WORDS.get(kind) or _a(kind.__name__)


def _shown(value: Any) -> str:
    plain = isinstance(value, str | int | float | bytes | NoneType)
    return f"{value!r:.40}" if plain else _a(type(value).__name__)


def _a(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"
