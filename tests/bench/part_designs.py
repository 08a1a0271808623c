"""Figures of designs and certificates over many modes, and of the VTOL's: CPU time, one after the other."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from types import FrameType
from typing import TYPE_CHECKING

from tests.bench.figure import AtMost, Figure, Found, Measure, Part, Row, Tell
from tests.bench.modes import (
    CERTIFICATE_SIDE,
    HINF_TIMES,
    LARGE_PLANT,
    bench_certificates,
    design_row,
    large_problem,
    motor_problem,
)  # fmt: skip

if TYPE_CHECKING:
    from design.tracking import TrackingProblem
    from design.tracking.synthesis import Design

ALONE, H2_BESIDE = "its evaluations, each alone", "the H2 design of the same loop"
LARGE = f"{LARGE_PLANT} states and 6 modes"
VTOL_TIMES, ARPACK_TIMES = 20.0, 4.0
"""What an H-infinity design of the VTOL, and a certificate, may take of their peers."""
LONGEST_S = 120.0
"""CPU time after which a design that has missed its goal is stopped."""


def _motor(norm: str, most: int) -> str:
    return f"{norm} design, tau_max = d_max = {most}"


H2 = {most: Figure(name=_motor("H2", most), unit="s", peer=ALONE, goal=AtMost(ratio=1.0)) for most in (4, 8)}
HINF = {most: Figure(name=_motor("H-infinity", most), unit="s", peer=H2_BESIDE, goal=AtMost(ratio=HINF_TIMES)) for most in H2}
LARGE_H2 = Figure(name=f"H2 design, {LARGE}", unit="s", peer=ALONE, goal=AtMost(ratio=1.0))
LARGE_HINF = Figure(name=f"H-infinity design, {LARGE}", unit="s", peer=H2_BESIDE, goal=AtMost(ratio=HINF_TIMES))
VTOL = Figure(name="H-infinity design of the VTOL", unit="s", peer=H2_BESIDE, goal=AtMost(ratio=VTOL_TIMES))
CERTIFICATE = Figure(
    name=f"certificate of {CERTIFICATE_SIDE**2} modes", unit="s", peer="ARPACK, the radius alone",
    goal=AtMost(ratio=ARPACK_TIMES),
)  # fmt: skip
ONE_MODE = {
    norm: Figure(name=f"{norm} norm, one mode of 40 states", unit="s", peer="python-control") for norm in ("H2", "H-infinity")
}


def _problem(objective: str, most: int, quick: bool) -> TrackingProblem:
    """The motor's loop with delays up to `most`, or that of the plant of many states for 0."""
    if most:
        return motor_problem(1 if quick else most, objective)
    return large_problem(2 if quick else LARGE_PLANT, objective)


@cache
def _h2_row(tell: Tell, most: int, quick: bool) -> Row:
    """The H2 design, made once."""
    return design_row(f"tau_max = d_max = {most}" if most else LARGE, _problem("h2", most, quick), None, tell)


def _h2(tell: Tell, quick: bool, figure: Figure, most: int) -> Iterator[Found]:
    row = _h2_row(tell, most, quick)
    peer = row["CPU s"] + row["evaluations"] * (row["alone ms"] - row["H2 evaluation ms"]) / 1e3
    reported = f"norm {row['norm']:.6g}, {row['evaluations']} evaluations; peer projected from 5"
    yield Found(figure.name, row["CPU s"], peer, reported)


def _hinf(tell: Tell, quick: bool, figure: Figure, most: int) -> Iterator[Found]:
    yield _design(tell, figure, _problem("hinf", most, quick), _h2_row(tell, most, quick)["CPU s"])


def _vtol(tell: Tell, quick: bool) -> Iterator[Found]:
    from design.tracking.synthesis import solve
    from hil.design_questions import problem_for, tracking_target

    target = tracking_target("dc-motor" if quick else "vtol")
    hinf, h2 = (
        problem_for(target, objective=objective, information="generated", output="stacked", hinf_bound=None)
        for objective in ("h2" if quick else "hinf", "h2")
    )
    tell("H2 design of the VTOL")
    yield _design(tell, VTOL, hinf, _cpu(partial(solve, h2))[0])


def _design(tell: Tell, figure: Figure, problem: TrackingProblem, peer_s: float) -> Found:
    """An H-infinity design, stopped where its time is up, beside what the H2 design took."""
    from design.tracking.synthesis import solve

    times = figure.goal.ratio if figure.goal is not None and figure.goal.ratio is not None else 0.0
    tell(figure.name)
    limit_s = max(times * peer_s, LONGEST_S)
    try:
        with _at_most(limit_s):
            ours_s, design = _cpu(partial(solve, problem))
    except TimeoutError:
        return Found(figure.name, limit_s, peer_s, f"not done after {limit_s:g} s of CPU time", unfinished=True)
    norm = design.certificate.hinf_norm if problem.objective == "hinf" else design.certificate.h2_norm
    return Found(figure.name, ours_s, peer_s, f"norm {norm:.6g}, {design.evaluations} evaluations")


def _cpu(task: partial[Design]) -> tuple[float, Design]:
    begun = time.process_time()
    design = task()
    return time.process_time() - begun, design


@contextmanager
def _at_most(cpu_s: float) -> Iterator[None]:
    """Raise TimeoutError in the block once this process has computed for so long."""

    def up(number: int, frame: FrameType | None) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGPROF, up)
    signal.setitimer(signal.ITIMER_PROF, cpu_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _certificates(tell: Tell, quick: bool) -> Iterator[Found]:
    rows = bench_certificates(tell, side=3 if quick else CERTIFICATE_SIDE, orders=(4 if quick else 40,))
    for figure, row in zip((CERTIFICATE, *ONE_MODE.values()), rows):
        both = row["value"], row["peer's value"]
        yield Found(figure.name, row["CPU s"], row["peer s"], "value {:.6g}, the peer's {:.6g}".format(*both))


PART = Part("designs", "designs and certificates over many modes", 150.0, (
    Measure((CERTIFICATE, *ONE_MODE.values()), _certificates),
    Measure((H2[4],), partial(_h2, figure=H2[4], most=4)),
    Measure((LARGE_H2,), partial(_h2, figure=LARGE_H2, most=0)),
    Measure((HINF[4],), partial(_hinf, figure=HINF[4], most=4)),
    Measure((LARGE_HINF,), partial(_hinf, figure=LARGE_HINF, most=0)),
    Measure((VTOL,), _vtol),
    Measure((H2[8],), partial(_h2, figure=H2[8], most=8)),
    Measure((HINF[8],), partial(_hinf, figure=HINF[8], most=8)),
))  # fmt: skip
