"""A code in every packet: what is forged, replayed, reflected or of another session is refused and counted."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from binascii import crc_hqx
from pathlib import Path

import pytest

from transport import (
    ControlPacket,
    MemoryLink,
    SensorPacket,
    TransportError,
    decode,
    encode_control,
    encode_sensor,
    memory_pair,
    open_link,
)
from transport.links.authentication import SILENCE_S, AuthenticatedLink, cmac, read_key
from transport.packets import EMPTY, packet_size
from transport.wire import HELLO, tag_of, with_tag

KEY = bytes(range(16))


class Clock:
    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> float:
        return self.s


def hello(nonce: int = 7, counter: int = 1) -> bytes:
    return encode_sensor(SensorPacket(HELLO, EMPTY, 0, (), nonce=nonce, counter=counter))


def question(k: int, nonce: int = 0, y: float = 1.0) -> bytes:
    return encode_sensor(SensorPacket(k, 0, 0, (y,), nonce=nonce or 100 + k, counter=k + 1))


def answer(k: int, nonce: int = 0, u: float = 0.5) -> bytes:
    counter = k + 1 if k < HELLO else 1
    return encode_control(ControlPacket(k, 0, 0, 0, 1, ((u,), (u,)), echo=nonce or 100 + k, counter=counter))


class Wire:
    """Rig and controller with a key, and what travels between them in hand: nothing arrives unless it is passed on."""

    def __init__(self, rig_key: bytes = KEY, controller_key: bytes = KEY) -> None:
        self.clock = Clock()
        (rig, self.rig_side), (self.controller_side, controller) = memory_pair(), memory_pair()
        self.rig = AuthenticatedLink(rig, "rig", cmac(rig_key), self.clock)
        self.controller = AuthenticatedLink(controller, "controller", cmac(controller_key), self.clock)

    def say(self, end: AuthenticatedLink, packet: bytes) -> bytes:
        """What an end puts on the wire for a packet."""
        end.send(packet)
        side: MemoryLink = self.rig_side if end is self.rig else self.controller_side
        data = side.receive(0)
        assert data is not None
        return data

    def on_frame(self, end: AuthenticatedLink, data: bytes) -> bytes | None:
        """What an end makes of bytes on the wire."""
        (self.rig_side if end is self.rig else self.controller_side).send(data)
        return end.receive(0)

    def begin(self, nonce: int = 7) -> None:
        assert self.on_frame(self.controller, self.say(self.rig, hello(nonce))) is not None
        assert self.on_frame(self.rig, self.say(self.controller, answer(HELLO, nonce))) is not None


def test_packets_arrive_whole_with_their_fields_and_a_code() -> None:
    wire = Wire()
    wire.begin()
    for k in range(5):
        asked = wire.say(wire.rig, question(k))
        assert len(asked) == packet_size(asked) == 48 and wire.on_frame(wire.controller, asked) == asked
        packet = decode(asked)
        assert isinstance(packet, SensorPacket) and packet.y == (1.0,) and packet.nonce == 100 + k
        assert tag_of(asked) is not None
        said = wire.say(wire.controller, answer(k))
        assert len(said) == 64 and wire.on_frame(wire.rig, said) == said
        packet = decode(said)
        assert isinstance(packet, ControlPacket) and packet.rows == ((0.5,), (0.5,)) and packet.counter == k + 1
    assert wire.rig.counters.refused == wire.controller.counters.refused == 0


def test_a_forger_without_the_key_is_refused_and_counted() -> None:
    wire, intruder = Wire(), Wire(KEY, b"another key of16")
    wire.begin()
    intruder.controller._session = (7).to_bytes(8, "little")  # it receives everything
    forged = [answer(3), intruder.say(intruder.controller, answer(3, u=-4.0)), b"junk", bytes(64)]
    honest = wire.say(wire.controller, answer(3))
    for i in range(8 * len(honest)):  # every flip of one bit, its CRC repaired
        flipped = bytearray(honest)
        flipped[i // 8] ^= 1 << i % 8
        flipped[:2] = crc_hqx(bytes(flipped[2:]), 0xFFFF).to_bytes(2, "little")
        said = tag_of(bytes(flipped))
        if i // 8 > 1 and (said is None or said[4:] != tag_of(honest)[4:]):  # type: ignore[index]
            forged.append(bytes(flipped))
    assert len(forged) > 400
    for data in forged:
        assert wire.on_frame(wire.rig, data) is None, data.hex()
    assert wire.rig.counters.refused == len(forged)
    assert wire.on_frame(wire.rig, honest) == honest


def test_a_replay_and_a_reflection_are_refused() -> None:
    wire = Wire()
    wire.begin()
    old = wire.say(wire.controller, answer(0))
    assert wire.on_frame(wire.rig, old) == old
    assert wire.on_frame(wire.rig, old) is None  # the same again
    skipped, newer = wire.say(wire.controller, answer(1)), wire.say(wire.controller, answer(2))
    assert wire.on_frame(wire.rig, newer) == newer and wire.on_frame(wire.rig, skipped) is None  # kept back, then sent
    asked = wire.say(wire.rig, question(3))
    assert wire.on_frame(wire.rig, asked) is None  # a question is no answer
    assert wire.rig.counters.refused == 3


def test_what_was_recorded_in_another_session_is_refused() -> None:
    wire = Wire()
    wire.begin(7)
    recorded = [wire.say(wire.controller, answer(k)) for k in range(50)]
    questions = [wire.say(wire.rig, question(k)) for k in range(50)]
    old_hello = wire.say(wire.rig, hello(7))
    wire.clock.s += 2 * SILENCE_S
    wire.begin(8)  # the rig begins anew, with another nonce
    assert all(wire.on_frame(wire.rig, data) is None for data in recorded)
    assert all(wire.on_frame(wire.controller, data) is None for data in (*questions, old_hello))
    asked = wire.say(wire.rig, question(0))
    assert wire.on_frame(wire.controller, asked) == asked


def test_a_controller_that_receives_from_its_rig_is_not_taken_away_by_an_old_question() -> None:
    wire = Wire()
    wire.begin(7)
    old_hello = wire.say(wire.rig, hello(7))
    wire.clock.s += 2 * SILENCE_S
    wire.begin(8)
    wire.clock.s += 0.9 * SILENCE_S
    asked = wire.say(wire.rig, question(0))
    assert wire.on_frame(wire.controller, asked) == asked
    wire.clock.s += 0.9 * SILENCE_S
    assert wire.on_frame(wire.controller, old_hello) is None
    asked = wire.say(wire.rig, question(1))
    assert wire.on_frame(wire.controller, asked) == asked


def test_an_old_question_between_two_slots_of_a_slow_loop_takes_no_controller_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A loop of 2 s is silent for longer than `SILENCE_S` in every slot."""
    key = tmp_path / "k"
    key.write_text(KEY.hex())
    key.chmod(0o600)
    clock = Clock()
    monkeypatch.setattr(AuthenticatedLink.__init__, "__defaults__", (clock, SILENCE_S))
    uri = f"can:hil:slow?auth={key}"
    with open_link(uri, "rig") as rig, open_link(uri, "controller", 2.0) as controller:
        assert isinstance(rig, AuthenticatedLink)
        old_hello = with_tag(hello(6), lambda signed: cmac(KEY)((6).to_bytes(8, "little") + signed))
        assert old_hello is not None
        rig.send(hello(7))
        assert controller.receive(1.0) is not None
        for k in range(2):
            clock.s += 1.9
            rig._link.send(old_hello)
            assert controller.receive(0.1) is None
            rig.send(question(k))
            assert controller.receive(1.0) is not None, k


def test_a_flood_of_forgeries_does_not_hold_a_call() -> None:
    wire = Wire()
    for _ in range(200):
        wire.rig_side.send(answer(0))
    assert wire.rig.receive(0) is None and wire.rig.counters.refused == 64


def test_what_has_no_room_for_a_code_is_not_sent() -> None:
    wire = Wire()
    wire.rig.send(encode_sensor(SensorPacket(1, 0, 0, (1.0,))))  # before the question that begins the session
    wire.controller.send(answer(0))  # no question was sent yet
    assert wire.rig_side.receive(0) is None and wire.controller_side.receive(0) is None
    assert wire.rig.counters.refused == wire.controller.counters.refused == 1


def test_the_code_is_that_of_nist() -> None:
    """NIST SP 800-38B, examples 2 and 3 for AES-128: messages of 16 and 40 bytes."""
    code = cmac(bytes.fromhex("2b7e151628aed2a6abf7158809cf4f3c"))
    message = bytes.fromhex("6bc1bee22e409f96e93d7e117393172aae2d8a571e03ac9c9eb76fac45af8e5130c81c46a35ce411")
    assert code(message[:16]).hex() == "070a16b46b4d4144"
    assert code(message).hex() == "dfa66747de9ae630"


def test_no_bytes_make_the_reader_of_tags_raise() -> None:
    rng = random.Random(0)
    shapes = [question(1), answer(1), with_tag(answer(1), lambda b: bytes(8)) or b""]
    for _ in range(20_000):
        data = bytearray(rng.choice(shapes) if rng.random() < 0.7 else rng.randbytes(rng.randrange(80)))
        for _ in range(rng.randrange(4)):
            if data:
                data[rng.randrange(len(data))] = rng.randrange(256)
        tag_of(bytes(data[: rng.randrange(len(data) + 1)]))


@pytest.mark.parametrize(
    ("contents", "mode", "says"),
    [
        ("00" * 16, 0o644, r"other users can read it \(mode 644\); chmod 600"),
        ("00" * 16, 0o640, "other users can read it"),
        ("00" * 15, 0o600, "expected a key of 32 or 64 hexadecimal digits"),
        ("no key", 0o600, "expected a key of 32 or 64"),
        ("0" * 70_000, 0o600, "more than 65536 bytes"),
    ],
)
def test_a_key_file_that_is_none_is_refused(tmp_path: Path, contents: str, mode: int, says: str) -> None:
    path = tmp_path / "k"
    path.write_text(contents)
    path.chmod(mode)
    with pytest.raises(TransportError, match=says):
        read_key(str(path))
    with pytest.raises(TransportError, match=says):
        open_link(f"can:hil:auth?auth={path}", "rig")


def test_a_pipe_or_a_device_is_no_key(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe", 0o600)
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises(TransportError, match="no regular file"):
            read_key(str(path))
    with pytest.raises(TransportError, match="cannot be read: No such file"):
        read_key(str(tmp_path / "nosuch"))


def test_no_process_of_a_loop_imports_cryptography_without_a_key(tmp_path: Path) -> None:
    program = (
        "import sys\nfrom transport import open_link\nimport hil.runtime.real.rig_process, hil.runtime.real.controller_process\n"
        "with open_link(sys.argv[1], 'rig'):\n    print('cryptography' in sys.modules)"
    )
    key = tmp_path / "k"
    key.write_text("00" * 16)
    key.chmod(0o600)
    for uri, there in (("can:hil:bare", "False"), (f"can:hil:keyed?auth={key}", "True")):
        done = subprocess.run([sys.executable, "-c", program, uri], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == there, uri


class Late(MemoryLink):
    """An end on which what is foreign, then an answer comes, half a second of a clock apart."""

    def __init__(self, clock: Clock, packets: list[bytes]) -> None:
        self.clock, self.packets, self.waits = clock, packets, list[float]()

    def receive(self, timeout_s: float) -> bytes | None:
        self.waits.append(timeout_s)
        self.clock.s += 0.5
        return self.packets.pop(0) if self.packets else None


@pytest.mark.parametrize(("timeout_s", "arrives"), [(2.0, True), (0.4, False), (0.0, False)])
def test_what_is_foreign_takes_of_the_wait_for_an_answer_and_does_not_end_it(timeout_s: float, arrives: bool) -> None:
    wire = Wire()
    wire.begin()
    honest = wire.say(wire.controller, answer(3))
    late = Late(wire.clock, [b"junk", honest])
    wire.rig._link = late
    assert (wire.rig.receive(timeout_s) == honest) is arrives
    assert late.waits == ([2.0, 1.5] if arrives else [timeout_s])
