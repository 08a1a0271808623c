"""Stages of chapters that take tenths of a second, by themselves: what they judge, and what they draw.

The slow tests reproduce whole chapters. In ``tests/data/stages.txt`` stands what these stages computed on 2026-11-28, so that a
mistake in what computes it is seen. It holds to 1e-3 of its size, or to a tenth of the tolerance of what is to be 0.
``python -m tests.hil.thesis.test_stages`` writes it anew, for a reviewer to read what a change does to it.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from msgspec.structs import fields

from design.as_printed import chapter3_gain, chapter4_seen_gain
from design.as_printed.chapters_2_to_4 import PrintedRequest
from design.monte_carlo import Workers
from design.passivity.synthesis import stiffest_coupler
from design.processes.partitions import Partition
from design.semi_markov_loop import DelayedJumpSystem, JumpSystem
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.robust_feedback import Synthesis
from design.tracking.synthesis import TrackingProblem
from hil.pages import Bars, Histogram
from hil.thesis import Stage
from hil.thesis.chapter6_equations import distortion_norm
from hil.thesis.chapter7_friction import loop_of
from hil.thesis.chapter7_models import H2
from hil.thesis.chapter7_runs import ideal
from hil.thesis.judgement import Approximately, NotJudged
from hil.thesis.noisy_runs import delayed_runs
from hil.thesis.statements import judge, last_digit, named
from tests.hil.thesis.judging import assert_every_number_decides
from tests.mutations.faults import ROOT


def scale(system: JumpSystem, request: Synthesis, *, tolerance: float) -> tuple[float, None]:
    """A largest scale of no search: by the form, the number of sections and where the second of given ones begins."""
    form = 3.0 if isinstance(request, PrintedRequest) else {"pwc": 1.0, "pwl": 2.0}[request.method]
    cut = request.sections
    return form + (0.1 * cut if isinstance(cut, int) else 0.1 * len(cut[0]) + cut[0][1]), None


def certificate(system: DelayedJumpSystem, *given: Any, **more: Any) -> JumpCertificate:
    """A level of no search: by the bound and the sections, or by the nodes."""
    gamma = more["gain_bound"] / len(more["sections"][0]) if "sections" in more else 0.1 * len(more.get("nodes", [[0.0]])[0])
    return JumpCertificate(method="pwc", verdict="certified", reason="", gamma=gamma, gain=chapter3_gain())


def printed_section(system: object, process: object, sections: Partition, m: int, gain: None, **more: Any) -> JumpCertificate:
    """A level of no search: by the bound, the sections and which of them."""
    gamma = more["gain_bound"] / len(sections[0]) + 0.1 * m
    return JumpCertificate(method=more["reading"], verdict="certified", reason="", gamma=gamma)


def seen() -> JumpCertificate:
    return JumpCertificate(method="", verdict="certified", reason="", gamma=1.0, gain=chapter4_seen_gain(partitioned=True))


SHORTER = "duration=31 s"
"""Until a second after the disturbance."""

SMALLER: dict[str, Any] = {
    "chapter2_runs.RUNS": 30, "chapter2_feasibility.BOUNDS": (5.0,), "chapter2.largest_uncertainty": scale,
    "chapter3.delayed_hinf": certificate, "chapter3.analyse_delayed": certificate,
    "chapter3.delayed_runs": partial(delayed_runs, step_s=0.05), "chapter3.RUNS": 4, "chapter3.MORE": 9,
    "chapter3_partitions.delayed_runs": partial(delayed_runs, step_s=0.02), "chapter3_partitions.RUNS": 10,
    "chapter3_partitions.BOXES": 20, "chapter3_partitions.delayed_section": printed_section,
    "chapter3_partitions.analyse_delayed": certificate,
    "chapter3_partitions.decay_of": lambda *given: SimpleNamespace(rate=0.05, coefficient=40.0),
    "chapter3_partitions.rates_inside": lambda found: (-found.gamma, -2.0 * found.gamma), "chapter4_simulations.RUNS": 8,
    "chapter4_simulations.our_gains": seen, "chapter4.our_gains": seen, "chapter7.SMITH_RUNS": 50,
    "chapter7.ideal": lambda *given: ideal(*given, SHORTER), "chapter7_friction.loop_of": lambda *given: loop_of(*given, SHORTER),
    "chapter7_friction.BATCH_RUNS": 20, "chapter7_friction.FIT_SEEDS": 2, "chapter7_friction.CANDIDATES": 3,
    "chapter7_friction.CHECK_SEEDS": 3, "chapter7_runs.Workers": lambda **_: Workers(), "chapter7_runs.BATCH_RUNS": 20,
    "chapter7_designs.TrackingProblem": partial(TrackingProblem, starts=1),
    "chapter7_delays.TrackingProblem": partial(TrackingProblem, starts=1),
    "chapter7_designs.PROBLEMS": (("motor", "h2"),), "chapter7_designs.SERIES": (("motor", "h2"),),
    "chapter7_designs.GAINS": {("motor", "h2"): H2}, "chapter7_designs.BOUNDS": (0.5,),
    "chapter6_wall.STAYS": ((1, 2), (2, 3), (1, 2)), "chapter6_wall.distortion_norm": partial(distortion_norm, mixed=False),
    "chapter6_wall.safe_coupler": lambda: stiffest_coupler(range(5), period_s=0.05, damping_n_s_per_m=1.9857).coupler,
}  # fmt: skip
"""What takes minutes with the numbers of `hil reproduce`: short runs, few problems, one start of a descent, no process."""

NAMES = {
    "chapter2: a Markov approximation": "markov[0] stay",
    "chapter2: certified scales": "least[printed] least[pwc] least[pwl] line[printed] line[pwc] line[pwl]",
    "chapter2: partition strategies": "pwc[scales] pwc[role] pwl[scales] pwl[role] sections",
    "chapter3: sound levels": "unforced published.gamma ramp norm whole halves gain frozen made",
    "chapter7: designs": "motor_h2_sum[norm] motor_h2_sum[largest] motor_h2_sum[off] motor_h2_sum[gains][0] "
    "motor_h2_sum[each][0] motor_h2_stacked[norm] motor_h2 wrong",
    "chapter7: what the actuator knows": "motor_h2",
    "chapter7: gain bounds": "",
}
"""Stages of which so much is left out that their rows cannot be judged: numbers by name.

The largest decay over a stay, `semi`, is none of them: a search by a solver, it is 0.898 or 0.933 on one processor or another.
"""

FEW = {"chapter2: settling times", "chapter3: simulations", "chapter7: fit of the motor, Table 7.2, experiment", *NAMES}
"""By so few runs that many a check is undecided."""

SOLVED = {"chapter2: theorems", "chapter4: conditions", "chapter6: materials"}
"""With levels or margins of a solver: to 2 %."""

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
WRITTEN = Path(ROOT, "tests/data/stages.txt")
FOUND = dict(part.split("\n", 1) for part in WRITTEN.read_text(encoding="utf-8").split("# ")[1:])
"""Of a stage: a line for every number, what it is of and what it was."""

Line = tuple[str, Any, float]
"""What is shown, its number or word, and how far it may be off, whatever its size."""


def stage_of(name: str) -> Stage:
    chapter, _, title = name.partition(": ")
    stages = importlib.import_module(f"hil.thesis.{chapter}").CHAPTER.stages
    return next(stage for stage in stages if stage.title == title)


def lines_of(name: str, values: Mapping[str, Any]) -> Iterator[Line]:
    """Yield what a stage judges, or the numbers that are named, and what it draws."""
    for each in () if name in NAMES else stage_of(name).statements:
        (row,) = judge([each], values)
        if each.computed or each.basis:
            yield row.item, f"{each.computed and row.computed}; {row.basis}", 3e-8
        for check in (*row.checks, *row.witness, *row.beside):
            near = 0.1 * check.rule.tolerance if isinstance(check.rule, Approximately) and not check.rule.printed else 3e-8
            if not isinstance(check.rule, NotJudged):
                yield f"{row.verdict}: {row.item}: {check.what}", check.value, near
    for each in NAMES.get(name, "").split():
        for n, value in enumerate(scalars(named(values, each))):
            yield f"{each} {n}", value, 3e-8
    for words, size in drawn(values).items():
        yield words, float(np.mean(size)), 3e-8


def scalars(value: Any) -> Iterator[Any]:
    """Yield every number of nested ones."""
    if isinstance(value, Mapping | list | np.ndarray):
        for each in value.values() if isinstance(value, Mapping) else value:
            yield from scalars(each)
    else:
        yield value


def said(of: Any) -> str:
    """What a plot, a panel or a line has beside its numbers, where it is not as by default."""
    shown = [(each.name, getattr(of, each.name), each.default) for each in fields(of)]
    markers = [f"{each.label} at {each.x:g}" for each in getattr(of, "markers", ())]
    words = [f"{name} {value}" for name, value, default in shown if isinstance(value, str | bool | int) and value != default]
    ends = [f"y {of.y_range}"] if getattr(of, "y_range", None) else []
    return ", ".join([*words, *markers, *ends])


def drawn(values: Mapping[str, Any]) -> dict[str, list[float]]:
    """Return the words of every line, end of a band and group of bars, and the mean square of each.

    Of known gains: those that a stage designs itself are left out. Lines of the same words are one.
    """
    found: dict[str, list[float]] = {}
    for plot in values.get("figures", ()):
        for panel in plot.panels:
            if isinstance(panel, Bars):
                lines = [(f"{said(group)}: {panel.categories}", np.asarray(group.values)) for group in panel.groups]
            elif isinstance(panel, Histogram):
                lines = [(f"{len(panel.counts)} counts", np.sqrt(panel.counts * panel.edges[1:]))]
            else:
                lines = [(f"{said(each)}, {len(each.x)} to {each.x[-1]:g}", np.asarray(each.y)) for each in panel.series]
                for each in panel.bands:
                    words = f"{said(each)}, {len(each.x)} to {each.x[-1]:g}"
                    lines += [(f"{words}, below", np.asarray(each.lower)), (f"{words}, above", np.asarray(each.upper))]
            for words, y in lines:
                if not words.startswith("label ours") and not panel.title.startswith("ours"):
                    found.setdefault(f"{said(plot)}: {said(panel)}: {words}", []).append(float(np.square(y).mean()))
    return found


@pytest.mark.parametrize("name", FOUND)
def test_a_stage_computes_what_it_did(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for setting, value in SMALLER.items():
        monkeypatch.setattr(f"hil.thesis.{setting}", value)
    if not name.startswith("chapter7"):  # as many runs are computed together, and it has 4000; no number depends on it
        monkeypatch.setattr("design.monte_carlo.studies.CHUNK", 32)
    steps: list[tuple[int, int]] = []
    values = stage_of(name).compute(lambda text, done=0, total=0, /: steps.append((done, total)))
    found = [*lines_of(name, values)]
    expected = [line.rpartition(" :: ") for line in FOUND[name].splitlines()]
    assert [words for words, *_ in found] == [words for words, *_ in expected]
    rel = 0.02 if name in SOLVED else 1e-3
    for (words, value, near), (*_, number) in zip(found, expected):
        if isinstance(value, str):
            assert NUMBER.sub("", value) == NUMBER.sub("", number), words
            for shown, was in zip(NUMBER.findall(value), NUMBER.findall(number)):
                assert float(shown) == pytest.approx(float(was), rel=rel, abs=1.1 * last_digit(was.partition("e")[0])), words
        else:
            assert value == pytest.approx(float(number), rel=rel, abs=near), words
    if name not in FEW:
        assert_every_number_decides(judge(stage_of(name).statements, values))
    counted = [step for step in steps if step[1]]
    assert counted == sorted(counted) and all(done <= total for done, total in counted)


if __name__ == "__main__":
    for setting, value in SMALLER.items():
        module, _, constant = setting.partition(".")
        setattr(importlib.import_module(f"hil.thesis.{module}"), constant, value)
    text = ""
    for name in FOUND:
        lines = lines_of(name, stage_of(name).compute(lambda text, done=0, total=0, /: None))
        text += f"# {name}\n" + "".join(f"{w} :: {v if isinstance(v, str) else format(v, '.5g')}\n" for w, v, _ in lines)
    WRITTEN.write_text(text, encoding="utf-8")
