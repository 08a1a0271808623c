"""Every recorded answer carries the code of the key, or is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.errors import HilError
from hil.log.run import Run
from hil.log.topics import CONTROL, SENSOR
from hil.runtime.nodes.wire import Wire, session_wire
from hil.session.replay.recorded import Tags, verify_tags
from transport.links import TransportError
from transport.links.authenticated_link import cmac
from transport.packets import EMPTY, ControlPacket, SensorPacket, encode_control, encode_sensor
from transport.wire import with_tag

KEY = bytes(range(16))
SLOTS = 20


def key_in(folder: Path, key: bytes = KEY) -> Path:
    path = folder / "frames.key"
    path.write_text(key.hex())
    path.chmod(0o600)
    return path


def answers(wire: Wire) -> list[bytes]:
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
    made = answers(wire)
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
    assert verify_tags(log(wire, answers(wire)), key_in(tmp_path, bytes(16))) == none
    assert verify_tags(log(wire, answers(other)), key_in(tmp_path)) == none


def test_a_log_without_nonces_and_a_file_that_is_no_key_are_refused(tmp_path: Path) -> None:
    key = key_in(tmp_path)
    with pytest.raises(HilError, match="no nonce of slot 0"):
        verify_tags(log(Wire(nonce=lambda k: 0), []), key)
    key.chmod(0o644)
    with pytest.raises(TransportError, match="chmod 600"):
        verify_tags(log(session_wire(bytes(16), SLOTS), []), key)
