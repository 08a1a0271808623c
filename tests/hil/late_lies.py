"""Plants and controllers that keep their word as long as the door looks, and break it in the run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from design.controllers import LoopModel, Rows
from tests.hil.compose.lying_plugins import LIES, OUTPUTS, Rowed, Run, Table


def _unstable(condition: Callable[[Run, float], bool]) -> Callable[..., None]:
    def lie(run: Run, v: float, a: Any, b: Any, f: Any) -> None:
        if condition(run, v):
            a[:] = [[0.5, 0.0], [0.0, 0.5]]

    return lie


def _turned(condition: Callable[[Run, float], bool]) -> Callable[..., None]:
    def lie(run: Run, v: float, a: Any, b: Any, f: Any) -> None:
        if condition(run, v):
            b[:] = -3.0 * b

    return lie


def _noisy(lie: Callable[..., None]) -> Callable[..., None]:
    def both(run: Run, v: float, a: Any, b: Any, f: Any) -> None:
        f += run.drawn[:2]
        lie(run, v, a, b, f)

    return both


def _grown(run: Run, v: float, a: Any, b: Any, f: Any) -> None:
    if run.k > 300:
        run.hidden *= 1.1
        f[0] += run.hidden


CONDITIONS: dict[str, Callable[[Run, float], bool]] = {
    "after slot 300": lambda run, v: run.k > 300,
    "from 16 s on": lambda run, v: run.now_ns > 16_000_000_000,
    "in every slot of a hundred after 250": lambda run, v: run.k > 250 and run.k % 100 == 7,
    "after slot 300, of positive inputs": lambda run, v: run.k > 300 and v > 0,
    "after slot 300, of states alike": lambda run, v: run.k > 300 and run.x[0] > 0,
}
LATE = {
    **{f"unstable {when}": _unstable(condition) for when, condition in CONDITIONS.items()},
    "noise, and unstable after slot 300": _noisy(_unstable(CONDITIONS["after slot 300"])),
    **{f"noise, and turned {when}": _noisy(_turned(condition)) for when, condition in CONDITIONS.items()},
    "a hidden state that grows after slot 300": _grown,
    "an output that turns after slot 300": lambda *a: None,
    "noise, and an output that turns after slot 300": LIES["noise"],
    "an output that is no number after slot 300": lambda *a: None,
    "noise, and an output that is infinite after slot 300": LIES["noise"],
}
LIES |= LATE
LIES["a load, and late noise"] = lambda run, v, a, b, f: f.__iadd__([0.0, 0.2] if run.k < 2500 else 0.1 * run.drawn[:2])
LIES["noise, and a late load"] = lambda run, v, a, b, f: f.__iadd__(run.drawn[:2] + (0.2 if run.k > 2500 else 0.0))
VERY_LATE = _unstable(lambda run, v: run.k >= 2500)
LIES |= {"very late": VERY_LATE, "noise, and very late": _noisy(VERY_LATE)}
LIES["noise, and a stronger input after slot 2500"] = _noisy(lambda run, v, a, b, f: b.__imul__(1.3 if run.k > 2500 else 1.0))
for _name in ("an output that turns after slot 300", "noise, and an output that turns after slot 300"):
    OUTPUTS[_name] = lambda run, y: y if run.k < 300 else -5.0 * y
OUTPUTS["an output that is no number after slot 300"] = lambda run, y: y if run.k < 300 else float("nan")
OUTPUTS["noise, and an output that is infinite after slot 300"] = lambda run, y: y if run.k < 300 else float("inf")


@dataclass(frozen=True)
class LateTable(Table):
    """A table that is answered until a condition holds."""

    late: str = "between slots 300 and 900"

    def start(self, model: LoopModel) -> Rowed:
        return LateRowed(self, model)


WHEN: dict[str, Callable[[Any, int, Sequence[float]], bool]] = {
    "between slots 300 and 900": lambda run, k, y: 300 < k < 900,
    "once it was asked 290 times": lambda run, k, y: run.asked > 290,
    "once it was asked 290 times, in odd slots": lambda run, k, y: run.asked > 290 and k % 2 == 1,
}


class LateRowed(Rowed):
    def __init__(self, table: LateTable, model: LoopModel) -> None:
        super().__init__(table, model)
        self.asked, self.late = 0, table.late

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        self.asked += 1
        rows = super().rows(k, tau, y, r)
        if WHEN[self.late](self, k, y):
            return tuple(tuple(u + 0.3 * y[0] for u in row) for row in rows)
        return rows
