"""Figures of real time: round trips, late answers by affinity, the log of a slot in the loop, rates beside cyclictest."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from hil.bench.links import FLOOR, bench_links, free_port
from hil.bench.timing import EXPERIMENT, Turn, take_turn
from hil.errors import HilError
from tests.bench.figure import AtMost, Figure, Found, Measure, Part, Tell
from tests.bench.loop_log import loop_log_us
from tests.bench.shares import of_shares

BARE, PLAIN, C = "bare Unix sockets of Python", "plainest zenoh-python, both CPUs", "UDP in C"

CAN = Figure(name="round trip over can:hil, p50", unit="us", peer=BARE, goal=AtMost(ratio=1.5))
CAN_C = Figure(name="round trip over can:hil, p50, beside C", unit="us", peer=C)
ONE_CPU = Figure(name="round trip over zenoh on one CPU, p50", unit="us", peer=PLAIN)
BOTH_CPUS = Figure(name="round trip over zenoh on both CPUs, p50", unit="us", peer=PLAIN)
LATE = Figure(name="late answers over zenoh on one CPU", unit="%", peer=PLAIN, condition=AtMost(ratio=0.1))

IN_LOOP = Figure(name="log of a slot in the loop at 1 kHz, p50", unit="us", peer="record by record", goal=AtMost(ratio=0.5))

FREE = "affinity free, alternately"
AUTO_FREE = Figure(name="late answers, 1 kHz over zenoh, affinity auto", unit="%", peer=FREE)
SHARED_FREE = Figure(name="late answers, 1 kHz over zenoh, affinity shared", unit="%", peer=FREE)
AUTO_CAN = Figure(
    name="late answers, 1 kHz over zenoh beside can:hil", unit="%", peer="can:hil, alternately", goal=AtMost(ratio=2.0, plus=0.05)
)
TRIP = Figure(name="round trip of a session over zenoh, affinity auto, p50", unit="us", peer=FREE)

MISSED = "missed by cyclictest, alternately"
AS_CYCLICTEST = AtMost(ratio=3.0, plus=0.5)
RATE_CAN = Figure(name="overruns at 4 kHz over can:hil", unit="%", peer=MISSED, goal=AS_CYCLICTEST)
RATE_LOCAL = Figure(name="overruns at 10 kHz over local:", unit="%", peer=MISSED, goal=AS_CYCLICTEST)
RATES = {
    RATE_CAN: ("can:hil:rate{pid}", ("period=250 us", "limits.watchdog_slots=800")),
    RATE_LOCAL: ("local:", ("period=100 us", "limits.watchdog_slots=2000")),
}
"""Of each: the link, and what is changed in the experiment of 1 kHz; the watchdog keeps its 0.2 s."""


def _links(tell: Tell, quick: bool) -> Iterator[Found]:
    tell("round trips at 1 kHz over every link, alternately")
    found = bench_links(1000.0, 0.5 if quick else 6.0, links=_LINKS)
    rows = {(row["link"].split("/")[0], row["affinity"]): row for row in found}
    can, bare, plain = rows["can:hil:bench-*", "free"], rows["plain-unix:*", "free"], rows["plain-zenoh:unixsock-stream", "free"]
    floor = rows[FLOOR, "free"]
    yield _trip(CAN, can, bare)
    yield _trip(CAN_C, can, floor)
    for figure, how in ((ONE_CPU, "shared"), (BOTH_CPUS, "free")):
        yield _trip(figure, rows["zenoh:unixsock-stream", how], plain)


_ZENOH = ("zenoh:unixsock-stream/{folder}/bench", "plain-zenoh:unixsock-stream/{folder}/plain")
_LINKS = ("can:hil:bench-{pid}", "plain-unix:{folder}/bare", *_ZENOH)


def _late_answers(tell: Tell, quick: bool) -> Iterator[Found]:
    tell("late answers over zenoh at 1 kHz, alternately: there are few, so it takes two minutes")
    rows = bench_links(1000.0, 0.5 if quick else 40.0, links=_ZENOH, floor=False)
    for row in rows:
        if row["note"]:
            raise HilError(str(row["note"]))
    _, shared, plain = ((int(row["late"]), int(row["trips"])) for row in rows)
    yield of_shares(LATE.name, shared, plain)


def _trip(figure: Figure, ours: dict[str, float | str], peer: dict[str, float | str]) -> Found:
    if ours["note"]:
        raise HilError(str(ours["note"]))
    beside = float(peer["p50_us"])
    return Found(figure.name, float(ours["p50_us"]), None if math.isnan(beside) else beside, str(peer["note"]))


def _in_loop(tell: Tell, quick: bool) -> Iterator[Found]:
    tell("the log of a slot in the loop, packed at once and record by record, alternately")
    yield Found(IN_LOOP.name, *loop_log_us(200 if quick else 3000))


def _affinities(tell: Tell, quick: bool) -> Iterator[Found]:
    zenoh = f"zenoh:tcp/127.0.0.1:{free_port()}"
    auto = zenoh, "auto"
    ways = [auto, (zenoh, "free"), auto if quick else (zenoh, "shared"), (f"can:hil:affinity{os.getpid()}", "auto")]
    turns, length_s = (1, 0.2) if quick else (4, 4.0)
    taken: dict[tuple[str, str], list[Turn]] = {way: [] for way in ways}
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as folder:
        for turn in range(turns):
            for uri, how in taken:
                tell(f"turn {turn + 1} of {turns}: 1 kHz for {length_s:g} s over {uri} ({how})")
                taken[uri, how].append(_session(uri, length_s, folder, [f"timing.affinity={how}"]))
    ours, free, shared, can = (_late(taken[way]) for way in ways)
    reported = f"{turns} sessions of {length_s:g} s each"
    yield of_shares(AUTO_FREE.name, ours, free, reported)
    yield of_shares(SHARED_FREE.name, shared, free, reported)
    yield of_shares(AUTO_CAN.name, ours, can, reported)
    yield Found(TRIP.name, _p50(taken[auto]), _p50(taken[zenoh, "free"]), reported)


def _session(uri: str, length_s: float, folder: str, sets: Sequence[str], *, beside: bool = False) -> Turn:
    return take_turn(EXPERIMENT, uri, length_s, Path(folder), sets, beside=beside)


def _late(turns: Sequence[Turn]) -> tuple[int, int]:
    late = np.concatenate([turn.timed["late"] for turn in turns])
    return int(late.sum()), len(late)


def _p50(turns: Sequence[Turn]) -> float:
    return float(np.nanmedian(np.concatenate([turn.timed["round_trip_us"] for turn in turns])))


def _rates(tell: Tell, quick: bool) -> Iterator[Found]:
    turns, length_s = (1, 0.2) if quick else (5, 4.0)
    beside = shutil.which("cyclictest") is not None
    taken: dict[Figure, list[Turn]] = {figure: [] for figure in RATES}
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as folder:
        for turn in range(turns):
            for figure, (link, sets) in RATES.items():
                tell(f"turn {turn + 1} of {turns}: {figure.name}, for {length_s:g} s")
                taken[figure].append(_session(link.format(pid=os.getpid()), length_s, folder, sets, beside=beside))
    for figure, found in taken.items():
        ours = 100 * float(np.mean(np.concatenate([turn.timed["overrun"] for turn in found])))
        woken = sum(len(turn.cyclictest_us) for turn in found)
        peer = 100 * sum(turn.missed for turn in found) / woken if woken else None
        reported = f"{turns} sessions of {length_s:g} s" if beside else "cyclictest is not installed: apt-get install rt-tests"
        yield Found(figure.name, ours, peer, reported)


PART = Part("real-time", "round trips, late answers by affinity, the log in the loop, rates beside cyclictest", 400.0, (
    Measure((CAN, CAN_C, ONE_CPU, BOTH_CPUS), _links, loops=True),
    Measure((LATE,), _late_answers),
    Measure((IN_LOOP,), _in_loop, loops=True),
    Measure((AUTO_FREE, SHARED_FREE, AUTO_CAN, TRIP), _affinities),
    Measure(tuple(RATES), _rates, loops=True),
))  # fmt: skip
