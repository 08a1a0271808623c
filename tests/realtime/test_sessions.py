"""Sessions in real time over real links: the injected modes, states and inputs are the virtual run's, up to a late slot."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from hil.compose import compose
from hil.errors import Terminated
from hil.experiment import experiment_from_resolved, load_experiment
from hil.log.read import read_run
from hil.log.topics import FRAME_TOPICS
from hil.runtime.virtual import simulate
from hil.session import run_session
from hil.session.replay.replay import verify
from tests.foreign_session import drive
from tests.forked_program import forked
from tests.onlooker import Looks
from tests.ports import free_port
from tests.waiting import gone, until
from tests.warm_hil import hil_command

pytestmark = pytest.mark.realtime

ROOM_S = 30.0  # thirty times what a quiet machine needs; the sequence of a stop is tested with a clock of its own


def links() -> list[str]:
    return [f"can:hil:test{os.getpid()}", f"zenoh:tcp/127.0.0.1:{free_port()}", "local:"]


@pytest.mark.parametrize("which", [0, 1, 2], ids=["can-hil", "zenoh", "local"])
def test_real_run_equals_the_virtual_run_up_to_the_first_late_slot(tmp_path: Path, which: int) -> None:
    changes = ["duration=1.5", "reference.0.at=0.25", "seed=11"]
    experiment = load_experiment("dc-motor-hinf", changes)
    begun_ns = time.time_ns()
    real = run_session(experiment, clock="real", link=links()[which], path=tmp_path / "real.mcap")
    assert begun_ns < real.run.start_ns < time.time_ns()
    late = real.summary["timing"]["first_late_slot"]
    assert real.status == 0 or late is not None, real.summary  # a machine that stalls for long may trip the watchdog
    virtual = simulate(compose(experiment), 11)
    end = 30 if late is None else late
    for side in ("/network/sc", "/network/ca"):
        a, b = real.run.arrays[side], virtual.arrays[side]
        a, b = a[a["mode"] >= 0], b[b["mode"] >= 0]
        np.testing.assert_array_equal(a["mode"], b["mode"][: len(a)])  # to the end, late or not
    for topic, fields in (("/plant/state", ("angle", "speed")), ("/actuator/applied", ("voltage", "d", "row"))):
        for name in fields:
            np.testing.assert_array_equal(real.run.arrays[topic][name][:end], virtual.arrays[topic][name][:end])
    assert len(real.run.arrays["/timing/slot"]) == real.summary["slots"]
    assert real.summary["log"]["dropped"] == 0
    said = [set(real.run.arrays[topic]["can_id"]) for topic in FRAME_TOPICS if "can_id" in real.run.arrays[topic].dtype.names]
    assert said == ([{0x100}, {0x140}] if which == 0 else [])
    if late is None:
        assert verify(real.run).difference is None
        with open(tmp_path / "real.mcap", "rb") as file:
            published = {(c.topic, m.log_time): m.publish_time for _, c, m in make_reader(file).iter_messages()}
        for t_ns, round_trip_us in real.run.arrays["/timing/slot"][["t_ns", "round_trip_us"]].tolist():
            sent, received = (published[topic, real.run.start_ns + t_ns] for topic in ("/link/sensor", "/link/control"))
            assert abs((received - sent) / 1e3 - round_trip_us) < 0.01


@pytest.mark.parametrize("which", [0, 1], ids=["can-hil", "zenoh"])
def test_the_haptic_rig_at_1_khz_is_the_virtual_one_up_to_the_first_late_packet(tmp_path: Path, which: int) -> None:
    experiment = load_experiment("omni-1khz", ["duration=0.75"])
    real = run_session(experiment, clock="real", link=links()[which], path=tmp_path / "real.mcap")
    late = real.summary["timing"]["first_late_slot"]
    assert real.status == 0 or late is not None, real.summary
    assert real.summary["log"]["dropped"] == 0 and not real.summary.get("problems"), real.summary
    assert len(real.run.arrays["/timing/slot"]) == real.summary["slots"]
    virtual, end = simulate(compose(experiment), experiment.seed), real.summary["slots"] if late is None else late
    for topic, fields in (
        ("/actuator/applied", ("force", "d", "row")), ("/plant/state", ("position", "speed", "y", "z", "push", "given")),
        ("/plant/measurement", ("position", "y", "z")),
    ):  # fmt: skip
        for name in fields:
            np.testing.assert_array_equal(real.run.arrays[topic][name][:end], virtual.arrays[topic][name][:end])
    if late is None:
        assert real.summary["slots"] == 750 and verify(real.run).difference is None


class Running:
    """A `hil run` in the background, with the pids of its children."""

    def __init__(self, folder: Path, *args: str, experiment: str = "dc-motor-hinf", duration: str = "30") -> None:
        self.log = folder / "run.mcap"
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hil", "run", experiment, "--clock", "real", "--link", f"can:hil:k{os.getpid()}", "--json",
             "--duration", duration, "-o", str(self.log), *args],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def child(self, name: str) -> int:
        """Pid of the rig's or the controller's process, once the log has slots in it."""
        until(lambda: self.process.poll() is not None or (self.log.exists() and self.log.stat().st_size > 12_000), "the session")
        assert self.process.poll() is None, self.process.communicate()
        for line in subprocess.run(["ps", "-wweo", "pid,ppid,args"], capture_output=True, text=True).stdout.splitlines():
            pid, ppid, args = line.split(None, 2)
            if ppid == str(self.process.pid) and f"hil.runtime.real.{name}_process" in args:
                return int(pid)
        raise AssertionError(f"no {name} process")

    def finish(self, timeout: float = 120.0) -> tuple[int, dict[str, Any]]:
        out, err = self.process.communicate(timeout=timeout)
        assert "Traceback" not in err, err
        return self.process.returncode, json.loads(out) if out else {}


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Running]:
    running = Running(tmp_path)
    yield running
    if running.process.poll() is None:
        running.process.kill()
    running.process.wait()


def statuses(path: Path) -> list[int]:
    return read_run(path).arrays["/actuator/applied"]["status"].tolist()


def test_killed_controller_leaves_the_rig_up_in_its_safe_state_and_said(session: Running) -> None:
    os.kill(session.child("controller"), signal.SIGKILL)
    status, summary = session.finish()
    assert status == 3
    assert "watchdog" in summary["safety"]
    assert "SIGKILL" in summary["problems"]["controller_lost"]
    got = statuses(session.log)
    assert got.count(3) >= 20  # one second of safe state was logged after the trip
    applied = read_run(session.log).arrays["/actuator/applied"]
    assert np.all(applied["voltage"][applied["status"] == 3] == 0)


def test_stopped_controller_trips_the_watchdog_and_does_not_outlive_the_session(session: Running) -> None:
    pid = session.child("controller")
    os.kill(pid, signal.SIGSTOP)
    status, summary = session.finish()
    assert status == 3 and "watchdog" in summary["safety"]
    until(lambda: gone(pid), "the controller's end", ROOM_S)


@pytest.mark.parametrize(("number", "how"), [(signal.SIGKILL, "killed by SIGKILL"), (signal.SIGTERM, "ended with status 143")])
def test_killed_rig_ends_the_session_and_keeps_the_log(session: Running, number: int, how: str) -> None:
    controller = session.child("controller")
    os.kill(session.child("rig"), number)
    status, summary = session.finish()
    assert status == 1
    assert how in summary["problems"]["rig_lost"]
    assert len(read_run(session.log).arrays["/plant/state"]) > 3
    until(lambda: gone(controller), "the controller's end", ROOM_S)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_stop_ends_everything_and_closes_the_log(session: Running, number: int, status: int) -> None:
    pids = [session.child("rig"), session.child("controller")]
    session.process.send_signal(number)
    for pid in pids:
        until(lambda pid=pid: gone(pid), "the end of what the session started", ROOM_S)  # type: ignore[misc]
    got, summary = session.finish()
    assert got == status and summary["problems"]["interrupted"] == signal.Signals(number).name
    assert len(read_run(session.log).arrays["/plant/state"]) > 3


def test_killed_session_leaves_no_orphan_and_a_log_whole_but_for_the_last_tenth(session: Running, tmp_path: Path) -> None:
    pids = [session.child("rig"), session.child("controller")]
    size = session.log.stat().st_size
    until(lambda: session.log.stat().st_size > size + 8_000, "more of the log")
    session.process.kill()
    for pid in pids:
        until(lambda pid=pid: gone(pid), "the end of an orphan", ROOM_S)  # type: ignore[misc]
    session.process.wait()
    done = hil_command("recover", str(session.log), "-o", str(tmp_path / "ok.mcap"), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    run = read_run(tmp_path / "ok.mcap")
    assert len(run.arrays["/plant/state"]) > 15  # it was being flushed, and not at its end only
    assert run.resolved["name"] == "dc-motor-hinf" and run.experiment_text


def test_read_only_log_folder_is_refused_before_anything_starts(tmp_path: Path) -> None:
    folder = tmp_path / "ro"
    folder.mkdir()
    done = subprocess.run(
        ["unshare", "--mount", "sh", "-c", f"mount --bind {folder} {folder} && mount -o remount,ro,bind {folder} && "
         f"exec {sys.executable} -m hil run dc-motor-hinf --clock real --link can:hil:ro{os.getpid()} -o {folder}/x.mcap"],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    if "unshare" in done.stderr:
        pytest.skip("no permission to mount a read-only folder here")
    assert done.returncode == 2
    assert "cannot be created" in done.stderr and "Read-only" in done.stderr
    assert list(folder.iterdir()) == []


def test_full_disk_costs_the_log_and_not_the_run(tmp_path: Path) -> None:
    folder = tmp_path / "full"
    folder.mkdir()
    done = subprocess.run(
        ["unshare", "--mount", "sh", "-c", f"mount -t tmpfs -o size=32k tmpfs {folder} && "
         f"{sys.executable} -m hil run dc-motor-1khz --clock real --link can:hil:f{os.getpid()} --duration 1 --json "
         f"-o {folder}/x.mcap; echo $? >&2; cp {folder}/x.mcap {tmp_path}/cut.mcap"],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    if "unshare" in done.stderr:
        pytest.skip("no permission to mount a small disk here")
    summary = json.loads(done.stdout[: done.stdout.rindex("}") + 1])
    assert "1" in done.stderr.splitlines()
    slot = re.match(r"disk full at slot (\d+): .*No space left", summary["problems"]["log_error"])
    assert slot is not None and 0 < int(slot[1]) < 1000, summary["problems"]
    assert summary["log"]["dropped"] > 0
    saved = hil_command("recover", "cut.mcap", "-o", "saved.mcap", cwd=tmp_path)
    assert saved.returncode == 0, saved.stderr
    assert len(read_run(tmp_path / "saved.mcap").arrays["/plant/state"]) > 10


@pytest.mark.parametrize(
    ("spoil", "external", "message"),
    [
        ("", True, "no controller answered on can:hil:"),
        ("real.controller_process.Job = lambda **job: 7", False, "the controller process"),
        ("real.rig_process.Job = lambda **job: Spoilt()", False, "the rig process"),
    ],
    ids=["no process dies", "controller dies", "rig dies"],
)
def test_a_session_that_does_not_begin_says_why_at_once(spoil: str, external: bool, message: str) -> None:
    code = (
        "import hil.runtime.real.supervisor as real\n"
        "from hil.errors import HilError\n"
        "from hil.experiment import load_experiment; from hil.compose import compose\n"
        "from hil.log.topics import channels_of; from hil.log.write import MemorySink\n"
        "from hil.rig.session_link import link_of\n"
        "class Spoilt: hello_timeout_s = 1\n"
        f"{spoil}\n"
        "loop = compose(load_experiment('dc-motor-hinf'))\n"
        "sink = MemorySink(channels_of(loop))\n"
        "try:\n"
        f"    real.run_real(loop, 0, link_of(loop.rig, 'can:hil:n{os.getpid()}'), sink, external={external},"
        f" hello_timeout_s={0.5 if external else 600})\n"
        "except HilError as e:\n"
        "    print(e)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=200)  # not 600 s
    assert message in done.stdout, done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_before_a_controller_answers_leaves_no_log(tmp_path: Path, number: int) -> None:
    plain, log = signal.getsignal(number), tmp_path / "run.mcap"

    def end() -> None:
        until(lambda: signal.getsignal(number) not in (plain, signal.SIG_IGN), "who waits for a signal")
        os.kill(os.getpid(), number)

    threading.Thread(target=end, daemon=True).start()
    with pytest.raises(Terminated) as ended:
        run_session(load_experiment("dc-motor-hinf"), clock="real", link=f"can:hil:s{os.getpid()}", external=True, path=log)
    assert ended.value.status == 128 + number and not log.exists()


def test_foreign_controller_drives_the_rig(tmp_path: Path) -> None:
    """A controller of thirty lines that knows nothing of ours but the frame layout, in plain Python and python-can."""
    channel = f"foreign{os.getpid()}"
    with forked([str(Path(__file__).parents[1] / "foreign_controller.py"), channel]):
        drive(tmp_path, "dc-motor-hinf", f"can:hil:{channel}")


def test_a_stopped_rig_is_said_and_ends_the_session(session: Running) -> None:
    rig = session.child("rig")
    os.kill(rig, signal.SIGSTOP)
    status, summary = session.finish()
    assert status == 1 and "the rig process is stopped" in summary["problems"]["rig_lost"]
    assert any(event["kind"] == "rig lost" for event in read_run(session.log).events)
    until(lambda: gone(rig), "the rig's end", ROOM_S)


def test_a_log_that_is_removed_while_it_is_written_is_said_and_summed_up(tmp_path: Path) -> None:
    session = Running(tmp_path, duration="3")
    session.child("rig")
    session.log.unlink()
    status, summary = session.finish()
    assert status == 1 and "was removed during the run" in summary["problems"]["log_lost"]
    assert summary["slots"] == 60 and summary["log"]["messages"] > 300 and len(summary["log"]["sha256"]) == 64


def test_local_needs_no_controller_process_and_takes_no_external_controller(tmp_path: Path) -> None:
    run = ("run", "dc-motor-hinf", "--clock", "real", "--link", "local:", "--duration", "1", "--json",
           "--set", "reference.0.at=0.2")  # fmt: skip
    done = hil_command(*run, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["slots"] == 20 and summary["link"] == "local:" and not summary["problems"]
    refused = hil_command(*run, "--external", cwd=tmp_path)
    assert refused.returncode == 2 and "lies within one process" in refused.stderr


def test_a_restart_on_the_time_line_ends_the_controller_process_and_starts_another(tmp_path: Path) -> None:
    """However long a start takes: the session is stopped by the first answer after the restart."""
    fault = {"at": 0.5, "kind": "controller-restart"}
    experiment = load_experiment("dc-motor-hinf", ["duration=300", "limits.watchdog_slots=100000", "allow_uncertified=true"])
    experiment = experiment_from_resolved({**experiment.resolved(), "fault": [fault]}, "", "test")
    stopped: list[int] = []

    def stop(t_ns: int, _payload: bytes) -> None:
        if t_ns > 550_000_000 and missed(t_ns) and not stopped:
            stopped.append(t_ns)
            os.kill(os.getpid(), signal.SIGINT)

    answered = [0]

    def missed(t_ns: int) -> bool:
        gap, answered[0] = t_ns - answered[0], t_ns
        return gap > 60_000_000

    found = run_session(
        experiment, clock="real", link=links()[0], path=tmp_path / "x.mcap", onlooker=Looks({"/controller/rows": stop})
    )
    assert stopped and found.status == 130, found.summary
    assert [event["kind"] for event in found.run.events if event["kind"].startswith("fault")] == ["fault: controller-restart"]
    assert not {"controller_lost", "second_controller"} & set(found.summary["problems"])
    counted = next(event for event in found.run.events if event["kind"] == "controller ended")
    assert counted["message"].endswith("; processes that were killed and are not counted: 1")
