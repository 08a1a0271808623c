"""A frame with a flipped bit, before anything is sent."""

from __future__ import annotations

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.runtime.nodes.fault_injector import FaultInjector
from transport.packets import SensorPacket, encode_sensor, packet_size


def test_a_flipped_bit_leaves_the_length_that_a_frame_states() -> None:
    """Of 256 bits of the frame more than 10 state its length: 300 draws hit none of them with probability 1e-5 at most."""
    faults, frame = FaultInjector(compose(load_experiment("dc-motor-hinf")), 0), encode_sensor(SensorPacket(7, 0, 0, (0.5,)))
    wrong = [faults.flip(frame) for _ in range(300)]
    assert {packet_size(each) for each in wrong} == {packet_size(frame)} and len(set(wrong)) > 50
    assert {(int.from_bytes(each) ^ int.from_bytes(frame)).bit_count() for each in wrong} == {1}
