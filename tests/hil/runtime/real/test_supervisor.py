"""The process that watches a session: its own watchdog, the memory that it gives back, and too few file descriptors."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryFile

import pytest
from msgspec import structs

from hil.runtime.real import supervisor
from hil.runtime.real.child import GRACE_S, LAST_LOOK_S, end_all
from hil.runtime.real.controller_process import ControllerReport, _write, read_reports
from hil.runtime.real.supervisor import START_S, HeartbeatTimeout

STEP_S = 0.02


def given_up_at(
    silence: HeartbeatTimeout, *,
    records: Callable[[float], int] = lambda t: 100, stopped: Callable[[float], bool] = lambda t: False,
) -> float:
    """Time at which the rig is given up, inf if it is not within an hour."""
    for look in range(round(3600 / STEP_S)):
        t = look * STEP_S
        if silence.look(round(t * 1e9), records(t), stopped(t)):
            return t
    return float("inf")


@pytest.mark.parametrize(("period_s", "bound_s"), [(0.001, 1.0), (0.05, 2.5)])
def test_a_stopped_rig_is_given_up_within_a_second_or_fifty_periods(period_s: float, bound_s: float) -> None:
    silence = HeartbeatTimeout(period_s, 15.0)
    assert given_up_at(silence, stopped=lambda t: True) == pytest.approx(bound_s, abs=0.05)
    assert "stopped" in (silence.look(10**13, 100, True) or "")


def test_a_silent_rig_that_is_not_stopped_has_ten_times_as_long() -> None:
    assert given_up_at(HeartbeatTimeout(0.001, 15.0)) == pytest.approx(10.0, abs=0.1)


def test_a_rig_that_waits_for_its_controller_is_not_silent() -> None:
    assert given_up_at(HeartbeatTimeout(0.001, 120.0), records=lambda t: 0) == pytest.approx(120 + START_S, abs=0.5)


def test_a_rig_that_went_on_in_time_is_kept() -> None:
    silence = HeartbeatTimeout(0.01, 15.0)
    assert given_up_at(silence, records=lambda t: int(t / 0.9), stopped=lambda t: t % 0.9 < 0.8) == float("inf")


def test_time_in_which_the_session_itself_stood_still_is_not_the_rigs() -> None:
    silence = HeartbeatTimeout(0.001, 15.0)
    assert silence.look(0, 100, False) is None
    assert silence.look(3600 * 10**9, 100, True) is None  # the machine slept for an hour


class Ending:
    """A process that ends so long after SIGTERM, or never, on a clock that only waiting moves."""

    now_ns = 0

    def __init__(self, after_s: float) -> None:
        self.after_s, self.asked_ns, self.killed_ns = after_s, -1, -1

    def terminate(self) -> None:
        self.asked_ns = Ending.now_ns

    def wait(self, timeout_s: float) -> bool:
        left_s = self.after_s - (Ending.now_ns - self.asked_ns) / 1e9
        Ending.now_ns += round(max(min(left_s, timeout_s), 0) * 1e9)
        return left_s <= timeout_s

    def kill(self) -> None:
        self.killed_ns = Ending.now_ns


@pytest.mark.parametrize("after_s", [(0.0, 0.0), (0.1, 0.3), (9.0, 0.1), (9.0, 9.0), (9.0,) * 5])
def test_all_are_asked_at_once_share_one_grace_and_are_killed(after_s: tuple[float, ...]) -> None:
    Ending.now_ns = 0
    children = [Ending(after) for after in after_s]
    end_all(children, now_ns=lambda: Ending.now_ns)
    assert all(child.asked_ns == 0 for child in children)
    assert [child.killed_ns >= 0 for child in children] == [after > GRACE_S for after in after_s]
    assert Ending.now_ns / 1e9 <= GRACE_S + LAST_LOOK_S * len(after_s) < 1.0


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


RUN = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[1]),) * 2)
from hil.cli import main
main(sys.argv[2:])
"""


@pytest.mark.parametrize(("link", "limits"), [("zenoh:?name=few", (9, 16)), ("can:hil:few", (9, 12))])
def test_a_run_without_descriptors_is_one_message_with_status_2(tmp_path: Path, link: str, limits: tuple[int, int]) -> None:
    statuses = []
    for most in limits:
        command = ["run", "dc-motor-hinf", "--clock", "real", "--link", link, "--duration", "0.1", "-o", "run.mcap"]
        done = subprocess.run(
            [sys.executable, "-c", RUN, str(most), *command], cwd=tmp_path, capture_output=True, text=True, timeout=120
        )
        assert done.returncode in (0, 2) and "Traceback" not in done.stderr, (most, done.stderr)
        if done.returncode:
            assert not any(tmp_path.iterdir())
            assert len(done.stderr.splitlines()) == 1 and done.stderr.startswith("hil: "), (most, done.stderr)
        (tmp_path / "run.mcap").unlink(missing_ok=True)
        statuses.append(done.returncode)
    assert 2 in statuses


@pytest.mark.parametrize("written", [b"", b'{"counts":', b"[]", b'{"counts": {"sent": "many"}}', b'{"departed": [1]}'])
def test_every_controller_of_a_session_that_ended_in_order_is_read_and_the_others_are_said(written: bytes) -> None:
    report = ControllerReport(counts={"sent": 3}, departed=(7, "by 0.2"), failed="no")
    after = ControllerReport(counts={"sent": 4, "refused": 1}, departed=(9, "by 0.3"))
    with TemporaryFile() as file:
        os.write(file.fileno(), written)
        assert read_reports(file, 1) == ControllerReport(silent=1)
        _write(file.fileno(), report)
        assert read_reports(file, 2) == structs.replace(report, silent=1)
        _write(file.fileno(), after)
        assert read_reports(file, 3) == structs.replace(report, counts={"sent": 7, "refused": 1}, silent=1)
