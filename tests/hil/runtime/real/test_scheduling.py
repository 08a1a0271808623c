"""What the operating system grants is what the line says."""

from __future__ import annotations

import os
import subprocess
import sys

LATENCY = "/dev/cpu_dma_latency"
PROGRAM = """
import os
from hil.runtime.real.scheduling import go_real_time
print(go_real_time(1, None, awake=True))
print(*(os.readlink(f"/proc/self/fd/{fd}") for fd in os.listdir("/proc/self/fd") if os.path.lexists(f"/proc/self/fd/{fd}")))
"""


def test_idle_cpus_are_kept_awake_for_as_long_as_the_process_lives() -> None:
    said, held = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True).stdout.splitlines()
    assert ("CPUs awake" in said) == (LATENCY in held.split()) == os.access(LATENCY, os.W_OK)
    assert "gc frozen" in said
