"""What is no record of an axis is refused with its file; a slot without a measurement stays empty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.read.run import read_run
from hil.log.run import Run, StructuredArray
from hil.measure import identification_records
from hil.measure.identification_records import AxisRecord, read_axis_record, read_mode_record
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
