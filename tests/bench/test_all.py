"""``python -m tests.bench all``: every figure is there; a part that dies and an interrupt lose no measured figure."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from tests.bench.__main__ import SUBJECTS, main
from tests.bench.catalogue import PARTS

Bench = Callable[..., tuple[int, str, str]]


@pytest.fixture
def bench(capsys: pytest.CaptureFixture[str]) -> Bench:
    """Call ``python -m tests.bench`` in this process: (exit status, standard output, standard error)."""

    def call(*arguments: object) -> tuple[int, str, str]:
        status = 0
        try:
            main([*map(str, arguments)])
        except SystemExit as end:
            status = int(end.code or 0)
        return status, *capsys.readouterr()

    return call


FIGURES = """
hil --help, CPU time
hil run of one slot, CPU time
composing dc-motor-hinf with its certificate, CPU time
hil run of one slot of smjls-robust, CPU time
a real session beyond its run, wall time
dc-motor-hinf in a sweep, CPU time per run
dc-motor-smith in a sweep, CPU time per run
vtol-h2 in a sweep, CPU time per run
hil sweep, 1000 runs, wall time
hil sweep, 100,000 runs, wall time
hil sweep, 100,000 runs, peak memory
sweep over dask, wall time per run
hil report of a run, wall time
round trip over can:hil, p50
round trip over can:hil, p50, beside C
round trip over zenoh on one CPU, p50
round trip over zenoh on both CPUs, p50
late answers over zenoh on one CPU
log of a slot in the loop at 1 kHz, p50
late answers, 1 kHz over zenoh, affinity auto
late answers, 1 kHz over zenoh, affinity shared
late answers, 1 kHz over zenoh beside can:hil
round trip of a session over zenoh, affinity auto, p50
overruns at 4 kHz over can:hil
overruns at 10 kHz over local:
virtual slot with its log, CPU time
virtual slot without a log, CPU time
log files that differ from the mcap package's output
log per slot, --index full (the default)
log per slot, --index chunk
virtual slot with its log, CPU time, beside 3aeb887
virtual slot without a log, CPU time, beside 3aeb887
held per further slot while a log is written
hil run of 10^5 slots, peak memory
hil run of 10^6 slots, peak memory
hil run, memory per slot from 10^5 to 10^6
hil run, CPU time per slot of 10^6
hil report of 10^6 slots, peak memory
hil replay --verify of 10^6 slots, peak memory
hil export of 10^6 slots, peak memory
hil recover of 10^6 slots, peak memory
hil recover of 10^6 slots, CPU time
certificate of 484 modes
H2 norm, one mode of 40 states
H-infinity norm, one mode of 40 states
H2 design, tau_max = d_max = 4
H2 design, 20 states and 6 modes
H-infinity design, tau_max = d_max = 4
H-infinity design, 20 states and 6 modes
H-infinity design of the VTOL
H2 design, tau_max = d_max = 8
H-infinity design, tau_max = d_max = 8
""".strip().splitlines()


def test_what_is_to_be_reached_is_a_ratio_to_a_peer_of_the_same_run() -> None:
    figures = [figure for part in PARTS for figure in part.figures]
    goals = [figure.goal for figure in figures if figure.goal is not None]
    assert len(goals) > 10 and all(goal.ours is None and goal.ratio is not None for goal in goals)
    timed = [figure for figure in figures if figure.unit in ("s", "us", "ms") and figure.condition is not None]
    assert timed and all(figure.condition is not None and figure.condition.ours is None for figure in timed)


@pytest.mark.parametrize("name", SUBJECTS)
def test_every_subject_names_what_measures_it(name: str, bench: Bench) -> None:
    for _, place in SUBJECTS[name][1]:
        module, function = place.split(".")
        assert callable(getattr(import_module(f"tests.bench.{module}"), function))
    status, out, _ = bench(name, "--help")
    assert status == 0 and SUBJECTS[name][0].split()[0] in out


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_every_figure_is_measured_with_its_peer(bench: Bench, tmp_path: Path) -> None:
    status, out, err = bench("all", "--quick", "--json")
    found = json.loads(out)
    assert status == 0 and "5 of 5: designs" in err
    assert [row["name"] for row in found["figures"]] == FIGURES
    for row in found["figures"]:
        if row["name"].endswith("3aeb887"):
            assert "--before" in row["goal_verdict"] and row["ours"] is None
        elif "cyclictest" in row["note"]:
            assert "apt-get install rt-tests" in row["note"] and row["peer"] is None
        elif row["part"] != "real-time" and "session" not in row["name"]:  # one may fail on a busy machine, and says so
            assert row["ours"] is not None and row["peer"] is not None, row
        else:
            assert row["peer"] is not None or row["goal_verdict"].startswith("not measured: "), row
    (tmp_path / "figures.json").write_text(out)
    _, page, _ = bench("page", tmp_path / "figures.json")
    assert all(f"| {name}" in page for name in FIGURES)
    assert found["date"] in page and found["machine"]["python"] in page


def _started(*options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.bench", "all", "--quick", "--json", *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _child_of(pid: int) -> int:
    children = Path(f"/proc/{pid}/task/{pid}/children")
    while not (found := children.read_text().split()):
        time.sleep(0.01)
    return int(found[0])


def _figures(out: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(out)["figures"]
    return found


TWO_PARTS = """
import dataclasses, json, sys
from tests.bench.catalogue import PARTS
from tests.bench.run_parts import run_parts
start, *_, logs, _ = PARTS
short = dataclasses.replace(logs, measures=logs.measures[:1])
found, _ = run_parts((start, short), lambda text: print(text, file=sys.stderr), quick=True)
print(json.dumps(found))
"""
"""What ``all --quick --only start --only logs`` does, with the first measure of the logs alone."""


def test_a_part_whose_process_dies_is_named_and_the_next_is_measured() -> None:
    command = [sys.executable, "-P", "-c", TWO_PARTS]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as hil:
        os.kill(_child_of(hil.pid), signal.SIGKILL)
        out, err = hil.communicate()
    start, *rest = _figures(out)
    assert hil.returncode == 0 and "2 of 2: logs" in err
    assert start["part"] == "start" and start["goal_verdict"] == "not measured: its process ended with status -9"
    assert rest[-1]["part"] == "logs" and rest[-1]["ours"] > 0.0


def test_an_interrupt_prints_what_was_found_and_leaves_no_process() -> None:
    with _started("--only", "start", "--only", "sweeps") as hil:
        child = _child_of(hil.pid)
        assert hil.stderr is not None and "1 of 2" in hil.stderr.readline() and "numpy" in hil.stderr.readline()
        hil.send_signal(signal.SIGINT)
        out, _ = hil.communicate()
    assert hil.returncode == 130
    assert all(row["goal_verdict"] == "not measured: interrupted" for row in _figures(out)[1:])
    assert len(_figures(out)) == sum(len(part.figures) for part in PARTS if part.name in ("start", "sweeps"))
    assert not Path(f"/proc/{child}").exists()


def test_an_unknown_part_is_named_with_those_that_there_are(bench: Bench) -> None:
    status, _, err = bench("all", "--only", "speed")
    assert status == 2 and "--only: no part 'speed'; expected start, sweeps, real-time, logs, designs" in err


@pytest.mark.parametrize("option", ["--compiled", "--before"])
def test_other_code_is_looked_at_before_anything_is_measured(bench: Bench, tmp_path: Path, option: str) -> None:
    status, out, err = bench("all", "--quick", "--only", "start", option, tmp_path)
    assert status == 2 and not out and f"{option} {tmp_path}: expected" in err


def test_a_page_is_made_of_figures_alone(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text("[1]")
    status, _, err = bench("page", tmp_path / "other.json")
    assert status == 2 and "not what `python -m tests.bench all --json` prints" in err
