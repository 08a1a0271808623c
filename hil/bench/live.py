"""The lateness of a session in real time with no, one and three readers of its live page, in turns."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.experiment import load_experiment
from hil.log.topics import TIMING
from hil.measure.summary import percentiles
from hil.pages.live.watch import watched
from hil.runtime.real.child import PYTHON
from hil.runtime.time.clock import pause
from hil.session import run_session

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
    *, duration_s: float, turns: int, link: str, experiment: str, readers: Sequence[int] = READERS,
    progress: Callable[[str], None] = lambda text: None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Return a row for each number of readers; `ratio` is its lateness over that of the first.

    Args:
        duration_s: time with each number of readers, s.
        turns: sessions into which that time is cut, in turns, so that what else the machine does hits all of them alike.
        link: URI.
        experiment: name or path.
        readers: how many, in turns.
        progress: called with what is running.

    Raises:
        HilError: a session failed.
    """
    lateness: dict[int, list[Any]] = {n: [] for n in readers}
    missed, pictures, dropped = dict.fromkeys(readers, 0), dict.fromkeys(readers, 0), dict.fromkeys(readers, 0)
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as folder:
        for turn in range(turns):
            for n in readers:
                progress(f"turn {turn + 1} of {turns}: {experiment} over {link}, {n} readers")
                found = _session(n, experiment, link, duration_s / turns, Path(folder) / "run.mcap")
                lateness[n].append(found[0])
                missed[n], dropped[n], pictures[n] = missed[n] + found[1], dropped[n] + found[2], pictures[n] + found[3]
    of = {n: percentiles(np.concatenate(lateness[n])) for n in readers}
    first = of[readers[0]]
    return [
        {
            "readers": n, "slots": sum(map(len, lateness[n])), "lateness_us": of[n], "pictures": pictures[n], "missed": missed[n],
            "dropped_records": dropped[n], "ratio": {q: (of[n][q] or 0.0) / max(first[q] or 0.0, 1.0) for q in first},
        }
        for n in readers
    ]  # fmt: skip


def _session(readers: int, name: str, uri: str, duration_s: float, log: Path) -> tuple[Any, int, int, int]:
    """Return the lateness of every slot in us, slots without an answer or over their time, records dropped, and pictures read."""
    urls: list[str] = []
    processes = []
    with ExitStack() as stack:
        side = stack.enter_context(watched("real", urls.append)) if readers else None
        for _ in range(readers):
            command = [*PYTHON, "-c", f"from hil.bench.live import read_page; print(read_page({urls[0].split('/')[2]!r}))"]
            processes.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        try:
            experiment = load_experiment(name, [f"duration={duration_s}"])
            session = run_session(experiment, clock="real", link=uri, path=log, onlooker=side)
        except BaseException:
            for process in processes:
                process.kill()
            raise
    ticks = session.run.arrays[TIMING.name]
    log.unlink()
    read = sum(int(process.communicate(timeout=30)[0] or 0) for process in processes)
    return ticks["lateness_us"], int(ticks["late"].sum() + ticks["overrun"].sum()), session.summary["log"]["dropped"], read
