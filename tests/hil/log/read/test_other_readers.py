"""Logs in other people's hands: rosbags, mcap's ROS 2 support and Foxglove's readers read every topic."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from hil.experiment import load_experiment
from hil.log.read import Run, read_run
from hil.log.read.recover import recover
from hil.log.write.mcap_sink import McapSink
from hil.log.write.pipe_sink import PipeSink
from hil.log.write.pump import pump
from hil.session import run_session
from tests.hil.log.recording import PERIOD_NS, TABLE, provenance, record

NODE = Path(__file__).parents[3] / "node"
START_NS = 1_795_000_000_123_456_789  # some evening in 2026
SENT_NS, HEARD_NS = 40_000, 250_000


@pytest.fixture(scope="module", params=["virtual", "real"])
def log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of a run in virtual time; one as a session in real time writes it, through the pipe."""
    path: Path = tmp_path_factory.mktemp("log") / f"{request.param}.mcap"
    if request.param == "virtual":
        run_session(load_experiment("dc-motor-hinf", ["duration=0.5"]), path=path)
        return path
    read_fd, write_fd = os.pipe()
    with McapSink(path, TABLE, provenance(clock="real"), now=lambda: 0.0) as sink:
        far = PipeSink(write_fd, TABLE)
        far.begin(START_NS)
        for k in range(6):
            for behind, part in ((SENT_NS, "/link/sensor"), (HEARD_NS, "/link/control")):
                far.behind(behind)
                put = far.channel(part)
                assert put is not None
                put(k * PERIOD_NS, TABLE[part].schema.pack(k, 0, b"frame"))
        far.behind(0)
        record(far, 6, start=6)
        far.close()
        pump(read_fd, sink, TABLE)
        sink.event(12 * PERIOD_NS, "rig lost", "nul \0 and \ud800", a={"b": [1]})
    os.close(read_fd)
    return path


def counts(run: Run) -> dict[str, int]:
    return {topic: len(array) for topic, array in run.arrays.items()} | {"/events": len(run.events)}


def test_rosbags_reads_every_topic(log: Path) -> None:
    run = read_run(log)
    found: dict[str, list[Any]] = {topic: [] for topic in counts(run)}
    with AnyReader([log], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, t_ns, data in reader.messages():
            found[connection.topic].append((t_ns, reader.deserialize(data, connection.msgtype)))
    assert {topic: len(messages) for topic, messages in found.items()} == counts(run)
    for topic, array in run.arrays.items():
        for (t_ns, message), row in zip(found[topic], array):
            assert t_ns - run.start_ns == row["t_ns"]
            for name in array.dtype.names[1:]:
                value = getattr(message, name)
                np.testing.assert_array_equal(bytes(value) if name == "data" else value, row[name])
    assert [json.loads(message.data) for _, message in found["/events"]] == [event["data"] for event in run.events]
    assert [message.kind for _, message in found["/events"]] == [event["kind"] for event in run.events]


def test_the_ros_2_support_of_mcap_decodes_every_topic(log: Path) -> None:
    run = read_run(log)
    with open(log, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        decoded = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == len(decoded)
    assert {a.name for a in summary.attachment_indexes} >= {"experiment.toml", "resolved.json", "certificate.json"}
    assert {topic: sum(t == topic for t, _ in decoded) for topic in counts(run)} == counts(run)
    assert [m.message for topic, m in decoded if topic == "/events"] == [event["message"] for event in run.events]


@pytest.mark.foxglove
def test_foxglove_s_readers_read_every_topic(log: Path) -> None:
    reported = subprocess.run(["node", NODE / "read_log.mjs", log], capture_output=True, text=True, check=True, timeout=120)
    found, run = json.loads(reported.stdout), read_run(log)
    assert {topic: seen[0] for topic, seen in found.items()} == {topic: n for topic, n in counts(run).items() if n}
    for topic, (_, first_ns, last) in found.items():
        if topic == "/events":
            assert json.loads(last["data"]) == run.events[-1]["data"] and last["kind"] == run.events[-1]["kind"]
            continue
        array = run.arrays[topic]
        assert int(first_ns) - run.start_ns == array["t_ns"].min()
        newest = array[array["t_ns"] == array["t_ns"].max()][-1]
        for name in array.dtype.names[1:]:
            value = newest[name]
            assert last[name] is None or last[name] == (list(value) if isinstance(value, bytes) else value)  # None: NaN


def test_in_real_time_a_record_has_the_wall_clock_and_the_instant_within_its_slot(tmp_path: Path, log: Path) -> None:
    run = read_run(log)
    assert run.start_ns == (START_NS if log.stem == "real" else 0)
    if log.stem == "virtual":
        return
    with open(log, "rb") as file:
        stamps = [(c.topic, m.log_time, m.publish_time) for _, c, m in make_reader(file).iter_messages(log_time_order=False)]
    for topic, behind in (("/link/sensor", SENT_NS), ("/link/control", HEARD_NS)):
        own = [(log_ns, publish_ns) for t, log_ns, publish_ns in stamps if t == topic][:6]
        assert own == [(START_NS + k * PERIOD_NS, START_NS + k * PERIOD_NS + behind) for k in range(6)]
    state = run.arrays["/plant/state"]
    assert state["t_ns"].tolist() == [k * PERIOD_NS for k in range(6, 12)]
    lost = {"t_s": 0.012, "slot": -1, "kind": "rig lost", "severity": "info"}
    assert run.events[-1] == lost | {"message": "nul \\0 and \\ud800", "data": {"a": {"b": [1]}}}
    assert "up to 0.012 s of session time" in recover(log, tmp_path / "copy.mcap").text
    assert read_run(tmp_path / "copy.mcap").start_ns == START_NS
