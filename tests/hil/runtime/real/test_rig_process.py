"""The rig's process: what it does with overruns and with a bus that has faults ahead, and its end."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.topics import channels_of
from hil.log.write.pipe_sink import PipeSink
from hil.rig.session_link import no_link
from hil.runtime.nodes import session_wire
from hil.runtime.real import rig_process
from hil.runtime.real.ending import ENDED
from hil.runtime.real.rig_process import PLAN_NS, SETTLE_NS, Job, RealLoop
from transport.can_bus_model.disturbances import BusFault
from transport.links.memory import MemoryLink

NEVER_CLOSED = """
import threading
from contextlib import ExitStack
from hil.runtime.real.ending import ENDED
from hil.runtime.real.rig_process import _leave
with ExitStack() as link:
    link.callback(threading.Event().wait)
    _leave(ENDED)
"""


def test_a_link_that_never_closes_does_not_keep_the_rig_from_its_end() -> None:
    assert subprocess.run([sys.executable, "-c", NEVER_CLOSED], timeout=60).returncode == ENDED


@pytest.fixture
def real() -> Iterator[RealLoop]:
    loop = compose(load_experiment("dc-motor-hinf"), certify=False)
    read, write = os.pipe()
    job = Job(loop=loop, link=no_link(loop.rig), seed=7, parent=os.getpid(), log_fd=write, hello_timeout_s=1.0)
    yield RealLoop(job, MemoryLink(), PipeSink(write, channels_of(loop)), session_wire(bytes(16), 1))
    for fd in (read, write):
        os.close(fd)


@pytest.mark.parametrize("planned", [False, True])
def test_a_bus_that_has_faults_ahead_learns_them_in_session_time_long_before_slot_0(
    real: RealLoop, planned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, disturbed = 5_000_000_000, []
    monkeypatch.setattr(rig_process, "monotonic_ns", lambda: now)
    fault = BusFault(first_ns=10, end_ns=20, rate=0.5)
    real._link_faults = [fault] * planned
    real._on_bus = SimpleNamespace(disturb=lambda faults, seed: disturbed.append((faults, seed)))  # type: ignore[assignment]
    real.clock = SimpleNamespace(begin=disturbed.append)  # type: ignore[assignment]
    real.begin()
    start = now + (PLAN_NS if planned else SETTLE_NS)
    assert disturbed == [([fault._replace(first_ns=start + 10, end_ns=start + 20)], 7)] * planned + [start]
    assert PLAN_NS >= 10 * SETTLE_NS


def test_an_overrun_is_a_slot_that_ends_after_its_period(real: RealLoop) -> None:
    period = 50_000_000
    for end, overruns in ((period, 0), (period + 1, 1), (3 * period, 2)):
        real.clock = SimpleNamespace(now=lambda end=end: end)  # type: ignore[assignment]
        real._commit()
        assert real.overruns == overruns
