"""What is no record of an axis, or no table of signals, is refused with its file; a slot without a measurement stays empty."""

from __future__ import annotations

import math
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from hil.errors import HilError
from hil.experiment import load_experiment
from hil.files import arrays
from hil.log.read import read_run
from hil.log.run import Run, StructuredArray
from hil.measure import identification_records
from hil.measure.identification_records import AxisRecord, read_axis_record, read_mode_record, read_signal_table
from hil.session import run_session

APPLIED, MEASURED = "/actuator/applied", "/plant/measurement"


def read(run: Run, monkeypatch: pytest.MonkeyPatch) -> AxisRecord:
    monkeypatch.setattr(identification_records, "read_run", lambda path: run)
    return read_axis_record(Path("a.mcap"), None, (None, None))


def test_a_log_without_every_input_or_of_no_axis_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_session(load_experiment("dc-motor-hinf", ["duration=1"]), path=tmp_path / "a.mcap")
    run = read_run(tmp_path / "a.mcap")
    whole, applied, measured = read(run, monkeypatch), run.arrays[APPLIED], run.arrays[MEASURED]
    assert len(whole.u) == len(whole.y) == len(applied) == 20 and whole.period_s == 0.05
    run.arrays[MEASURED] = np.delete(measured, 3)
    without = read(run, monkeypatch)
    assert np.isnan(without.y[3]) and (np.delete(without.y, 3) == np.delete(whole.y, 3)).all()
    for kept, message in ((np.arange(20) != 7, "the input after slot 6 is missing"), (np.zeros(20, bool), "holds no slot")):
        run.arrays[APPLIED] = applied[kept]
        with pytest.raises(HilError, match=f"a.mcap: {message}"):
            read(run, monkeypatch)
    run.resolved["plant"]["kind"] = "vtol"
    with pytest.raises(HilError, match=r"a\.mcap: plant 'vtol' is no axis y'' \+ p y' = g u; expected omni or dc-motor"):
        read(run, monkeypatch)


@pytest.mark.parametrize(("last", "slots"), [("0.3,,4", 3), ("0.3,6,4", 4)])
def test_the_last_measurement_of_a_table_needs_an_input_behind_it(tmp_path: Path, last: str, slots: int) -> None:
    (tmp_path / "a.csv").write_text(f"t_s,voltage,angle\n0,5,1\n0.1,,2\n0.2,3,\n{last}\n")
    record = read_axis_record(tmp_path / "a.csv", "dc-motor", (None, None))
    np.testing.assert_array_equal(record.u, [5.0, np.nan, 3.0, 6.0][:slots])
    np.testing.assert_array_equal(record.y, [1.0, 2.0, np.nan, 4.0][:slots])
    with pytest.raises(HilError, match=r"a\.csv: a table does not name its plant; add --plant omni or dc-motor"):
        read_axis_record(tmp_path / "a.csv", None, (None, None))


def test_a_log_without_every_mode_gives_no_rates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_session(load_experiment("vtol-fault", ["duration=1", "allow_uncertified=true"]), path=tmp_path / "a.mcap")
    run = read_run(tmp_path / "a.mcap")
    states = run.arrays["/plant/state"]
    monkeypatch.setattr(identification_records, "read_run", lambda path: run)
    record, _ = read_mode_record(Path("a.mcap"))
    assert len(record.fault) == len(record.detected) == len(states) and record.period_s == load_experiment("vtol-fault").period
    for wrong, message in (
        (states[:0], "holds no slot of /plant/state"),
        (np.delete(states, 4), f"the modes after slot {states['slot'][3]} are missing"),
        (with_mode(states, 0.0), "mode"),
        (with_mode(states, 1.5), "mode"),
        (with_mode(states, np.nan), "mode"),
    ):
        run.arrays["/plant/state"] = wrong
        with pytest.raises(HilError, match=f"a.mcap: .*{message}"):
            read_mode_record(Path("a.mcap"))
    run.arrays["/plant/state"] = states
    with pytest.raises(HilError, match="has no mode 'other'"):
        read_mode_record(Path("a.mcap"), ("other", "detected_mode"))


def with_mode(states: StructuredArray, value: float) -> StructuredArray:
    states = states.copy()
    states["fault_mode"][2] = value
    return states


def test_a_table_with_units_a_gap_and_an_empty_entry_is_read(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("\ufefft_ns [ns],u [V],y\n0,1,2\n100000000,,3\n200000000,6,7\n4e8,4,5\n")
    period_s, columns = read_signal_table(tmp_path / "t.csv", ("y", "u"))
    assert period_s == pytest.approx(0.1)
    np.testing.assert_array_equal(columns, [[2, 1], [3, np.nan], [7, 6], [np.nan, np.nan], [5, 4]])


@pytest.mark.parametrize(("clock", "begin"), [("time", -2.5), ("t", 7.0), ("t_s", 1000.0)])
def test_a_table_may_begin_at_any_time(tmp_path: Path, clock: str, begin: float) -> None:
    rows = "".join(f"{begin + 0.1 * k:.9f},{k}\n" for k in (0, 1, 2, 5, 6))
    (tmp_path / "t.csv").write_text(f"{clock},y\n{rows}")
    period_s, columns = read_signal_table(tmp_path / "t.csv", ("y",))
    assert period_s == pytest.approx(0.1, rel=1e-9)
    np.testing.assert_array_equal(columns[:, 0], [0, 1, 2, np.nan, np.nan, 5, 6])
    (tmp_path / "off.csv").write_text("time,y\n" + "".join(f"{begin + 0.1 * k + 0.02 * (k == 10):.9f},7\n" for k in range(21)))
    with pytest.raises(HilError, match=rf"off.csv: row 11: {begin + 1.02:.9g} s is 0.2 periods off a multiple of 0.1 s"):
        read_signal_table(tmp_path / "off.csv", ("y",))


def test_a_clock_that_is_read_late_is_refused_with_the_true_period_and_a_remedy(tmp_path: Path) -> None:
    """The median of such steps is 1 % too long, which after 100 rows is a whole period."""
    rng = np.random.default_rng(1)
    steps = np.where(np.arange(400) % 4 < 3, 1.01e-3, 0.97e-3)  # their mean is 1 ms
    times = np.concatenate(([0.0], np.cumsum(steps))) + rng.uniform(0.0, 4e-5, 401)
    (tmp_path / "t.csv").write_text("t,y\n" + "".join(f"{t:.9f},1\n" for t in times))
    with pytest.raises(HilError, match=r"is 0\.\d+ periods off a multiple of 0\.00100\d+ s, expected up to 0\.01; where"):
        read_signal_table(tmp_path / "t.csv", ("y",))


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("time [ms],u [V],y", "time is in 'ms', expected s"),
        ("t_ns [s],u [V],y", "t_ns is in 's', expected ns"),
        ("t,u [mV],y [rad]", "u is in 'mV', expected V"),
        ("t,u [V],y [deg]", "y is in 'deg', expected rad"),
    ],
)
def test_a_column_in_another_unit_is_refused(tmp_path: Path, head: str, said: str) -> None:
    (tmp_path / "t.csv").write_text(f"{head}\n0,1,2\n1,1,2\n")
    with pytest.raises(HilError, match=rf"t\.csv: {said}"):
        read_signal_table(tmp_path / "t.csv", ("u", "y"), ("V", "rad"))


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ((0.0, 0.1, 0.1, 0.2), "row 3: the time does not grow"),
        ((0.0, 0.2, 0.1, 0.3), "row 3: the time does not grow"),
        ((0.0, 0.1, 0.2, math.inf), "row 4: the time does not grow, or is infinite"),
        ((0.0, 0.1, 0.2, 1.7), "4 rows over 17 periods of 0.1 s; expected no such gaps"),
        ((0.0,), "1 rows, expected at least 2"),
    ],
)
def test_times_that_do_not_grow_or_leave_most_out_are_refused(tmp_path: Path, times: tuple[float, ...], said: str) -> None:
    (tmp_path / "t.csv").write_text("t_s,y\n" + "".join(f"{t},1\n" for t in times))
    with pytest.raises(HilError, match=f"t.csv: {said}"):
        read_signal_table(tmp_path / "t.csv", ("y",))


def test_a_table_costs_little_more_memory_than_it_is_long(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("t,u,y\n0,1,2\n1,2,3\n")
    read_signal_table(path, ("u", "y"))  # what the first one imports is no memory of a table
    path.write_text("t,u,y\n" + "".join(f"{k * 0.01:.2f},{k % 7}.125,{k % 11}.0625\n" for k in range(10_000)))
    tracemalloc.start()
    try:
        read_signal_table(path, ("u", "y"))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8 * path.stat().st_size  # the whole text and a list of numbers for each line took 16 times


def test_what_is_no_regular_file_or_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "t.csv").write_text("t,y\n0,1\n1,2\n")
    monkeypatch.setattr(arrays, "MOST_BYTES", 5)
    refused = {"pipe": "is no regular file", "": "is a folder", "none": "cannot be read", "t.csv": "more than 5 bytes"}
    for name, said in refused.items():
        with pytest.raises(HilError, match=said):
            read_signal_table(tmp_path / name, ("y",))
