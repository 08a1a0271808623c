"""The rig's real-time behaviour beside ``cyclictest``, at the same priority and in the same minute."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import HilError
from hil.experiment import load_experiment
from hil.report.timing import percentiles
from hil.session import run_session

LINKS = ("can:hil:bench", "zenoh:tcp/127.0.0.1:7447", "can:udp_multicast:239.74.163.2")


def start_cyclictest(priority: int, period_us: int, duration_s: float, output: Path) -> subprocess.Popen[bytes]:
    """Start cyclictest with a 1 us histogram, written as JSON.

    Raises
    ------
    HilError
        If it is not installed.
    """
    program = shutil.which("cyclictest")
    if program is None:
        raise HilError("cyclictest is not installed: apt-get install rt-tests")
    # One thread, absolute clock_nanosleep: the same primitive as the rig's clock.
    args = [program, "-q", "-m", f"-i{period_us}", f"-D{max(round(duration_s), 1)}", "-h100000", f"--json={output}"]
    if os.geteuid() == 0:
        args.append(f"-p{priority}")
    return subprocess.Popen(args, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def read_cyclictest(output: Path, period_us: int) -> dict[str, Any]:
    """Return p50, p99, p99_9 and max of the wake-up lateness in us, the number of ticks, and how many of them were missed.

    After a stall cyclictest leaves out the ticks that have gone by, the rig runs them all. They are put in here with the
    lateness that they would have had (the correction for coordinated omission), so that both are judged over every tick.
    """
    histogram = json.loads(output.read_text())["thread"]["0"]["histogram"]
    late = [int(us) for us, times in histogram.items() for _ in range(times)]
    missed = [us - n * period_us for us in late for n in range(1, us // period_us + 1)]
    return {**percentiles(np.array(late + missed)), "ticks": len(late) + len(missed), "missed": len(missed)}


def bench_timing(
    *, duration_s: float = 20.0, links: Sequence[str] = LINKS, progress: Callable[[str], None] = lambda text: None
) -> list[dict[str, Any]]:
    """Run ``dc-motor-1khz`` over each link with cyclictest beside it; return one row per link.

    `ratio` is the rig's lateness over cyclictest's, `round_trip_ratio` the median round trip over that of the last link.

    Parameters
    ----------
    duration_s : float
        Length of each run, s.
    links : sequence of str
        URIs.
    progress : callable
        Told what is running.
    """
    rows = []
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as folder:
        for i, uri in enumerate(links):
            progress(f"1 kHz for {duration_s:g} s over {uri}, cyclictest beside it")
            experiment = load_experiment("dc-motor-1khz", [f"duration={duration_s}"])
            output = Path(folder) / f"cyclictest-{i}.json"
            reference = start_cyclictest(experiment.timing.priority, 1000, duration_s, output)
            try:
                session = run_session(experiment, clock="real", link=uri, path=Path(folder) / f"{i}.mcap")
                if session.status > 128:  # a signal, which the session took to close its log
                    raise SystemExit(session.status)
                if session.status == 1:
                    raise HilError(f"{uri}: the session failed: {'; '.join(map(str, session.summary['problems'].values()))}")
                reference.wait(duration_s + 10)
            finally:
                if reference.poll() is None:
                    reference.kill()
                    reference.wait()
            if not output.exists():
                raise HilError(f"cyclictest gave no result: {(reference.stderr.read() if reference.stderr else b'').decode()!r}")
            timing, ticks, beside = session.summary["timing"], session.summary["ticks"], read_cyclictest(output, 1000)
            lateness = timing["lateness_us"]
            rows.append({
                "link": uri,
                "ticks": ticks,
                "lateness_us": lateness,
                "cyclictest_us": beside,
                "ratio": {q: lateness[q] / max(beside[q], 1.0) for q in lateness},
                "round_trip_us": timing["round_trip_us"],
                "overruns": timing["overruns"],
                "overrun_share": timing["overruns"] / ticks,
                "cyclictest_missed_share": beside.pop("missed") / beside.pop("ticks"),
                "late": sum(session.summary["network"][side]["late"] for side in ("ca",)),
                "dropped_records": session.summary["log"]["dropped"],
                "valid": timing["valid"],
                "scheduler": timing["scheduler"],
            })  # fmt: skip
    for row in rows:
        row["round_trip_ratio"] = row["round_trip_us"]["p50"] / rows[-1]["round_trip_us"]["p50"]
    return rows
