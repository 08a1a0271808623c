"""The rig's process: what it does with overruns and with a bus that has faults ahead, what it refuses, and its end."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace

import pytest

from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.topics import channels_of
from hil.log.write import MemorySink
from hil.log.write.pipe_sink import PipeSink
from hil.rig.loop import Loop
from hil.rig.session_link import link_of, no_link
from hil.runtime.changes import ChangeReceiver
from hil.runtime.clock import monotonic_ns
from hil.runtime.nodes import session_wire
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.real import rig_process
from hil.runtime.real.controller_process import _answer_next, serve
from hil.runtime.real.ending import ENDED, useless_frames
from hil.runtime.real.exchange import Handshake
from hil.runtime.real.rig_process import PLAN_NS, SETTLE_NS, Job, RealLoop
from hil.runtime.real.supervisor import Processes, run_real
from transport.can_bus_model.disturbances import BusFault
from transport.links.contract import MemoryLink
from transport.links.opening import open_link

NEVER_CLOSED = """
import threading
from contextlib import ExitStack
from hil.runtime.real.ending import ENDED
from hil.runtime.real.rig_process import end_after
with ExitStack() as link:
    link.callback(threading.Event().wait)
    end_after(0.05, ENDED)
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


@pytest.fixture(scope="module")
def loop() -> Loop:
    return compose(load_experiment("dc-motor-hinf"), certify=False)


@pytest.fixture
def ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Return the link of an end with these options, on a channel of its own."""
    monkeypatch.setenv("HIL_CAN_DIR", str(tmp_path))
    (tmp_path / "frames.key").write_text("00" * 16)
    (tmp_path / "frames.key").chmod(0o600)
    return lambda options: f"can:hil:x?{options.replace('KEY', str(tmp_path / 'frames.key'))}"


class Heard(Exception):
    pass


@contextmanager
def beside(work: Callable[[Callable[[], bool]], object]) -> Iterator[None]:
    """Do something in another thread, until the block ends."""
    over = Event()
    other = Thread(target=work, args=(over.is_set,))
    other.start()
    try:
        yield
    finally:
        over.set()
        other.join()


def answer(loop: Loop, uri: str, over: Callable[[], bool]) -> None:
    node, changes = ControlNode(loop), ChangeReceiver(-1)
    with open_link(uri, "controller") as link:
        while not over():
            _answer_next(node, link, changes)


def test_a_rig_waits_for_the_controller_of_its_own_session(
    loop: Loop, ends: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of several sessions on one link one has the rig and another the controller where both begin at once."""
    link, channels = link_of(loop.rig, ends("")), channels_of(loop)
    monkeypatch.setattr(Processes, "start_controller", lambda self: None)
    with beside(partial(answer, loop, link.uri)), pytest.raises(HilError, match=r"no controller answered on .* within 0\.5 s"):
        run_real(loop, 0, link, MemorySink(channels), hello_timeout_s=0.5)


@pytest.mark.parametrize(
    ("rig", "controller", "why"),
    [("", "fd=0", "CAN FD where fd=0"), ("fd=0", "", "give both ends the same base= and fd="), ("pad=1", "", "another pad="),
     ("base=0x200", "", "other CAN identifiers"), ("", "auth=KEY", "without a valid code")],
)  # fmt: skip
def test_a_controller_says_why_it_refuses_every_frame_of_a_rig(
    loop: Loop, ends: Callable[[str], str], rig: str, controller: str, why: str
) -> None:
    def greet(over: Callable[[], bool]) -> None:
        with open_link(ends(rig), "rig") as link:
            Handshake(link, 20.0, over, monotonic_ns, session_wire(bytes(16), 1)).greet()

    def heard(said: str) -> None:
        raise Heard(said)

    with beside(greet), pytest.raises(Heard, match=r"^\d\d+ frames came on can:hil:x.*" + why):
        serve(loop, ends(controller), warn=heard)


@pytest.mark.parametrize(("rig", "controller", "why"), [("auth=KEY", "", "without a valid code"), ("", "pad=1", "another pad=")])
def test_a_rig_that_refuses_every_answer_says_why(
    loop: Loop, ends: Callable[[str], str], rig: str, controller: str, why: str
) -> None:
    with beside(partial(answer, loop, ends(controller))), open_link(ends(rig), "rig") as link:
        def came() -> bool:
            return bool(link.counters.refused or handshake._foreign)

        handshake = Handshake(link, 20.0, came, monotonic_ns, session_wire(bytes(16), 1))
        found = handshake.greet()
        assert not found.answered and why in useless_frames("can:hil:x", link.counters, found.foreign)
