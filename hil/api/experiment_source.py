"""What a caller hands to a function of ``import hil``: arguments of the kinds that it takes, and which experiment they name.

Only the kinds of the arguments are looked at, as the annotations state them; what a value means is checked where it is used, and
a fault is one error in the caller's words. An experiment is a name, a file or one that was loaded, with changes; a plant or a
controller that was built in Python takes the place of its table.
"""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from inspect import Parameter, Signature, signature
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, SimpleNamespace, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from design.errors import DesignError
from hil.errors import ExperimentError, HilError, nearest
from hil.experiment import load_experiment as read_experiment
from hil.experiment import parse_plugin
from hil.experiment.check import Checker
from hil.experiment.tables import Experiment
from hil.files.toml_text import toml_value
from hil.plugins.registry import group_of
from plants import LinearPlant, from_control
from plants.errors import PlantError
from transport.links import TransportError

P = ParamSpec("P")
R = TypeVar("R")

WORDS: dict[Any, str] = {
    str: "text", Path: "a path", int: "a whole number", float: "a number", bool: "True or False", NoneType: "None",
    Mapping: "a dict with keys of text", Sequence: "a list", Callable: "a function",
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
            hints.update(get_type_hints(SimpleNamespace(__annotations__=own), globalns=vars(sys.modules[function.__module__])))
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


def waited(wait: float | None, external: bool) -> float | None:
    """Return how long to wait for an external controller, s, as it is; None for as long as is usual.

    Raises:
        HilError: there is no external controller, or it is no time.
    """
    from hil.rig.session_link import LONGEST_WAIT_S  # of runs in real time

    check_kind("hil.run: wait", wait, float | None)
    if wait is not None and not external:
        raise HilError("hil.run: wait: only with external=True; it is how long the rig waits for your program")
    if wait is not None and not 0.0 < wait <= LONGEST_WAIT_S:
        raise HilError(f"hil.run: wait: {wait:g}; expected more than 0 s and at most {LONGEST_WAIT_S:g} s")
    return wait


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
            fits = isinstance(value, kind) and (kind is not Mapping or all(isinstance(key, str) for key in value))
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


def with_objects(experiment: Experiment, **objects: object) -> Experiment:
    """Return the same experiment with a plant, a controller, or both, of Python.

    Args:
        experiment: the rest.
        objects: `plant` and `controller`.

    Raises:
        ExperimentError: an object that is no plant or no controller, with what it lacks.
    """
    checker = Checker(experiment.folder, objects)
    made = {path: checker.plugin(group_of(path), None, path) for path in objects}
    if checker.faults:
        raise ExperimentError(experiment.name, checker.faults)
    return msgspec.structs.replace(experiment, kinds=experiment.kinds | checker.kinds, **made)


Source = str | Path | Experiment
OBJECT = re.compile(r"plant|controller|network\.(sc|ca|nodes\.[^.]+)\.law")
"""Paths of the tables of an experiment for which an object may stand."""


@checked_arguments
def load_experiment(
    source: str | Path, sets: Sequence[str] = (), *, seed: int | None = None, duration: str | float | None = None, **changes: Any
) -> Experiment:
    """Read and check an experiment.

    Args:
        source: name of a shipped experiment, or path of a TOML file.
        sets: changes ``path=value`` in TOML notation, as ``hil run --set`` takes them; they come after all others.
        seed: root of all random streams.
        duration: length of a run: seconds, or text such as "2 min".
        changes: path to value, as ``**{"plant.gain": 150, "network.sc.max_age": 4}``. ``plant`` takes a `control.StateSpace` or a
            `control.TransferFunction`, or what `plants.from_control` made of it; ``controller`` a fixed gain as one of them, a
            matrix (m, p) or a number, or a model in discrete time that the error y - r drives and whose output adds to u*. Both
            take an object of any class, one of a notebook's cell too, that is a plant (`plants.Plant`) or a controller
            (`design.controllers.Controller`); the log says so, and `verify` takes it again. ``network.sc.law``,
            ``network.ca.law`` and ``network.nodes.NAME.law`` take an object that is a network law, likewise.

    Raises:
        HilError: with every fault found, each with the path of its field.
    """
    lasting = {} if duration is None else {"duration": str(duration)}
    tables = {path: _table_of(path, value) for path, value in (lasting | changes).items()}
    objects = {path: value for path, value in tables.items() if OBJECT.fullmatch(path) and not isinstance(value, str | Mapping)}
    said = [*(f"{path}={_toml(value, path)}" for path, value in tables.items() if path not in objects), *sets]
    return read_experiment(source, said, seed=seed, objects=objects)


def checked_experiment(source: Source, seed: int | None, duration: str | float | None, changes: Mapping[str, Any]) -> Experiment:
    """Return the experiment of a source with its changes; see `load_experiment`."""
    if not isinstance(source, Experiment):
        given = {"seed": seed, "duration": duration}
        return load_experiment(source, **{key: value for key, value in given.items() if value is not None} | dict(changes))
    objects = [p for p in ("plant", "controller") if p in changes and not isinstance(_table_of(p, changes[p]), str | Mapping)]
    if duration is not None or len(objects) < len(changes):
        raise HilError("a loaded experiment takes no changes but a plant and a controller: give them to load_experiment")
    found = with_objects(source, **changes)
    return found if seed is None else msgspec.structs.replace(found, seed=seed)


def object_of(path: str, value: Any) -> Any:
    """Return the plant or the controller that a value stands for: itself, or what the table is that it would be in a file.

    Args:
        path: "plant" or "controller".
        value: as in `load_experiment`.

    Raises:
        HilError: a table that does not fit.
    """
    table = _table_of(path, value)
    if isinstance(table, Mapping):
        said = [f"{key}={_toml(each, path)}" for key, each in table.items() if key != "kind" and each is not None]
        return parse_plugin(group_of(path), str(table["kind"]), said)
    return table


def _table_of(path: str, value: Any) -> Any:
    """Return the table of an experiment that a model, a plant or a gain stands for; anything else as it is."""
    control = sys.modules.get("control")  # who has a model of python-control has imported it
    model = control is not None and isinstance(value, control.StateSpace | control.TransferFunction)
    if path == "plant":
        plant = from_control(value) if model else value
        if type(plant) is LinearPlant:  # a subclass may have methods of its own: it runs as an object
            fields = {f.name: getattr(plant, f.name) for f in dataclasses.fields(plant)}
            return {"kind": "state-space", **fields}
    if path == "controller":
        if control is not None and model:
            found = control.ss(value)
            if found.nstates and not found.isdtime(strict=True):
                raise HilError("controller: a model with states in continuous time is no fixed gain; sample it first")
            if found.nstates:
                return {"kind": "output-feedback", "A": found.A, "B": found.B, "C": found.C, "D": found.D}
            value = found.D
        if isinstance(value, np.ndarray | list | tuple | float | int):
            try:
                return {"kind": "local", "gain": np.atleast_2d(np.asarray(value, dtype=np.float64))}
            except (TypeError, ValueError) as error:
                raise HilError(f"controller: {value!r:.60}; expected a gain, a matrix (m, p) of numbers, or an object") from error
    return value


def as_change(value: Any, path: str) -> str:
    """Return a value as ``--set`` takes it: text as it is, anything else in TOML notation."""
    return value if isinstance(value, str) else _toml(value, path)


def _toml(value: Any, path: str) -> str:
    """Return a value in TOML notation."""
    try:
        return toml_value(value)
    except TypeError as error:
        raise HilError(
            f"{path}: {error} is not a value of an experiment; expected a number, text, a list or a table"
            "; objects stand at plant, controller, network.sc.law and network.ca.law"
        ) from None
