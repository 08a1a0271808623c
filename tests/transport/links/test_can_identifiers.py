"""Who says what under which CAN identifier: one for each node, and no two owners of one."""

from __future__ import annotations

from collections.abc import Iterator
from uuid import uuid4

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from transport import SensorPacket, TransportError, encode_sensor, open_link
from transport.links.can_identifiers import FRAGMENTS, Identifiers, derived, filters, identifiers_of, identifiers_text, read_range


@pytest.mark.parametrize("fd", [True, False])
@pytest.mark.parametrize("nodes", [1, 2, 3, 4, 5, 33, 64])
def test_a_derived_identifier_is_base_direction_node_and_fragment(nodes: int, fd: bool) -> None:
    found = derived(0x300, fd, nodes)
    bits = 6 - (nodes - 1).bit_length()
    for node, own in enumerate(found.sensors):
        assert [*own] == [0x300 | (not fd) << 7 | node << bits | fragment for fragment in range(1 << bits)]
    assert identifiers_text(found.control) == f"{0x300 | (not fd) << 7 | 0x40:#x}-{0x300 | (not fd) << 7 | 0x7F:#x}"


OWN = st.integers(0, 0x7F0).flatmap(lambda first: st.integers(1, 15).map(lambda count: range(first, first + count)))


@given(st.lists(OWN, min_size=1, max_size=6))
def test_filters_let_the_own_identifiers_through_and_no_other(owns: list[range]) -> None:
    found, own = filters(owns), {identifier for own in owns for identifier in own}
    passed = {i for i in range(0x800) for f in found if i & int(f["can_mask"]) == int(f["can_id"]) & int(f["can_mask"])}
    assert passed == own


def test_two_owners_of_one_identifier_are_refused() -> None:
    with pytest.raises(ValueError, match="node 1: the identifier 0x141 is that of node 0 already"):
        Identifiers(sensors=(range(0x140, 0x142), range(0x141, 0x142)), control=range(0x150, 0x151))
    with pytest.raises(ValueError, match="control: the identifier 0x140 is that of node 0 already"):
        Identifiers(sensors=(range(0x140, 0x142),), control=range(0x13F, 0x141))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ids": "0x141,0x141"}, "node 1: the identifier 0x141"),
        ({"ids": "0x800"}, "none above 0x7ff"), ({"ids": "0x142-0x141"}, "ascending order"), ({"ids": "0x100-0x180"}, "up to 64"),
        ({"ids": "x"}, "expected a number or two"), ({"ids": "007"}, "expected a number or two"), ({"ids": ","}, "''"),
        ({"nodes": "65"}, "expected 1 to 64"), ({"nodes": "0"}, "expected 1 to 64"), ({"nodes": "9" * 5000}, "expected a number"),
        ({"nodes": "2", "ids": "1,2"}, "no ids="), ({"control": "0x101"}, "control: the identifier 0x101"),
        ({"base": "0x210"}, "multiple of 0x100"),
    ],
)  # fmt: skip
def test_a_uri_that_says_no_identifiers_is_refused_with_the_option(options: dict[str, str], message: str) -> None:
    with pytest.raises(TransportError, match=message):
        identifiers_of("can:hil:x", options, True)


@given(st.integers(0, 0x7FF), st.integers(1, FRAGMENTS))
def test_a_range_reads_as_it_was_said(first: int, count: int) -> None:
    own = range(first, min(first + count, 0x800))
    assert read_range(identifiers_text(own)) == own


def packet(seq: int, node: int, samples: int = 1) -> bytes:
    y = tuple(seq + node / 8 + i for i in range(samples))
    return encode_sensor(SensorPacket(seq, 0, seq, y, node, samples, (), 3))


@pytest.fixture(params=["nodes=3", "nodes=3&fd=0", "ids=0x150-0x16f,0x90-0xaf,0x7d0-0x7ef&fd=0"])
def ends(request: pytest.FixtureRequest) -> Iterator[tuple[str, str]]:
    yield uuid4().hex, request.param


def test_each_node_speaks_under_its_own_identifier_and_fragments_of_two_may_interleave(ends: tuple[str, str]) -> None:
    channel, options = ends
    fd = "fd=0" not in options
    protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
    first = [0x150, 0x90, 0x7D0] if "ids" in options else [own[0] for own in derived(fd=fd, nodes=3).sensors]
    with (
        can.Bus(channel, interface="virtual", protocol=protocol) as bus,
        open_link(f"can:virtual:{channel}?{options}", "rig") as rig,
        open_link(f"can:virtual:{channel}?{options}", "controller") as controller,
    ):
        said: list[list[can.Message]] = []
        for node in range(3):
            rig.send(packet(7, node, 20))  # several fragments each
            assert controller.receive(1) == packet(7, node, 20)
            said.append([])
            while (message := bus.recv(0)) is not None:
                said[-1].append(message)
            assert [m.arbitration_id for m in said[-1]] == list(range(first[node], first[node] + len(said[-1])))
            assert len(said[-1]) > 1
        for some in zip(*said, strict=True):  # as arbitration on a bus does
            for message in some:
                bus.send(message)
        assert [controller.receive(1) for _ in range(3)] == [packet(7, node, 20) for node in range(3)]
        assert controller.counters.malformed == 0


def test_a_packet_under_the_identifier_of_another_node_is_malformed(ends: tuple[str, str]) -> None:
    channel, options = ends
    with (
        open_link(f"can:virtual:{channel}?{options}", "controller") as controller,
        open_link(f"can:virtual:{channel}?{options}", "rig") as rig,
    ):
        rig._say = rig._say[::-1]  # type: ignore[attr-defined]  # a rig with another order of its nodes
        rig.send(packet(1, 0))
        rig.send(packet(1, 1))
        assert controller.receive(1) == packet(1, 1) and controller.receive(0) is None
        assert controller.counters.malformed == 1


def test_a_node_without_an_identifier_is_not_sent(ends: tuple[str, str]) -> None:
    channel, options = ends
    with open_link(f"can:virtual:{channel}?{options}", "rig") as rig:
        rig.send(encode_sensor(SensorPacket(1, 0, 1, (1.0,), 3, 1, (), 4)))
        assert (rig.counters.dropped, rig.counters.sent) == (1, 0)
