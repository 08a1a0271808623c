"""Whole sessions in virtual time: reproducible, verifiable, with the numbers of the thesis."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil.session.replay as replay_compare
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.read import read_run
from hil.log.run import Run
from hil.measure.summary import summarise
from hil.measure.view import view_of
from hil.runtime.virtual import simulate
from hil.session import run_session
from hil.session.finished import controller_counters, link_counters, not_admitted
from hil.session.replay import replay
from hil.session.replay.replay import verify, what_if
from hil.sweeps import statistics
from hil.sweeps.seeds import here, run_sweep
from tests.onlooker import Looks
from tests.warm_hil import hil_command
from transport.packets import ControlPacket, SensorPacket, decode, encode_control, encode_sensor


def test_same_seed_gives_the_same_file_in_two_processes_with_two_hash_seeds(tmp_path: Path) -> None:
    found = set()
    for hash_seed in ("1", "2"):
        done = subprocess.run(
            [sys.executable, "-m", "hil", "run", "dc-motor-hinf", "--json", "-o", f"{hash_seed}.mcap"], cwd=tmp_path,
            capture_output=True, text=True, env={**os.environ, "PYTHONHASHSEED": hash_seed},
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found.add(json.loads(done.stdout)["log"]["sha256"])
        found.add(hashlib.sha256((tmp_path / f"{hash_seed}.mcap").read_bytes()).hexdigest())
    assert len(found) == 1


def test_another_seed_gives_another_file(tmp_path: Path) -> None:
    experiments = [load_experiment("dc-motor-hinf", [f"seed={s}", "duration=5"]) for s in (0, 1)]
    a, b = (run_session(e, path=tmp_path / f"{e.seed}.mcap").summary["log"]["sha256"] for e in experiments)
    assert a != b


def test_json_summary_has_everything_that_is_promised(tmp_path: Path) -> None:
    """Beside what `hil.measure.summary.summarise` says, which is printed in tests/data/summaries.json."""
    summary = json.loads(hil_command("run", "dc-motor-hinf", "--json", cwd=tmp_path).stdout)
    assert {"wall_s", "log", "link_counters", "controller_counters", "problems", "gains", "accepted_from"} <= set(summary)
    assert {"path", "sha256", "messages", "dropped"} == set(summary["log"]) and summary["log"]["dropped"] == 0
    assert (summary["slots"], summary["duration_s"], summary["safety"]) == (1000, 50.0, None)


def writable(run: Run, topic: str) -> Any:
    """Return the records of a topic that a test may change: a copy, in the place of what was read."""
    run.arrays[topic] = run.arrays[topic].copy()
    return run.arrays[topic]


def test_log_verifies_and_a_changed_log_does_not(tmp_path: Path) -> None:
    session = run_session(load_experiment("dc-motor-smith", ["duration=10"]), path=tmp_path / "a.mcap")
    verdict = verify(session.run)
    assert verdict.likeness == "same bits" and verdict.difference is None and verdict.answers == verdict.states == 200
    run = read_run(tmp_path / "a.mcap")
    writable(run, "/plant/state")["speed"][77] += 1e-6
    verdict = verify(run)
    assert verdict.likeness == "different" and verdict.answers == verdict.states == 77
    assert "/plant/state of slot 77: speed" in (verdict.difference or "")


def test_a_log_of_a_machine_with_other_last_bits_is_distinguished_from_one_that_differs(tmp_path: Path) -> None:
    run = run_session(load_experiment("dc-motor-hinf", ["duration=5"]), path=tmp_path / "a.mcap").run
    writable(run, "/plant/state")["speed"][77] += 1e-12
    writable(run, "/plant/state")["speed"][90] -= 1e-13
    verdict = verify(run)
    assert (verdict.likeness, verdict.answers, verdict.states) == ("same within 1e-9", 100, 100)
    assert "/plant/state of slot 77: speed" in (verdict.difference or "")
    for share, likeness in ((0.9e-9, "same within 1e-9"), (1.1e-9, "different")):
        again = read_run(tmp_path / "a.mcap")
        for name in ("angle", "speed"):
            values = writable(again, "/plant/state")[name]
            values[80] += share * np.abs(values).max()
        assert verify(again).likeness == likeness
    again = read_run(tmp_path / "a.mcap")
    sent = writable(again, "/link/sensor")["data"]
    question = decode(sent[60])
    assert isinstance(question, SensorPacket)
    for change, likeness in ((1.0 + 2.0**-23, "same within 1e-9"), (1.0 + 2.0**-20, "different")):
        sent[60] = encode_sensor(question._replace(y=tuple(change * y for y in question.y)))
        assert verify(again).likeness == likeness and "/link/sensor of slot 60: data" in (verify(again).difference or "")
    frames = run.arrays["/link/control"]["data"]
    packet = decode(frames[60])
    assert isinstance(packet, ControlPacket)
    for change, likeness in ((1.0 + 2.0**-23, "same within 1e-9"), (1.0 + 2.0**-20, "different")):
        rows = tuple(tuple(change * u for u in row) for row in packet.rows)
        again = read_run(tmp_path / "a.mcap")
        writable(again, "/link/control")["data"][60] = encode_control(packet._replace(rows=rows))
        found = verify(again)
        assert found.likeness == likeness and "slot 60" in (found.difference or ""), change


@pytest.mark.parametrize(
    ("topic", "name"),
    [("/plant/measurement", "angle"), ("/reference", "angle"), ("/network/ca", "age"), ("/actuator/applied", "voltage")],
)
def test_a_change_of_any_record_is_found_and_the_first_one_is_named(tmp_path: Path, topic: str, name: str) -> None:
    run = run_session(load_experiment("dc-motor-hinf", ["duration=3"]), path=tmp_path / "a.mcap").run
    frames = writable(run, "/link/control")["data"]
    frames[50] = bytes([frames[50][0] ^ 1]) + frames[50][1:]
    assert (verify(run).difference or "").startswith("control packet of slot 50: nothing recorded, ((")
    at = int(np.flatnonzero(run.arrays[topic]["slot"] == 20)[0])
    writable(run, topic)[name][at] += 1
    assert f"{topic} of slot 20: {name}" in (verify(run).difference or "")


def test_a_gap_in_the_log_is_a_difference(tmp_path: Path) -> None:
    run = run_session(load_experiment("dc-motor-hinf", ["duration=3"]), path=tmp_path / "a.mcap").run
    run.arrays["/plant/state"] = np.delete(run.arrays["/plant/state"], 10)
    assert verify(run).difference == "/plant/state: a record of slot 10 is missing"
    run.arrays["/actuator/applied"] = run.arrays["/actuator/applied"][:0]
    with pytest.raises(HilError, match="no slots"):
        verify(run)


def test_a_zero_of_the_other_sign_is_not_the_same_bits(tmp_path: Path) -> None:
    run = run_session(load_experiment("dc-motor-hinf", ["duration=1"]), path=tmp_path / "a.mcap").run
    values = writable(run, "/plant/state")["speed"]
    assert values[0] == 0.0
    values[0] = -values[0]
    found = verify(run)
    assert found.likeness == "same within 1e-9" and "/plant/state of slot 0: speed = -0.0 recorded" in (found.difference or "")


@pytest.mark.parametrize("topic", ["/plant/state", "/plant/measurement", "/reference", "/controller/rows", "/network/sc"])
def test_a_log_without_a_topic_of_its_run_is_not_verified(tmp_path: Path, topic: str) -> None:
    run_session(load_experiment("dc-motor-hinf", ["duration=1"]), path=tmp_path / "a.mcap")
    run = read_run(tmp_path / "a.mcap")
    del run.arrays[topic]
    with pytest.raises(HilError, match=f"topic {topic}: this log lacks it"):
        verify(run)


def test_a_log_that_ends_before_its_run_is_different(tmp_path: Path) -> None:
    run_session(load_experiment("dc-motor-hinf", ["duration=3"]), path=tmp_path / "a.mcap")
    run = read_run(tmp_path / "a.mcap")
    for topic in [*run.arrays]:
        run.arrays[topic] = run.arrays[topic][run.arrays[topic]["slot"] < 40]
    found = verify(run)
    assert (found.likeness, found.states) == ("different", 40)
    assert found.difference == "the log ends with slot 39; the rig says that it ran 60 slots"
    run.events.clear()  # of a rig that was killed
    assert verify(run).likeness == "same bits"


def test_differences_are_found_in_whatever_batch_they_stand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (replay, replay_compare):
        monkeypatch.setattr(module, "BATCH", 16)
    run_session(load_experiment("dc-motor-hinf", ["duration=1.5"]), path=tmp_path / "a.mcap")
    run = read_run(tmp_path / "a.mcap")
    assert verify(run).difference is None and verify(run).answers == 30
    state = run.arrays["/plant/state"]
    for at in (15, 16, 29):
        run.arrays["/plant/state"] = np.delete(state, at)
        assert verify(run).difference == f"/plant/state: a record of slot {at} is missing"
        run.arrays["/plant/state"] = np.insert(state, at, state[at])
        assert "that should not be" in (verify(run).difference or "")


def test_what_if_refuses_a_controller_that_takes_other_packets(tmp_path: Path) -> None:
    run = run_session(load_experiment("dc-motor-ours-two-samples", ["duration=2"]), path=tmp_path / "a.mcap").run
    with pytest.raises(HilError, match="its sensor packets carry 2 samples, hinf takes 1"):
        what_if(run, load_experiment("dc-motor-hinf").controller, "hinf")


def test_what_if_with_the_same_controller_is_what_was(tmp_path: Path) -> None:
    experiment = load_experiment("dc-motor-h2", ["duration=10"])
    run = run_session(experiment, path=tmp_path / "a.mcap").run
    series = what_if(run, experiment.controller, "h2")
    shown = np.isfinite(series["h2_voltage"])
    assert shown.sum() > 190
    np.testing.assert_array_equal(series["h2_voltage"][shown], series["recorded_voltage"][shown])


def test_loop_that_is_not_stable_is_refused_and_with_leave_is_stopped_by_safety(tmp_path: Path) -> None:
    with pytest.raises(HilError, match=r"radius 1\.054"):
        compose(load_experiment("dc-motor-local", ["allow_uncertified=false"]))
    done = hil_command("run", "dc-motor-local", "--json", cwd=tmp_path)
    assert done.returncode == 3
    assert "safe state" in json.loads(done.stdout)["safety"]


# name, mean and sd of sse, mean and sd of sse_after_5s over 10,000 runs (Table 7.2 and Section 7.4.2; ERRATA 16, 17)
TABLE = [
    ("dc-motor-hinf", 12.03, 0.41, 0.0305, 0.0058),
    ("dc-motor-h2", 12.33, 0.46, 0.0302, 0.0058),
    ("dc-motor-hinf-fast", 11.41, 0.20, 0.0060, 0.0007),
    ("dc-motor-h2-fast", 11.35, 0.18, 0.0049, 0.0006),
]


@pytest.mark.parametrize(("name", "mean", "sd", "mean_5s", "sd_5s"), TABLE)
def test_many_seeds_give_the_known_means(name: str, mean: float, sd: float, mean_5s: float, sd_5s: float) -> None:
    """Two-sided z tests at 1e-4 each, widened by the rounding of the printed values."""
    n = 120
    found: dict[str, Any] = run_sweep(load_experiment(name), range(n), workers=here(2)).values
    for metric, expected, spread, rounding in (("sse", mean, sd, 0.005), ("sse_after_5s", mean_5s, sd_5s, 0.00005)):
        got = statistics(found[metric])
        assert abs(got["mean"] - expected) < 3.9 * spread / np.sqrt(n) + rounding
    assert found["stopped"].sum() == 0


def test_sweep_gives_the_same_numbers_for_every_number_of_jobs() -> None:
    experiment = load_experiment("dc-motor-hinf", ["duration=3"])
    one, two = run_sweep(experiment, range(12), workers=here(1)).values, run_sweep(experiment, range(12), workers=here(2)).values
    for name in one:
        np.testing.assert_array_equal(one[name], two[name])


def test_adding_a_disturbance_does_not_shift_the_delays() -> None:
    base = load_experiment("dc-motor-hinf", ["duration=5"])
    other = load_experiment(
        "dc-motor-hinf", ["duration=5", "disturbance.0.at=2", "plant.encoder.step_rad=0.01", "allow_uncertified=true"]
    )
    a, b = (simulate(compose(e), 3).arrays["/network/sc"] for e in (base, other))
    np.testing.assert_array_equal(a["mode"], b["mode"])


PROCESSES = (
    "import sys, pickle; import hil.runtime.real.rig_process, hil.runtime.real.controller_process;"
    "from hil.experiment import load_experiment; from hil.compose import compose;"
    "heavy = {'control', 'cvxpy', 'cantools', 'matplotlib', 'scipy.signal', 'scipy.stats'} & set(sys.modules);"
    "assert not heavy, heavy;"
    "loop = compose(load_experiment('dc-motor-hinf')); loop.start_controller();"
    "heavy = {'control', 'cvxpy', 'cantools', 'matplotlib', 'scipy.signal'} & set(sys.modules); assert not heavy, heavy"
)
HELP = (
    "import sys, hil.cli\n"
    "try: hil.cli.main(['--help'])\n"
    "except SystemExit: pass\n"
    "heavy = {'numpy', 'can', 'zenoh', 'mcap', 'rich', 'msgspec', 'control', 'cvxpy', 'scipy'} & set(sys.modules)\n"
    "assert not heavy, heavy"
)


@pytest.mark.parametrize("code", [PROCESSES, HELP], ids=["rig and controller", "help"])
def test_nothing_heavy_is_imported(code: str) -> None:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_live_view_sees_a_run_in_virtual_time_and_leaves_the_log_as_it_is(tmp_path: Path) -> None:
    experiment = load_experiment("dc-motor-hinf", ["duration=2"])
    seen: list[int] = []
    taps = {"/plant/state": lambda t_ns, payload: seen.append(t_ns), "/events": lambda t_ns, payload: seen.append(-1)}
    one = run_session(experiment, path=tmp_path / "a.mcap", onlooker=Looks(taps))
    two = run_session(experiment, path=tmp_path / "b.mcap")
    assert seen.count(-1) == len(one.run.events) and len(seen) == 40 + seen.count(-1)
    assert one.summary["log"]["sha256"] == two.summary["log"]["sha256"]


def test_the_first_disturbance_ends_the_window_of_the_step(tmp_path: Path) -> None:
    """Kicks at 6 s and at 9 s: neither may count as overshoot of the step at 1 s, as the first ends its window."""
    kick = "{at=%g, value=[30.0], samples=4}"
    one, both = (
        run_session(
            load_experiment("dc-motor-hinf", ["duration=12", f"disturbance=[{','.join(kick % at for at in times)}]"]),
            path=tmp_path / f"{len(times)}.mcap",
        ).summary["metrics"]
        for times in ((6.0,), (6.0, 9.0))
    )
    assert one["overshoot"] == both["overshoot"] and one["settling_time_s"] == both["settling_time_s"]
    assert both["sse_after_5s"] > 2 * 0.1  # the kicks are felt


@pytest.mark.parametrize(
    ("frames", "status", "problem"),
    [("twice", 5, "second_controller"), ("often", 6, "flood"), ("once", 0, None)],
)
def test_another_process_on_the_link_has_an_exit_status_and_a_problem_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, frames: str, status: int, problem: str | None
) -> None:
    from hil.runtime.virtual import DirectExchange
    from transport.packets import ControlPacket, decode, encode_control

    ours = DirectExchange.answer

    def answer(self: DirectExchange, t_ns: int, on_frame: Callable[[bytes], bool]) -> None:
        def hear_and_more(data: bytes) -> bool:
            packet = decode(data)
            assert isinstance(packet, ControlPacket)
            taken = on_frame(data)
            if frames == "twice":
                on_frame(encode_control(packet._replace(rows=((1.0,), (1.0,)))))
            for _ in range(100 if frames == "often" else 0):
                on_frame(b"junk")
            return taken

        ours(self, t_ns, hear_and_more)

    monkeypatch.setattr(DirectExchange, "answer", answer)
    session = run_session(load_experiment("dc-motor-hinf", ["duration=1", "reference.0.at=0.2"]), path=tmp_path / "a.mcap")
    assert session.status == status
    assert list(session.summary["problems"]) == ([problem] if problem else [])


@pytest.mark.parametrize("name", ["dc-motor-hinf", "dc-motor-packets", "dc-motor-local"])  # the last is stopped by safety
def test_a_summary_from_memory_is_that_of_the_log(name: str, tmp_path: Path) -> None:
    experiment = load_experiment(name, ["duration=8"])
    session = run_session(experiment, path=tmp_path / "run.mcap")
    again = summarise(view_of(session.run, experiment))
    reported = {key: session.summary[key] for key in again}
    assert reported == again
    assert session.run.arrays["/link/sensor"]["data"].size  # the log itself, in full


def test_a_run_in_virtual_time_reads_nothing_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("the log was read back")

    monkeypatch.setattr("hil.log.read.read_run", refuse)
    session = run_session(load_experiment("dc-motor-hinf", ["duration=2"]), path=tmp_path / "run.mcap")
    assert session.summary["slots"] == 40
    with pytest.raises(AssertionError, match="read back"):
        session.arrays["/plant/state"]


def test_what_both_ends_of_a_link_counted_is_read_from_their_events() -> None:
    rig = {"kind": "outcome", "data": {"link": {"received": 7.0, "refused": 2}}}
    controller = {"kind": "controller ended", "data": {"answered": 5}}
    silent = [{"kind": "outcome"}, {"kind": "outcome", "data": {"safety": "no"}}, {"kind": "controller ended"}]
    whole, none = (Run(arrays={}, schemas={}, events=events) for events in ([*silent, rig, controller], silent))
    assert (link_counters(whole), controller_counters(whole)) == ({"received": 7, "refused": 2}, {"answered": 5})
    assert (link_counters(none), controller_counters(none)) == (None, None)
    assert not_admitted({"refused": 2, "unopened": 3, "foreign": 4}) == {
        "refused": "2 packets or peers on the link were refused: they lacked the key or the name",
        "unopened": "3 connections to the rig's endpoint said nothing, or nonsense, which delays the link where they are many",
    }
    assert not_admitted({"refused": 0}) == {} and [*not_admitted({"turned_away": 1})] == ["turned_away"]
