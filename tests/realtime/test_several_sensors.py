"""Four sensor nodes in real time: the inputs are the virtual run's bit for bit, up to the first late packet."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import numpy as np
import pytest

from hil.compose.loop import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.replay import verify
from hil.session import run_session, simulate

pytestmark = pytest.mark.realtime


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


@pytest.mark.parametrize("name", ["multisensor-published", "multisensor-lossy"])
@pytest.mark.parametrize("which", [0, 1, 2], ids=["can-hil", "zenoh", "local"])
def test_four_nodes_in_real_time_are_the_virtual_ones(tmp_path: Path, which: int, name: str) -> None:
    link = [f"can:hil:nodes{os.getpid()}", f"zenoh:tcp/127.0.0.1:{free_port()}", "local:"][which]
    experiment = load_experiment(name, ["duration=2", "seed=5"])
    real = run_session(experiment, clock="real", link=link, path=tmp_path / "real.mcap")
    late = real.summary["timing"]["first_late_tick"]
    assert real.status == 0 or late is not None, real.summary
    virtual = simulate(compose(experiment), 5)
    end = 40 if late is None else late
    for topic, fields in (("/plant/state", ("x1", "x2", "x3", "x4")), ("/actuator/applied", ("u1", "d", "row"))):
        for field in fields:
            np.testing.assert_array_equal(real.run.arrays[topic][field][:end], virtual.arrays[topic][field][:end])
    np.testing.assert_array_equal(real.run.arrays["/network/sc"]["reason"], virtual.arrays["/network/sc"]["reason"])
    assert real.run.arrays["/actuator/applied"]["u1"][:end].any() or end < 4
    if late is None:
        assert verify(real.run).difference is None


def test_wire_version_1_cannot_carry_several_nodes(tmp_path: Path) -> None:
    experiment = load_experiment("multisensor-published", ["duration=1"])
    link = f"can:hil:nodes{os.getpid()}?version=1"
    with pytest.raises(HilError, match="wire version 1 knows one sensor node"):
        run_session(experiment, clock="real", link=link, path=tmp_path / "a.mcap")
    assert not (tmp_path / "a.mcap").exists()
