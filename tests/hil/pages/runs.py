"""Runs to report on: real loops in virtual time, kept in memory; times of a real-time run are added where wanted.

And their pages, of which no certificate is computed, and what ran where (versions) is left out.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

import numpy as np
from msgspec.structs import replace

from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.read import Run
from hil.log.topics import channels_of
from hil.log.write import MemorySink
from hil.log.write.provenance import Provenance
from hil.measure.view import RunView, view_of
from hil.pages.live import Side
from hil.pages.live.about import Window, about, picture
from hil.pages.live.desk import Desk, Wish
from hil.pages.run_page import LoggedRun, logged_run, render_report, runs_page
from hil.pages.viewers import foxglove, plotjuggler
from hil.runtime.clock import PacedClock
from hil.runtime.virtual import run_virtual
from tests.hil.pages.whole_pages import GOOD, lines, rounded
from transport.draws import REASONS


def run_of(name: str, *sets: str, timed: bool = False, certify: bool = False) -> Run:
    """Return a finished run of a shipped experiment; `timed` adds what a real-time run measures of itself."""
    experiment = load_experiment(name, sets)
    loop = compose(experiment, certify=certify)
    sink = MemorySink(channels_of(loop))
    rig = run_virtual(loop, experiment.seed, sink)
    if timed:
        rng = np.random.default_rng(0)
        put, pack = sink.channel("/timing/slot"), channels_of(loop)["/timing/slot"].schema.pack
        assert put is not None
        lateness = 20.0 + rng.pareto(2.5, rig.k + 1) * 10.0
        for k in range(rig.k + 1):
            late = k % 2000 == 1999
            trip = float("nan") if late else float(90.0 + rng.gamma(2.0, 15.0))
            put(k * experiment.period_ns, pack(float(lateness[k]), trip, 80.0, k, late, 0))
        sink.event(0, "started", "rig started", scheduler="SCHED_FIFO 60")
        sink.event(1999 * experiment.period_ns, "late", "no control packet", slot=1999, severity="warning")
    about = Provenance(
        experiment=experiment.name,
        experiment_text=experiment.text,
        resolved=experiment.resolved(),
        seed=experiment.seed,
        clock="real" if timed else "virtual",
        link="can:hil:rig0" if timed else "memory:",
    )
    return Run.from_memory(
        sink,
        metadata=about.metadata()["hilrig"],
        versions=dict(about.versions),
        codes={"reason": list(REASONS)},
        experiment_text=experiment.text,
        resolved=dict(about.resolved),
        certificate=loop.certificate or {},
    )


CERTIFICATE: Final[dict[str, Any]] = {
    "state": "certified", "kind": "mean-square stability", "reason": "stable over this network", "stable": True,
    "quantity": "second-moment radius per slot", "number": 0.8977276639, "limit": 1.0, "method": "second moments (Theorem 7.1)",
    "assumptions": ["no packet is later than its law says", "no limit trips"], "mean_square_radius": 0.8977276639,
    "h2_norm": 3.892, "hinf_norm": None, "rounding": 7e-10, "modes": 6, "order": 5, "digest": "156cfcef", "delays": [6, 7],
    "felt_n_per_m": [[7.4, 1.0]],
    "static_compliance_m_per_n": 0.134, "worst_delay": 6, "ends_within": {"angle_rms": 0.01, "speed": (1.0, 2.0)},
    "nothing": [], "cases": [{"angle_rms": 0.01}, {}],
}  # fmt: skip
REFUSED: Final = {"state": "refused", "reason": "not stable", "number": [1.5, 2]}
EVENTS: Final = [
    {"slot": 7, "t_s": 0.35, "kind": "late", "severity": "warning", "message": "second", "data": {}},
    {"slot": 1, "t_s": 0.05, "kind": "<b>", "severity": "error", "message": "first", "data": {}},
    {"slot": 9, "t_s": 0.45, "kind": "note", "message": "third", "data": {}},
]  # fmt: skip


def view(name: str, *sets: str, timed: bool = False, certificate: Mapping[str, Any] = CERTIFICATE, **about: Any) -> RunView:
    """A short run, in which nothing says what ran it."""
    run = run_of(name, *sets, timed=timed)
    about = {"versions": {"hilrig": "1"}, "session": {"started": "now"}, "events": run.events + about.pop("events", [])} | about
    return view_of(replace(run, certificate=dict(certificate), **about))


def folder() -> dict[str, list[str]]:
    """The page of a folder of logs."""

    def logged(name: str, shown: RunView, drawn: bool = True) -> LoggedRun:
        return logged_run(f"{name}.mcap", f"{name}.html", shown, drawn=drawn)

    runs = [
        logged("a", view("dc-motor-hinf", "duration=0.5")),
        logged("b", view("dc-motor-hinf", "duration=0.5", "seed=3"), drawn=False),
        logged("c", view("omni-push", "duration=0.5", certificate=REFUSED)),
        logged("d", view("dc-motor-h2", "duration=0.5", certificate={})),
        LoggedRun(name="e.mcap", failure="is no MCAP file", numbers={}), logged("f", view("dc-motor-local", "duration=5")),
    ]  # fmt: skip
    many = [LoggedRun(name=f"{i}.mcap", page=f"{i}.html", verdict=GOOD, numbers={"n": i, "m": None}) for i in range(61)]
    pages = {"few": runs_page("folder <&>", runs), "many": runs_page("many", [*many, runs[0]])}
    return {f"{name}: {section}": own for name, page in pages.items() for section, own in lines(page).items()}


PACKETS: Final = 'network.sc.law={kind="packet", latency="60 ms", loss={p_gb=0.1, p_bg=0.5}, duplication=0.2}'
DAMPER: Final = "limits.passivity={damping_n_s_per_m=30}"
RUNS: Final[dict[str, tuple[str, ...]]] = {
    "plain": ("dc-motor-hinf", "duration=2"), "one slot": ("dc-motor-hinf", "duration=0.05"), "stopped": ("dc-motor-local",),
    "packets": ("dc-motor-smith", "duration=3", PACKETS, "network.sc.max_age=8"), "bursty": ("dc-motor-bursty", "duration=20"),
    "nodes": ("dc-motor-two-nodes", "duration=1", "reference.0.at=0.1", "controller={kind='local', gain=[[-0.05, -0.006]]}"),
    "turns": ("multisensor-published", "duration=1"), "jump": ("smjls-robust-published", "duration=1"),
    "bus": ("dc-motor-busy-can", "duration=0.5", "network.media.bus.bit_error_rate=0.002"),
    "constant": ("dc-motor-h2", "duration=3", "network.ca.law={kind='constant', age=1}", "disturbance.0.at=0.2"),
    "supply": ("dc-motor-hinf-supply", "duration=1.5"), "fault": ("vtol-fault-published", "duration=1"),
    "slide": ("omni-slide", "duration=3"), "damper": ("omni-push", "duration=1", DAMPER),
    "theorem": ("omni-theorem61", "duration=2"),
}  # fmt: skip


def run_page(name: str) -> dict[str, list[str]]:
    """The page of a run."""
    return lines(render_report(view(*RUNS[name], events=EVENTS if name == "plain" else [])))


def in_time() -> dict[str, list[str]]:
    """The page of a run in real time that another program answered, and of one that was late, without a certificate."""
    late = view("dc-motor-1khz", "duration=2.1", timed=True, session={"external_controller": "True"}, certificate=REFUSED)
    summary = {"log": {"messages": 10, "dropped": 3}, "problems": {"torn_end": "its end is missing"}}
    few = view("dc-motor-1khz", "period=0.0002", "duration=0.1", timed=True, certificate={}, summary=summary)
    return lines(render_report(late)) | {f"few: {name}": own for name, own in lines(render_report(few)).items()}


WISHES: Final = (
    Wish(do="dance"), Wish(do="hold"), Wish(do="step", slots=0), Wish(do="step", slots=1001), Wish(do="speed", speed=2e3),
    Wish(do="speed", speed=1e-4), Wish(do="check", path="end"), Wish(do="restart", seed=-1), Wish(do="step", sides=(2,)),
    Wish(do="step", sides=(-1,)), Wish(do="apply", path="end"),
)  # fmt: skip


def live() -> dict[str, list[str]]:
    """What the live page is given of a log, and of a run that may be changed."""
    shown = view(*RUNS["nodes"], timed=True, events=EVENTS)
    assert shown.experiment is not None
    side, acts = Side(), Side(PacedClock(), acts=True)
    loop = compose(shown.experiment, certify=False)
    side.show(shown.run, loop)
    acts.begin(loop, {})
    drawn = np.frombuffer(picture(side.records(), side.traces, Window.over(*side.span(), 9)), "<f4").reshape(len(side.traces), -1)
    taken = [_taken(desk, wish) for desk in map(Desk, ([side], [acts, acts], [Side(acts=True)])) for wish in WISHES]
    said = {"wishes": taken, "about": about([side, acts], "here"), "now": side.now(1, True),
            "acts": acts.now(0, True), "span": side.span()}
    layouts = {"foxglove": foxglove(shown.run.schemas).splitlines(), "plotjuggler": plotjuggler(shown.run.schemas).splitlines()}
    drawn_lines = [f"{trace}: {rounded(values.astype(float))}" for trace, values in zip(side.traces, drawn)]
    offers = {name: _json(_offered(name)) for name in ("dc-motor-smith", "dc-motor-packets", "dc-motor-busy-can", "omni-push")}
    return layouts | offers | {name: _json(one) for name, one in said.items()} | {"picture": drawn_lines}


def _offered(name: str) -> Any:
    """Return what a page is given of an experiment that is seen, that takes changes in real time, and in virtual time."""
    sides, loop = (Side(), Side(acts=True), Side(PacedClock(), acts=True)), compose(load_experiment(name), certify=False)
    for side in sides:
        side.begin(loop, {})
    return about(sides, name)


def _taken(desk: Desk, wish: Wish) -> list[Any]:
    """Return the draft before a wish, and what is said where it cannot be done."""
    draft = asdict(desk.draft)
    try:
        return [draft, desk.take(wish)]
    except HilError as error:
        return [draft, str(error)]
    finally:
        desk.close()


def _json(value: Any) -> list[str]:
    plain = json.loads(json.dumps(value), parse_float=lambda text: float(f"{float(text):.6g}"))
    return re.split(r', (?=")', json.dumps(plain, ensure_ascii=False))
