"""What the operating system grants is what the line says."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from hil.experiment.tables import Affinity
from hil.runtime.real import leave_to_loop
from transport.links.traits import traits_of

LATENCY = "/dev/cpu_dma_latency"
PROGRAM = """
import os
from hil.runtime.real import go_real_time
print(go_real_time(1, None, awake=True))
print(*(os.readlink(f"/proc/self/fd/{fd}") for fd in os.listdir("/proc/self/fd") if os.path.lexists(f"/proc/self/fd/{fd}")))
"""


def test_idle_cpus_are_kept_awake_for_as_long_as_the_process_lives() -> None:
    said, held = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True).stdout.splitlines()
    assert ("CPUs awake" in said) == (LATENCY in held.split()) == os.access(LATENCY, os.W_OK)
    assert "gc frozen" in said


@pytest.mark.parametrize(
    ("affinity", "uri", "leaves"),
    [("shared", "can:hil:rig0", True), ("auto", "zenoh:", True), ("auto", "can:hil:rig0", False), ("pinned", "zenoh:", False)],
)
def test_the_log_keeps_off_the_cpu_that_rig_and_controller_share(affinity: Affinity, uri: str, leaves: bool) -> None:
    def cpus() -> set[int]:
        leave_to_loop(affinity, traits_of(uri))
        return os.sched_getaffinity(0)  # of this thread

    allowed = os.sched_getaffinity(0)
    with ThreadPoolExecutor(1) as other:
        left = other.submit(cpus).result()
    assert left == (allowed - {max(allowed)} if leaves and len(allowed) > 1 else allowed)
    assert os.sched_getaffinity(0) == allowed


def test_what_takes_long_is_done_before_real_time_and_after_it() -> None:
    """Locked memory, a collection of garbage, the end of Python: in real time they kept the loops of other sessions waiting."""
    program = """
import gc, os, threading
import hil.runtime.real as machine
policy = lambda: os.sched_getscheduler(0)
policies = lambda: {os.sched_getscheduler(int(thread)) for thread in os.listdir("/proc/self/task")}
seen, collect = [], gc.collect
gc.collect = lambda: (seen.append(policy()), collect())
machine.go_real_time(1, None)
seen.append(policy())
threading.Thread(target=threading.Event().wait, daemon=True).start()  # as those of a link: of the priority of what opened it
machine.leave_real_time()
print(*seen, *policies(), flush=True)
os._exit(0)
"""
    before, within, after = map(int, subprocess.check_output([sys.executable, "-c", program]).split())
    assert before == after == os.SCHED_OTHER
    assert within in (os.SCHED_FIFO, os.SCHED_OTHER)  # as allowed
