"""What was freed goes back to the system, once a second."""

import subprocess
import sys

import pytest

from hil.runtime.real import supervisor

HOLES = """
import ctypes, sys
from pathlib import Path
from hil.runtime.real.supervisor import EVERY_NS, FreeMemory

if not hasattr(ctypes.CDLL(None), "malloc_trim"):
    sys.exit(77)

def anonymous_kb():
    return int(Path("/proc/self/status").read_text().split("RssAnon:")[1].split()[0])

free = FreeMemory(0)
rows = [bytes(9_000) for _ in range(4_000)]
kept = rows[::50]
del rows
seen = [anonymous_kb()]
for now_ns in (0, EVERY_NS - 1, EVERY_NS):
    free.look(now_ns)
    seen.append(anonymous_kb())
print(*seen)
"""


def test_what_is_free_between_what_is_used_goes_back_when_it_is_time() -> None:
    reported = subprocess.run([sys.executable, "-c", HOLES], capture_output=True, text=True)
    if reported.returncode == 77:
        pytest.skip("another C library than glibc")
    assert reported.returncode == 0, reported.stderr
    before, first, early, due = map(int, reported.stdout.split())
    assert abs(first - before) < 1_000 and abs(early - before) < 1_000
    assert due < before - 20_000


def test_a_c_library_without_it_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor.ctypes, "CDLL", lambda name: object())
    supervisor.FreeMemory(0).look(10 * supervisor.EVERY_NS)
