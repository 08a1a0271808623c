"""The wire format: round trips, hostile bytes, and the flips that the CRC has to find."""

from __future__ import annotations

import math
import random
import struct
from binascii import crc_hqx
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from transport.packets import (
    EMPTY,
    FD_LENGTHS,
    MORE,
    TAU_LIMIT,
    ControlPacket,
    SensorPacket,
    decode,
    encode_control,
    encode_sensor,
    packet_size,
)
from transport.wire import echo, tag_of, with_tag

singles = st.floats(width=32, allow_nan=False)
instants = st.integers(-(2**63), 2**63 - 1)
counters = st.integers(0, 2**32 - 1)


@st.composite
def sensor_packets(draw: st.DrawFn, most: int = 63) -> SensorPacket:
    y = tuple(draw(st.lists(singles, min_size=0, max_size=most)))
    flags = draw(st.sampled_from((0, MORE))) | (0 if y else EMPTY)
    return SensorPacket(draw(counters), flags, draw(instants), y)


nonces = st.integers(0, 2**64 - 1)


@st.composite
def sensor_packets_2(draw: st.DrawFn) -> SensorPacket:
    samples, outputs = draw(st.integers(1, 9)), draw(st.integers(0, 7))
    y = tuple(draw(st.lists(singles, min_size=samples * outputs, max_size=samples * outputs)))
    flags, nodes = draw(st.sampled_from((0, MORE))) | (0 if y else EMPTY), draw(st.integers(1, 255))
    node, reference = draw(st.integers(0, nodes - 1)), tuple(draw(st.lists(singles, max_size=7)))
    shape = y, node, samples if y else 1, reference, nodes
    return SensorPacket(draw(counters), flags, draw(instants), *shape, draw(nonces), draw(counters))


@st.composite
def control_packets_2(draw: st.DrawFn) -> ControlPacket:
    return draw(control_packets())._replace(echo=draw(nonces), counter=draw(counters))


@st.composite
def control_packets(draw: st.DrawFn) -> ControlPacket:
    count, inputs = draw(st.integers(0, 12)), draw(st.integers(1, 6))
    row = st.lists(singles, min_size=inputs, max_size=inputs).map(tuple)
    rows = tuple(draw(st.lists(row, min_size=count, max_size=count)))
    tau, selection = draw(st.integers(-1, TAU_LIMIT)), draw(st.integers(0, 4))
    return ControlPacket(draw(counters), draw(instants), draw(instants), tau, selection, rows)


def encode(packet: SensorPacket | ControlPacket) -> bytes:
    return encode_sensor(packet) if isinstance(packet, SensorPacket) else encode_control(packet)


packets = st.one_of(sensor_packets(), control_packets(), sensor_packets_2(), control_packets_2())


@given(packets)
def test_every_packet_comes_back_as_it_went(packet: SensorPacket | ControlPacket) -> None:
    data = encode(packet)
    tagged = with_tag(data, lambda signed: signed[:8])
    assert tagged is not None and len(tagged) >= len(data)
    for each in (data, tagged):
        assert decode(each) == packet
        assert packet_size(each) == len(each)


@given(packets)
def test_every_packet_has_the_length_of_a_frame(packet: SensorPacket | ControlPacket) -> None:
    size = len(encode(packet))
    assert size in FD_LENGTHS or (size > 64 and size % 8 == 0)


def test_the_crc_is_ccitt_false() -> None:
    data = encode_sensor(SensorPacket(seq=0x01020304, flags=MORE, sample_ns=-2, y=(1.5, -2.0)))
    assert data[:2] == struct.pack("<H", crc_hqx(data[2:], 0xFFFF))
    assert crc_hqx(b"123456789", 0xFFFF) == 0x29B1


def test_byte_layout_is_the_stated_one() -> None:
    tag = bytes(range(8))
    sensor = SensorPacket(7, MORE, -2, (1.5, -2.0), 1, 2, (3.0,), 4, 2**64 - 2, 9)
    data = with_tag(encode_sensor(sensor), lambda signed: tag)
    assert data is not None and data[2:] == struct.pack(
        "<BBIQqBBBBIfff8s12x", 0x31, 0x40 | 1, 7, 2**64 - 2, -2, 1, 2, 0x80 | 1, 4, 9, 1.5, -2.0, 3.0, tag
    )
    control = ControlPacket(7, 5, 6, -1, 3, ((1.0,), (2.0,)), 2**64 - 2, 9)
    data = with_tag(encode_control(control), lambda signed: tag)
    assert data is not None and data[2:] == struct.pack(
        "<BBIQqqhBBIff8s8x", 0x32, 0x80 | 3, 7, 2**64 - 2, 5, 6, -1, 2, 1, 9, 1.0, 2.0, tag
    )


def test_motor_packets_fit_one_fd_frame_with_a_tag_too() -> None:
    sensor = encode_sensor(SensorPacket(1, 0, 5, (3.0,), reference=(3.0,)))
    control = encode_control(ControlPacket(1, 0, 0, 1, 1, ((1.0,), (2.0,))))
    assert len(sensor) == len(with_tag(sensor, lambda signed: bytes(8)) or b"") == 48
    assert len(control) == 48 and len(with_tag(control, lambda signed: bytes(8)) or b"") == 64


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("y", {"samples": 2}), ("y", {"y": (0.0,) * 64}), ("y", {"y": (0.0,) * 256, "samples": 256}),
        ("reference", {"reference": (0.0,) * 128}), ("reference", {"y": (0.0,) * 945, "samples": 15, "reference": (0.0,) * 56}),
        ("node", {"node": 1}),
    ],
)  # fmt: skip
def test_sensor_packet_that_cannot_be_carried_is_refused_with_its_field(field: str, change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=rf"^{field}: "):
        encode_sensor(SensorPacket(0, 0, 0, (1.0,))._replace(**change))


@given(st.binary(max_size=300))
def test_arbitrary_bytes_never_raise(data: bytes) -> None:
    packet = decode(data)
    assert packet is None or packet_size(data) <= len(data)  # type: ignore[operator]


@given(st.binary(max_size=120), st.sampled_from((0x11, 0x22, 0x31, 0x32)))
def test_arbitrary_bytes_with_a_true_header_and_crc_never_raise_and_are_never_read_beyond(
    body: bytes, kind: int
) -> None:
    body = bytes((kind,)) + body
    data = crc_hqx(body, 0xFFFF).to_bytes(2, "little") + body
    packet = decode(data)
    if packet is not None:
        size = packet_size(data)
        assert size is not None and size <= len(data)
        assert len(encode(packet)) == size


@given(packets, st.data())
def test_every_proper_beginning_of_a_packet_is_refused(
    packet: SensorPacket | ControlPacket, data: st.DataObject
) -> None:
    whole = encode(packet)
    assert decode(whole[: data.draw(st.integers(0, len(whole) - 1))]) is None


@settings(max_examples=60, deadline=None)
@given(packets, st.integers(0, 7))
def test_crc_finds_every_flip_of_one_bit_padding_included(packet: SensorPacket | ControlPacket, padding: int) -> None:
    data = bytearray(encode(packet) + bytes(padding))
    for bit in range(8 * len(data)):
        data[bit >> 3] ^= 1 << (bit & 7)
        assert decode(bytes(data)) is None, bit
        data[bit >> 3] ^= 1 << (bit & 7)
    assert decode(bytes(data)) == packet


@given(packets, st.integers(1, 7))
def test_zero_padding_of_a_classic_frame_is_ignored_and_other_padding_refused(
    packet: SensorPacket | ControlPacket, padding: int
) -> None:
    data = encode(packet)
    assert decode(data + bytes(padding)) == packet
    assert decode(data + bytes(padding - 1) + b"\1") is None
    assert decode(data + bytes(8)) is None


def test_what_float32_cannot_hold_becomes_infinite_and_never_raises() -> None:
    sent = (1e300, -1e300, math.nan, math.inf, 3.4e38)
    sensor = decode(encode_sensor(SensorPacket(0, 0, 0, sent)))
    control = decode(encode_control(ControlPacket(0, 0, 0, 0, 0, (sent, sent))))
    assert isinstance(sensor, SensorPacket) and isinstance(control, ControlPacket)
    for received in (sensor.y, *control.rows):
        assert received[0] == math.inf and received[1] == -math.inf and math.isnan(received[2])
        assert received[3] == math.inf and received[4] == pytest.approx(3.4e38, rel=1e-6)


def test_counters_wrap_and_ages_saturate() -> None:
    packet = decode(encode_control(ControlPacket(2**32 + 5, 0, 0, 10**9, 0, ((0.0,),))))
    assert isinstance(packet, ControlPacket) and packet.seq == 5 and packet.tau == TAU_LIMIT


@pytest.mark.parametrize(("flags", "y"), [(0, ()), (EMPTY, (1.0,)), (0, (0.0,) * 64)])
def test_a_sensor_packet_that_contradicts_itself_is_refused(flags: int, y: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"^y: "):
        encode_sensor(SensorPacket(0, flags, 0, y))


@pytest.mark.parametrize(
    "rows", [((1.0,), (1.0, 2.0)), ((1.0, 2.0), (1.0,), (1.0, 2.0, 3.0)), ((), ()), ((0.0,),) * 256]
)
def test_ragged_or_empty_rows_are_refused(rows: tuple[tuple[float, ...], ...]) -> None:
    with pytest.raises(ValueError, match=r"^rows: "):
        encode_control(ControlPacket(0, 0, 0, 0, 0, rows))


def test_an_unknown_selection_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^selection: 5"):
        encode_control(ControlPacket(0, 0, 0, 0, 5, ((0.0,),)))


def hostile_inputs(number: int, rng: random.Random) -> None:
    """Feed ``number`` inputs: noise, noise behind a true header, mutated packets with and without a mended CRC."""
    valid = [
        encode_sensor(SensorPacket(3, 0, 10**9, tuple(rng.uniform(-9, 9) for _ in range(count))))
        for count in range(1, 14)
    ] + [
        encode_control(ControlPacket(3, 1, 2, 1, 1, tuple((rng.uniform(-9, 9),) * inputs for _ in range(rows))))
        for rows in range(1, 7)
        for inputs in range(1, 4)
    ]
    valid += [encode(packet._replace(counter=index)) for index, packet in enumerate(map(decode, valid)) if packet]
    for index in range(number):
        choice = index & 3
        if choice == 0:
            data = bytearray(rng.randbytes(rng.randrange(0, 90)))
        elif choice == 1:
            data = bytearray(rng.randbytes(rng.randrange(3, 90)))
            data[2] = (0x11, 0x22, 0x31, 0x32)[index >> 2 & 3]
        else:
            data = bytearray(rng.choice(valid))
            for _ in range(rng.randrange(1, 5)):
                data[rng.randrange(len(data))] = rng.randrange(256)
            del data[rng.randrange(len(data)) + 1 :: rng.choice((1, 1000))]
        if choice == 3 and len(data) > 2:
            data[:2] = crc_hqx(data[2:], 0xFFFF).to_bytes(2, "little")
        packet = decode(bytes(data))
        if packet is not None:
            size = packet_size(bytes(data))
            assert size is not None and size <= len(data)


def test_thirty_thousand_hostile_inputs_never_raise() -> None:
    hostile_inputs(30_000, random.Random(1))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_one_million_hostile_inputs_never_raise() -> None:
    hostile_inputs(1_000_000, random.Random(2))


@pytest.mark.parametrize(("offset", "value"), [(3, 0x80 | 1), (3, 0)], ids=["EMPTY with a value", "nothing and not EMPTY"])
def test_a_frame_that_contradicts_itself_is_refused_whatever_its_crc(offset: int, value: int) -> None:
    data = bytearray(encode_sensor(SensorPacket(0, 0, 0, (1.0,))))
    data[offset] = value
    data[:2] = crc_hqx(bytes(data[2:]), 0xFFFF).to_bytes(2, "little")
    assert not isinstance(decode(bytes(data)), SensorPacket)


def test_a_negative_age_saturates_at_its_own_end() -> None:
    packet = decode(encode_control(ControlPacket(0, 0, 0, -7, 0, ((0.0,),))))
    assert isinstance(packet, ControlPacket) and packet.tau == -1


def test_digest_and_tag_of_a_sensor_packet_are_about_every_value_and_no_padding() -> None:
    data, signed = encode_sensor(SensorPacket(3, 0, 10**9, (1.0, 2.0), reference=(3.0,))), []
    whole = echo([data])
    assert echo([data.ljust(64, b"\0")]) == whole
    assert whole not in [echo([data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]]) for at in range(32, 44)]

    def code(text: bytes) -> bytes:
        signed.append(bytes(text))
        return bytes(16)

    assert with_tag(data.ljust(64, b"\0"), code) is not None
    for other in (bytes(64), b"\xff" * 64, data[:2] + b"\x07" + data[3:].ljust(61, b"\xff")):
        assert with_tag(other, code) is None is tag_of(other)
    assert data[32:44] in signed[0]
