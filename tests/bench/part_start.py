"""Figures of start-up: what a command takes before and after its work."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from hil.runtime.real.child import PYTHON
from tests.bench.figure import AtMost, Figure, Found, Measure, Part, Tell
from tests.bench.processes import HIL, NUMPY, Spent, spent

MOTOR, SOLVED = "dc-motor-hinf", "smjls-robust"
SCIPY = "import scipy.linalg; "
COMPOSE = f"from hil.compose import compose; from hil.experiment import load_experiment; compose(load_experiment('{MOTOR}'))"
REAL_S = 2.0

NUMPY_STARTS = "start of Python with numpy"
HELP = Figure(name="hil --help, CPU time", unit="s", peer=NUMPY_STARTS)
SLOT = Figure(name="hil run of one slot, CPU time", unit="s", peer=NUMPY_STARTS, goal=AtMost(ratio=2.5))
COMPOSING = Figure(name="composing dc-motor-hinf with its certificate, CPU time", unit="s", peer="with scipy.linalg imported")
CACHED = Figure(name="hil run of one slot of smjls-robust, CPU time", unit="s", peer="the first on a machine: gains are solved")
SESSION = Figure(
    name="a real session beyond its run, wall time", unit="s", peer="three starts of Python with numpy", goal=AtMost(ratio=3.0)
)


def _least(times: int, *commands: Sequence[str]) -> list[Spent]:
    """What each command takes where nothing disturbs it: the least of some times, one after the other in turns."""
    return [min(found) for found in zip(*([spent(command) for command in commands] for _ in range(times)))]


def _start(tell: Tell, quick: bool) -> Iterator[Found]:
    times = 1 if quick else 15
    with tempfile.TemporaryDirectory(prefix="hilrig-bench-") as folder:
        tell("python -c 'import numpy', hil --help, hil run of one slot, composing")
        one = [*HIL, "run", MOTOR, "--duration", "50 ms", "-o", str(Path(folder) / "slot.mcap"), "--force", "--quiet"]
        numpy, help_, slot = _least(times, NUMPY, [*HIL, "--help"], one)
        yield Found(HELP.name, help_.cpu_s, numpy.cpu_s)
        yield Found(SLOT.name, slot.cpu_s, numpy.cpu_s)
        ours, peer = _least(times, *([*PYTHON, "-c", text + COMPOSE] for text in ("", SCIPY)))
        yield Found(COMPOSING.name, ours.cpu_s, peer.cpu_s, "start of Python included")


def _cached(tell: Tell, quick: bool) -> Iterator[Found]:
    with tempfile.TemporaryDirectory(prefix="hilrig-bench-") as folder:
        name = MOTOR if quick else SOLVED
        tell(f"hil run of one slot of {name}, twice")
        log, length = str(Path(folder) / "slot.mcap"), "50 ms" if quick else "5 ms"
        one = [*HIL, "run", name, "--duration", length, "-o", log, "--force", "--quiet"]
        first, again = (spent(one, sets={"XDG_CACHE_HOME": folder}) for _ in range(2))
        yield Found(CACHED.name, again.cpu_s, first.cpu_s)


def _session(tell: Tell, quick: bool) -> Iterator[Found]:
    length_s, times = (0.2, 1) if quick else (REAL_S, 3)
    tell(f"hil run --clock real of {length_s:g} s")
    with tempfile.TemporaryDirectory(prefix="hilrig-bench-") as folder:
        run = [*HIL, "run", MOTOR, "--clock", "real", "--link", f"can:hil:bench{os.getpid()}", "--duration", f"{length_s:g}"]
        run += ["-o", str(Path(folder) / "real.mcap"), "--force", "--quiet"]
        wall_s = sorted(spent(run).wall_s for _ in range(times))[times // 2]
        [numpy] = _least(times, NUMPY)
        yield Found(SESSION.name, wall_s - length_s, 3 * numpy.wall_s, f"a run of {length_s:g} s over can:hil")


PART = Part("start", "start and stop of commands and sessions", 60.0, (
    Measure((HELP, SLOT, COMPOSING), _start, loops=True),
    Measure((CACHED,), _cached),
    Measure((SESSION,), _session, loops=True),
))  # fmt: skip
