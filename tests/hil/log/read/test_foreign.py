"""Logs that hil did not write, or that were edited: one message names the field, for every kind that once ended elsewhere."""

import math
import struct
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from hil.errors import HilError
from hil.log import encode_event
from hil.log.read import check_events, check_topics, check_words, read_run
from hil.log.records import CDR_HEADER, EVENTS_TOPIC, Field, Schema
from hil.log.write.mcap_writer import McapWriter
from hil.log.write.provenance import FORMAT
from tests.hil.log.recording import TABLE

SCHEMAS = {topic: channel.schema for topic, channel in TABLE.items()}
EVENT = {"slot": 3, "t_s": 0.15, "kind": "safety", "severity": "error", "message": "limit", "data": {}}
RESOLVED: dict[str, Any] = {
    "period": 0.05, "plant": {}, "controller": {}, "disturbance": [{"at": 1.0}],
    "network": {"sc": {"law": {}}, "ca": {"law": {}}},
}  # fmt: skip


def test_what_hil_writes_is_taken() -> None:
    check_topics(SCHEMAS)
    check_events([EVENT, {**EVENT, "slot": -1, "t_s": 2}])
    certificate = {"state": "certified", "reason": "radius below 1"}
    check_words({"seed": "7"}, RESOLVED, {"problems": {}, "log": {"messages": 3, "path": "x.mcap"}}, certificate)


@pytest.mark.parametrize("topic", sorted(SCHEMAS))
def test_a_field_of_another_name_or_type_is_named_and_a_topic_may_lack(topic: str) -> None:
    check_topics({f"{name}2" if name == topic else name: schema for name, schema in SCHEMAS.items()})
    slot = next(f for f in SCHEMAS[topic].fields if f.name == "slot")
    others = tuple(f for f in SCHEMAS[topic].fields if f is not slot)
    renamed = tuple(Field(type=f.type, name="pick") if f is slot else f for f in SCHEMAS[topic].fields)
    for fields in (renamed, (Field(type="float64", name="slot"), *others)):
        with pytest.raises(HilError, match=f"topic {topic}: field slot: is (missing|float64), expected {slot.type}"):
            check_topics({**SCHEMAS, topic: Schema(name=SCHEMAS[topic].name, fields=fields)})


@pytest.mark.parametrize(
    "change",
    [
        {"slot": 10**400}, {"slot": -(1 << 63)}, {"t_s": 10**400}, {"t_s": math.nan}, {"t_s": -math.inf}, {"t_s": 1e300},
        {"data": "x"}, {"data": None},
    ],
    ids=lambda change: str(change)[:20],
)  # fmt: skip
def test_an_event_of_another_kind_is_named(change: dict[str, Any]) -> None:
    with pytest.raises(HilError, match=f"event 1: {next(iter(change))}: "):
        check_events([EVENT, {**EVENT, **change}])


@pytest.mark.parametrize("seed", ["", "x", "-1", "1e3", "1" * 25, "७"])
def test_a_seed_that_is_none_is_named(seed: str) -> None:
    with pytest.raises(HilError, match="metadata hilrig: seed"):
        check_words({"seed": seed}, {}, {}, {})


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("period", "x"), ("period", 0), ("period", math.nan), ("period", True), ("period", 10**400), ("plant", []),
        ("controller", "hinf"), ("network", 3), ("network.sc", []), ("network.ca.law", "markov"), ("disturbance", {}),
        ("disturbance", [3]), ("disturbance", [{}]), ("disturbance", [{"at": "1 s"}]), ("disturbance", [{"at": 10**400}]),
    ],
)  # fmt: skip
def test_an_experiment_of_other_types_is_named(path: str, value: Any) -> None:
    resolved: dict[str, Any] = deepcopy(RESOLVED)
    *folders, last = path.split(".")
    node = resolved
    for folder in folders:
        node = node[folder]
    node[last] = value
    with pytest.raises(HilError, match=rf"resolved\.json: {path}: "):
        check_words({"seed": "7"}, resolved, {}, {})


@pytest.mark.parametrize("summary", [{"problems": []}, {"log": "x"}, {"log": {"messages": None}}], ids=str)
def test_a_summary_of_other_types_is_named(summary: dict[str, Any]) -> None:
    with pytest.raises(HilError, match="metadata summary: "):
        check_words({"seed": "7"}, {}, summary, {})


@pytest.mark.parametrize("slot", [1 << 62, 17, -2])
def test_a_slot_that_is_none_of_so_many_records_is_named(tmp_path: Path, slot: int) -> None:
    schema = SCHEMAS["/link/control"]
    for right in (0, 16, -1):
        log_of(tmp_path / "a.mcap", (at_slot(right),), ("", b""))
        assert read_run(tmp_path / "a.mcap").arrays["/reference"]["slot"].tolist() == [right]
    stranger = ("/link/control", schema.text, "ros2msg", schema.pack(slot, 1, b""))
    log_of(tmp_path / "a.mcap", (stranger, at_slot(0)), ("", b""))
    assert read_run(tmp_path / "a.mcap").arrays["/link/control"]["slot"].tolist() == [slot], "a stranger's frame"
    log_of(tmp_path / "a.mcap", (at_slot(slot),), ("", b""))
    with pytest.raises(HilError, match=rf"a\.mcap: topic /reference: slot: {slot} to {slot}; in a log of 1 records -1 to 16"):
        read_run(tmp_path / "a.mcap")


@pytest.mark.parametrize(("late", "trip"), [(math.nan, 1.0), (-math.inf, 1.0), (0.0, math.inf), (0.0, -1e16)])
def test_a_time_that_no_slot_takes_is_named(tmp_path: Path, late: float, trip: float) -> None:
    schema = SCHEMAS["/timing/slot"]
    for values in ((5.0, math.nan), (late, trip)):
        payload = schema.pack(*values, 1.0, 0, 0, 0)
        log_of(tmp_path / "a.mcap", (("/timing/slot", schema.text, "ros2msg", payload),), ("", b""))
        if values == (late, trip):
            with pytest.raises(HilError, match=r"a\.mcap: topic /timing/slot: (lateness_us|round_trip_us): "):
                read_run(tmp_path / "a.mcap")
        else:
            assert len(read_run(tmp_path / "a.mcap").arrays["/timing/slot"]) == 1


@pytest.mark.parametrize("certificate", [{"state": "certified"}, {"state": 3, "reason": ""}, {"state": "", "reason": None}])
def test_a_certificate_without_its_words_is_named(certificate: dict[str, Any]) -> None:
    with pytest.raises(HilError, match=r"certificate\.json: (state|reason): .*, expected text"):
        check_words({"seed": "7"}, {}, {}, certificate)


HEAD = {"format": FORMAT, "experiment": "x", "seed": "0", "clock": "virtual", "link": ""}


def at_slot(k: int) -> tuple[str, str, str, bytes]:
    return "/reference", SCHEMAS["/reference"].text, "ros2msg", SCHEMAS["/reference"].pack(1.0, k)


REFERENCE = at_slot(0)
OTHER = SCHEMAS["/reference"].text.replace("angle", "speed")
AT_NO_INSTANT = CDR_HEADER + struct.pack("<d", math.inf) + encode_event(0, "mark", "", data={})[len(CDR_HEADER) + 8 :]
Topics = tuple[tuple[str, str, str, bytes], ...]


def log_of(path: Path, topics: Topics, attached: tuple[str, bytes], **said: dict[str, str]) -> None:
    with path.open("wb") as file:
        writer = McapWriter(file, profile="", library="")
        for name, values in ({"hilrig": HEAD} | said).items():
            if values:
                writer.add_metadata(name, values)
        writer.add_attachment(attached[0], "application/json", attached[1])
        for topic, text, encoding, payload in topics:
            schema = writer.register_schema("hil/msg/Reference", encoding, text.encode())
            writer.messages_of(writer.register_channel(topic, "cdr", schema))(0, payload)
        writer.finish()


@pytest.mark.parametrize(
    ("topics", "attached", "said", "message"),
    [
        ((), "", {}, "holds no records: the session ended before the first"),
        ((REFERENCE, REFERENCE), "", {}, "topic /reference: occurs twice in the file"),
        (((*REFERENCE[:3], b"short"),), "", {}, "topic /reference: record 0 of hil/msg/Reference: 5 bytes, expected 20"),
        (((*REFERENCE[:2], "jsonschema", b""),), "", {}, "topic /reference: expected a ros2msg schema and CDR messages"),
        ((("/reference", "float32 x  # 1", "ros2msg", b""),), "", {}, "topic /reference: unknown schema: type: 'float32'"),
        ((REFERENCE, (EVENTS_TOPIC, "", "ros2msg", b"none")), "", {}, "event 0: is no event: no little-endian CDR"),
        ((REFERENCE, (EVENTS_TOPIC, "", "ros2msg", AT_NO_INSTANT)), "", {}, "event 0: t_s: inf is no instant of a run"),
        ((REFERENCE, ("/plant/measurement", OTHER, *REFERENCE[2:])), "", {}, "topic /reference: signals angle, expected those"),
        ((REFERENCE,), "resolved.json={", {}, "attachment resolved.json is no JSON: "),
        ((REFERENCE,), "certificate.json=[3]", {}, "attachment certificate.json is no JSON object"),
        ((REFERENCE,), "", {"summary": {"json": "nothing"}}, "metadata 'summary' is no JSON: "),
        ((REFERENCE,), "", {"hilrig": HEAD | {"format": "1"}}, f"log format '1' is unknown, this version reads {FORMAT}"),
        ((REFERENCE,), "", {"hilrig": {}}, "is an MCAP file, but not a log of hilrig: it has no metadata record 'hilrig'"),
        ((("/x", "{}", "json", b""),), "", {"hilrig": {}}, "is an MCAP file, but not a log of hilrig: topic /x"),
        ((REFERENCE,), "", {"clock": {"start_ns": "-1"}}, "metadata clock: start_ns: '-1', expected nanoseconds since 1970"),
        ((REFERENCE,), "", {"clock": {"start_ns": str(1 << 62)}}, "metadata clock: start_ns: '4611686018427387904', expected"),
    ],
)  # fmt: skip
def test_what_no_session_writes_is_named(
    tmp_path: Path, topics: Topics, attached: str, said: dict[str, dict[str, str]], message: str
) -> None:
    name, _, content = attached.partition("=")
    log_of(tmp_path / "a.mcap", topics, (name, content.encode()), **said)
    with pytest.raises(HilError, match=rf"a\.mcap: {message}"):
        read_run(tmp_path / "a.mcap")


def test_a_log_of_more_topics_than_a_session_has_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each topic takes 64 KiB before its first record is a number: a file of 5 MB took 4 GB."""
    monkeypatch.setattr("hil.log.read.MOST_TOPICS", 3)
    topics = tuple((f"/t{i}", *REFERENCE[1:]) for i in range(4))
    log_of(tmp_path / "a.mcap", topics[:3], ("", b""))
    assert len(read_run(tmp_path / "a.mcap").arrays) == 3
    log_of(tmp_path / "a.mcap", topics, ("", b""))
    with pytest.raises(HilError, match=r"a\.mcap: more than 3 topics; no session has as many"):
        read_run(tmp_path / "a.mcap")


def test_a_log_of_one_topic_is_read(tmp_path: Path) -> None:
    log_of(tmp_path / "a.mcap", (REFERENCE,), ("resolved.json", b'{"period": 0.5}'), codes={"reason": "lost,sent"})
    run = read_run(tmp_path / "a.mcap")
    assert run.arrays["/reference"].tolist() == [(0, 1.0, 0)] and [*run.arrays] == ["/reference"]
    assert (run.resolved, run.certificate, run.summary, run.experiment_text) == ({"period": 0.5}, {}, {}, "")
    assert (run.metadata, run.codes, run.versions, run.session) == (HEAD, {"reason": ["lost", "sent"]}, {}, {})
