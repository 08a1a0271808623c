"""Measures one after the other, each in a process of its own: none of them can take the others with it.

What runs slots is measured interpreted and then compiled, where a compiled loop is given.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import date
from pathlib import Path
from typing import Any, Final

from hil.errors import HilError
from hil.runtime.real.child import python_module
from tests.bench.catalogue import PARTS
from tests.bench.figure import Part, Row, Tell, in_both_forms, row_of
from tests.bench.other_code import BEFORE, beside

GRACE_S: Final = 0.4


def chosen(names: Sequence[str]) -> tuple[Part, ...]:
    """Return the parts of some names, all for none, in their order.

    Raises:
        HilError: there is no such part.
    """
    known = [part.name for part in PARTS]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise HilError(f"--only: no part {unknown[0]!r}; expected {', '.join(known)}")
    return tuple(part for part in PARTS if not names or part.name in names)


def run_parts(
    parts: Sequence[Part], tell: Tell, *, quick: bool = False, compiled: Path | None = None, before: Path | None = None
) -> tuple[dict[str, Any], KeyboardInterrupt | None]:
    """Measure parts.

    Args:
        parts: what is measured.
        tell: called with which part runs, and about how long.
        quick: whether something smaller is measured, a few seconds a part.
        compiled: the wheel with the compiled loop, unpacked.
        before: sources of the version that a slot is set beside.

    Returns:
        `machine`, `date`, `quick`, `seconds` that each part took, and `figures`, one row each, measured or not; and the interrupt
        if one came: then the rows say so.
    """
    figures: list[Row] = []
    seconds: dict[str, float] = {}
    stop: KeyboardInterrupt | None = None
    for number, part in enumerate(parts, 1):
        if stop is None:
            left = sum(each.seconds for each in parts[number - 1 :])
            often = "a few seconds" if quick else f"about {_lasts(part.seconds)}, {_lasts(left)} to the end"
            tell(f"{number} of {len(parts)}: {part.name} ({part.about}): {often}")
        begun = time.perf_counter()
        about = {} if before is None else {BEFORE: str(before.resolve())}
        for numbers in together(part):
            command = python_module("tests.bench.catalogue", part.name, ",".join(map(str, numbers)), *(["--quick"] * quick))
            ways = [about]
            if compiled is not None and part.measures[numbers[0]].loops:
                ways.append(about | beside(compiled))
            taken = []
            for sets in ways:
                rows: dict[str, Row] = {}
                why = "interrupted"
                if stop is None:
                    try:
                        why = _run(command, rows, sets)
                    except KeyboardInterrupt as interrupt:
                        stop = interrupt
                wanted = [figure for each in numbers for figure in part.measures[each].figures]
                taken.append([rows.get(f.name) or row_of(part.name, f, None, why) for f in wanted])
            figures += taken[0] if len(taken) == 1 else map(in_both_forms, *taken)
        seconds[part.name] = round(time.perf_counter() - begun, 1)
    return {
        "machine": machine(), "date": date.today().isoformat(), "quick": quick, "seconds": seconds, "figures": figures,
    }, stop  # fmt: skip


def together(part: Part) -> list[list[int]]:
    """Return which measures share a process: those without slots, which stand side by side and keep what they have computed."""
    found: list[list[int]] = []
    for number, measure in enumerate(part.measures):
        if found and not measure.loops and not part.measures[number - 1].loops:
            found[-1].append(number)
        else:
            found.append([number])
    return found


def _run(command: Sequence[str], rows: dict[str, Row], sets: Mapping[str, str]) -> str:
    """Run one measure, keep its rows as they come, and return how it ended; an interrupt ends all of its processes."""
    with tempfile.TemporaryDirectory(prefix="hilrig-bench-", ignore_cleanup_errors=True) as folder:
        own = Path(folder) / "can"  # what a process leaves that is killed goes with the folder
        own.mkdir(mode=0o700)
        about = {"TMPDIR": folder, "HIL_CAN_DIR": str(own), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", **sets}
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, env=os.environ | about, start_new_session=True
        )
        assert process.stdout is not None
        try:
            for line in process.stdout:
                row = json.loads(line)
                rows[row["name"]] = row
            status = process.wait()
        finally:
            _end(process)
            process.stdout.close()
    return f"its process ended with status {status}"


def _end(process: subprocess.Popen[str]) -> None:
    """End a process and all that it has started: first as sessions end, then at once."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        if number == signal.SIGTERM and process.poll() is None:
            with suppress(subprocess.TimeoutExpired):
                process.wait(GRACE_S)
    process.wait()


def machine() -> dict[str, Any]:
    """Return what the figures were measured on."""
    names = [line.partition(":")[2].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")]
    memory = next((int(line.split()[1]) for line in _lines("/proc/meminfo") if line.startswith("MemTotal")), 0)
    return {
        "cpus": len(os.sched_getaffinity(0)), "cpu": names[0] if names else platform.machine(),
        "memory_gb": round(memory / 1e6, 1),
        "system": platform.platform(), "python": platform.python_version(), "load_before": round(os.getloadavg()[0], 1),
    }  # fmt: skip


def _lines(path: str) -> list[str]:
    with suppress(OSError):
        return Path(path).read_text().splitlines()
    return []


def _lasts(seconds: float) -> str:
    """Return a time in words.

    >>> _lasts(25.0), _lasts(300.0)
    ('25 s', '5 min')
    """
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
