"""The records of frames say their CAN identifiers where the link is a CAN link, and nothing of it elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.read import Run, read_run
from hil.log.topics import channels_of
from hil.log.write import MemorySink, Sink
from hil.log.write.mcap_sink import McapSink
from hil.rig.loop import Loop
from hil.rig.session_link import link_of
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.journal import Journal
from hil.runtime.nodes.rig import Rig
from hil.runtime.slot import Slot
from hil.runtime.virtual import DirectExchange, simulate
from tests.hil.log.recording import provenance
from transport.links.can_identifiers import Identifiers
from transport.packets import node_of

SLOTS = 20


def recorded(loop: Loop, uri: str, sink: Sink) -> None:
    """Record what a session over this link records, in virtual time."""
    link = link_of(loop.rig, uri)
    rig = Rig(loop, 0, sink, channels_of(loop, on_can=link.on_can), lambda: None, identifiers=link.logged)
    slot = Slot(rig, DirectExchange(ControlNode(loop)))
    for k in range(SLOTS):
        slot.run(k * loop.experiment.period_ns)


def run_over(loop: Loop, uri: str) -> Run:
    sink = MemorySink(channels_of(loop, on_can=link_of(loop.rig, uri).on_can))
    recorded(loop, uri, sink)
    return Run.from_memory(sink)


@pytest.mark.parametrize(("uri", "sensor", "control"), [("can:hil:a", 0x100, 0x140), ("can:hil:a?fd=0&base=0x200", 0x280, 0x2C0)])
def test_a_record_has_the_identifier_of_its_packet(uri: str, sensor: int, control: int) -> None:
    run = run_over(compose(load_experiment("dc-motor-hinf")), uri)
    assert set(run.arrays["/link/sensor"]["can_id"]) == {sensor} and set(run.arrays["/link/control"]["can_id"]) == {control}
    assert run.schemas["/link/sensor"].name == "hil/msg/CanFrame"


def test_every_node_has_its_own() -> None:
    loop = compose(load_experiment("multisensor-published", ["duration=1"]))
    frames = run_over(loop, link_of(loop.rig, "can:hil:a").uri).arrays["/link/sensor"]
    nodes = np.array([node_of(bytes(data)) for data in frames["data"]])
    assert set(nodes) == {0, 1, 2, 3} and frames["can_id"].tolist() == [0x100 + 16 * node for node in nodes]


def test_nothing_else_of_a_run_changes_and_no_other_link_has_the_field() -> None:
    loop = compose(load_experiment("dc-motor-hinf", [f"duration={SLOTS * 0.05}"]))
    assert link_of(loop.rig, "zenoh:tcp/127.0.0.1:7447").logged is None
    virtual, can = simulate(loop, 0), run_over(loop, "can:hil:a")
    for topic, records in virtual.arrays.items():
        names = records.dtype.names or ()
        assert set(can.arrays[topic].dtype.names or ()) - set(names) == ({"can_id"} if topic.startswith("/link/") else set())
        for name in names:
            np.testing.assert_array_equal(can.arrays[topic][name], records[name])


def test_a_file_has_it_and_a_slot_that_is_packed_at_once_too(tmp_path: Path) -> None:
    loop = compose(load_experiment("dc-motor-hinf"))
    about = provenance(link="can:hil:a", experiment_text=loop.experiment.text, resolved=loop.experiment.resolved())
    with McapSink(tmp_path / "run.mcap", channels_of(loop, on_can=True), about) as sink:
        recorded(loop, "can:hil:a", sink)
    run = read_run(tmp_path / "run.mcap")
    assert run.arrays["/link/control"]["can_id"].tolist() == [0x140] * SLOTS
    assert [len(data) for data in run.arrays["/link/sensor"]["data"]] == [
        len(data) for data in simulate(loop, 0).arrays["/link/sensor"]["data"][:SLOTS]
    ]


def test_a_mangled_number_names_no_process() -> None:
    loop = compose(load_experiment("multisensor-published", ["duration=1"]))
    table = channels_of(loop, on_can=True)
    sink = MemorySink(table)
    identifiers = Identifiers(sensors=tuple(range(i, i + 1) for i in range(1, 5)), control=range(9, 10))
    journal = Journal(sink, table, 1, [(i,) for i in range(4)], identifiers)
    frame = bytes(loop_frame(loop))
    journal.asked(0, 0, [frame, frame[:24] + bytes((77,)) + frame[25:]])
    assert Run.from_memory(sink).arrays["/link/sensor"]["can_id"].tolist() == [2, -1]


def loop_frame(loop: Loop) -> bytes:
    """Return a frame of node 1."""
    return next(bytes(data) for data in simulate(loop, 0).arrays["/link/sensor"]["data"] if node_of(bytes(data)) == 1)
