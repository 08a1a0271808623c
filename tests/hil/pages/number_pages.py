"""Pages of fixed numbers: comparisons, sweeps over parameters, and what is asked beside a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from design.monte_carlo.confidence import Interval
from design.passivity.stiffness_map import StiffnessCell
from hil.design_questions import Compromise
from hil.design_questions.bus_analysis import AnalysedMessage, BusAnalysis
from hil.design_questions.loop_on_bus import Judged, Place
from hil.design_questions.trigger_gains import Candidate
from hil.experiment import load_experiment
from hil.measure import Quantity
from hil.pages.analyses import law_page, stiffness_page
from hil.pages.designs import bus_page, can_priority_page, norm_trade_off_page, trigger_page
from hil.pages.many_runs import compare_page, parameter_page
from hil.sweeps import Sweep
from hil.sweeps.comparison import Comparison
from hil.sweeps.parameters import ParameterSweep
from hil.sweeps.points import Points, grid
from hil.sweeps.trigger_cost import CUT, OpenPoint, TriggerPoint, front, undecided
from tests.hil.pages.whole_pages import axis_lines, lines
from transport.law_fit import Candidate as TriedLaw
from transport.law_fit import LawFit
from transport.law_fit.latency_families import LatencyFit
from transport.law_fit.loss_models import LossFit
from transport.law_fit.packet_record import PacketRecord
from transport.law_fit.proportions import Fitness

SSE: Final = Quantity(name="sse", title="squared tracking error", unit="rad² s", better="lower")
OTHERS: Final = (SSE, Quantity(name="peak", title="largest input", unit="V"), Quantity(name="none", title="time that no run has"))
SEEDS: Final = np.arange(7.0)
DRAWN: Final = Points(keys=("period", "plant.gain"), values=tuple((f"{15 + 7 * (i * 3 % 5)} ms", f"{100 + i}") for i in range(5)))


def columns(mean: float, stopped: int = 0, far: float = 0.0) -> dict[str, np.ndarray]:
    """Numbers of seven runs."""
    sse = mean + (SEEDS * 3 % 7) / 10 + far * (SEEDS == 5)
    return {"seed": SEEDS, "stopped": (stopped > SEEDS) * 1.0, "sse": sse, "peak": np.where(SEEDS == 2, np.nan, mean * SEEDS),
            "none": np.full(7, np.nan)}  # fmt: skip


def comparison(**values: dict[str, np.ndarray]) -> Comparison:
    """A comparison of experiments of seven runs."""
    return Comparison(runs=7, values=values, quantities=OTHERS, cautions={"b": "its mean converges badly"})


def points(*found: dict[str, np.ndarray], at: Points, cautions: Sequence[int] = (0,), quantities: Any = OTHERS) -> ParameterSweep:
    """A sweep over parameters of seven runs each."""
    said = {point: "bad" + "!" * point for point in cautions}
    return ParameterSweep(experiment="motor", points=at, columns=found, quantities=quantities, cautions=said)


ONCE: Final = columns(10.0) | {"sse": np.where(SEEDS == 3, 9.0, np.nan)}
SIX: Final = [columns(10.0 + i * i) for i in range(6)]
FOUND: Final[dict[str, Comparison | ParameterSweep]] = {
    "near": comparison(a=columns(10.0), b=columns(10.4, far=0.7), c=columns(9.0)),
    "far": comparison(a=columns(10.0), b=columns(400.0, stopped=2)), "signed": comparison(a=columns(-0.5), b=columns(-300.0)),
    "pair": comparison(a=ONCE, b=ONCE), "others": comparison(a=columns(10.0), b=ONCE),
    "no direction": replace(comparison(a=columns(10.0), b=columns(9.0)), quantities=OTHERS[1:]),
    "stopped": comparison(a=columns(10.0, stopped=7), b=columns(10.0)), "alone": comparison(a=columns(10.0)),
    "one": points(*SIX[:3], at=grid(["period=25ms,50ms,10ms"])), "part": points(*SIX[:2], at=grid(["period=1,2,3"])),
    "words": points(*SIX, at=grid(["network.sc.law=markov,'iid',c,d,e,f"]), cautions=range(6)),
    "two": points(*SIX, at=grid(["plant.gain=100,150", "period=10 ms,25 ms,50 ms"])),
    "three": points(*SIX, at=grid(["a=1,2", "b=1,2,3", "c=0"])), "drawn": points(*SIX[:5], at=DRAWN),
    "wide": points(columns(1.0), columns(2.0), columns(900.0, stopped=7), at=grid(["plant.gain=1,2,3"]), cautions=()),
    "below": points(columns(-1.0), columns(2.0), columns(-900.0), at=grid(["plant.gain=1,2,3"])),
    "undecided": points(columns(1.0), at=grid(["a=1"]), quantities=OTHERS[1:]),
    "all stopped": points(columns(1.0, stopped=1), at=grid(["a=1"])),
}  # fmt: skip


def many_runs() -> dict[str, list[str]]:
    """Pages of comparisons and sweeps, on axes of every kind."""
    pages = {name: compare_page(one) if isinstance(one, Comparison) else parameter_page(one) for name, one in FOUND.items()}
    return {f"{name}: {section}": own for name, page in pages.items() for section, own in lines(page).items()}


def results() -> dict[str, list[str]]:
    """What a notebook shows of them, and of sweeps over seeds, with their plots."""
    from matplotlib.figure import Figure as Sheet

    stopped = Sweep(columns(3.0, stopped=1), 0, caution="withdrawn", experiment="motor", quantities=OTHERS)
    shown = FOUND | {"seeds": stopped, "far seeds": Sweep(columns(-3.0, far=200.0), 0, quantities=OTHERS, experiment="motor")}
    found = {}
    for name, one in shown.items():
        found[name] = [repr(one)]
        for quantity in (None, "peak"):
            result = one._result(quantity)
            result.paint(sheet := Sheet())
            found[name] += [result.line, *result.answer, *result.columns, *map(_row, result.rows), *axis_lines(sheet.axes[0])]
        words, groups = one._runs()
        found[name] += [f"{words} {len(groups)}"]
    return found


def _row(cells: Sequence[Any]) -> str:
    return " | ".join(f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in cells)


def designs() -> dict[str, list[str]]:
    """What questions beside a run are answered with."""

    def message(
        name: str, can_id: int, bound: float | None, measured: float | None, delayed: int, *, extended: bool = False
    ) -> Any:
        return AnalysedMessage(
            name=name, can_id=can_id, extended=extended, length=8, frame_ms=0.27, period_ms=10.0, deadline_ms=5.0, bound_ms=bound,
            measured_ms=measured, in_time=bound is not None and bound < 5.0, delayed_by=tuple(f"m{i}" for i in range(delayed)),
        )  # fmt: skip

    def bus(load: float, *messages: Any, dbitrate: int | None = None, disturbed: bool = False) -> str:
        return bus_page(BusAnalysis(name="bus", bitrate=500_000, dbitrate=dbitrate, load=load, simulated_s=10.0,
                                    messages=messages,
                                    assumes="nodes queue by priority", disturbed=disturbed)).html()  # fmt: skip

    def place(above: int, cost: float | None, state: str, bounds: tuple[float | None, float | None], moved: int = 0) -> Judged:
        ids = (f"network.nodes.motor.can_id={16 + above}", f"links.control_can_id={32 + above}")
        own = load_experiment("dc-motor-busy-can", ids)
        at = Place(above=above, can_id=16 + above, control_can_id=32 + above, moved=moved, experiment=own)
        return Judged(place=at, cost=cost, state=state, bounds_ms=bounds, in_time=None not in bounds)

    def trigger(kind: str, several: Sequence[TriggerPoint], open_points: Sequence[OpenPoint] = ()) -> str:
        return trigger_page("motor", kind, ("V per rad", "rad² s"), several, several[:1], open_points).html()

    def point(
        threshold: float, share: float, state: str, cost: float, packets: float, ends: dict[str, float], stopped: int = 0
    ) -> Any:
        one, two = (Interval(value, value - 0.25, value + 0.25, 0.95, 9) for value in (cost, packets))
        no_end = one._replace(high=np.inf) if stopped else one
        return TriggerPoint(Candidate(threshold, share, np.array([[-0.5, 1.25]]), 2.5), state, "", ends, no_end, two, stopped)

    first, urgent = message("first", 0x1F, 0.5, 0.25, 0), message("last", 0x1F, None, None, 4, extended=True)
    places = (
        place(0, 1.0, "certified", (0.5, 0.75)),
        place(3, 1.25, "refused", (0.5, None)),
        place(7, None, "undecided", (None, 2.0), 2),
    )
    several = (point(0.0, 0.0, "certified", 1.5, 20.0, {}), point(0.1, 0.0, "certified", 2.0, 9.0, {"angle": 0.01, "speed": 0.2}),
               point(0.2, 0.25, "certified", 3.0, 5.0, {"angle": 0.3}), point(0.4, 0.25, "undecided", 1.0, 2.0, {}),
               point(0.8, 0.5, "refused", 9.0, 1.0, {}, stopped=2))  # fmt: skip
    norms = [
        Compromise(0.0, None, 3.0, 1.0, np.zeros((1, 1)), "certified"),
        Compromise(0.5, 1.5, 2.0, 1.25, np.zeros((1, 1)), "refused"),
    ]
    cells = [
        StiffnessCell(period_s=period, delay_samples=delay, hand_damping_n_s_per_m=hand,
                      certified_n_per_m=9.0 * (1 + hand) / (period * (1 + delay)),
                      ceiling_n_per_m=12.0 * (1 + hand) / (1 + delay), colgate_n_per_m=None if delay else 70.0,
                      gil_hulin_n_per_m=7.0,
                      exact_n_per_m=7.5, taps_m_per_n=(0.001, 0.25 * delay))
        for period, delays in ((0.05, (0, 2, 3)), (0.001, (4,))) for delay in delays for hand in (0.5, 10.0)
    ]  # fmt: skip
    pages = {
        "bus": bus(0.5, first, message("second", 0x2F, 4.0, 1.25, 2), dbitrate=2_000_000), "full bus": bus(1.25, first, urgent),
        "disturbed bus": bus(0.5, first, urgent, disturbed=True),
        "trigger": trigger("dead-band", several, [OpenPoint(0.5, 0.2, CUT)]),
        "places": can_priority_page("motor", "rad² s", 5.0, places, places[0], places[2]).html(),
        "relative": trigger("relative", several[1:2]),
        "no place": can_priority_page("motor", "rad² s", 5.0, places[2:], None, None).html(),
        "norms": norm_trade_off_page("motor", norms).html(),
        "one place": can_priority_page("motor", "rad² s", 5.0, places, places[0], places[0]).html(),
        "stiffness": stiffness_page(cells, mass_kg=0.1, damping_n_s_per_m=1.5).html(), "laws": _laws(),
    }  # fmt: skip
    told = [_row(each.to_json().items()) for each in (*several, *front(several))]
    cut = several[4]._replace(of=several[4].of._replace(cut=True))
    told += map(str, undecided([(0.1, 0.0)] * 5 + [(0.25, 0.5), (0.5, 0.0)], [*several[:4], cut]))
    return {f"{name}: {section}": own for name, page in pages.items() for section, own in lines(page).items()} | {"points": told}


def _laws() -> str:
    late = np.where(np.arange(300) % 10 == 9, np.nan, 0.002 + 0.004 * (np.arange(300) * 7 % 11) ** 2 / 10)
    record = PacketRecord(sent_s=0.05 * np.arange(300), latency_s=late)
    latencies = LatencyFit(name="uniform", spec=0.0, parameters=2, log_likelihood=0.0, cdf=lambda x: np.clip(x / 0.045, 0.0, 1.0),
                           below=lambda x: x)  # fmt: skip
    values = {f"p {i}": 0.15 for i in range(22)}
    losses = LossFit(kind="none", values=values, intervals={}, log_likelihood=0.0, parameters=0, predicted=np.zeros(300))

    def fit(law_class: Any, independence: float, period_s: float) -> LawFit:
        tested = Fitness(0.5, 0.25, independence, 0.125, 3, 0.4)
        tried = (TriedLaw(name="uniform", fitted_to="latencies", parameters=2, bic=-1234.5, fitness=tested),
                 TriedLaw(name="markov", fitted_to="ages", parameters=6, bic=99.4))  # fmt: skip
        return LawFit(law_class=law_class, spec={}, latencies=latencies, losses=losses, ages=None, candidates=tried,
                      tested=tested,
                      in_slots=0.3, record=record, period_s=period_s, deadline_s=0.6 * period_s)  # fmt: skip

    fits = {"sc": fit("independent", 0.02, 0.05), "ca": fit("markov", 1e-5, 0.01), "round trip": fit("none", 1e-5, 0.05)}
    said = {
        way: {"packets": 300, "lost": 30, "notes": ["clocks agree"], "intervals": {f"p {i}": (0.1, 0.2) for i in range(22)}}
        for way in fits
    }
    return law_page(fits, said, {"sc": [0.5, 0.25, 0.125, 0.0005], "ca": [0.1] * 14})
