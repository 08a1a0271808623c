"""Every boundary at which a stranger's text or bytes come in: one message, no traceback, no hang.

The same attacks run twice: a few dozen inputs with the other tests, a million with ``make test-hostile``.
"""

from __future__ import annotations

import json
import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from design.tracking.design_file import load_design
from hil.cli.terminal import LONGEST, message_lines
from hil.errors import HilError
from hil.experiment import Seconds, load_experiment, parse_experiment, shipped
from hil.log.read.export import export
from hil.log.read.recover import recover
from hil.log.read.run import read_run
from hil.log.write.mcap_sink import McapSink
from hil.measure.summary import summarise
from hil.measure.view import view_of
from hil.replay import verify
from hil.report.run.run_page import render_report
from hil.sweeps.store import SweepStore
from tests.hil.log.recording import TABLE, provenance, record
from transport.laws.trace import read_ages

FEW, MANY = 60, 112_000
"""Inputs for each of nine boundaries: a million in all."""

GOOD = shipped()["dc-motor-hinf"].read_text()
DESIGN = json.loads((shipped()["dc-motor-ours-bursty"].parent / "designs" / "dc-motor-bursty-h2-sojourns.json").read_text())

leaf = st.one_of(
    st.none(), st.booleans(), st.integers(), st.integers(-(10**400), 10**400), st.floats(), st.text(max_size=20),
    st.sampled_from(["nan s", "1e400 s", "\x1b[2J", "[/]", "inf", "-0.0"]),
)  # fmt: skip
value = st.recursive(
    leaf, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3), max_leaves=5
)


@st.composite
def damaged(draw: st.DrawFn, tree: Any) -> Any:
    """A JSON tree with one to three of its nodes replaced or removed."""
    tree = json.loads(json.dumps(tree))
    for _ in range(draw(st.integers(1, 3))):
        node = tree
        while isinstance(node, dict | list) and node:
            key = draw(st.sampled_from(sorted(node) if isinstance(node, dict) else range(min(len(node), 4))))
            if not isinstance(node[key], dict | list) or not node[key] or draw(st.integers(0, 3)) == 0:
                if isinstance(node, dict) and draw(st.booleans()):
                    del node[key]
                else:
                    node[key] = draw(value)
                break
            node = node[key]
    return tree


@st.composite
def edited(draw: st.DrawFn, text: str) -> str:
    """A text with a few pieces cut, doubled or replaced."""
    pieces = [*"=[]{}\"'\n.#\\", "9" * 4400, "1e400", "nan", '"""', "\x1b[2J", "a." * 40, "[" * 40, "inf", "-1", "\0", "é"]
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(text)))
        text = text[:at] + draw(st.sampled_from(pieces)) + text[at + draw(st.integers(0, 12)) :]
    return text


@st.composite
def flipped(draw: st.DrawFn, data: bytes) -> bytes:
    """Bytes with a few of them others, cut, or zeroed."""
    out = bytearray(data)
    for _ in range(draw(st.integers(1, 5))):
        at = draw(st.integers(0, len(out) - 1))
        out[at : at + draw(st.integers(1, 9))] = draw(st.binary(min_size=1, max_size=9))
    return bytes(out[: draw(st.integers(0, len(out)))] if draw(st.integers(0, 3)) == 0 else out)


@contextmanager
def within(work_s: float = 5.0, waiting_s: float = 120.0) -> Iterator[None]:
    """Fail where the work hangs: after so many seconds of CPU time, or where it waits for ever.

    The first is hundreds of times what the work takes, however busy the machine is.
    """

    def late(number: int, _frame: object) -> None:
        raise AssertionError(f"hangs: not done in {work_s} s of work" if number == signal.SIGPROF else "waits for ever")

    before = {number: signal.signal(number, late) for number in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(signal.ITIMER_PROF, work_s)
    signal.setitimer(signal.ITIMER_REAL, waiting_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


def test_a_hang_is_seen_by_its_work_and_by_its_waiting() -> None:
    with pytest.raises(AssertionError, match="hangs"), within(0.02):
        while True:
            pass
    with pytest.raises(AssertionError, match="waits"), within(5.0, 0.02):
        signal.pause()


def write_log(path: Path, words: dict[str, Any]) -> None:
    about = provenance(resolved=words["resolved"], certificate=words["certificate"])
    with McapSink(path, TABLE, about) as sink:
        record(sink, 5)
        for event in words["events"]:
            put = sink.channel("/events")
            assert put is not None
            put(0, json.dumps(event).encode())
        sink.summary(words["summary"] if isinstance(words["summary"], dict) else {"problems": words["summary"]})


def use_log(path: Path) -> None:
    run = read_run(path)
    view = view_of(run)
    render_report(view, {**summarise(view), **{k: v for k, v in run.summary.items() if k in ("problems", "log")}})
    export(run, path.with_suffix(".csv"), replace=True)
    verify(run)


MOTOR = load_experiment("dc-motor-hinf")
WORDS = {
    "resolved": MOTOR.resolved(),
    "certificate": {"state": "certified", "kind": "mean-square stability", "reason": "radius below 1", "radius": 0.9},
    "events": [{"tick": 0, "t_s": 0.0, "kind": "safety", "severity": "error", "message": "limit", "data": {"scheduler": "x"}}],
    "summary": {"problems": {"x": "y"}},
}


def attack_log_words(place: Path, words: Any) -> None:
    words = {**WORDS, **words}
    write_log(place / "x.mcap", {**words, "events": words["events"] if isinstance(words["events"], list) else []})
    use_log(place / "x.mcap")


def attack_log_bytes(place: Path, data: bytes) -> None:
    (place / "x.mcap").write_bytes(data)
    (place / "y.mcap").unlink(missing_ok=True)
    try:
        use_log(place / "x.mcap")
    finally:
        recover(place / "x.mcap", place / "y.mcap")


def attack_design(place: Path, document: Any) -> None:
    (place / "d.json").write_text(json.dumps(document))
    load_design(place / "d.json")


def attack_sweep(place: Path, line: str) -> None:
    (place / "s").unlink(missing_ok=True)
    with SweepStore(place / "s", MOTOR, ("sse",)):
        pass
    with open(place / "s", "a", errors="replace") as file:
        file.write(line + "\n")
    with SweepStore(place / "s", MOTOR, ("sse",)):
        pass


def attack_trace(place: Path, text: str) -> None:
    (place / "t.csv").write_text(text, errors="replace")
    read_ages(place / "t.csv")


def log_bytes() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        write_log(Path(folder) / "x.mcap", WORDS)
        return (Path(folder) / "x.mcap").read_bytes()


ATTACKS: dict[str, tuple[st.SearchStrategy[Any], Callable[[Path, Any], object]]] = {
    "experiment": (edited(GOOD), lambda place, text: parse_experiment(text, folder=str(place))),
    "set": (st.tuples(st.sampled_from(["plant.gain", "seed", "reference", "links.sc.law", "x.y", ""]), value),
            lambda place, pair: load_experiment("dc-motor-hinf", [f"{pair[0]}={pair[1]}"])),
    "seconds": (st.one_of(leaf, st.text(max_size=30)), lambda place, given: Seconds.parse(given)),
    "design": (damaged(DESIGN), attack_design),
    "sweep row": (damaged({"seed": 3, "sse": 1.0}).map(json.dumps) | edited('{"seed": 3, "sse": 1.0}'), attack_sweep),
    "trace": (edited("age\n0\n1\n2\n0\n"), attack_trace),
    "log words": (damaged(WORDS), attack_log_words),
    "log bytes": (flipped(log_bytes()), attack_log_bytes),
    "message": (st.text(), lambda place, text: message_lines(text)),
}  # fmt: skip


def fuzz(name: str, count: int) -> None:
    strategy, attack = ATTACKS[name]

    @settings(max_examples=count, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(strategy)
    def run(data: Any) -> None:
        with tempfile.TemporaryDirectory(prefix="hil-fuzz-") as folder, within():
            try:
                attack(Path(folder), data)
            except (HilError, ValueError) as error:
                # ValueError is what design and transport promise of a file; hil makes it a HilError with the field's path.
                assert isinstance(error, HilError) or name in ("design", "trace", "seconds"), repr(error)
                assert sum(len(line.encode()) + 6 for line in message_lines(str(error))) <= LONGEST

    run()


@pytest.mark.parametrize("name", ATTACKS)
def test_what_a_stranger_writes_is_read_or_refused_with_one_message(name: str) -> None:
    fuzz(name, FEW)


FOUND: list[tuple[str, Any]] = [
    ("log words", {"events": [{**WORDS["events"][0], "t_s": 10**400}]}),  # type: ignore[index]
]
"""Inputs that the fuzz found, with the boundary at which each was a traceback."""


@pytest.mark.parametrize("name, data", FOUND)
def test_what_the_fuzz_found_stays_refused(tmp_path: Path, name: str, data: Any) -> None:
    with pytest.raises(HilError), within():
        ATTACKS[name][1](tmp_path, data)


@pytest.mark.hostile
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name", ATTACKS)
def test_a_million_inputs_are_read_or_refused_with_one_message(name: str) -> None:
    fuzz(name, MANY)
