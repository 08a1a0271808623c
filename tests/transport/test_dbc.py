"""The DBC, our packing and the CAN link say the same of every byte."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from uuid import uuid4

import can
import cantools
import pytest
from cantools.database.can import Database

from transport import EMPTY, MORE, SELECTIONS, ControlPacket, SensorPacket, dbc_path, encode_control, encode_sensor
from transport.dbc import BusNode, dbc_text
from transport.links import Role
from transport.links.can_identifiers import FRAGMENTS, derived
from transport.links.can_open import open_can

SENSORS = [
    SensorPacket(seq=0xDEADBEEF, flags=MORE, sample_ns=-5, y=(3.25,)),
    SensorPacket(seq=1, flags=0, sample_ns=2**40, y=(1.0, -2.5)),
    SensorPacket(seq=2, flags=EMPTY, sample_ns=0, y=()),
    SensorPacket(seq=3, flags=0, sample_ns=1, y=tuple(range(12))),
    SensorPacket(seq=4, flags=0, sample_ns=1, y=tuple(range(24))),
]
CONTROLS = [
    ControlPacket(seq=7, sample_ns=3, control_ns=4, tau=-1, selection=0, rows=((0.5,),)),
    ControlPacket(seq=7, sample_ns=-3, control_ns=2**50, tau=2, selection=1, rows=((1.0, 2.0), (3.0, 4.0))),
    ControlPacket(seq=8, sample_ns=3, control_ns=4, tau=300, selection=4, rows=tuple((float(i),) for i in range(9))),
    ControlPacket(seq=9, sample_ns=3, control_ns=4, tau=0, selection=2, rows=tuple((i, -1.5, 2.0) for i in range(7))),
]
DIGEST = 0xFEDCBA9876543210
SENSORS_2 = [
    SensorPacket(5, MORE, -5, (3.25,), reference=(3.0,), nonce=DIGEST, counter=1),
    SensorPacket(6, 0, 2**40, (1.0, -2.5, 0.5), node=2, samples=3, nodes=4, nonce=DIGEST, counter=2**32 - 1),
    SensorPacket(7, EMPTY, 0, (), reference=(1.0, 2.0), nonce=DIGEST),
    SensorPacket(8, 0, 1, tuple(range(18)), samples=2, reference=(1.5,) * 5, nonce=DIGEST),
]
CONTROLS_2 = [packet._replace(seq=packet.seq + 10 * i, echo=DIGEST, counter=i) for i, packet in enumerate(CONTROLS[:3], 1)]
PACKETS = [*SENSORS, *CONTROLS, *SENSORS_2, *CONTROLS_2]


DATABASE = cantools.database.load_file(dbc_path())


@pytest.fixture
def database() -> Database:
    assert isinstance(DATABASE, Database)
    return DATABASE


def encode(packet: SensorPacket | ControlPacket) -> bytes:
    return encode_sensor(packet) if isinstance(packet, SensorPacket) else encode_control(packet)


def named(packet: SensorPacket | ControlPacket, data: bytes) -> dict[str, Any]:
    """What the DBC has to say of a packet; values beyond the last are the padding's zeros."""
    crc = int.from_bytes(data[:2], "little")
    new = {"Tagged": 0, "Counter": packet.counter}
    if isinstance(packet, SensorPacket):
        flags = {"More": packet.flags & 1, "Empty": packet.flags >> 1}
        samples = packet.samples if packet.y else 0
        count = {"Outputs": len(packet.y) // packet.samples, "Samples": samples, "References": len(packet.reference)}
        count |= {"Node": packet.node, "Nodes": packet.nodes, "Nonce": packet.nonce}
        head = {"Crc": crc, "Kind": "sensor", **count, **flags, **new, "Seq": packet.seq}
        values = (*packet.y, *packet.reference)
        return {**head, "SampleTime": packet.sample_ns, **{f"Y{i}": y for i, y in enumerate(values)}}
    new["Echo"] = packet.echo
    head = {**new, "Crc": crc, "Kind": "control", "Selection": SELECTIONS[packet.selection], "Seq": packet.seq, "Tau": packet.tau}
    shape = {"Rows": len(packet.rows), "Inputs": len(packet.rows[0])}
    values = [value for row in packet.rows for value in row]
    times = {"SampleTime": packet.sample_ns, "ControlTime": packet.control_ns}
    return {**head, **shape, **times, **{f"U{i}": value for i, value in enumerate(values)}}


@contextmanager
def frames(packet: SensorPacket | ControlPacket, fd: bool) -> Iterator[list[can.Message]]:
    """The frames that the link makes of a packet."""
    channel, role = uuid4().hex, "rig" if isinstance(packet, SensorPacket) else "controller"
    protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
    received: list[can.Message] = []
    with can.Bus(channel, interface="virtual", protocol=protocol) as listener:
        sender: Role = "rig" if role == "rig" else "controller"
        with open_can(f"can:virtual:{channel}?fd={fd:d}", sender) as link:
            link.send(encode(packet))
        while (message := listener.recv(0)) is not None:
            received.append(message)
    yield received


@pytest.mark.parametrize("fd", [True, False], ids=["fd", "classic"])
@pytest.mark.parametrize("packet", PACKETS, ids=lambda packet: f"{type(packet).__name__}-{packet.seq}")
def test_every_frame_on_the_bus_reads_by_the_dbc_as_what_was_packed(
    packet: SensorPacket | ControlPacket, fd: bool, database: Database
) -> None:
    data = encode(packet)
    read: dict[str, Any] = {}
    with frames(packet, fd) as received:
        for message in received:
            frame = database.get_message_by_frame_id(message.arbitration_id)
            assert frame.is_fd == message.is_fd == fd and not message.is_extended_id and message.dlc <= frame.length
            signals = database.decode_message(message.arbitration_id, bytes(message.data), allow_truncated=True)
            assert isinstance(signals, Mapping)
            read |= {name: str(v) if name in ("Kind", "Selection") else v for name, v in signals.items()}
    expected = named(packet, data)
    assert {name: read[name] for name in expected} == expected
    assert not any(value for name, value in read.items() if name not in expected)


@pytest.mark.parametrize("packet", PACKETS, ids=lambda packet: f"{type(packet).__name__}-{packet.seq}")
def test_cantools_packs_the_very_bytes_that_we_pack(packet: SensorPacket | ControlPacket, database: Database) -> None:
    data = encode(packet)
    values = named(packet, data)
    first = (derived().control if isinstance(packet, ControlPacket) else derived().sensors[0])[0]
    packed = b""
    for index in range(-(-len(data) // 64)):
        frame = database.get_message_by_frame_id(first + index)
        packed += frame.encode({signal.name: values.get(signal.name, 0) for signal in frame.signals}, strict=False)
    assert packed[: len(data)] == data and not any(packed[len(data) :])


def test_every_frame_lies_in_the_links_identifiers_and_says_its_kind(database: Database) -> None:
    for fd in (True, False):
        for first, sender in zip((derived(fd=fd).sensors[0][0], derived(fd=fd).control[0]), ("Rig", "Controller")):
            block = [message for message in database.messages if 0 <= message.frame_id - first < FRAGMENTS]
            assert [message.frame_id - first for message in block] == list(range(len(block)))
            assert sum(message.length for message in block) == 128
            assert all(message.is_fd == fd and message.senders == [sender] for message in block)
            assert all(message.length == (64 if fd else 8) for message in block)
    assert len(database.messages) == 36
    assert database.dbc is not None and database.dbc.attributes["BusType"].value == "CAN FD"


def test_a_whole_number_has_the_range_of_its_bits() -> None:
    senders = [
        BusNode(name="Angle", about="a sensor", identifiers=range(0x100, 0x102), values=(("angle", "rad"), ("speed", "rad/s"))),
        BusNode(name="Command", about="commands", identifiers=range(0x200, 0x202), values=(("voltage", "V"),), sensor=False),
    ]
    made = cantools.database.load_string(dbc_text(senders, fd=True, title="two nodes"), "dbc")
    assert isinstance(made, Database)
    whole = [signal for message in made.messages for signal in message.signals if not signal.is_float and not signal.is_signed]
    assert {signal.length for signal in whole} > {1, 8, 16, 32}
    for signal in whole:
        assert signal.minimum == 0 and signal.maximum == pytest.approx(2**signal.length - 1, rel=0.03), signal.name


def test_the_fd_flag_survives_cantools_writing_the_file(database: Database) -> None:
    again = cantools.database.load_string(database.as_dbc_string(), "dbc")
    assert isinstance(again, Database)
    assert {m.name: m.is_fd for m in again.messages} == {m.name: m.is_fd for m in database.messages}
