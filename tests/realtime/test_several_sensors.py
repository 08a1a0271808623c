"""Several sensor nodes in real time: the inputs are the virtual run's bit for bit, up to the first late packet."""

from __future__ import annotations

import json
import os
import re
from functools import cache
from pathlib import Path

import can
import numpy as np
import pytest

from design.controllers.historical import Historical
from hil.cli.guide import pages
from hil.compose import compose
from hil.experiment import load_experiment
from hil.runtime.virtual import simulate
from hil.session import run_session
from hil.session.replay.replay import verify
from tests.foreign_session import drive
from tests.forked_program import forked
from tests.ports import free_port

pytestmark = pytest.mark.realtime


STATES = {
    "multisensor-published": ("x1", "x2", "x3", "x4"), "multisensor-lossy": ("x1", "x2", "x3", "x4"),
    "dc-motor-two-nodes": ("angle", "speed"),
}  # fmt: skip


@cache
def designed(name: str) -> tuple[str, ...]:
    """The gains of an experiment with a design of its own, designed once for all links, as a change of the experiment."""
    gains = compose(load_experiment(name), certify=False).controller
    assert isinstance(gains, Historical)
    return (f"controller={{kind='historical', uses='{gains.uses}', gains={json.dumps(gains.gains)}}}",)


@pytest.mark.parametrize(("which", "name"), [*((0, name) for name in STATES), *((i, "dc-motor-two-nodes") for i in (1, 2))])
def test_several_nodes_in_real_time_are_the_virtual_ones(tmp_path: Path, which: int, name: str) -> None:
    link = [f"can:hil:nodes{os.getpid()}", f"zenoh:tcp/127.0.0.1:{free_port()}", "local:"][which]
    early = ["reference.0.at=0.2"] if name == "dc-motor-two-nodes" else []
    gains = designed(name) if name == "multisensor-lossy" else ()
    experiment = load_experiment(name, ["duration=1", "seed=5", *early, *gains])
    real = run_session(experiment, clock="real", link=link, path=tmp_path / "real.mcap")
    late = real.summary["timing"]["first_late_slot"]
    assert real.status == 0 or late is not None, real.summary
    virtual = simulate(compose(experiment), 5)
    end = 20 if late is None else late
    u = experiment.plant.inputs[0].name
    for topic, fields in (("/plant/state", STATES[name]), ("/actuator/applied", (u, "d", "row"))):
        for field in fields:
            np.testing.assert_array_equal(real.run.arrays[topic][field][:end], virtual.arrays[topic][field][:end])
    np.testing.assert_array_equal(real.run.arrays["/network/sc"]["reason"], virtual.arrays["/network/sc"]["reason"])
    assert real.run.arrays["/actuator/applied"][u][:end].any() or end < 8
    if late is None:
        assert verify(real.run).difference is None


def test_each_node_is_received_on_the_bus_under_the_identifier_that_the_experiment_gives_it(tmp_path: Path) -> None:
    ids = {"first": 0x090, "second": 0x091, "third": 0x210, "fourth": 0x2A0}
    changes = [f"network.nodes.{name}.can_id={number}" for name, number in ids.items()]
    experiment = load_experiment("multisensor-published", ["duration=0.4", "links.control_can_id=0x300", *changes])
    channel = f"ids{os.getpid()}"
    with can.Bus(interface="hil", channel=channel, fd=True) as bus:
        real = run_session(experiment, clock="real", link=f"can:hil:{channel}", path=tmp_path / "real.mcap")
        received: dict[int, set[int]] = {}
        while (frame := bus.recv(0.2)) is not None:
            received.setdefault(frame.arbitration_id, set()).add(frame.data[24])
    assert {**received, 0x300: {0}} == {number: {node} for node, number in enumerate(ids.values())} | {0x300: {0}}
    assert real.summary["slots"] == 8 and 0x300 in received
    late = real.summary["timing"]["first_late_slot"]
    end = 8 if late is None else late
    u = simulate(compose(experiment), 0).arrays["/actuator/applied"]["u1"][:end]
    np.testing.assert_array_equal(real.run.arrays["/actuator/applied"]["u1"][:end], u)


def test_the_foreign_controller_of_the_guide_drives_two_nodes(tmp_path: Path) -> None:
    """The program that `hil guide several-sensors` shows, in plain Python and python-can: it knows the frame layout alone."""
    (program,) = re.findall(r"```python\n(.*?)```", pages()["several-sensors"].read_text(encoding="utf-8"), re.S)
    assert "hil." not in program and "transport" not in program
    (tmp_path / "controller.py").write_text(program, encoding="utf-8")
    channel = f"two{os.getpid()}"
    with forked([str(tmp_path / "controller.py"), channel]):
        gain = "controller={kind='local', gain=[[-0.05, -0.006]]}"
        drive(tmp_path, "dc-motor-two-nodes", f"can:hil:{channel}", gain, duration_s=4)
