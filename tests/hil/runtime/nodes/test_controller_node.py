"""The controller node outlives a session, and what does not fit its time; who lies to it never reaches the control law unseen."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import count

import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.rig.loop import Loop
from hil.runtime.nodes import SEGMENT, Wire, before, session_wire
from hil.runtime.nodes.controller_node import MOST_FRAMES, NEAR, SILENCE_NS, ControlNode, Questions, Refusals
from transport.packets import EMPTY, MORE, ControlPacket, SensorPacket, decode, encode_sensor
from transport.wire import HELLO, echo

PERIOD_NS = 50_000_000


def node(kind: str) -> ControlNode:
    return ControlNode(compose(load_experiment(kind)))


def session(of: ControlNode, slots: int) -> list[bytes | None]:
    hello = of.on_frame(encode_sensor(SensorPacket(HELLO, EMPTY, 0, ())))
    assert hello is not None
    return [of.on_frame(encode_sensor(SensorPacket(k, 0, k * PERIOD_NS, (0.01 * k,)))) for k in range(slots)]


@pytest.mark.parametrize("kind", ["dc-motor-hinf", "dc-motor-smith"])
def test_a_second_session_is_answered_as_the_first(kind: str) -> None:
    lasting = node(kind)
    first = session(lasting, 40)
    assert None not in first
    assert session(lasting, 40) == first


def test_a_sample_from_the_future_is_counted_and_not_answered() -> None:
    ours = node("dc-motor-hinf")
    session(ours, 20)
    assert ours.on_frame(encode_sensor(SensorPacket(3, EMPTY, 0, ()))) is None  # another rig, which has only begun
    assert ours.counts.malformed == 1
    answer = ours.on_frame(encode_sensor(SensorPacket(20, 0, 20 * PERIOD_NS, (0.2,))))
    assert answer is not None and isinstance(decode(answer), ControlPacket)


def test_a_packet_of_another_width_is_counted_and_not_used() -> None:
    ours, two = node("dc-motor-hinf"), node("dc-motor-ours-two-samples")
    session(ours, 3)
    assert ours.on_frame(encode_sensor(SensorPacket(3, 0, 3 * PERIOD_NS, (0.1, 0.2)))) is None
    assert two.on_frame(encode_sensor(SensorPacket(0, 0, 0, (0.1,)))) is None
    assert (ours.counts.malformed, two.counts.malformed) == (1, 1)
    assert two.on_frame(encode_sensor(SensorPacket(0, 0, 0, (0.1, 0.1)))) is not None


def test_an_older_sample_never_replaces_a_newer_one_of_the_same_slot() -> None:
    """Reordered: the sample of slot 5, then in the same slot that of slot 3. The newer one is answered for, with tau = 1."""
    ours, plain = node("dc-motor-hinf"), node("dc-motor-hinf")
    for each in (ours, plain):
        session(each, 5)
    newer, older = (5 * PERIOD_NS, (0.5,)), (3 * PERIOD_NS, (-0.9,))
    assert ours.on_frame(encode_sensor(SensorPacket(6, MORE, *newer))) is None
    answer = ours.on_frame(encode_sensor(SensorPacket(6, 0, *older)))
    assert answer == plain.on_frame(encode_sensor(SensorPacket(6, 0, *newer)))
    assert answer is not None
    packet = decode(answer)
    assert isinstance(packet, ControlPacket) and (packet.sample_ns, packet.tau) == (5 * PERIOD_NS, 1)


T = 50_000_000
FORGED = 10.0


@pytest.fixture(scope="module")
def loop() -> Loop:
    return compose(load_experiment("dc-motor-hinf"), certify=False)


class RigSide:
    """The true rig, on one wire with other senders."""

    def __init__(self, loop: Loop, secret: bytes = b"s" * 16) -> None:
        self.node, self.wire = ControlNode(loop), session_wire(secret)
        self.k = -1
        self._counter = count(1)

    def greet(self, now_ns: int = 0, number: int = 1) -> bytes | None:
        hello = SensorPacket(HELLO, EMPTY, 0, (), nonce=self.wire.hello, counter=number)
        return self.node.on_frame(encode_sensor(hello), now_ns)

    def ask(self, y: float = 0.5) -> tuple[bytes, bytes | None]:
        """Ask in the next slot; return question and answer."""
        self.k += 1
        data = question(self.wire, self.k, next(self._counter), y)
        return data, self.node.on_frame(data, self.k * T)

    def true_answers(self, slots: int) -> None:
        for _ in range(slots):
            data, answer = self.ask()
            packet = decode(answer or b"")
            assert isinstance(packet, ControlPacket) and packet.echo == echo([data]) and packet.sample_ns == self.k * T


def question(wire: Wire, k: int, counter: int, y: float, flags: int = 0, nonce: int | None = None) -> bytes:
    known = wire.nonce(k) if nonce is None else nonce
    return encode_sensor(SensorPacket(k, flags, k * T, (y,), reference=(3.0,), nonce=known, counter=counter))


def begun(loop: Loop, slots: int = 5) -> RigSide:
    rig = RigSide(loop)
    assert rig.greet() is not None
    rig.true_answers(slots)
    return rig


def forgeries(rig: RigSide) -> Iterable[bytes]:
    """What one who receives everything can put on the wire between two slots."""
    k, received = rig.k, rig.wire.nonce(rig.k)
    for nonce in (0, 1, received, before(received), rig.wire.hello):
        for seq in (k + 1, k + 2, k + 8, k + NEAR, 10**6, 2**31, k - 1, 0):
            for flags in (0, MORE):
                yield question(rig.wire, seq, rig.k + 2, FORGED, flags, nonce=nonce)
    for counter in (k + 1, k + 2, 2**32 - 1, 0):  # beside the true frame of the slot that is over
        for flags in (0, MORE):
            yield question(rig.wire, k, counter, FORGED, flags)


def test_no_forged_question_of_a_slot_that_has_not_begun_is_answered_used_or_outdates_the_true_ones(loop: Loop) -> None:
    rig, alone = begun(loop), begun(loop)
    tried = 0
    for _ in range(20):
        for data in forgeries(rig):
            tried += 1
            assert rig.node.on_frame(data, rig.k * T) is None
        assert rig.ask() == alone.ask()  # to the byte: nothing of it reached the control law
    counts = rig.node.counts
    assert counts.refused + counts.contradicted + counts.malformed >= tried - 20 and counts.contradicted > 0
    assert alone.node.counts.refused == alone.node.counts.contradicted == 0


def test_one_forged_number_far_ahead_does_not_silence_the_controller(loop: Loop) -> None:
    rig = begun(loop)
    assert rig.node.on_frame(question(rig.wire, 10**6, 2**32 - 1, FORGED, MORE, nonce=77), rig.k * T) is None
    rig.true_answers(10)
    assert rig.node.counts.refused == 1


def test_a_forged_hello_neither_ends_the_session_nor_resets_the_control_law(loop: Loop) -> None:
    rig, alone, other = begun(loop), begun(loop), RigSide(loop, b"o" * 16)
    for _ in range(20):
        for nonce in (rig.wire.hello, other.wire.hello, 0, rig.wire.nonce(rig.k)):
            hello = encode_sensor(SensorPacket(HELLO, EMPTY, 0, (), nonce=nonce, counter=9))
            assert rig.node.on_frame(hello, rig.k * T) is None
        assert rig.ask() == alone.ask()
    assert rig.node.counts.refused == 80


def test_hellos_of_others_before_the_session_do_not_keep_the_rig_from_it(loop: Loop) -> None:
    rig = RigSide(loop)
    for number in range(1, 22):
        assert rig.greet(number=number) is not None
    for nonce in range(1, 500):
        rig.node.on_frame(encode_sensor(SensorPacket(HELLO, EMPTY, 0, (), nonce=nonce, counter=1)))
    rig.true_answers(5)


def test_a_forged_frame_before_the_true_one_of_the_slot_shows_in_the_echo_and_is_counted(loop: Loop) -> None:
    """Who receives from the rig first can be faster: the rig then sees that other frames than its own were answered."""
    rig = begun(loop)
    k = rig.k + 1
    first = rig.node.on_frame(question(rig.wire, k, 6, FORGED), k * T)
    data, second = rig.ask()
    packet = decode(first or b"")
    assert isinstance(packet, ControlPacket) and packet.echo != echo([data])
    assert second is None and rig.node.counts.contradicted == 1
    rig.true_answers(3)


@pytest.mark.parametrize("ahead", [0, 1, 1000])
def test_frames_between_those_of_one_slot_never_count_unseen(ahead: int) -> None:
    two = compose(load_experiment("dc-motor-two-nodes"), certify=False)
    wire, node = session_wire(b"2" * 16), ControlNode(two)
    node.on_frame(encode_sensor(SensorPacket(HELLO, EMPTY, 0, (), nonce=wire.hello, counter=1)))

    def frame(i: int, flags: int, y: float, counter: int) -> bytes:
        return encode_sensor(SensorPacket(0, flags, 0, (y,), i, 1, (3.0, 0.0), 2, wire.nonce(0), counter))

    true = [frame(0, MORE, 0.1, 1), frame(1, 0, 0.2, 2)]
    assert node.on_frame(true[0]) is None
    assert node.on_frame(frame(1, MORE, FORGED, 2 + ahead)) is None  # the number of the next one, or one beyond
    answer = decode(node.on_frame(true[1]) or b"")
    if ahead:  # beyond the frame that closes the slot: dropped, and the rest is the rig's
        assert isinstance(answer, ControlPacket) and answer.echo == echo(true)
    else:  # which of the two is the rig's is not known here
        assert answer is None
    assert node.counts.contradicted == 1


@pytest.mark.parametrize("first", ["forged", "true"])
def test_of_two_frames_with_one_number_neither_sample_counts(first: str) -> None:
    wire, counts = session_wire(b"2" * 16), Refusals()
    questions = Questions(counts, T)

    def frame(i: int, flags: int, y: float) -> bytes:
        return encode_sensor(SensorPacket(0, flags, 0, (y,), i, 1, (3.0, 0.0), 2, wire.nonce(0), i + 1))

    def take(data: bytes) -> list[tuple[SensorPacket, bytes]] | None:
        packet = decode(data)
        assert isinstance(packet, SensorPacket)
        return questions.take(packet, data, 0)

    pair = [frame(0, MORE, FORGED), frame(0, MORE, 0.1)]
    last = frame(1, 0, 0.2)
    assert [take(data) for data in (pair if first == "forged" else pair[::-1])] == [None, None]
    taken = take(last)
    assert taken is not None and [data for _, data in taken] == [b"", last] and counts.contradicted == 1


def test_frames_that_no_one_closes_take_bounded_memory(loop: Loop) -> None:
    """Without a rig, whoever sends first begins a slot; of frames that never end it, each was kept."""
    node = ControlNode(loop)

    def frame(flags: int, counter: int) -> bytes:
        return encode_sensor(SensorPacket(5, flags | EMPTY, 0, (), nonce=7, counter=counter))

    for counter in range(1, MOST_FRAMES + 11):
        assert node.on_frame(frame(MORE, counter)) is None
    questions = node._questions
    assert len(questions._frames) == MOST_FRAMES and node.counts.contradicted == 10
    assert node.on_frame(frame(0, MOST_FRAMES + 11)) is not None
    for counter in range(2000, 2010):
        assert node.on_frame(frame(MORE, counter)) is None
    assert node.counts.contradicted == 20 and not questions._spoilt


def test_a_new_rig_has_its_controller_after_a_second_of_silence_and_a_controller_that_starts_late_its_rig(loop: Loop) -> None:
    rig, new = begun(loop), RigSide(loop, b"n" * 16)
    new.node = rig.node
    at = rig.k * T
    assert new.greet(at + SILENCE_NS - 1) is None
    assert new.greet(at + SILENCE_NS) is not None
    new.true_answers(5)
    late = RigSide(loop)
    late.k = 99
    late.true_answers(5)


def test_lost_questions_are_passed_over_and_a_chain_ends_where_the_next_begins(loop: Loop) -> None:
    rig = begun(loop)
    rig.k += NEAR - 1
    rig.true_answers(3)
    rig.k += 500  # only after a second without the rig
    assert rig.ask()[1] is not None
    assert SEGMENT == 1 << 18
    wire = session_wire(b"w" * 16, 10)
    assert [before(wire.nonce(k + 1)) == wire.nonce(k) for k in range(9)] == [True] * 9
