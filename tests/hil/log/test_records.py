"""The record table: layout, names, and agreement with an independent CDR decoder."""

from __future__ import annotations

import pickle
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Schema as McapSchema
from mcap_ros2.decoder import DecoderFactory

from hil.errors import HilError
from hil.log import Logged
from hil.log.records import Channel, Field, Schema, field_name
from hil.log.run import assemble
from hil.log.topics import channels
from tests.hil.log.recording import Signal

TABLE = channels(Logged(
    states=(Signal("angle", "rad"), Signal("speed", "rad/s")),
    inputs=(Signal("voltage", "V"), Signal("Brake torque", "N m")),
    outputs=(Signal("angle", "rad"),),
    n_rows=3,
))

_VALUES = {
    "float64": st.floats(),
    "int64": st.integers(-(2**63), 2**63 - 1),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "uint8": st.integers(0, 255),
    "uint8[]": st.binary(max_size=200),
}


def ros2(schema: Schema, payload: bytes) -> Any:
    mcap_schema = McapSchema(id=1, name=schema.name, encoding="ros2msg", data=schema.text.encode())
    decode = DecoderFactory().decoder_for("cdr", mcap_schema)
    assert decode is not None
    return decode(payload)


def values_of(schema: Schema) -> st.SearchStrategy[tuple[Any, ...]]:
    return st.tuples(*(_VALUES[f.type] for f in schema.fields))


def same(a: Any, b: Any) -> bool:
    return a == b or (a != a and b != b)


def assert_decoded(schema: Schema, values: Sequence[Any]) -> None:
    message = ros2(schema, schema.pack(*values))
    for f, value in zip(schema.fields, values, strict=True):
        got = getattr(message, f.name)
        assert same(bytes(got) if f.type == "uint8[]" else got, value), f


@given(st.data())
def test_an_independent_decoder_reads_what_pack_wrote(data: st.DataObject) -> None:
    schema = data.draw(st.sampled_from(list(TABLE.values()))).schema
    assert_decoded(schema, data.draw(values_of(schema)))


@given(st.data())
def test_the_dtype_reads_what_pack_wrote(data: st.DataObject) -> None:
    schema = data.draw(st.sampled_from(list(TABLE.values()))).schema
    values = data.draw(values_of(schema))
    payload = schema.pack(*values)
    record = np.frombuffer(payload, schema.dtype, count=1, offset=4)[0]
    for name, value in zip(schema.dtype.names or (), values, strict=False):
        assert same(record[name].item(), value)
    if schema.raw:
        assert payload[schema.data_offset :] == values[-1]
    else:
        assert len(payload) == 4 + schema.dtype.itemsize


_NUMBERS = st.lists(st.sampled_from(["float64", "int64", "int32", "uint8"]), min_size=1, max_size=9)


@given(_NUMBERS, st.booleans(), st.data())
def test_packed_is_aligned_for_every_schema_that_is_accepted(types: list[str], raw: bool, data: st.DataObject) -> None:
    order = ["float64", "int64", "int32", "uint8", "uint8[]"]
    types = sorted(types, key=order.index) + ["uint8[]"] * raw
    schema = Schema(name="hil/msg/Any", fields=tuple(Field(type=t, name=f"f{i}") for i, t in enumerate(types)))
    assert_decoded(schema, data.draw(values_of(schema)))


@pytest.mark.parametrize("channel", TABLE.values(), ids=lambda c: c.topic)
def test_a_schema_is_read_back_from_its_text(channel: Channel) -> None:
    again = Schema.from_text(channel.schema.name, channel.schema.text)
    assert again == channel.schema
    assert again.dtype == channel.schema.dtype


@pytest.mark.parametrize("channel", TABLE.values(), ids=lambda c: c.topic)
def test_a_channel_travels_to_another_process(channel: Channel) -> None:
    again = pickle.loads(pickle.dumps(channel))
    assert again == channel
    values = [b"xy" if f.type == "uint8[]" else 1 for f in channel.schema.fields]
    assert again.schema.pack(*values) == channel.schema.pack(*values)


@given(st.text(max_size=60))
def test_foreign_schema_text_is_refused_or_read_but_never_breaks(text: str) -> None:
    try:
        Schema.from_text("hil/msg/Any", text)
    except ValueError:
        pass


@given(st.text(max_size=20))
def test_a_field_name_is_valid_or_refused_with_the_signal_named(name: str) -> None:
    try:
        clean = field_name(name)
    except HilError as error:
        assert repr(name) in str(error)
    else:
        assert re.fullmatch(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*", clean)


@pytest.mark.parametrize("names", [("angle", "Angle"), ("slot",), ("a b", "a_b")])
def test_signals_that_would_share_a_field_are_refused(names: tuple[str, ...]) -> None:
    signals = [Signal(name, "1") for name in names]
    with pytest.raises(HilError, match=r"log topic /plant/state.* more than one field"):
        channels(Logged(states=signals, n_rows=1))


@pytest.mark.parametrize(
    "types",
    [("int64", "float64"), ("uint8[]", "uint8"), ("uint8[]", "uint8[]"), ()],
)
def test_a_layout_that_would_not_be_aligned_is_refused(types: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=r"fields: hil/msg/Bad must be ordered"):
        Schema(name="hil/msg/Bad", fields=tuple(Field(type=t, name=f"f{i}") for i, t in enumerate(types)))


def test_the_time_of_a_record_is_no_name_of_a_signal() -> None:
    with pytest.raises(HilError, match=r"signal 'T ns': 't_ns' is the log's own name for the time of a record"):
        field_name("T ns")


def test_a_schema_name_that_ros2_readers_cannot_take_is_refused() -> None:
    with pytest.raises(ValueError, match="package/msg/Name"):
        Schema(name="hil.PlantState", fields=(Field(type="float64", name="a"),))


def test_a_unit_cannot_break_the_schema_text() -> None:
    table = channels(Logged(states=[Signal("a", "m,\n s")], n_rows=1))
    assert table["/plant/state"].schema.fields[0].unit == "m s"


PLAIN = Schema(name="hil/msg/Plain", fields=(Field(type="float64", name="x"), Field(type="int32", name="k")))
RAW = Schema(name="hil/msg/Raw", fields=(Field(type="int64", name="slot"), Field(type="uint8[]", name="data")))


def test_records_become_an_array_with_their_own_times_or_given_ones() -> None:
    packed = [PLAIN.pack(0.5 * k, k) for k in range(3)]
    found = assemble(PLAIN, packed, times=[10, 20, 30])
    assert found["t_ns"].tolist() == [10, 20, 30] and found["x"].tolist() == [0.0, 0.5, 1.0] and found["k"].tolist() == [0, 1, 2]
    framed = [b"head" + (100 * k).to_bytes(8, "little") + each for k, each in enumerate(packed)]
    assert assemble(PLAIN, framed, payload_at=12, time_at=4)["t_ns"].tolist() == [0, 100, 200]
    raw = assemble(RAW, [RAW.pack(7, b"abc"), RAW.pack(8, b"")], times=[1, 2])
    assert raw["slot"].tolist() == [7, 8] and raw["data"].tolist() == [b"abc", b""]
    assert len(assemble(RAW, [])) == 0


@pytest.mark.parametrize("payload_at", [0, 5])
def test_a_record_of_another_length_or_form_is_refused_with_its_number(payload_at: int) -> None:
    good, raw = (bytes(payload_at) + each for each in (PLAIN.pack(1.0, 2), RAW.pack(7, b"abc")))
    size = len(good) - payload_at
    big = good[:payload_at] + b"\0\0" + good[payload_at + 2 :]
    for schema, records, said in (
        (PLAIN, [good, good[:-1]], f"record 1 of hil/msg/Plain: {size - 1} bytes, expected {size}"),
        (PLAIN, [good + b"0"], f"record 0 of hil/msg/Plain: {size + 1} bytes, expected {size}"),
        (PLAIN, [good, good, big], "record 2 of hil/msg/Plain: no little-endian CDR"),
        (RAW, [raw, raw[:-1]], "record 1 of hil/msg/Raw: .* not as its length states"),
        (RAW, [raw + b"0"], "record 0 of hil/msg/Raw: .* not as its length states"),
        (RAW, [raw, raw, raw[: payload_at + 6]], "record 2 of hil/msg/Raw: 6 bytes, not as its length states"),
    ):  # fmt: skip
        with pytest.raises(HilError, match=said):
            assemble(schema, records, payload_at=payload_at, times=[0] * len(records))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"type": "float32"}, "type: 'float32', expected one of float64"), ({"name": "Speed"}, "name: 'Speed' is no ROS 2"),
        ({"name": "a__b"}, "is no ROS 2 field name"), ({"unit": "m,s"}, "unit: 'm,s' or its doc holds a comma or a line break"),
        ({"unit": "m\n"}, "or a line break"), ({"doc": "two\nlines"}, "or a line break"),
    ],
)  # fmt: skip
def test_a_field_that_its_text_could_not_say_is_refused(given: dict[str, str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Field(**({"type": "float64", "name": "x"} | given))
    assert Field(type="float64", name="x", doc="a doc, with a comma").line == "float64 x  # 1, a doc, with a comma"
