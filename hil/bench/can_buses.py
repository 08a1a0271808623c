"""Frames per second and round trips over CAN buses of this machine, with the bus model off and on, side by side.

Each bus has its own pair of processes, and the pairs take turns; python-can's `virtual` lives in one process, as two threads.
Where frames take time, the error of a frame's time is how much later than the end of its EOF a program has it: what the machine
adds to the bus, and no part of the model. cyclictest runs beside, in the same minute and at the same priority.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from time import time
from typing import Any, Final

import numpy as np

from hil.bench import Ask, Commands, open_pair, part_of_pair
from hil.bench.timing import read_cyclictest, start_cyclictest
from hil.runtime.clock import monotonic_ns
from hil.runtime.real import go_real_time
from hil.runtime.real.child import python_module
from transport.links.python_can import can

BUSES: Final = ("hil", "hil, bitrate and no time", "hil, 1 Mbit/s in time", "socketcan", "udp_multicast", "virtual")
PRIORITY: Final = 60
FLOOD: Final = 500
TRIPS: Final = 200
PERIOD_US: Final = 1000
_PATIENCE_S: Final = 1.0
_TRIES: Final = 10
_QUESTION, _ANSWER, _END, _COUNT, _FRAME = 0x010, 0x011, 0x020, 0x021, 0x123
_DATA: Final = bytes.fromhex("1122334455667788")  # 112 bits with its identifier: 8929 frames a second at 1 Mbit/s

Row = dict[str, Any]


def bench_can_buses(
    duration_s: float = 10.0, *, buses: Sequence[str] = BUSES, progress: Callable[[str], None] = lambda text: None
) -> list[Row]:  # fmt: skip
    """Measure all buses in turns.

    Args:
        duration_s: about how long all of it takes, s.
        buses: names, see `BUSES`.
        progress: called with the name of what is running.

    Returns:
        One row per bus: `bus`, `frames_s` (sent and received), `times_off` (ratio to `hil`), `p50_us`, `p99_us` of round trips,
        `trip_times_off`, `late_p50_us` and `late_p99_us` (the error of frame times; None where frames take no time),
        `cyclictest_p99_us` and `late_of_cyclictest` (ratio of the two p99; None without cyclictest), `lost` and `note`.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hil-bench-")))
        pairs = {bus: open_pair(stack, _pair(bus)) for bus in buses}
        output, beside = folder / "cyclictest.json", None
        if shutil.which("cyclictest") is not None:
            beside = start_cyclictest(PRIORITY, PERIOD_US, duration_s, output)
        floods: dict[str, list[tuple[int, int]]] = {bus: [] for bus in buses}
        trips: dict[str, list[int]] = {bus: [] for bus in buses}
        late: dict[str, list[int]] = {bus: [] for bus in buses}
        before = dict.fromkeys(buses, 0)
        end, turn = monotonic_ns() + round(duration_s * 1e9), 0
        while turn < 2 or monotonic_ns() < end:
            progress(f"turn {turn}")
            for bus, ask in pairs.items():
                if isinstance(ask, str):
                    continue
                try:
                    found, ns = ask(f"flood {FLOOD}")
                    answers = ask(f"trips {TRIPS}")
                except (OSError, ValueError) as error:
                    pairs[bus] = f"ended in mid-run: {error}"
                    continue
                if turn:  # the first turn warms up
                    floods[bus].append((max(found - before[bus], 0), ns))
                    trips[bus] += answers[:TRIPS]
                    late[bus] += answers[TRIPS:]
                before[bus] = found
            turn += 1
        cyclic = math.nan
        if beside is not None:
            beside.communicate()
            cyclic = float(np.percentile(read_cyclictest(output, PERIOD_US)[0], 99))
    rows = [_row(bus, floods[bus], trips[bus], late[bus], cyclic, pairs[bus]) for bus in buses]
    for row in rows:
        row["times_off"] = row["frames_s"] / rows[0]["frames_s"]
        row["trip_times_off"] = row["p50_us"] / rows[0]["p50_us"]
    return rows


def _row(bus: str, floods: list[tuple[int, int]], trips: list[int], late: list[int], cyclic: float, pair: Ask | str) -> Row:
    came = [trip / 1e3 for trip in trips if trip >= 0]
    p50, p99 = (float(np.percentile(came, q)) if came else math.nan for q in (50, 99))
    errors = [float(np.percentile(late, q)) / 1e3 if late else None for q in (50, 99)]
    ns = sum(each for _, each in floods)
    return {
        "bus": bus, "frames_s": sum(found for found, _ in floods) * 1e9 / ns if ns else math.nan, "times_off": math.nan,
        "p50_us": p50, "p99_us": p99, "trip_times_off": math.nan, "late_p50_us": errors[0], "late_p99_us": errors[1],
        "cyclictest_p99_us": cyclic if late and not math.isnan(cyclic) else None,
        "late_of_cyclictest": errors[1] / cyclic if errors[1] is not None and cyclic > 0 else None,
        "lost": len(trips) - len(came) + len(floods) * FLOOD - sum(found for found, _ in floods),
        "note": pair if isinstance(pair, str) else "",
    }  # fmt: skip


def _pair(bus: str) -> Callable[[], Commands]:
    command, channel = python_module("hil.bench.can_buses"), f"bench-{os.getpid()}-{abs(hash(bus)) % 1000}"
    return lambda: ([*command, "echo", bus, channel], [*command, "drive", bus, channel])


# What follows runs in the processes of a pair.


def _join(bus: str, channel: str) -> can.BusABC:
    options: dict[str, Any] = {"interface": bus.partition(",")[0], "channel": channel, "ignore_config": True}
    if "in time" in bus:
        options |= {"timed": True, "bitrate": 1_000_000}
    elif "no time" in bus:
        options |= {"bitrate": 1_000_000}
    elif bus == "socketcan":
        options["channel"] = "vcan0"
    elif bus == "udp_multicast":
        options |= {"channel": "239.74.163.2", "port": 20_000 + os.getppid() % 20_000, "hop_limit": 0}
    return can.Bus(**options)


def _echo(bus: can.BusABC) -> None:
    """Answer questions, and count frames."""
    count = 0
    while True:
        frame = bus.recv(1.0)
        if frame is None or frame.is_error_frame:
            continue
        if frame.arbitration_id == _FRAME:
            count += 1
        elif frame.arbitration_id == _QUESTION:
            _send(bus, _ANSWER, bytes(frame.data))
        elif frame.arbitration_id == _END:
            _send(bus, _COUNT, count.to_bytes(4, "little"))


def _send(bus: can.BusABC, identifier: int, data: bytes) -> None:
    bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data), timeout=_PATIENCE_S)


def _answer(bus: can.BusABC, identifier: int, patience_s: float = _PATIENCE_S) -> can.Message | None:
    end = monotonic_ns() + round(patience_s * 1e9)
    while (left := end - monotonic_ns()) > 0:
        frame = bus.recv(left / 1e9)
        if frame is not None and frame.arbitration_id == identifier and not frame.is_error_frame:
            return frame
    return None


def _flood(bus: can.BusABC, count: int) -> list[int]:
    """Return how many frames came since the other end began, and how long these took, ns."""
    begin = monotonic_ns()
    for _ in range(count):
        _send(bus, _FRAME, _DATA)
    for _ in range(_TRIES):  # a bus that loses frames may lose this one
        _send(bus, _END, b"")
        reply = _answer(bus, _COUNT, _PATIENCE_S / _TRIES)
        if reply is not None:
            return [int.from_bytes(reply.data, "little"), monotonic_ns() - begin]
    return [0, monotonic_ns() - begin]


def _trips(bus: can.BusABC, count: int, *, timed: bool) -> list[int]:
    """Return the ns of every round trip, -1 for one that did not come; then, where timed, how late each answer was, ns."""
    taken, late = [], []
    for n in range(count):
        begin = monotonic_ns()
        _send(bus, _QUESTION, n.to_bytes(8, "little"))
        reply = _answer(bus, _ANSWER)
        taken.append(-1 if reply is None else monotonic_ns() - begin)
        if timed and reply is not None:
            late.append(round((time() - reply.timestamp) * 1e9))
    return taken + late


def main() -> None:
    """Be one of the processes of a pair."""
    role, name, channel = sys.argv[1:4]
    with part_of_pair(can.CanError, OSError, NotImplementedError):  # the last: no such interface
        go_real_time(PRIORITY - (role == "echo"), None, awake=True)
        with _join(name, channel) as bus, ExitStack() as stack:
            if role == "echo" and name != "virtual":
                print("ready", flush=True)  # noqa: T201 (this is the process's interface)
                _echo(bus)
            if name == "virtual" and role == "drive":
                other = stack.enter_context(_join(name, channel))
                threading.Thread(target=_echo, args=(other,), daemon=True).start()
            print("ready", flush=True)  # noqa: T201
            for line in sys.stdin:
                what, number = line.split()
                found = _flood(bus, int(number)) if what == "flood" else _trips(bus, int(number), timed="in time" in name)
                print(*found, flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
