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
from numpy.typing import NDArray

from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.read import Run
from hil.report.timing import percentiles
from hil.session import run_session

LINKS = ("can:hil:bench", "zenoh:tcp/127.0.0.1:7447")


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


def read_cyclictest(output: Path) -> dict[str, float]:
    """Return p50, p99, p99_9 and max of the wake-up lateness, us."""
    thread = json.loads(output.read_text())["thread"]["0"]
    histogram = {int(us): int(n) for us, n in thread["histogram"].items()}
    total = sum(histogram.values()) or 1
    out, seen = {}, 0
    wanted = [("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999)]
    for us in sorted(histogram):
        seen += histogram[us]
        while wanted and seen >= wanted[0][1] * total:
            out[wanted.pop(0)[0]] = float(us)
    return {**out, "max": float(thread["max"])}


def wake_ups_us(run: Run) -> NDArray[np.float64]:
    """Return the lateness of the slots that the rig slept for, us.

    After a stall the rig runs the slots that it missed back to back; cyclictest leaves out the ticks that it missed. So the two
    are compared on the slots before which the rig went to sleep: those whose predecessor ended in time.
    """
    ticks = run.arrays["/timing/tick"]
    period_us = float(run.resolved["period"]) * 1e6
    busy = ticks["lateness_us"] + np.nan_to_num(ticks["round_trip_us"], nan=period_us) + ticks["work_us"]
    slept = np.concatenate([[True], busy[:-1] < period_us])
    return np.asarray(ticks["lateness_us"][slept])


def bench_timing(
    *, duration_s: float = 20.0, links: Sequence[str] = LINKS, progress: Callable[[str], None] = lambda text: None
) -> list[dict[str, Any]]:
    """Run ``dc-motor-1khz`` over each link with cyclictest beside it; return one row per link.

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
                reference.wait(duration_s + 10)
            finally:
                if reference.poll() is None:
                    reference.kill()
                    reference.wait()
            if not output.exists():
                raise HilError(f"cyclictest gave no result: {(reference.stderr.read() if reference.stderr else b'').decode()!r}")
            timing, beside = session.summary["timing"], read_cyclictest(output)
            ticks, woken = session.summary["ticks"], percentiles(wake_ups_us(session.run))
            rows.append({
                "link": uri,
                "ticks": ticks,
                "lateness_us": timing["lateness_us"],
                "wake_up_us": woken,
                "cyclictest_us": beside,
                "ratio": {q: (woken[q] or 0.0) / max(beside[q], 1.0) for q in beside},
                "round_trip_us": timing["round_trip_us"],
                "overruns": timing["overruns"],
                "overrun_share": timing["overruns"] / max(ticks, 1),
                "late": sum(session.summary["network"][side]["late"] for side in ("ca",)),
                "dropped_records": session.summary["log"]["dropped"],
                "valid": timing["valid"],
                "scheduler": timing["scheduler"],
            })  # fmt: skip
    return rows
