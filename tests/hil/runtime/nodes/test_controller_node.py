"""The controller node outlives a session, and what does not fit its time."""

from __future__ import annotations

import pytest

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.runtime.nodes.controller_node import HELLO, ControlNode
from transport.packets import EMPTY, MORE, ControlPacket, SensorPacket, decode, encode_sensor

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
