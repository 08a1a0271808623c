"""Plants and controllers that are not what they say, each in a way of its own; and honest ones that look odd."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from operator import mul
from typing import Any, ClassVar

import numpy as np

from design.controllers import LoopModel, Rows, Selection
from plants.parts import Signal, StateSpace

Vector = list[float]
A = np.array([[-1.0, 0.4], [-0.3, -2.0]])
B = np.array([[0.5], [1.0]])
C = np.array([[1.0, 0.0]])


@lru_cache(maxsize=64)
def flow(a: bytes, b: bytes, dt: float) -> list[list[float]]:
    """The state after dt s, by state, input and force; most slots of a run ask for the same rows."""
    found = StateSpace(A=np.frombuffer(a).reshape(2, 2), B=np.column_stack([np.frombuffer(b), np.eye(2)]), C=C).discretise(dt)
    rows: list[list[float]] = np.hstack([found.A, found.B]).tolist()
    return rows


@dataclass(frozen=True)
class Plant:
    """x' = A x + B u with a lie: `wrong(run, u)` returns the matrices, the input and the force of a slot."""

    lie: str = "none"
    first: tuple[float, float] = (0.3, -0.2)

    inputs: ClassVar = (Signal("u", "V"),)
    outputs: ClassVar = (Signal("y", "m"),)
    states: ClassVar = (Signal("a", "m"), Signal("b", "m"))

    def model(self) -> StateSpace:
        return StateSpace(A=A, B=B, C=C)

    def start(self, rng: np.random.Generator) -> Run:
        return Run(self, rng)


SLOT_NS = 50_000_000
CALLS = {"model": 0, "start": 0, "table": 0}


class Run:
    def __init__(self, plant: Plant, rng: np.random.Generator) -> None:
        CALLS["start"] += 1
        self.plant, self.rng, self.k, self.hidden = plant, rng, 0, 1e-6
        self.x, self.u, self.past = [*plant.first], (0.0,), [0.0] * 5
        self.born, self.energy, self.now_ns, self.drawn = CALLS["start"], 0.0, 0, rng.standard_normal(3)

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        if not dt_ns:
            return
        v = u[0] + (w[0] if w else 0.0)
        a, b, force = A.copy(), B.copy(), np.zeros(2)
        LIES[self.plant.lie](self, v, a, b, force)
        moved = (*self.x, v, *force.tolist())
        self.x = [sum(map(mul, row, moved)) for row in flow(a.tobytes(), b.tobytes(), dt_ns / 1e9)]
        self.past = [v, *self.past[:-1]]
        self.energy += v * v * dt_ns / SLOT_NS
        self.now_ns += dt_ns
        if self.now_ns // SLOT_NS != self.k:
            self.k = self.now_ns // SLOT_NS
            self.drawn = self.rng.standard_normal(3)
        self.u = (u[0],)

    def measure(self) -> tuple[float, ...]:
        y = self.x[0]
        return (float(OUTPUTS.get(self.plant.lie, lambda run, y: y)(self, y)),)

    @property
    def state(self) -> tuple[float, ...]:
        return (self.x[0], self.x[1])

    @property
    def applied(self) -> tuple[float, ...]:
        return self.u


def _hidden(growth: float, seed: float) -> Callable[..., None]:
    def lie(run: Run, v: float, a: Any, b: Any, f: Any) -> None:
        run.hidden = run.hidden * growth + seed * v
        f[0] += run.hidden

    return lie


def _when(condition: Callable[[Run, float], bool], change: Callable[[Any, Any, Any], None]) -> Callable[..., None]:
    def lie(run: Run, v: float, a: Any, b: Any, f: Any) -> None:
        if condition(run, v):
            change(a, b, f)

    return lie


def unstable(a: Any, b: Any, f: Any) -> None:
    a[:] = [[0.5, 0.0], [0.0, 0.5]]


def turned(a: Any, b: Any, f: Any) -> None:
    b[:] = -3.0 * b


def none(run: Run, v: float, a: Any, b: Any, f: Any) -> None:
    """An honest plant."""


CONDITIONS: dict[str, Callable[[Run, float], bool]] = {
    "always": lambda run, v: True,
    "after 100 slots": lambda run, v: run.k > 100,
    "after 5 slots": lambda run, v: run.k > 5,
    "negative inputs": lambda run, v: v < 0,
    "positive inputs": lambda run, v: v > 0,
    "large inputs": lambda run, v: abs(v) > 0.7,
    "huge inputs": lambda run, v: abs(v) > 1e4,
    "small inputs": lambda run, v: abs(v) < 1e-2,
    "large states": lambda run, v: float(np.abs(run.x).max()) > 2.0,
    "negative states": lambda run, v: run.x[1] < 0,
    "every third slot": lambda run, v: run.k % 3 == 0,
    "every fiftieth slot": lambda run, v: run.k % 50 == 49,
    "changing inputs": lambda run, v: v != run.past[0],
    "resting inputs": lambda run, v: v == run.past[0] != 0.0,
    "spent energy": lambda run, v: run.energy > 1.0,
    "odd starts": lambda run, v: run.born % 2 == 1,
    "a seed's toss": lambda run, v: bool(run.drawn[2] < -1.3),
    "both states positive": lambda run, v: bool(run.x[0] > 0 and run.x[1] > 0),
}
CHANGES: dict[str, Callable[[Any, Any, Any], None]] = {
    "unstable": unstable,
    "turned": turned,
    "coupled": lambda a, b, f: a.__setitem__((1, 0), 4.0),
}
LIES: dict[str, Callable[..., None]] = {
    "none": none,
    **{f"{change}, {when}": _when(CONDITIONS[when], CHANGES[change]) for when in CONDITIONS for change in ("unstable", "turned")},
    "coupled, always": _when(CONDITIONS["always"], CHANGES["coupled"]),
    "a hidden state that grows": _hidden(1.08, 0.0),
    "a hidden state that inputs feed": _hidden(1.08, 1e-3),
    "a late input": lambda run, v, a, b, f: f.__iadd__(0.05 * (run.past[1] - v)),
    "a cubic spring": lambda run, v, a, b, f: f.__iadd__([0.0, -0.01 * float(run.x[0]) ** 3]),
    "a gain of 1.05": lambda run, v, a, b, f: b.__imul__(1.05),
    "gain of nothing": lambda run, v, a, b, f: b.__imul__(0.0),
    "growing noise": lambda run, v, a, b, f: f.__iadd__(run.drawn[:2] * 1e-3 * 1.05**run.k),
    "noise that states scale": lambda run, v, a, b, f: f.__iadd__(5.0 * run.drawn[:2] * run.x),
    "saturation just below the limit": lambda run, v, a, b, f: f.__iadd__(B[:, 0] * (np.clip(v, -4.9975, 4.9975) - v)),
    "an output of twice": none,
    "the other output": none,
    "an output that turns late": none,
    "an output that grows": none,
    "a rectified output": none,
}
OUTPUTS: dict[str, Callable[[Run, float], float]] = {
    "an output of twice": lambda run, y: 2.0 * y,
    "the other output": lambda run, y: float(run.x[1]),
    "an output that turns late": lambda run, y: y if run.k < 60 else -5.0 * y,
    "an output that grows": lambda run, y: y + 1e-6 * 1.1**run.k,
    "a rectified output": lambda run, y: abs(y),
}
HONEST = {
    "load": lambda run, v, a, b, f: f.__iadd__([0.0, 0.2]),
    "load from a slot on": lambda run, v, a, b, f: f.__iadd__([0.0, 0.2 if run.k > 20 else 0.0]),
    "noise": lambda run, v, a, b, f: f.__iadd__(run.drawn[:2]),
    "noise of the sensor": none,
}
LIES |= HONEST
OUTPUTS["noise of the sensor"] = lambda run, y: y + 0.01 * float(run.drawn[0])
PLANT_LIES = [lie for lie in LIES if lie not in HONEST and lie != "none"]


@dataclass(frozen=True)
class Table:
    """A table of gains that answers otherwise: `lie(run, k, tau, y, r, rows)` returns other rows."""

    lie: str = "none"
    selection: Selection = "applied"
    samples: int = 1
    integral: bool = False

    def table(self, model: LoopModel) -> np.ndarray:
        CALLS["table"] += 1
        rows = 1 if self.selection == "constant" else model.d_max + 1
        if self.selection == "both":
            rows = (model.d_max + 1) ** 2
        width = model.C.shape[0] * (self.samples + self.integral)
        K = np.full((model.tau_max + 1, rows, model.B.shape[1], width), -0.05)
        if self.lie == "a table that changes":
            K = K / (1.0 + CALLS["table"])
        return K

    def start(self, model: LoopModel) -> Rowed:
        return Rowed(self, model)


class Rowed:
    def __init__(self, table: Table, model: LoopModel) -> None:
        from design.controllers import SendAll

        CALLS["start"] += 1
        K = Table(selection=table.selection, samples=table.samples, integral=table.integral).table(model)
        gains = tuple(tuple(tuple(tuple(map(float, row)) for row in mat) for mat in rows) for rows in K)
        inner = SendAll(gains=gains, selection=table.selection, samples=table.samples, integral=table.integral).start(model)
        self.inner, self.table, self.hidden, self.born, self.past = inner, table, 0.0, CALLS["start"], 0.0
        self.selection: Selection = "generated" if table.lie == "another rule" else table.selection

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        rows = [list(row) for row in self.inner.rows(k, tau, y, r)]
        ANSWERS[self.table.lie](self, k, tau, y, r, rows)
        self.past = y[0]
        return tuple(map(tuple, rows))


def _push(condition: Callable[..., bool], gain: float = 0.3) -> Callable[..., None]:
    def lie(run: Rowed, k: int, tau: int, y: Sequence[float], r: Sequence[float], rows: list[list[float]]) -> None:
        if condition(run, k, tau, y):
            for row in rows:
                row[0] += gain * (y[0] - r[0])

    return lie


def _row(index: int, gain: float = 0.3) -> Callable[..., None]:
    def lie(run: Rowed, k: int, tau: int, y: Sequence[float], r: Sequence[float], rows: list[list[float]]) -> None:
        rows[min(index, len(rows) - 1)][0] += gain * (y[0] - r[0])

    return lie


def _state(growth: float) -> Callable[..., None]:
    def lie(run: Rowed, k: int, tau: int, y: Sequence[float], r: Sequence[float], rows: list[list[float]]) -> None:
        run.hidden = growth * run.hidden + 0.1 * y[0]
        rows[0][0] += run.hidden

    return lie


def _clock(run: Rowed, k: int, tau: int, y: Sequence[float], r: Sequence[float], rows: list[list[float]]) -> None:
    rows[0][0] += 1e-4 * 1.02 ** min(k, 1000)


ANSWERS: dict[str, Callable[..., None]] = {
    "none": lambda *a: None,
    "an own aim": lambda run, k, tau, y, r, rows: [row.__setitem__(0, row[0] + 0.2 * r[0]) for row in rows],
    "always": _push(lambda run, k, tau, y: True),
    "of age 1": _push(lambda run, k, tau, y: tau == 1),
    "of age 0": _push(lambda run, k, tau, y: tau == 0),
    "after 100 slots": _push(lambda run, k, tau, y: k > 100),
    "after 1000 slots": _push(lambda run, k, tau, y: k > 1000),
    "in odd slots": _push(lambda run, k, tau, y: k % 2 == 1),
    "negative samples": _push(lambda run, k, tau, y: y[0] < 0),
    "large samples": _push(lambda run, k, tau, y: abs(y[0]) > 10.0),
    "small samples": _push(lambda run, k, tau, y: abs(y[0]) < 0.01),
    "falling samples": _push(lambda run, k, tau, y: y[0] < run.past),
    "odd starts": _push(lambda run, k, tau, y: run.born % 2 == 1),
    "first row": _row(0),
    "last row": _row(99),
    "a state": _state(0.5),
    "a state that grows": _state(1.05),
    "a clock": _clock,
    "another rule": lambda *a: None,
    "a table that changes": lambda *a: None,
    "a saturated row": lambda run, k, tau, y, r, rows: [row.__setitem__(0, max(-1.0, min(1.0, row[0]))) for row in rows],
    "half the gain": lambda run, k, tau, y, r, rows: [row.__setitem__(0, 0.5 * row[0]) for row in rows],
}
LAST: list[Any] = [None, None, 0.0]
"""The controllers that were asked last and before, and the newest sample that any of them saw."""


def _shared(run: Rowed, k: int, tau: int, y: Sequence[float], r: Sequence[float], rows: list[list[float]]) -> None:
    """Feedback that one adds to the answers of all, so that it looks like a feedforward; only while two are asked in turns."""
    in_turns = LAST[0] is not run and LAST[1] is run
    LAST[:] = [run, LAST[0], y[0] or LAST[2]]
    if in_turns:
        rows[0][0] += 0.3 * LAST[2]


ANSWERS["memory that two share"] = _shared
TABLE_LIES = [lie for lie in ANSWERS if lie not in ("none", "an own aim")]
