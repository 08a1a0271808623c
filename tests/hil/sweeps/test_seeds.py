"""Sweeps: kept on Ctrl-C, resumed, stopped by an interval, the same numbers on a cluster."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from design.monte_carlo import Workers
from design.monte_carlo.confidence import StopRule
from hil.cli.sweep import command, stop_rule
from hil.errors import HilError
from hil.experiment import Experiment, load_experiment
from hil.sweeps import SweepStore
from hil.sweeps.seeds import _parts, columns_of, here, run_sweep
from tests.file_limit import files_up_to
from tests.waiting import until

ONE_CORE = Workers()
COLUMNS = columns_of(load_experiment("dc-motor-hinf"))


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return load_experiment("dc-motor-hinf", ["duration=3"])


@pytest.fixture(scope="module")
def plain(experiment: Experiment) -> dict[str, Any]:
    return run_sweep(experiment, range(40), workers=here(1)).values


def same(a: dict[str, Any], b: dict[str, Any]) -> None:
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name])


@pytest.mark.parametrize(
    "row",
    ['{"seed": 1e999}', '{"seed": 0, "iae": 1' + "0" * 400 + "}", "[" * 100_000, '{"seed": ' + "9" * 5000 + "}", '"x"'],
    ids=["infinite seed", "metric beyond a double", "nested", "long seed", "text"],
)
def test_a_row_that_is_none_is_one_message(experiment: Experiment, tmp_path: Path, row: str) -> None:
    with SweepStore(tmp_path / "s", experiment, ("iae",)):
        pass
    with open(tmp_path / "s", "a") as file:
        file.write(row + "\n")
    with pytest.raises(HilError, match="line 2 is not a row of this sweep") as refused:
        SweepStore(tmp_path / "s", experiment, ("iae",))
    with pytest.raises(HilError, match="line 2 is not a row of this sweep"):  # what was refused holds the file no longer
        SweepStore(tmp_path / "s", experiment, ("iae",))
    assert refused.value.status == 2


def test_a_line_without_end_is_no_sweep(experiment: Experiment, tmp_path: Path) -> None:
    with open(tmp_path / "s", "wb") as file:
        file.truncate(10**10)  # sparse: one line of zeros
    with pytest.raises(HilError, match="is not the file of a sweep"):
        SweepStore(tmp_path / "s", experiment, ("iae",))


def test_a_resumed_sweep_has_the_numbers_of_one_that_was_never_interrupted(
    tmp_path: Path, experiment: Experiment, plain: dict[str, Any]
) -> None:
    reported: list[int] = []
    with SweepStore(tmp_path / "s", experiment, COLUMNS) as store:
        run_sweep(experiment, range(10, 25), workers=ONE_CORE, store=store)
    with open(tmp_path / "s", "ab") as torn:
        torn.write(b'{"seed": 77, "ss')  # the machine died while it wrote
    with SweepStore(tmp_path / "s", experiment, COLUMNS) as store:
        found = run_sweep(experiment, range(40), workers=ONE_CORE, store=store, progress=reported.append)
    same(found.values, plain)
    assert (reported[0], reported[-1]) == (15, 40)
    assert len((tmp_path / "s").read_text().splitlines()) == 41


def test_a_full_disk_is_said_and_costs_only_the_rows_that_did_not_fit(tmp_path: Path, experiment: Experiment) -> None:
    with (
        SweepStore(tmp_path / "s", experiment, COLUMNS) as store, files_up_to(1000),
        pytest.raises(HilError, match="s: cannot be written: File too large"),
    ):  # fmt: skip
        run_sweep(experiment, range(20), workers=ONE_CORE, store=store)
    with SweepStore(tmp_path / "s", experiment, COLUMNS) as store:
        assert 0 < len(store.rows) < 20


def test_ctrl_c_keeps_what_is_done(tmp_path: Path, experiment: Experiment, plain: dict[str, Any]) -> None:
    def interrupt(done: int) -> None:
        if done >= 5:
            raise KeyboardInterrupt

    with SweepStore(tmp_path / "s", experiment, COLUMNS) as store:
        found = run_sweep(experiment, range(40), workers=ONE_CORE, store=store, progress=interrupt)
        assert found.interrupted
        assert 5 <= found.values["seed"].size < 40
        assert len(store.rows) == found.values["seed"].size
    with SweepStore(tmp_path / "s", experiment, COLUMNS) as store:
        same(run_sweep(experiment, range(40), workers=ONE_CORE, store=store).values, plain)


def test_ctrl_c_at_any_line_of_the_store_leaves_its_rows_and_its_file_the_same(tmp_path: Path, experiment: Experiment) -> None:
    rows = run_sweep(experiment, range(3), workers=here(1)).values
    plain_rows = [{name: float(column[i]) for name, column in rows.items()} for i in range(3)]

    def kept_after_a_signal_at(number: int) -> tuple[bool, int]:
        left = number

        def trace(frame: FrameType, event: str, _: Any) -> Any:
            nonlocal left
            if frame.f_code.co_filename != store_file:
                return None
            left -= event == "line"
            if left == 0 and event == "line":
                raise KeyboardInterrupt
            return trace

        path = tmp_path / str(number)
        with SweepStore(path, experiment, COLUMNS) as store:
            try:
                sys.settrace(trace)
                store.add(plain_rows)
            except KeyboardInterrupt:
                pass
            finally:
                sys.settrace(None)
            assert len(store.rows) == path.read_bytes().count(b"\n") - 1
            return left <= 0, len(store.rows)

    store_file = sys.modules[SweepStore.__module__].__file__
    found = [kept_after_a_signal_at(number) for number in range(1, 400)]
    assert {rows for struck, rows in found if struck} == {0, 3}  # before the first byte nothing, from then on all
    assert not found[-1][0]  # the last ones came after the end


@pytest.mark.parametrize(
    ("number", "status", "send"),
    [(signal.SIGINT, 130, os.killpg), pytest.param(signal.SIGTERM, 143, os.kill, marks=pytest.mark.slow)],
)
def test_a_signal_on_the_command_line_prints_and_exits_with_its_status(
    tmp_path: Path, number: int, status: int, send: Callable[[int, int], None]
) -> None:
    kept = tmp_path / "kept"
    words = ["sweep", "dc-motor-hinf", "--runs", "100000", "--jobs", "2", "--resume", str(kept), "--json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    until(lambda: process.poll() is not None or (kept.exists() and kept.read_bytes().count(b"\n") > 10), "ten rows")
    send(process.pid, number)  # a terminal sends Ctrl-C to the workers too
    out, err = process.communicate(timeout=120)
    assert process.returncode == status, err
    found = json.loads(out)
    assert 10 <= found["runs"] < 100000
    assert found["runs"] == kept.read_bytes().count(b"\n") - 1
    assert "the same command goes on" in err
    assert "Traceback" not in err


def test_it_stops_when_the_interval_is_narrow_enough(experiment: Experiment, plain: dict[str, Any]) -> None:
    rule = StopRule(half_width=1.0, first_look=30)
    found = run_sweep(experiment, range(40), workers=ONE_CORE, until=("sse", rule))
    assert found.reached
    assert found.values["seed"].size == 30
    np.testing.assert_array_equal(found.values["sse"], plain["sse"][:30])
    never = run_sweep(experiment, range(40), workers=ONE_CORE, until=("sse", StopRule(half_width=1e-9, first_look=30)))
    assert not never.reached
    assert never.interval is not None
    assert never.interval.n == 40
    same(never.values, plain)


def test_a_cluster_of_two_workers_gives_the_same_numbers(experiment: Experiment, plain: dict[str, Any]) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as cluster:
        workers = Workers(backend="dask", scheduler=cluster.scheduler_address)
        same(run_sweep(experiment, range(40), workers=workers).values, plain)


def test_a_file_of_another_sweep_is_refused(tmp_path: Path, experiment: Experiment) -> None:
    SweepStore(tmp_path / "s", experiment, COLUMNS).close()
    SweepStore(tmp_path / "s", load_experiment("dc-motor-hinf", ["duration=3", "seed=9"]), COLUMNS).close()
    with pytest.raises(HilError, match="with another digest"):
        SweepStore(tmp_path / "s", load_experiment("dc-motor-hinf", ["duration=2"]), COLUMNS)
    (tmp_path / "note").write_text("buy milk")
    with pytest.raises(HilError, match="is not the file of a sweep"):
        SweepStore(tmp_path / "note", experiment, COLUMNS)
    assert (tmp_path / "note").read_text() == "buy milk"
    (tmp_path / "bad").write_bytes((tmp_path / "s").read_bytes() + b"[1]\n")
    with pytest.raises(HilError, match="line 2 is not a row"):
        SweepStore(tmp_path / "bad", experiment, COLUMNS)
    with pytest.raises(HilError, match=r"^--resume: "):
        SweepStore(tmp_path / "no" / "such", experiment, COLUMNS)


def test_two_sweeps_cannot_share_a_file(tmp_path: Path, experiment: Experiment) -> None:
    with SweepStore(tmp_path / "s", experiment, COLUMNS), pytest.raises(HilError, match="in use"):
        SweepStore(tmp_path / "s", experiment, COLUMNS)


def test_undefined_metrics_survive_the_file(tmp_path: Path, experiment: Experiment) -> None:
    row = dict.fromkeys(COLUMNS, 1.25) | {"settling_time_s": float("nan"), "seed": 3}
    with SweepStore(tmp_path / "s", experiment, COLUMNS) as store:
        store.add([row])
    with SweepStore(tmp_path / "s", experiment, COLUMNS) as store:
        np.testing.assert_equal(store.rows, {3: row})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("speed=1", ": .*'speed' is not one of"),
        ("sse", " 'sse': expected METRIC=HALFWIDTH"),
        ("sse=0", ": .*half_width"),
        ("max:sse=1", ": .*statistic"),
    ],
)
def test_a_stopping_rule_that_cannot_be_is_refused(text: str, message: str) -> None:
    with pytest.raises(HilError, match=f"^--until{message}"):
        stop_rule(text, 0.95, COLUMNS[1:])


def test_status_is_1_when_the_runs_did_not_suffice() -> None:
    words = ["dc-motor-hinf", "--set", "duration=3", "--runs", "31", "--jobs", "1", "--until", "sd:sse=1e-9", "--json"]
    done = CliRunner().invoke(command, words)
    assert done.exit_code == 1
    wanted = json.loads(done.stdout)["until"]
    assert wanted["statistic"] == "sd"
    assert not wanted["reached"]
    words = ["dc-motor-hinf", "--set", "duration=3", "--runs", "150", "--jobs", "1", "--until"]
    said = [" ".join(CliRunner().invoke(command, [*words, each]).stdout.split()) for each in ("sse=9", "sd:sse=9")]
    shown = ["whenever it stops, if these runs show its tails" in each for each in said]
    assert shown == [False, True] and "whenever it stops (" in said[0]
    refused = CliRunner().invoke(command, ["dc-motor-hinf", "--backend", "dask"])
    assert isinstance(refused.exception, HilError)
    assert "--scheduler" in str(refused.exception)


def test_seeds_are_split_into_so_many_parts_that_each_worker_has_several() -> None:
    seeds = range(1000)
    parts = _parts(seeds, here(3), None)
    assert [seed for part in parts for seed in part] == [*seeds] and {len(part) for part in parts[:-1]} == {25}
    few = _parts(range(24), here(3), None)
    assert len(few) == 12 and {len(part) for part in few} == {2}
    assert [len(part) for part in _parts(seeds, here(3), 1000)] == [167] * 5 + [165]
    assert [len(part) for part in _parts(seeds, here(1), 400)] == [400, 400, 200]
    cores = len(os.sched_getaffinity(0))
    assert len(_parts(range(8 * cores), here(-1), None)) == 4 * cores


def test_more_runs_than_memory_holds_are_refused_before_any_work() -> None:
    with pytest.raises(HilError, match="runs: more than 1000000 of one experiment; run them in parts, by the first seed of each"):
        run_sweep(None, range(10**11), workers=Workers(backend="serial"))  # type: ignore[arg-type]
