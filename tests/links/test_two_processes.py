"""Links between real processes: round trips, a far end that is killed, stopped, and comes back."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic

import pytest

from tests.ports import free_port
from tests.waiting import LIMIT_S
from transport import Link, open_link
from transport.links.contract import SEND_LIMIT_S, control, sensor

CONTROLLER = """
import sys
from transport import ControlPacket, decode, encode_control, open_link
with open_link(sys.argv[1], "controller") as link:
    print("up", flush=True)
    while True:
        packet = decode(link.receive(1.0) or b"")
        if packet is not None:
            link.send(encode_control(ControlPacket(packet.seq, packet.sample_ns, 1, 0, 1, (packet.y, packet.y))))
"""


@pytest.fixture(
    params=[
        "can:hil:two",
        "can:hil:two?fd=0",
        "zenoh:tcp/127.0.0.1:{port}",
        pytest.param("can:socketcan:vcan0?base=0x400", marks=pytest.mark.vcan),
        pytest.param("can:socketcan:vcan0?fd=0&base=0x500", marks=pytest.mark.vcan),
    ]
)
def uri(request: pytest.FixtureRequest) -> str:
    template: str = request.param
    return template.format(port=free_port())


@contextmanager
def controller(uri: str) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, "-c", CONTROLLER, uri], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == b"up\n"
            yield process
        finally:
            process.kill()


def answered(rig: Link, seq: int, within_s: float) -> bool:
    """Ask until the answer to this very question comes."""
    end = monotonic() + within_s
    while monotonic() < end:
        rig.send(sensor(seq))
        until = monotonic() + 0.05
        while monotonic() < until:
            packet = rig.receive(0.02)
            if packet is not None and int.from_bytes(packet[4:8], "little") == seq:
                return True
    return False


def test_every_question_gets_its_answer(uri: str) -> None:
    with open_link(uri, "rig") as rig, controller(uri):
        assert answered(rig, 1, LIMIT_S)
        while rig.receive(0.1) is not None:
            pass
        for seq in range(2, 302):
            rig.send(sensor(seq, 3))
            answer = rig.receive(LIMIT_S)
            assert answer is not None and int.from_bytes(answer[4:8], "little") == seq
            assert len(answer) == len(control(seq, 2, 3))


def test_a_controller_that_is_killed_is_silent_and_its_successor_answers(uri: str) -> None:
    with open_link(uri, "rig") as rig:
        with controller(uri) as first:
            assert answered(rig, 1, LIMIT_S)
            first.kill()
            first.wait()
        assert not answered(rig, 2, 0.2)
        with controller(uri):
            assert answered(rig, 3, LIMIT_S)


def test_a_controller_that_is_stopped_never_blocks_the_rig_and_answers_again(uri: str) -> None:
    with open_link(uri, "rig") as rig, controller(uri) as sleeper:
        assert answered(rig, 1, LIMIT_S)
        os.kill(sleeper.pid, signal.SIGSTOP)
        slowest = 0.0
        for seq in range(2, 5002):
            begin = monotonic()
            rig.send(sensor(seq))
            slowest = max(slowest, monotonic() - begin)
        assert slowest < SEND_LIMIT_S
        os.kill(sleeper.pid, signal.SIGCONT)
        assert answered(rig, 9999, LIMIT_S)
