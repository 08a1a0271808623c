"""What the page reads: once, of the runs, their signals and fields, and what can be tried by a click; and what its scopes show.

Of a time window that is the smallest and the largest value of each column, so that no spike is lost.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache, reduce
from operator import getitem
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict

from design.controllers.rendered_wall import WallController
from hil.errors import HilError
from hil.experiment import load_experiment, shipped
from hil.pages.live import Records, Side, Trace
from hil.rig.loop import Array, Loop
from plants.parts.protocols import GoesOn, Plant
from transport.laws import ChainLaw, NetworkLaw


def about(sides: Sequence[Side], where: str) -> dict[str, Any]:
    """Return what the page is given of some runs that have begun.

    Args:
        sides: the runs.
        where: which clock, link or log, in words.
    """
    return {"where": where, "runs": [_run(side) for side in sides]}


def _run(side: Side) -> dict[str, Any]:
    loop = side.first
    if loop is None:
        return {"name": "", "traces": [], "waits": side.waits}
    e = loop.experiment
    resolved = e.resolved()
    return {
        "name": e.name, "description": e.description, "seed": e.seed, "period": side.period_s, "slots": e.slots,
        "controllable": side.acts, "paced": side.clock is not None, "traces": [asdict(trace) for trace in side.traces],
        "outputs": [{"name": s.name, "unit": s.unit} for s in e.plant.outputs],
        "inputs": [{"name": s.name, "unit": s.unit} for s in e.plant.inputs],
        "states": [{"name": s.name, "unit": s.unit} for s in e.plant.states],
        "limits": dict(e.limits.state), "plant": e.kinds.get("plant", ""), "wall": _wall(loop),
        "fields": _fields(e.plant, resolved["plant"], real=side.clock is None) if side.acts else {},
        "network": _network(loop, resolved["network"]),
        "controller": e.kinds.get("controller", ""), "own": resolved["controller"],
    }  # fmt: skip


def controllers_of(side: Side) -> dict[str, Any]:
    """Return the controllers that a run may be given; none where it takes none. The page asks when it is drawn: it takes long."""
    if side.first is None or not side.acts or side.clock is None:
        return {}
    e = side.first.experiment
    return controllers(e.kinds.get("plant", ""), side.period_s, len(e.plant.outputs))


def _fields(plant: Plant, said: dict[str, Any], *, real: bool) -> dict[str, float]:
    """Return the numbers of a plant that may change while it runs, in real time or in virtual time, by their paths."""
    found: dict[str, float] = {}

    def take(path: str, value: Any) -> None:
        if isinstance(value, dict):
            for name, inner in value.items():
                take(f"{path}.{name}", inner)
        elif isinstance(value, list | tuple):
            for i, inner in enumerate(value):
                take(f"{path}.{i}", inner)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            found[path] = float(value)

    for name in (plant.own_way() if real else plant.may_change()) if isinstance(plant, GoesOn) else ():
        take(f"plant.{name}", reduce(getitem, name.split("."), said))
    return found


def _network(loop: Loop, said: dict[str, Any]) -> dict[str, Any]:
    """Return the laws that may change, by the path below ``network`` of the table that holds each; none on a shared medium."""
    rig, there, back = loop.rig, int(said["sc"]["max_age"]), int(said["ca"]["max_age"])
    if rig.media:
        return {}
    nodes = rig.sensors if len(rig.sensors) > 1 else ()
    found = {"ca": _law("to the actuator", rig.ca_law, said["ca"]["law"], back)}
    for node in nodes:
        own = said["nodes"][node.name].get("law") or said["sc"]["law"]
        found[f"nodes.{node.name}"] = _law(f"{node.name} to the controller", node.law, own, there)
    return found if nodes else found | {"sc": _law("to the controller", rig.sensors[0].law, said["sc"]["law"], there)}


def _law(label: str, law: NetworkLaw, said: Any, longest: int) -> dict[str, Any]:
    """Return a law as it is said, with its chain of ages where it has one, and presets that keep its longest delay."""
    chain = law.transition_matrix().tolist() if isinstance(law, ChainLaw) else None
    return {"label": label, "law": said, "longest": longest, "chain": chain, "presets": presets(longest)}


def presets(longest: int) -> dict[str, dict[str, Any]]:
    """Return network laws whose ages stay within a bound, by name.

    >>> presets(1)["always late"]
    {'kind': 'constant', 'age': 1}
    """
    found: dict[str, dict[str, Any]] = {"no delay": {"kind": "constant", "age": 0}}
    if longest:
        found["seldom late"] = _markov(longest, 0.05)
        found["often late"] = _markov(longest, 0.5)
        found["mostly late"] = _markov(longest, 0.9)
        found["always late"] = {"kind": "constant", "age": longest}
    return found


def _markov(longest: int, worse: float) -> dict[str, Any]:
    """Return a chain of ages that grow by one with a probability, and otherwise are 0 again."""
    matrix = np.zeros((longest + 1, longest + 1))
    for age in range(longest + 1):
        matrix[age, min(age + 1, longest)] += worse
        matrix[age, 0] += 1.0 - worse
    return {"kind": "markov", "matrix": matrix.tolist()}


@cache
def controllers(plant: str, period_s: float, outputs: int) -> dict[str, Any]:
    """Return the controller tables of the shipped experiments over such a plant at such a period, by the names of these."""
    found = dict[str, Any]()
    for name, path in shipped().items():
        if tomllib.loads(path.read_text(encoding="utf-8"))["plant"]["kind"] != plant:
            continue
        try:
            other = load_experiment(name)
        except HilError:  # what it needs is not installed
            continue
        if float(other.period) == period_s and len(other.plant.outputs) == outputs:
            found[name] = other.resolved()["controller"]
    return found


def _wall(loop: Loop) -> dict[str, Any] | None:
    """Return what the page draws of a virtual wall."""
    if not isinstance(loop.controller, WallController):
        return None
    wall = loop.experiment.resolved()["controller"].get("wall", {})
    return dict(wall) if isinstance(wall, dict) else None


class Window(Struct, frozen=True, kw_only=True):
    """Slots [first, end) in columns of so many slots.

    Args:
        first: slot of the first column's beginning, a multiple of `slots`, so that columns do not flicker as time goes on.
        columns: their number.
        slots: of one column.
    """

    first: int
    columns: int
    slots: int

    @classmethod
    def over(cls, first: int, end: int, most: int) -> Window:
        """Return the window over some slots in as many columns as are asked for, or fewer.

        >>> Window.over(7, 27, 10)
        Window(first=6, columns=11, slots=2)
        """
        slots = max(-(-(end - first) // max(most, 1)), 1)
        begin = first - first % slots
        return cls(first=begin, columns=max(-(-(end - begin) // slots), 1), slots=slots)


def thinned(records: Records, field: str, window: Window, least: float = -np.inf) -> tuple[Array, Array]:
    """Return the smallest and the largest value of a field in every column, (columns,) each; NaN where there is none.

    Args:
        records: of a topic, in the order of slots, with the field ``slot``.
        field: of numbers.
        window: the columns.
        least: a value below it is none.
    """
    low, high = np.full(window.columns, np.nan), np.full(window.columns, np.nan)
    edges = np.arange(window.columns + 1, dtype=np.int64) * window.slots + window.first
    places = np.searchsorted(records["slot"], edges)
    there = np.flatnonzero(places[1:] > places[:-1])
    if len(there):
        values = np.array(records[field][places[0] : places[-1]], dtype=float)
        values[values < least] = np.nan
        starts = places[:-1][there] - places[0]
        low[there], high[there] = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    return low, high


def picture(records: Mapping[str, Records], traces: Sequence[Trace], window: Window) -> bytes:
    """Return the lows and highs of every trace, one behind the other, as float32 of little endian."""
    none: Any = np.full(window.columns, np.nan)
    rows: list[Array] = []
    for trace in traces:
        found = records.get(trace.topic)
        least = 0.0 if trace.unit == "samples" else -np.inf  # an age before the first packet is -1
        rows += [none, none] if found is None or not len(found) else thinned(found, trace.field, window, least)
    return np.array(rows, dtype="<f4").tobytes() if rows else b""
