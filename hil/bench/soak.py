"""How a rig at 1 kHz keeps for long, beside cyclictest: whether it holds, does not, or the machine was too busy to tell.

It measures memory of each process, log and overruns of a long session, and many short sessions.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from msgspec import Struct, field

from hil.bench import killed
from hil.bench.timing import EXPERIMENT, read_cyclictest, start_cyclictest
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.measure.summary import LATENESS_SHARE, OVERRUN_SHARE, percentiles
from hil.runtime.clock import monotonic_ns, pause
from hil.runtime.real.child import python_module

Found = Literal["holds", "does not hold", "undecided"]

LOG_SHARE: Final = 0.1
"""Largest share by which a log is longer or shorter than predicted."""

STATUS: Final[Mapping[Found, int]] = {"holds": 0, "does not hold": 1, "undecided": 4}
"""Exit status of `hil bench soak`; 4 says of a run too that the machine did not keep its times."""

SAFETY: Final = 3


def judge(row: Mapping[str, Any], groups: Mapping[str, Mapping[str, Any]], *, period_us: float) -> tuple[Found, list[str]]:
    """Return what a soak showed, and why if it does not hold or is undecided.

    What a busy machine does to a rig is no fault of the rig: late answers, overruns, a plant that runs away meanwhile and is
    stopped by safety. The machine was busy where cyclictest, in the same minutes and at the same priority, was late by more
    than a tenth of the period in 1 % of its cycles or missed more than 0.1 % of them; without cyclictest, where the run says
    so of itself. Memory that grows, records that were dropped and a log of another size are faults on any machine.

    Args:
        row: of the long session: `status`, `safety`, `slots`, `slots_expected`, `dropped`, `log_ratio`, `memory`,
            `timing_why`, `cyclictest_us`, `cyclictest_missed_share`, see `hil.bench.soak.bench_soak`.
        groups: how many sessions, to `statuses` and `dropped` of the short ones.
        period_us: sample period, us.
    """
    busy = _busy(row, period_us)
    faults = [f"{each['process']}: memory grows" for each in row["memory"] if each["grows"]]
    if row["dropped"]:
        faults.append(f"{row['dropped']} records of the log were dropped")
    if abs(row["log_ratio"] - 1.0) > LOG_SHARE:
        faults.append(f"the log has {row['log_ratio']:.3f} of its predicted length")
    late: list[str] = []
    if row["status"] == SAFETY:
        late.append(f"stopped by safety after {row['slots']} of {row['slots_expected']} slots: {row['safety']}")
    elif row["status"] != 0 or row["slots"] < row["slots_expected"]:
        faults.append(f"ended with status {row['status']} after {row['slots']} of {row['slots_expected']} slots")
    late += row["timing_why"]
    for how, group in groups.items():
        if group["dropped"]:
            faults.append(f"{how}: {group['dropped']} records were dropped")
        for status, count in group["statuses"].items():
            if status == str(SAFETY):
                late.append(f"{how}: {count} stopped by safety")
            elif status != "0":
                faults.append(f"{how}: {count} ended with status {status}")
    if faults:
        return "does not hold", faults + late
    if not late:
        return "holds", []
    if busy:
        return "undecided", [f"the machine was too busy to decide: {busy}", *late]
    return "does not hold", late


def _busy(row: Mapping[str, Any], period_us: float) -> str | None:
    """Return what shows that the machine was too busy, None if nothing does."""
    if row["cyclictest_us"] is None:
        return "no cyclictest stood beside it, and the run did not keep its times" if row["timing_why"] else None
    p99, missed = row["cyclictest_us"]["p99"], row["cyclictest_missed_share"]
    if p99 > LATENESS_SHARE * period_us:
        return f"p99 of cyclictest's lateness was {p99:.0f} us"
    return f"cyclictest missed {missed:.2%} of its cycles" if missed > OVERRUN_SHARE else None


WARM = 0.5
"""Share of a run after which memory counts: tables, caches and buffers are filled, and the heap has found its size, for which
it takes some 400,000 slots. What leaks goes on leaking."""
STEP_KB = 64.0
"""Growth over the whole of that below which a process does not grow: a heap that has found its size still takes a page now and
then. One object that leaks per chunk of the log, 20 a second, is 300 kB in five minutes."""
BATCHES = 10
"""Means of so many stretches are what a line is laid through: samples that follow each other closely are not independent."""
T_95 = 2.306  # Student's t, 8 degrees of freedom, two-sided 95 %
PROCESSES = ("session", "rig", "controller")
SHORT_S = 2.0
GRACE_S = 60.0

Floats = npt.NDArray[np.float64]
Row = dict[str, Any]


class Samples(Struct):
    """What was seen of one session while it ran.

    Attributes:
        t_s: seconds since the first record was in the log.
        kb: resident memory of each process, kB, by name.
        log: length of the log, bytes.
    """

    t_s: list[float] = field(default_factory=list)
    kb: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in PROCESSES})
    log: list[int] = field(default_factory=list)


def slope(t: Floats, y: Floats) -> tuple[float, float]:
    r"""Return the slope of a line through the means of `BATCHES` stretches, and half of its 95 % confidence interval.

    .. math:: \hat b \pm t_{0.975, 8}\, \sqrt{\textstyle\sum_i r_i^2 / (8 \sum_i (t_i - \bar t)^2)}

    Args:
        t: instants, (n,), n >= 2 `BATCHES`.
        y: values, (n,).

    Raises:
        ValueError: too few samples.

    >>> t = np.linspace(0.0, 1.0, 100)
    >>> [round(float(v), 6) for v in slope(t, 3.0 * t + 1.0)]
    [3.0, 0.0]
    """
    if len(t) < 2 * BATCHES:
        raise ValueError(f"{len(t)} samples, expected {2 * BATCHES} at least")
    y = y - y[0]  # what is constant has no slope, not one of rounding
    t_of, y_of = (np.array([part.mean() for part in np.array_split(v, BATCHES)]) for v in (t, y))
    from_mean = t_of - t_of.mean()
    spread = float(from_mean @ from_mean)
    b = float(from_mean @ y_of) / spread
    rest = y_of - y_of.mean() - b * from_mean
    return b, T_95 * float(np.sqrt(rest @ rest / (BATCHES - 2) / spread))


def bench_soak(
    *,
    duration_s: float = 600.0,
    sessions: int = 0,
    at_once: int = 0,
    progress: Callable[[str], None] = lambda text: None,
) -> Row:
    """Run ``dc-motor-1khz`` over can:hil for long, with cyclictest beside it where it is installed.

    Args:
        duration_s: length of the long session, s.
        sessions: so many short ones follow, one after the other.
        at_once: so many short ones follow, all at once, each on a channel of its own.
        progress: called with the name of what is running.

    Returns:
        `verdict` and `why` (see `judge`), `status`, `safety` (why it stopped the run, or None), `slots`, `slots_expected`,
        `dropped`, `late`, `overrun_share`, `lateness_us`, `timing_why` (what the run says against its times), of cyclictest
        `cyclictest_us` and `cyclictest_missed_share` (None without it), `log_bytes`, `log_predicted` (by its growth in the
        second tenth), `log_ratio`, `memory` (one row per process: `mb`, `slope_kb_per_min`, `plus_minus`, `grows`: the
        interval lies above what makes `STEP_KB`), of `in_a_row` and `at_once` how often each exit status came, and
        `short_dropped`, by how.

    Raises:
        HilError: the long session did not run, or was too short to judge.
    """
    with tempfile.TemporaryDirectory(prefix="hil-soak-") as name:
        folder = Path(name)
        progress(f"1 kHz for {duration_s:g} s over can:hil")
        row = _long(folder, duration_s)
        groups = {}
        if sessions:
            groups["in a row"] = _short(folder, [1] * sessions, progress, "in a row")
        if at_once:
            groups["at once"] = _short(folder, [at_once], progress, "at once")
    for how in ("in a row", "at once"):
        row[how.replace(" ", "_")] = groups[how]["statuses"] if how in groups else None
    row["short_dropped"] = {how: group["dropped"] for how, group in groups.items()}
    verdict, why = judge(row, groups, period_us=1e6 * float(load_experiment(EXPERIMENT).period))
    return {"verdict": verdict, "why": why, **row}


def _start(folder: Path, number: int, duration_s: float) -> subprocess.Popen[bytes]:
    log = folder / f"{number}.mcap"
    with open(folder / f"{number}.json", "wb") as out:
        return subprocess.Popen(
            [*python_module("hil"), "run", EXPERIMENT, "--clock", "real", "--link", f"can:hil:soak{os.getpid()}-{number}",
             "--duration", str(duration_s), "--json", "--force", "-o", str(log)],
            cwd=folder, stdout=out, stderr=subprocess.DEVNULL,
        )  # fmt: skip


def _long(folder: Path, duration_s: float) -> Row:
    beside, output = None, folder / "cyclictest.json"
    experiment = load_experiment(EXPERIMENT)
    period_us = experiment.period_ns // 1000
    if shutil.which("cyclictest") is not None:
        beside = start_cyclictest(experiment.timing.priority, period_us, duration_s, output)
    session = _start(folder, 0, duration_s)
    with killed(session, beside):
        seen = _watch(session, folder / "0.mcap", duration_s)
        status = session.wait(duration_s + GRACE_S)
        if beside is not None:
            beside.wait(duration_s + GRACE_S)
    try:
        summary = json.loads((folder / "0.json").read_text())
    except ValueError:
        raise HilError(f"the session ended with status {status} and without a summary") from None
    beside_us, missed = _beside(output, period_us)
    t, log = np.array(seen.t_s), np.array(seen.log, dtype=float)
    if len(t) < 4 * BATCHES:
        raise HilError(f"only {len(t)} samples were taken (status {status}): let it run longer")
    timing, slots = summary["timing"], summary["slots"]
    size = (folder / "0.mcap").stat().st_size
    predicted = _predicted(t, log, slots * float(experiment.period))  # of one that was stopped: until then
    return {
        "status": status, "safety": summary["safety"], "slots": slots,
        "slots_expected": round(duration_s / float(experiment.period)), "dropped": summary["log"]["dropped"],
        "late": timing["late"], "overrun_share": timing["overruns"] / max(slots, 1), "lateness_us": timing["lateness_us"],
        "timing_why": timing["why"], "cyclictest_us": beside_us, "cyclictest_missed_share": missed,
        "log_bytes": size, "log_predicted": predicted, "log_ratio": size / predicted,
        "memory": [_memory(name, t, np.array(seen.kb[name])) for name in PROCESSES],
    }  # fmt: skip


def _beside(output: Path, period_us: int) -> tuple[dict[str, float | None] | None, float | None]:
    """Return how late cyclictest was, us, and the share of its cycles that it missed; None where it has written nothing."""
    if not output.exists():
        return None, None
    late_us, missed = read_cyclictest(output, period_us)
    return percentiles(late_us), missed / max(len(late_us), 1)


def _predicted(t: Floats, log: Floats, duration_s: float) -> float:
    first, last = (int(np.searchsorted(t, share * duration_s)) for share in (0.1, 0.2))
    last = min(max(last, first + 1), len(t) - 1)
    rate = (log[last] - log[first]) / (t[last] - t[first])
    return float(log[first] + rate * (duration_s - t[first]))


def _memory(name: str, t: Floats, kb: Floats) -> Row:
    warm = t > WARM * t[-1]
    b, half = slope(t[warm], kb[warm])
    return {
        "process": name, "mb": float(kb[-1]) / 1e3, "slope_kb_per_min": 60.0 * b, "plus_minus": 60.0 * half,
        "grows": (b - half) * float(np.ptp(t[warm])) > STEP_KB,
    }  # fmt: skip


def _watch(session: subprocess.Popen[bytes], log: Path, duration_s: float) -> Samples:
    """Take samples until the run is over; what the session does with its log afterwards is not its memory while it runs."""
    seen, step_s = Samples(), min(max(duration_s / 400, 0.02), 2.0)
    begin: int | None = None
    pids: dict[str, int] = {}
    while session.poll() is None:
        size = log.stat().st_size if log.exists() else 0
        if begin is None and size > 12_000:
            begin, pids = monotonic_ns(), _processes(session.pid)
        if begin is not None:
            t_s = (monotonic_ns() - begin) / 1e9
            found = {name: _resident_kb(pid) for name, pid in pids.items()}
            if t_s > duration_s or len(found) < len(PROCESSES) or None in found.values():
                break
            seen.t_s.append(t_s)
            seen.log.append(size)
            for name, kb in found.items():
                seen.kb[name].append(float(kb or 0))
        pause(step_s)
    return seen


def _processes(session: int) -> dict[str, int]:
    found = {"session": session}
    for child in Path(f"/proc/{session}/task/{session}/children").read_text().split():
        with suppress(OSError):
            command = Path(f"/proc/{child}/cmdline").read_text()
            found |= {name: int(child) for name in PROCESSES if f"hil.runtime.real.{name}_process" in command}
    return found


def _resident_kb(pid: int) -> int | None:
    with suppress(OSError, ValueError, IndexError):
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") // 1024 if pages else None
    return None


def _short(folder: Path, groups: list[int], progress: Callable[[str], None], how: str) -> Row:
    """Run groups of short sessions, each group at once; return how often each exit status came, and what was dropped."""
    statuses: dict[str, int] = {}
    dropped = 0
    for turn, group in enumerate(groups):
        progress(f"{how}: {turn + 1} of {len(groups)}, {group} sessions of {SHORT_S:g} s")
        running = [_start(folder, 1 + number, SHORT_S) for number in range(group)]
        with killed(*running):
            for number, process in enumerate(running):
                status = str(process.wait(SHORT_S + GRACE_S * (1 + group / 4)))
                statuses[status] = statuses.get(status, 0) + 1
                with suppress(ValueError):  # one without a summary says so by its status
                    dropped += json.loads((folder / f"{1 + number}.json").read_text())["log"]["dropped"]
    return {"statuses": statuses, "dropped": dropped}
