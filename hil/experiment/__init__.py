"""Experiments: from a name or a TOML file to a checked, frozen description.

Every fault is reported at once, by its path.
"""

from __future__ import annotations

import os
import re
import tomllib
import typing
from pathlib import Path
from typing import Any

from hil.errors import ExperimentError, HilError, nearest
from hil.experiment.check import MAX_BYTES, Checker
from hil.experiment.table import Seconds as Seconds
from hil.experiment.table_check import infinite_faults
from hil.experiment.tables import Experiment as Experiment
from hil.files import read_regular
from hil.files.toml_text import DEEPEST, parse_toml
from hil.plugins import registry

FIRST: typing.Final = "dc-motor-hinf"
"""The experiment to begin with: Chapter 7's, certified, the example of every page of the guide."""
_SHIPPED = Path(__file__).parents[1] / "experiments"


def shipped() -> dict[str, Path]:
    """Return the experiments that come with the package, by name."""
    return {p.stem: p for p in sorted(_SHIPPED.glob("*.toml"))}


def near_shipped(name: str) -> str:
    """Return the question for the shipped experiment whose name begins so, or is near; nothing where none is."""
    begins = sorted((each for each in shipped() if each.startswith(f"{name}-")), key=lambda each: each != FIRST)
    return f"; did you mean {begins[0]!r}?" if begins else nearest(name, shipped())


def load_experiment(
    source: str | Path, sets: typing.Sequence[str] = (), *, seed: int | None = None, duration: str | None = None,
    objects: typing.Mapping[str, object] | None = None,
) -> Experiment:  # fmt: skip
    """Read and check an experiment.

    Args:
        source: name of a shipped experiment, or path of a TOML file.
        sets: changes ``path=value``, value in TOML notation (a bare word is taken as a string). A ``file`` (or ``traffic_file``)
            is looked for in the working folder first, then in that of the experiment.
        seed, duration: short for ``seed=...`` and ``duration="..."``, after the other changes.
        objects: plant, controller and network laws that were built in Python, by the paths of the tables that they stand for.

    Raises:
        ExperimentError: with every fault found, each with the path of its field.
    """
    changes = [*sets]
    if seed is not None:
        changes.append(f"seed={seed}")
    if duration is not None:
        changes.append(f'duration="{duration}"')
    name = str(source)
    if not name:
        raise HilError("no experiment is named; `hil list` shows the shipped ones")
    path = shipped().get(name, Path(source))
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        files = map(str, path.parent.glob("*.toml")) if name.endswith(".toml") else ()
        there = f"; did you mean '{name}.toml'?" if os.path.isfile(f"{name}.toml") else nearest(name, files)
        hint = (there or near_shipped(name) or ";") + " `hil list` shows the shipped ones"
        where = f" in {Path.cwd()}" if name.endswith(".toml") and not path.is_absolute() else ""
        raise HilError(f"no experiment {name!r}: neither a file{where} nor a shipped name{hint}") from None
    except (OSError, ValueError):  # such as a name that is too long: the reading says so
        pass
    if path.suffix == ".mcap":
        raise HilError(f"{name}: is a log, expected an experiment; `hil report` makes a page of a log, or of a folder of logs")
    data = read_regular(path, MAX_BYTES, "an experiment file")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise HilError(f"{name}: not a text file: byte 0x{data[e.start]:02x} at offset {e.start} is not UTF-8") from e
    return parse_experiment(text, sets=changes, source=name, folder=str(path.parent), objects=objects)


def parse_experiment(
    text: str, *, sets: typing.Sequence[str] = (), source: str = "experiment", folder: str = ".",
    objects: typing.Mapping[str, object] | None = None,
) -> Experiment:  # fmt: skip
    """Check the text of an experiment; see :func:`load_experiment`."""
    try:
        raw = parse_toml(text)
    except ValueError as e:
        raise HilError(f"{source}: not valid TOML: {e}{_line_of(text, e)}") from e
    for change in sets:
        path = change.partition("=")[0].strip()
        taken = next((each for each in objects or () if f"{path}.".startswith(f"{each}.")), None)
        if taken is not None:
            raise HilError(f"{source}: {path}: has no effect, an object stands at {taken}; give the object another value")
        _apply(raw, change)
    try:
        return _checked(Checker(folder, objects), raw, text, source)
    except RecursionError as e:
        raise HilError(f"{source}: not valid TOML: nested too deeply") from e


def _checked(checker: Checker, raw: dict[str, Any], text: str, source: str) -> Experiment:
    experiment = checker.experiment(raw, text)
    if experiment is None:
        raise ExperimentError(source, checker.faults)
    return experiment


def experiment_from_resolved(
    resolved: typing.Mapping[str, Any],
    text: str,
    source: str,
    *,
    folder: str | None = None,
    objects: typing.Mapping[str, object] | None = None,
) -> Experiment:
    """Check the resolved form that a log carries, so that what ran can run again.

    A plant or a controller that was built in Python, or stands in a file of its own, is `UnavailablePlugin` unless it is
    given, or the folder of its file is: no file is read, and no module run, because a log says so.

    Args:
        resolved: the experiment with every default.
        text: the file as it was written.
        source: the log, for messages.
        folder: where the files stand that the experiment names.
        objects: "plant", "controller" and paths of network laws to what ran.

    Raises:
        ExperimentError: with every fault found.
    """
    return _checked(Checker(folder, objects), _without_none(resolved), text, f"{source}: resolved experiment")


def parse_table(group: registry.Group, raw: dict[str, Any], path: str, folder: str = ".") -> Any:
    """Make the parameters of one plug-in from its table.

    Args:
        group: what it is.
        raw: the table, with its ``kind``.
        path: how messages name it.
        folder: where a class of the user's own stands.

    Raises:
        HilError: with every fault found.
    """
    checker = Checker(folder)
    checker.faults += infinite_faults(raw, path)
    made = checker.plugin(group, _without_none(raw), path)
    if checker.faults:
        raise HilError("\n".join(checker.faults))
    return made


def parse_plugin(group: registry.Group, kind: str, sets: typing.Sequence[str] = ()) -> Any:
    """Make the parameters of one plug-in from ``key=value`` changes, as the table of an experiment file would."""
    raw: dict[str, Any] = {}
    for change in sets:
        _apply(raw, change, "--parameter")
    return parse_table(group, {"kind": kind, **raw}, group.removeprefix("hil.").removesuffix("s"))


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list) else value


def _apply(raw: dict[str, Any], change: str, option: str = "--set") -> None:
    path, eq, value = change.partition("=")
    if not eq:
        raise HilError(f"{option} {change!r:.60}: expected path=value, such as plant.gain=170")
    try:
        parsed = parse_toml(f"v = {value}")["v"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()
    except ValueError as e:
        raise HilError(f"{option} {path}: {e}") from e
    set_field(raw, path, _found_here(parsed, path.rpartition(".")[2]), f"{option} {change!r:.60}")


FILE_KEYS: typing.Final = ("file", "traffic_file")


def _line_of(text: str, error: ValueError) -> str:
    """Return the line that an error of the parser names, and what is most often wrong with it."""
    place = re.search(r"at line (\d+)", str(error))
    if place is None:
        return ""
    line = text.split("\n")[int(place[1]) - 1].strip()
    return f": {line!r:.80}; text and durations stand in quotes, an inline table on one line"


def _found_here(value: Any, key: str) -> Any:
    """Return a change whose files are those of the working folder, where they stand there: it is typed there."""
    if isinstance(value, dict):
        return {name: _found_here(inner, name) for name, inner in value.items()}
    if key in FILE_KEYS and isinstance(value, str) and value and os.path.isfile(value):
        return os.path.abspath(value)
    return value


def set_field(raw: dict[str, Any], path: str, value: Any, label: str) -> None:
    """Put a value into the tables of an experiment.

    Args:
        raw: the tables; changed in place.
        path: of the field, such as ``network.sc.law``; entries of a list by their numbers.
        value: as the file's parser would give it.
        label: what messages call the change.

    Raises:
        HilError: there is no such place.
    """
    keys = path.strip().split(".")
    if not all(keys):
        raise HilError(f"{label}: expected path=value, such as plant.gain=170")
    if len(keys) > DEEPEST:
        raise HilError(f"{label}: the key has {len(keys)} parts; at most {DEEPEST}")
    node: Any = raw
    for i, key in enumerate(keys):
        at = ".".join(keys[:i])
        if isinstance(node, list):
            if not key.isdigit() or int(key) >= len(node):
                raise HilError(f"{label}: {at} has entries 0 to {len(node) - 1}, not {key!r}")
            index: Any = int(key)
        elif isinstance(node, dict):
            index = key
        else:
            raise HilError(f"{label}: {at} is a value, not a table")
        if i == len(keys) - 1:
            node[index] = value
        else:
            node = node.setdefault(index, {}) if isinstance(node, dict) else node[index]
