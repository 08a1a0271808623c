"""Every boundary at which foreign text or bytes come in: one message, no traceback, no hang.

Two kinds of inputs: what hypothesis draws, of the right form with the wrong contents; and real files with a few places damaged,
hundreds of them from each seed that it draws. The same attacks run twice: a few with the other tests, a million with
``make test-hostile``, which prints how many were read and refused.
"""

from __future__ import annotations

import io
import json
import signal
import struct
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import click
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode

from design.tracking.design_file import load_design
from hil.cli.terminal import message_lines
from hil.errors import HilError
from hil.experiment import Seconds, load_experiment, parse_experiment, shipped
from hil.log.read.mcap_walk import walk
from hil.log.read.recover import recover
from hil.pages.html.payload import Payload
from hil.sweeps import SweepStore
from tests.hostile.boundaries import BOUNDARIES, BUS, DESIGN, PACKETS, bus_log, units
from tests.hostile.logs import foreign_log, motor, use_log, words, write_log
from tests.hostile.mutation import mutated
from tests.hostile.structured import damaged, edited, leaf, value
from tests.hostile.tally import Note, Tally
from tests.hostile.watchdog import Hangs, within
from transport.laws.latency import latency
from transport.laws.trace import read_ages

FEW = 30
PARTS = 4
"""Tests that share the inputs of a boundary, so that several processes do."""

BATCH = 100
"""Damaged inputs from each seed that hypothesis draws."""

# What hypothesis draws


def attack_log_words(place: Path, drawn: Any) -> None:
    drawn = {**words(), **drawn}
    write_log(place / "x.mcap", {**drawn, "events": drawn["events"] if isinstance(drawn["events"], list) else []})
    use_log(place / "x.mcap")


def attack_design(place: Path, document: Any) -> None:
    (place / "d.json").write_text(json.dumps(document))
    load_design(place / "d.json")


def attack_sweep(place: Path, line: str) -> None:
    (place / "s").unlink(missing_ok=True)
    for text in ("", line + "\n"):
        with open(place / "s", "a", errors="replace") as file:
            file.write(text)
        with SweepStore(place / "s", motor(), ("sse",)):
            pass


def attack_trace(place: Path, text: str) -> None:
    (place / "t.csv").write_text(text, errors="replace")
    read_ages(place / "t.csv")


FIELDS = ["plant.gain", "seed", "reference", "network.sc.law", "x.y", ""]
ROW = {"seed": 3, "sse": 1.0}
CALLED = (HilError, ValueError)  # see `boundaries.CALLED`
Drawn = tuple[int, Callable[[], st.SearchStrategy[Any]], Callable[[Path, Any], object], tuple[type[Exception], ...]]
DRAWN: dict[str, Drawn] = {
    "experiment text": (2_000, lambda: edited(shipped()["dc-motor-hinf"].read_text()),
                        lambda place, text: parse_experiment(text, folder=str(place)), (HilError,)),
    "set value": (1_000, lambda: st.tuples(st.sampled_from(FIELDS), value),
                  lambda place, pair: load_experiment("dc-motor-hinf", [f"{pair[0]}={pair[1]}"]), (HilError,)),
    "seconds": (5_000, lambda: st.one_of(leaf, st.text(max_size=30)), lambda place, given: Seconds.parse(given), CALLED),
    "design tree": (3_000, lambda: damaged(json.loads(DESIGN.read_text())), attack_design, CALLED),
    "sweep row": (5_000, lambda: damaged(ROW).map(json.dumps) | edited(json.dumps(ROW)), attack_sweep, (HilError,)),
    "trace text": (5_000, lambda: edited("age\n0\n1\n2\n0\n"), attack_trace, CALLED),
    "log words": (1_500, lambda: damaged(words()), attack_log_words, (HilError,)),
    "message text": (10_000, st.text, lambda place, text: message_lines(text), ()),
}  # fmt: skip
"""How many with `make test-hostile`, what is drawn, what takes it, and what may be raised."""

ANYTHING = settings(deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck))


def draw(name: str, count: int, note: Note) -> None:
    _, strategy, attack, refusals = DRAWN[name]
    tally = Tally(name, refusals)
    with tempfile.TemporaryDirectory(prefix="hil-fuzz-") as folder:

        @settings(ANYTHING, max_examples=count)
        @given(strategy())
        def run(data: Any) -> None:
            tally.attack(lambda: attack(Path(folder), data), data)

        run()
    tally.end(note)


@pytest.mark.parametrize("name", DRAWN)
def test_what_another_program_writes_is_read_or_refused_with_one_message(name: str, record_property: Note) -> None:
    draw(name, FEW, record_property)


@pytest.mark.hostile
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name", DRAWN)
def test_thousands_drawn_are_read_or_refused_with_one_message(name: str, record_property: Note) -> None:
    draw(name, DRAWN[name][0], record_property)


# Real files, damaged


def damage(name: str, count: int, part: int, note: Note, batch: int = BATCH) -> None:
    boundary = BOUNDARIES[name]
    tally, real = Tally(name, boundary.refusals), boundary.real()
    with tempfile.TemporaryDirectory(prefix="hil-fuzz-") as folder:

        @settings(ANYTHING, max_examples=count // batch)
        @given(st.integers(0, 2**64 - 1), st.integers(1, 6))
        def run(seed: int, most: int) -> None:
            for i in range(batch):
                rng = Random(f"{name} {part} {seed} {i}")
                data = mutated(rng, rng.choice(real), boundary.edits, rng.randint(1, most))
                tally.attack(lambda: boundary.attack(Path(folder), data), data)  # noqa: B023 (called at once)

        run()
    assert tally.read + tally.refused <= count
    tally.end(note)


@pytest.mark.parametrize("name", BOUNDARIES)
def test_what_is_real_is_read_and_what_is_damaged_refused_with_one_message(
    name: str, tmp_path: Path, record_property: Note
) -> None:  # fmt: skip
    for data in BOUNDARIES[name].real():
        assert BOUNDARIES[name].attack(tmp_path, data)
    few = FEW // 10 if name == "mat" else FEW  # each of these files is read by a process of its own
    damage(name, few, PARTS, record_property, batch=few // 3)


@pytest.mark.hostile
@pytest.mark.timeout(0)
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("name", BOUNDARIES)
def test_a_million_inputs_are_read_or_refused_with_one_message(name: str, part: int, record_property: Note) -> None:
    damage(name, BOUNDARIES[name].count // PARTS, part, record_property)


def test_it_is_a_million_inputs() -> None:
    assert sum(boundary.count for boundary in BOUNDARIES.values()) >= 1_000_000
    assert all(boundary.count % (PARTS * BATCH) == 0 for boundary in BOUNDARIES.values())


# What was found, and the fuzz itself


def blf(*contents: bytes) -> bytes:
    head = BOUNDARIES["blf"].real()[0][:144]
    return head + b"".join(
        struct.pack("<4sHHIIH6xL4x", b"LOBJ", 16, 1, 32 + len(each), 10, 2, 0) + each + bytes(len(each) % 4) for each in contents
    )


def mat(kind: int, rows: int, columns: int) -> bytes:
    return struct.pack("<5I", kind, rows, columns, 0, 2) + b"A\0" + bytes(8 * rows * columns)


NO_LENGTH = zlib.compress(struct.pack("<4sHHII", b"LOBJ", 16, 3, 0, 1) + bytes(64))
"""An object of no length: python-can reads it for ever."""

FOUND: dict[str, tuple[str, Callable[[], bytes]]] = {
    "a whole number beyond all others": ("number list", lambda: b"9" * 400),
    "a header of an array that goes on": ("npy", lambda: b"\x93NUMPY\x01\x00\x10\x00" + b"{'descr': ('<f8',\n" + bytes(8)),
    "numbers in the byte order of a Cray": ("mat", lambda: mat(4000, 2, 2)),
    "millions of rows without a number": ("mat", lambda: mat(0, 16_777_218, 0)),
    "a container that is no zlib": ("blf", lambda: blf(b"x" * 40)),
    "an object of no length": ("blf", lambda: blf(NO_LENGTH)),
    "a container that unpacks to gigabytes": ("blf", lambda: blf(zlib.compress(bytes(20_000_000)))),
    "objects whose end never comes": ("blf", lambda: blf(zlib.compress(struct.pack("<4sHHII", b"LOBJ", 16, 1, 1 << 30, 1)))),
    "a unit packed by a damaged LZMA": ("FMU", lambda: units()[3].replace(b"\x5d\x00\x00", b"\xff\x00\x00")),
    "a unit of a later zip": ("FMU", lambda: units()[1].replace(b"PK\x01\x02\x14\x03\x14", b"PK\x01\x02\x14\x03\x98")),
    "an attribute of a DBC of another type": ("DBC", lambda: BUS.replace(b"INT 0 65535", b"IN5535")),
    "a table of traffic in one field": ("traffic", lambda: b'can_id,period\n"' + b"x" * 200_000),
    "a script that is no text": ("script of a live run", lambda: b'{"slot": 4, "field": "\x98"}'),
    "frames at no instant": ("pair of CAN logs", lambda: bus_log().replace(b"(1000000299.", b"(" + b"9" * 400 + b".")),
    "packets at the end of time": ("packets", lambda: PACKETS[1].replace(b"\n299,", b"\n1e308,").replace(b"\n0,", b"\n-1e308,")),
    "a line without end": ("candump", lambda: b"(1.0) can0 100#" + b"0" * 10_000),
}
"""Inputs that the fuzz found, with the boundary at which each was a traceback, a hang or much memory."""


@pytest.mark.parametrize("what", FOUND)
def test_what_the_fuzz_found_stays_refused(tmp_path: Path, what: str) -> None:
    name, data = FOUND[what]
    with pytest.raises(BOUNDARIES[name].refusals), within(), np.errstate(all="raise"):
        BOUNDARIES[name].attack(tmp_path, data())


@pytest.mark.parametrize("shape", [10**400, -(10**400), 1e301, float("inf"), float("nan")])
def test_a_latency_of_a_shape_beyond_all_numbers_is_refused(shape: float) -> None:
    with pytest.raises(ValueError), np.errstate(all="raise"):
        latency({"dist": "gamma", "a": shape, "scale": 1e-3})


def test_a_log_of_the_last_instants_of_all_is_recovered(tmp_path: Path) -> None:
    data = bytearray(foreign_log(chunked=False))
    message = next(each for each in walk(io.BytesIO(data), len(data)) if each.opcode == Opcode.MESSAGE)
    data[message.offset + 15 : message.offset + 23] = (2**64 - 5).to_bytes(8, "little")
    (tmp_path / "x.mcap").write_bytes(data)
    recover(tmp_path / "x.mcap", tmp_path / "y.mcap")


def test_numbers_beyond_single_precision_are_drawn_as_they_are() -> None:
    with np.errstate(all="raise"):
        payload = Payload()
        payload.add(np.array([0.0, 1e300, np.nan]))


def test_an_event_at_no_instant_is_refused(tmp_path: Path) -> None:
    with pytest.raises(HilError), within():
        attack_log_words(tmp_path, {"events": [{**words()["events"][0], "t_s": 10**400}]})


def test_a_hang_is_seen_by_its_work_and_by_its_waiting() -> None:
    with pytest.raises(Hangs, match="of work"), within(0.02):
        while True:
            pass
    with pytest.raises(Hangs, match="waits"), within(5.0, 0.02):
        signal.pause()


def test_a_traceback_a_long_message_and_much_memory_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.hostile.tally.MOST_MB", 40)
    noted: dict[str, object] = {}

    def too_long() -> None:
        raise HilError("x" * 2 + "\n" * 5000)

    def late() -> None:
        raise Hangs

    for attempt, said in ((lambda: 1 / 0, "ZeroDivisionError"), (late, "Hangs"), (lambda: np.ones(40_000_000), "MB for inputs")):
        tally = Tally("x", (click.UsageError,))
        tally.attack(attempt, b"data")
        with pytest.raises(AssertionError, match=said):
            tally.end(noted.__setitem__)
    tally = Tally("x", (HilError,))
    tally.attack(too_long, b"data")
    tally.attack(lambda: True, b"data")
    tally.end(noted.__setitem__)  # whatever an error says, message_lines cuts it
    assert noted == {"boundary": "x", "read": 1, "refused": 1}


def test_damage_is_the_same_for_the_same_seed_and_leaves_few_inputs_as_they_were() -> None:
    for boundary in BOUNDARIES.values():
        real = boundary.real()[0]
        once, again = ([mutated(Random(f"{i}"), real, boundary.edits, 2) for i in range(50)] for _ in range(2))
        assert once == again and len(set(once)) > 35 and once.count(real) < 10
