"""The record table: layout, names, and agreement with an independent CDR decoder."""

from __future__ import annotations

import pickle
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Schema as McapSchema
from mcap_ros2.decoder import DecoderFactory

from hil.errors import HilError
from hil.log.records import Channel, Field, Schema, field_name
from hil.log.topics import Logged, channels


class Signal(NamedTuple):
    name: str
    unit: str


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


def test_the_table_has_the_topics_and_fields_of_a_session() -> None:
    assert [c.id for c in TABLE.values()] == list(range(1, 11))
    names = {topic: [f.name for f in c.schema.fields] for topic, c in TABLE.items()}
    assert names["/plant/state"] == ["angle", "speed", "tick"]
    assert names["/plant/measurement"] == names["/reference"] == ["angle", "tick"]
    assert names["/actuator/applied"] == [
        "voltage", "brake_torque", "w_voltage", "w_brake_torque", "tick", "packet_tick", "d", "row", "status",
    ]  # fmt: skip
    assert names["/controller/rows"][:6] == [
        "row0_voltage", "row0_brake_torque", "row1_voltage", "row1_brake_torque", "row2_voltage", "row2_brake_torque",
    ]  # fmt: skip
    assert names["/controller/rows"][6:] == ["sample_ns", "control_ns", "tick", "tau", "selection"]
    assert names["/network/sc"] == names["/network/ca"] == ["latency_s", "tick", "packet_tick", "mode", "age", "reason"]
    assert names["/link/sensor"] == names["/link/control"] == ["tick", "late", "data"]
    assert names["/timing/tick"] == ["lateness_us", "round_trip_us", "work_us", "tick", "late", "overrun"]


def test_units_stand_in_the_schema_text() -> None:
    assert "float64 speed  # rad/s\n" in TABLE["/plant/state"].schema.text
    assert "float64 lateness_us  # us, wake-up after the nominal time\n" in TABLE["/timing/tick"].schema.text


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


@pytest.mark.parametrize("names", [("angle", "Angle"), ("tick",), ("a b", "a_b")])
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


def test_a_schema_name_that_ros2_readers_cannot_take_is_refused() -> None:
    with pytest.raises(ValueError, match="package/msg/Name"):
        Schema(name="hil.PlantState", fields=(Field(type="float64", name="a"),))


def test_a_unit_cannot_break_the_schema_text() -> None:
    table = channels(Logged(states=[Signal("a", "m,\n s")], n_rows=1))
    assert table["/plant/state"].schema.fields[0].unit == "m s"
