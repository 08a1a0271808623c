"""Figures of a log in virtual time: time and bytes of a slot, memory of a million, and of what reads and mends them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from hil.errors import HilError
from tests.bench.engines import bench_log, bench_memory
from tests.bench.figure import FLAT, AtMost, Figure, Found, Measure, Part, Tell
from tests.bench.other_code import BEFORE, OLD, beside
from tests.bench.processes import HIL, Spent, spent
from tests.bench.slot_turns import least_us

MOTOR = "dc-motor-hinf"
PLAIN = "mcap's own writer"
THEN = f"commit {OLD}, interpreted, alternately"

SLOT = Figure(
    name="virtual slot with its log, CPU time", unit="us", peer=PLAIN, goal=AtMost(ratio=0.48), condition=AtMost(ratio=60 / 104)
)
BARE = Figure(name="virtual slot without a log, CPU time", unit="us", peer="with a log")
DIFFERENT = Figure(name="log files that differ from the mcap package's output", unit="", peer="files", condition=AtMost(ours=0.0))
FULL = Figure(name="log per slot, --index full (the default)", unit="bytes", peer="--index chunk")
CHUNK = Figure(name="log per slot, --index chunk", unit="bytes", peer="--index full")
HELD = Figure(name="held per further slot while a log is written", unit="bytes", peer=PLAIN)

SOME, MANY = 100_000, 1_000_000
RUN_SOME = Figure(name="hil run of 10^5 slots, peak memory", unit="MB", peer="1 slot")
RUN_MANY = Figure(
    name="hil run of 10^6 slots, peak memory", unit="MB", peer="10^5 slots", condition=FLAT
)
SLOPE = Figure(name="hil run, memory per slot from 10^5 to 10^6", unit="bytes", peer="from 1 to 10^5")
RUN_TIME = Figure(name="hil run, CPU time per slot of 10^6", unit="us", peer="of 10^5")
READERS = {
    "report": ("report", "-o", "page.html"),
    "replay --verify": ("replay", "--verify"),
    "export": ("export", "--force", "-o", "tables.npz"),
    "recover": ("recover", "-o", "mended.mcap"),
}
RECOVER_TIME = Figure(
    name="hil recover of 10^6 slots, CPU time", unit="s", peer="hil run, which wrote them", goal=AtMost(ratio=1.0)
)


AS_BEFORE = Figure(name="virtual slot with its log, CPU time, beside 3aeb887", unit="us", peer=THEN, goal=AtMost(ratio=0.55))
BARE_AS_BEFORE = Figure(
    name="virtual slot without a log, CPU time, beside 3aeb887", unit="us", peer=THEN, goal=AtMost(ratio=0.5)
)


def _of_reader(name: str) -> str:
    return f"hil {name} of 10^6 slots, peak memory"


def _slot(tell: Tell, quick: bool) -> Iterator[Found]:
    (row,) = bench_log(tell, slots=100 if quick else 5000, turns=1 if quick else 5)
    yield Found(SLOT.name, row["us"], row["mcap's writer us"])
    yield Found(BARE.name, row["without log us"], row["us"])
    yield Found(DIFFERENT.name, float(not row["same bytes"]), 1.0)
    yield Found(FULL.name, row["bytes"], row["bytes, --index chunk"])
    yield Found(CHUNK.name, row["bytes, --index chunk"], row["bytes"])


def _before(tell: Tell, quick: bool) -> Iterator[Found]:
    folder = os.environ.get(BEFORE)
    if folder is None:
        raise HilError(f"no sources of {OLD} were given: --before FOLDER")
    turns, slots = (1, 100) if quick else (60, 2000)
    tell(f"virtual slot, of {OLD} and of today: {turns} turns")
    versions = {"then": ("hil.bench.engines", beside(Path(folder))), "ours": ("tests.bench.engines", {})}
    least = least_us(versions, slots=slots, turns=turns)
    note = f"least of {turns} turns of {slots} slots"
    for figure, ours, then in zip((AS_BEFORE, BARE_AS_BEFORE), least["ours"], least["then"]):
        yield Found(figure.name, ours, then, note)


def _held(tell: Tell, quick: bool) -> Iterator[Found]:
    (row,) = bench_memory(tell, slots=(20, 140) if quick else (4_000, 12_000))
    yield Found(HELD.name, row["bytes per slot"], row["mcap's writer"], "as Python counts it, without numpy's pages of files")


def _lengths(tell: Tell, quick: bool) -> Iterator[Found]:
    some, many = (20, 400) if quick else (SOME, MANY)
    with tempfile.TemporaryDirectory(prefix="hilrig-bench-") as folder:
        one, full = (_run(tell, slots, Path(folder)) for slots in (1, many))
        few = one if quick else _run(tell, some, Path(folder))
        yield Found(RUN_SOME.name, few.peak_mb, one.peak_mb)
        yield Found(RUN_MANY.name, full.peak_mb, few.peak_mb)
        slopes = (full.peak_mb - few.peak_mb) / (many - some), (few.peak_mb - one.peak_mb) / (some - 1)
        yield Found(SLOPE.name, slopes[0] * 1e6, slopes[1] * 1e6)
        each = full.cpu_s / many * 1e6, few.cpu_s / some * 1e6
        yield Found(RUN_TIME.name, *each, "start of the process included")
        for name, command in READERS.items():
            ours = _read(tell, name, command, Path(folder), many)
            peer = ours if quick else _read(tell, name, command, Path(folder), some)
            yield Found(_of_reader(name), ours.peak_mb, peer.peak_mb, f"{ours.cpu_s:.3g} s of CPU time")
            if name == "recover":
                yield Found(RECOVER_TIME.name, ours.cpu_s, full.cpu_s, "a log cut off before its end")


def _run(tell: Tell, slots: int, folder: Path) -> Spent:
    tell(f"hil run of {slots} slots")
    log = str(folder / f"{slots}.mcap")
    return spent([*HIL, "run", MOTOR, "--duration", repr(slots * 0.05), "--index", "chunk", "-o", log, "--quiet"])


def _read(tell: Tell, name: str, command: tuple[str, ...], folder: Path, slots: int) -> Spent:
    tell(f"hil {name} of {slots} slots")
    log = folder / f"{slots}.mcap"
    if name == "recover":  # the last: what it gets was cut off in its last chunk
        os.truncate(log, log.stat().st_size * 99 // 100)
    for made in ("page.html", "mended.mcap"):
        (folder / made).unlink(missing_ok=True)
    options = [str(folder / word) if "." in word else word for word in command[1:]]
    return spent([*HIL, command[0], str(log), *options])


PART = Part("logs", "a log in virtual time: a slot of it, a million slots, what reads and mends them", 480.0, (
    Measure((SLOT, BARE, DIFFERENT, FULL, CHUNK), _slot, loops=True),
    Measure((AS_BEFORE, BARE_AS_BEFORE), _before, loops=True),
    Measure((HELD,), _held),
    Measure((
        RUN_SOME, RUN_MANY, SLOPE, RUN_TIME,
        *(Figure(name=_of_reader(name), unit="MB", peer="10^5 slots", condition=FLAT) for name in READERS),
        RECOVER_TIME,
    ), _lengths),
))  # fmt: skip
