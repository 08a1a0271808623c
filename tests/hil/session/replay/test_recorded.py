"""What a log recorded of the link: found slot by slot, in order or not, in its own code or named, and asked over a link again."""

from __future__ import annotations

import re
import tracemalloc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.run import Run
from hil.log.topics import CONTROL, SENSOR
from hil.runtime.nodes import Wire, session_wire
from hil.runtime.virtual import simulate_as_logged
from hil.session.replay import near_values, over_link
from hil.session.replay import recorded as replay_recorded
from hil.session.replay.over_link import ask_process
from hil.session.replay.recorded import RecordedAnswers, Tags, changes_of, recorded_wire, verify_tags
from hil.session.replay.replay import experiment_of, verify, what_if
from transport.links import TransportError
from transport.links.authentication import cmac
from transport.packets import EMPTY, ControlPacket, SensorPacket, encode_control, encode_sensor
from transport.wire import with_tag


def answers(slots: Sequence[int], late: Sequence[int] = ()) -> Run:
    found = np.empty(len(slots), [("t_ns", "<i8"), ("slot", "<i8"), ("late", "u1"), ("data", object)])
    found["slot"], found["late"] = slots, np.isin(np.arange(len(slots)), late)
    found["data"] = [b"%d at %d" % (k, i) for i, k in enumerate(slots)]
    return Run(arrays={"/link/control": found}, schemas={})


@pytest.mark.parametrize("slots", [[*range(5000)], [0, 1, 1, 4, 4, 9], [3, 1, 2, 2, 0, 7], []])
def test_the_last_answer_of_a_slot_that_came_in_time_is_received(slots: list[int]) -> None:
    late = [i for i in range(len(slots)) if i % 3 == 1]
    kept = {k: b"%d at %d" % (k, i) for i, k in enumerate(slots) if i not in late}
    received = RecordedAnswers(answers(slots, late))
    for end in (0, 2, 4, 4097, 10_000):
        assert received.answered(end) == sum(k < end for k in kept)
    assert [received.get(k) for k in range(5001)] == [kept.get(k) for k in range(5001)]


def test_answers_out_of_order_are_sorted_up_to_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_recorded, "MOST_SORTED", 100)
    assert RecordedAnswers(answers([*range(1, 100), 0])).get(0) == b"0 at 99"
    assert RecordedAnswers(answers(range(5000))).answered(5000) == 5000  # in order: no limit
    assert RecordedAnswers(answers(range(-7, 200))).get(-7) == b"-7 at 0"  # so it is below slot 0
    with pytest.raises(HilError, match="/link/control: 101 packets that are out of order; hil sorts 100 at most"):
        RecordedAnswers(answers([*range(1, 101), 0]))


def test_asking_holds_no_more_for_a_longer_log() -> None:
    runs, held = [answers(range(n)) for n in (10_000, 40_000)], []
    for run in runs:
        tracemalloc.start()
        received = RecordedAnswers(run)
        assert received.answered(1 << 40) == len(run.arrays["/link/control"])
        held.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert held[1] - held[0] < 30_000  # a byte per slot; a column of slots has eight


@pytest.mark.parametrize("order", ["forwards", "backwards"])
def test_the_nonce_of_every_question_is_found(order: str) -> None:
    slots = np.arange(0, 9000, 2)[:: 1 if order == "forwards" else -1]
    questions = np.empty(len(slots), [("t_ns", "<i8"), ("slot", "<i8"), ("data", object)])
    questions["slot"] = slots
    questions["data"] = [encode_sensor(SensorPacket(int(k), 0, 0, (0.5,), nonce=int(k) + 7)) for k in slots]
    wire = recorded_wire(Run(arrays={"/link/sensor": questions}, schemas={}))
    assert [wire.nonce(k) for k in range(9010)] == [0 if k % 2 or k > 8998 else k + 7 for k in range(9010)]
    assert wire.nonce(4) == 11  # and one that was asked for before


KEY = bytes(range(16))
SLOTS = 20


def key_in(folder: Path, key: bytes = KEY) -> Path:
    path = folder / "frames.key"
    path.write_text(key.hex())
    path.chmod(0o600)
    return path


def sealed_answers(wire: Wire) -> list[bytes]:
    """Return the answers of a session, one a slot, as the rig's end of the link took them."""
    session = wire.hello.to_bytes(8, "little")
    made = []
    for k in range(SLOTS):
        bare = encode_control(ControlPacket(k, 0, 0, 0, 1, ((0.5,), (0.5,)), echo=k, counter=k + 1))
        sealed = with_tag(bare, lambda signed: cmac(KEY)(session + signed))
        assert sealed is not None
        made.append(sealed)
    return made


def log(wire: Wire, control: list[bytes]) -> Run:
    """Return a log of questions and answers."""
    fields = [("t_ns", "i8"), ("slot", "i8"), ("late", "i8"), ("data", "O")]
    asked = [encode_sensor(SensorPacket(k, EMPTY, 0, (), nonce=wire.nonce(k), counter=k + 1)) for k in range(SLOTS)]
    topics = {SENSOR.name: asked, CONTROL.name: control}
    arrays = {name: np.array([(k, k, 0, data) for k, data in enumerate(rows)], dtype=fields) for name, rows in topics.items()}
    return Run(arrays=arrays, schemas={})


def test_answers_of_the_key_are_verified_and_a_forged_one_is_named(tmp_path: Path) -> None:
    wire, key = session_wire(bytes(16), SLOTS), key_in(tmp_path)
    made = sealed_answers(wire)
    assert verify_tags(log(wire, made), key) == Tags(verified=SLOTS, wrong=0, first=None)
    forged = bytearray(made[7])
    forged[44] ^= 1  # the second row
    bare = encode_control(ControlPacket(9, 0, 0, 0, 1, ((0.5,), (0.5,)), echo=9, counter=10))
    for at, instead in ((7, bytes(forged)), (9, bare), (5, made[4]), (5, b"...")):
        reported = verify_tags(log(wire, [*made[:at], instead, *made[at + 1 :]]), key)
        wrong = instead != made[4]  # an answer that was recorded twice carries a true code: the replay itself finds it
        assert reported == Tags(verified=SLOTS - wrong, wrong=int(wrong), first=at if wrong else None)


def test_another_key_or_another_session_verifies_nothing(tmp_path: Path) -> None:
    wire, other = session_wire(bytes(16), SLOTS), session_wire(bytes(range(16)), SLOTS)
    none = Tags(verified=0, wrong=SLOTS, first=0)
    assert verify_tags(log(wire, sealed_answers(wire)), key_in(tmp_path, bytes(16))) == none
    assert verify_tags(log(wire, sealed_answers(other)), key_in(tmp_path)) == none


def test_a_log_without_nonces_and_a_file_that_is_no_key_are_refused(tmp_path: Path) -> None:
    key = key_in(tmp_path)
    with pytest.raises(HilError, match="no nonce of slot 0"):
        verify_tags(log(Wire(nonce=lambda k: 0), []), key)
    key.chmod(0o644)
    with pytest.raises(TransportError, match="chmod 600"):
        verify_tags(log(session_wire(bytes(16), SLOTS), []), key)


def test_the_questions_of_several_nodes_go_over_a_link_that_knows_them() -> None:
    run = simulate_as_logged(compose(load_experiment("multisensor-published", ["duration=1"])), 0)
    with pytest.raises(HilError, match=re.escape("no controller answered on can:hil:nodesreplay?nodes=4 within")):
        ask_process(run, "can:hil:nodesreplay", start_s=0.05)


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_frames_go_onto_a_link_in_their_order_and_at_their_spacing(speed: float, monkeypatch: pytest.MonkeyPatch) -> None:
    run, waits, seen = simulate_as_logged(compose(load_experiment("dc-motor-hinf", ["duration=1"])), 0), [], []

    clock = SimpleNamespace(wait_until=waits.append, now=lambda: waits[-1])
    monkeypatch.setattr(over_link, "RealClock", lambda start_ns: clock)
    played = over_link.onto(run, "can:hil:replayspaced", speed, lambda i, n: seen.append((i, n)))
    frames = [t for topic in (SENSOR.name, CONTROL.name) for t in run.arrays[topic]["t_ns"].tolist()]
    assert waits == [round((t - min(frames)) / speed) for t in sorted(frames)] and max(waits) == round(950_000_000 / speed)
    assert seen == [(i, len(frames)) for i in range(len(frames))]
    assert played.frames == len(frames) and played.error_us["max"] == 0.0


def test_a_log_with_a_gap_of_years_is_not_played_for_years() -> None:
    run = simulate_as_logged(compose(load_experiment("dc-motor-hinf", ["duration=0.1"])), 0)
    control = run.arrays[CONTROL.name].copy()
    control["t_ns"][-1] += 10**18
    late = replace(run, arrays={**run.arrays, CONTROL.name: control})
    with pytest.raises(HilError, match=r"frame 3 is 1e\+09 s behind the one before it, at most 3600 s are played"):
        over_link.onto(late, "can:hil:replaygap", 100.0, lambda done, of: None)


def test_frames_are_played_onto_a_link_that_is_never_empty(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a link of one's own returns is taken a thousand times between two frames, and then the next one is played."""
    run = simulate_as_logged(compose(load_experiment("dc-motor-hinf", ["duration=0.1"])), 0)
    taken = []

    @contextmanager
    def never_empty(uri: str, role: str) -> Iterator[SimpleNamespace]:
        yield SimpleNamespace(send=lambda data: None, receive=lambda timeout_s: taken.append(role) or b"nonsense")

    monkeypatch.setattr(over_link, "opened", never_empty)
    assert over_link.onto(run, "local:", 100.0, lambda done, of: None).frames == 4
    assert len(taken) == 4 * over_link.MOST_TAKEN


def test_a_log_that_cannot_be_asked_says_why() -> None:
    experiment = load_experiment("dc-motor-hinf", ["duration=0.5"])
    run, other = simulate_as_logged(compose(experiment), 0), experiment.controller
    for ask, said in ((lambda run: experiment_of(run, "a.mcap"), "a.mcap: the log carries no resolved experiment"),
                      (lambda run: what_if(run, other, "hinf"), "log: the log has no slot with an applied command"),
                      (lambda run: ask_process(run, "can:hil:x"), "the log: holds no answers to compare with"),
                      (lambda run: over_link.onto(run, "can:hil:x", 1.0, print), "the log has no frames to play"),
                      (verify, "log: the log holds no slots"),
                      (changes_of, "event of slot 3: a change without path and value")):  # fmt: skip
        bare = replace(run, arrays={topic: array[:0] for topic, array in run.arrays.items()}, events=[])
        if "experiment" in said:
            bare = replace(bare, resolved={})
        if "change" in said:
            bare = replace(bare, events=[{"kind": "change", "slot": 3, "data": {"path": "plant.gain"}}])
        with pytest.raises(HilError, match=re.escape(said)):
            ask(bare)


@pytest.mark.parametrize(
    ("one", "other", "near"),
    [
        (1.0, 1.0 + 2.0**-22, True), (1.0, 1.0 + 2.0**-21, False), (-1e-9, 1e-9, False), (np.inf, np.inf, True),
        (0.0, -0.0, True), (np.nan, np.nan, True), (np.nan, 1.0, False), (1.0, np.nan, False), (7, 7, True), (7, 8, False),
        (((1.0, 2.0), 3), ((1.0, 2.0 + 2.0**-22), 3), True), ((1.0,), (1.0, 2.0), False), ((), (), True), (None, (), False),
    ],
)  # fmt: skip
def test_values_of_a_frame_are_near_in_the_last_bits_of_the_wire(one: object, other: object, near: bool) -> None:
    assert near_values(one, other) is near_values(other, one) is near
