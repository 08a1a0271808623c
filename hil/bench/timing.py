"""The rig's real-time behaviour beside ``cyclictest``, at the same priority and in the same minute.

And the lateness of a session in real time with no, one and three readers of its live page, in turns.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack, nullcontext
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import Struct

from hil.bench import killed
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.topics import TIMING
from hil.measure.summary import Array, percentiles, timing_metrics
from hil.pages.live.watch import watched
from hil.runtime.clock import pause
from hil.runtime.real.child import PYTHON
from hil.session import Onlooker, run_session

LINKS = ("can:hil:bench", "zenoh:tcp/127.0.0.1:7447", "can:udp_multicast:239.74.163.2")
EXPERIMENT = "dc-motor-1khz"


def start_cyclictest(priority: int, period_us: int, duration_s: float, output: Path) -> subprocess.Popen[bytes]:
    """Start cyclictest with a 1 us histogram, written as JSON.

    Raises:
        HilError: if it is not installed.
    """
    program = shutil.which("cyclictest")
    if program is None:
        raise HilError("cyclictest is not installed: apt-get install rt-tests")
    # One thread, absolute clock_nanosleep: the same primitive as the rig's clock.
    args = [program, "-q", "-m", f"-i{period_us}", f"-D{max(round(duration_s), 1)}", "-h100000", f"--json={output}"]
    if os.geteuid() == 0:
        args.append(f"-p{priority}")
    return subprocess.Popen(args, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def read_cyclictest(output: Path, period_us: int) -> tuple[Array, int]:
    """Return the wake-up lateness of every cycle in us, (n,), and how many of them were missed.

    After a stall cyclictest leaves out the cycles that have gone by, the rig runs them all. They are put in here with the
    lateness that they would have had (the correction for coordinated omission), so that both are judged over every slot.
    """
    histogram = json.loads(output.read_text())["thread"]["0"]["histogram"]
    late = [int(us) for us, times in histogram.items() for _ in range(times)]
    missed = [us - n * period_us for us in late for n in range(1, us // period_us + 1)]
    return np.array(late + missed), len(missed)


class Turn(Struct, frozen=True):
    """One session, with cyclictest beside it or without."""

    period_s: float
    timed: Array  # the records of /timing/slot
    cyclictest_us: Array
    missed: int
    summary: dict[str, Any]


def take_turn(
    name: str, uri: str, duration_s: float, folder: Path, sets: Sequence[str], *, beside: bool = True,
    onlooker: Onlooker | None = None,
) -> Turn:  # fmt: skip
    """Run one session in real time.

    Args:
        name: of the experiment.
        uri: of the link.
        duration_s: its length, s.
        folder: for its log, which is not kept.
        sets: changes ``path=value`` of the experiment.
        beside: whether cyclictest runs at the same time.
        onlooker: of the session.

    Raises:
        HilError: cyclictest is not installed, or the session failed.
    """
    experiment = load_experiment(name, [*sets, f"duration={duration_s}"])
    period_us = round(1e6 * float(experiment.period))
    output, log = folder / "cyclictest.json", folder / "run.mcap"
    reference = start_cyclictest(experiment.timing.priority, period_us, duration_s, output) if beside else None
    with killed(reference):
        session = run_session(experiment, clock="real", link=uri, path=log, onlooker=onlooker)
        if session.status > 128:  # a signal, which the session took to close its log
            raise SystemExit(session.status)
        if session.status == 1:
            raise HilError(f"{uri}: the session failed: {'; '.join(map(str, session.summary['problems'].values()))}")
        if reference is not None:
            reference.wait(duration_s + 10)
    timed = session.run.arrays[TIMING.name]
    log.unlink()
    if reference is None:
        return Turn(float(experiment.period), timed, np.array([]), 0, session.summary)
    if not output.exists():
        raise HilError(f"cyclictest gave no result: {(reference.stderr.read() if reference.stderr else b'').decode()!r}")
    cyclictest_us, missed = read_cyclictest(output, period_us)
    output.unlink()
    return Turn(float(experiment.period), timed, cyclictest_us, missed, session.summary)


def _row(name: str, uri: str, affinity: str, turns: Sequence[Turn]) -> dict[str, Any]:
    timed = np.concatenate([turn.timed for turn in turns])
    columns = [timed[name] for name in ("lateness_us", "round_trip_us", "late", "overrun")]
    timing = timing_metrics(*columns, period_s=turns[0].period_s)
    beside_us = np.concatenate([turn.cyclictest_us for turn in turns])
    lateness, beside = timing["lateness_us"], percentiles(beside_us)
    return {
        "experiment": name,
        "period_s": turns[0].period_s,
        "link": uri,
        "affinity": affinity,
        "slots": len(timed),
        "turns": len(turns),
        "lateness_us": lateness,
        "cyclictest_us": beside,
        "ratio": {q: _ratio(us, beside[q]) for q, us in lateness.items()},
        "round_trip_us": timing["round_trip_us"],
        "overruns": timing["overruns"],
        "overrun_share": timing["overruns"] / len(timed),
        "cyclictest_missed_share": sum(turn.missed for turn in turns) / len(beside_us),
        "late": timing["late"],
        "late_share": timing["late"] / len(timed),
        "dropped_records": sum(turn.summary["log"]["dropped"] for turn in turns),
        "valid": timing["valid"],
        "scheduler": turns[0].summary["timing"]["scheduler"],
    }


def _ratio(ours_us: float | None, beside_us: float | None) -> float | None:
    return None if ours_us is None or beside_us is None else ours_us / max(beside_us, 1.0)


def bench_timing(
    *,
    duration_s: float = 20.0,
    turns: int = 4,
    links: Sequence[str] = LINKS,
    experiments: Sequence[str] = (EXPERIMENT,),
    sets: Sequence[str] = (),
    affinities: Sequence[str] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> list[dict[str, Any]]:
    """Run experiments over each link with cyclictest beside them; return one row per experiment and link.

    `ratio` is the rig's lateness over cyclictest's, `round_trip_ratio` the median round trip over that of the last row.

    Args:
        duration_s: time over each link, s.
        turns: sessions into which that time is cut; the links take turns, so that what else the machine does hits all of them
            alike.
        links: URIs.
        experiments: names or paths; they take turns too, so that two of them are measured in the same minute.
        sets: changes ``path=value`` of the experiments, for instance ``timing.affinity=pinned``.
        affinities: of `timing.affinity`; every experiment runs with each over each link, in turns [the experiment's].
        progress: called with the name of what is running.

    Raises:
        HilError: cyclictest is not installed, a session failed, or ``sets`` touches what the bench fixes.
    """
    fixed = {change.partition("=")[0].strip() for change in sets} & {"period", "duration"}
    if fixed:
        raise HilError(f"--set {min(fixed)}: this bench runs at the rate of the experiment, for as long as --duration says")
    rates = {name: 1.0 / float(load_experiment(name, sets).period) for name in experiments}
    tried = {name: affinities or [load_experiment(name, sets).timing.affinity] for name in experiments}
    taken: dict[tuple[str, str, str], list[Turn]] = {
        (name, uri, how): [] for name in experiments for uri in links for how in tried[name]
    }
    session_s = duration_s / turns
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as folder:
        for turn in range(turns):
            for name, uri, how in taken:
                said = f"{name} at {rates[name]:g} Hz for {session_s:g} s over {uri} ({how}), cyclictest beside it"
                progress(f"turn {turn + 1} of {turns}: {said}")
                taken[name, uri, how].append(take_turn(name, uri, session_s, Path(folder), [*sets, f"timing.affinity={how}"]))
    rows = [_row(*of, found) for of, found in taken.items()]
    for row in rows:
        row["round_trip_ratio"] = row["round_trip_us"]["p50"] / rows[-1]["round_trip_us"]["p50"]
    return rows


READERS: Final = (0, 1, 3)
HZ: Final = 30
"""Pictures that a reader asks for in a second."""


def read_page(host: str) -> int:
    """Ask for the picture of the last ten seconds as the page does, until the server ends; return how many came."""
    pictures = 0
    try:
        link = HTTPConnection(host, timeout=10)
        while True:
            link.request("GET", "/view?columns=1000&words=1" if pictures % 8 == 0 else "/view?columns=1000")
            link.getresponse().read()
            pictures += 1
            pause(1 / HZ)
    except (OSError, HTTPException):
        return pictures


def bench_live(
    *, duration_s: float, turns: int, link: str, experiment: str,
    progress: Callable[[str], None] = lambda text: None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Return a row for each number of readers; `ratio` is its lateness over that of the first.

    Args:
        duration_s: time with each number of readers, s.
        turns: sessions into which that time is cut, in turns, so that what else the machine does hits all of them alike.
        link: URI.
        experiment: name or path.
        progress: called with what is running.

    Raises:
        HilError: a session failed.
    """
    taken: dict[int, list[tuple[Turn, int]]] = {n: [] for n in READERS}
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as folder:
        for turn in range(turns):
            for n in READERS:
                progress(f"turn {turn + 1} of {turns}: {experiment} over {link}, {n} readers")
                taken[n].append(_session(n, experiment, link, duration_s / turns, Path(folder)))
    timed = {n: np.concatenate([turn.timed for turn, _ in found]) for n, found in taken.items()}
    of = {n: percentiles(each["lateness_us"]) for n, each in timed.items()}
    first = of[READERS[0]]
    return [
        {
            "readers": n, "slots": len(timed[n]), "lateness_us": of[n], "pictures": sum(read for _, read in found),
            "missed": int(timed[n]["late"].sum() + timed[n]["overrun"].sum()),
            "dropped_records": sum(turn.summary["log"]["dropped"] for turn, _ in found),
            "ratio": {q: (of[n][q] or 0.0) / max(first[q] or 0.0, 1.0) for q in first},
        }
        for n, found in taken.items()
    ]  # fmt: skip


def _session(readers: int, name: str, uri: str, duration_s: float, folder: Path) -> tuple[Turn, int]:
    """Run one session with readers of its page; return it, and how many pictures they read."""
    urls: list[str] = []
    with ExitStack() as stack:
        with watched("real", lambda page: urls.append(page.url)) if readers else nullcontext() as side:
            reads = [*PYTHON, "-c", "import sys; from hil.bench.timing import read_page; print(read_page(sys.argv[1]))"]
            processes = [
                subprocess.Popen([*reads, urls[0].split("/")[2]], stdout=subprocess.PIPE, text=True) for _ in range(readers)
            ]
            stack.enter_context(killed(*processes))
            turn = take_turn(name, uri, duration_s, folder, (), beside=False, onlooker=side)
        return turn, sum(int(process.communicate(timeout=30)[0] or 0) for process in processes)
