"""Logs in other formats hold the same values; frames stand in the order of time, and few of them wait in memory."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from msgspec.structs import replace
from scipy.io import loadmat

from hil.cli.log_files import export as command
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.read import can_log as module
from hil.log.read import read_run
from hil.log.read.can_log import measured_frames
from hil.log.read.export import export
from hil.log.run import Arrays, Run
from hil.rig import rig_of
from hil.rig.session_link import link_of
from hil.runtime.virtual import simulate
from hil.session import run_session
from tests.hil.log.recording import record_chunks


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    record_chunks(path, 6)
    return path


@pytest.fixture(scope="module")
def run(log: Path) -> Run:
    return read_run(log)


def test_a_table_reads_back_to_the_last_bit(run: Run, tmp_path: Path) -> None:
    target = tmp_path / "state.csv"
    assert export(run, target, ["/plant/state"]) == [target]
    with open(target, newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["t_ns [ns]", "angle [rad]", "speed [rad/s]", "slot [1]"]
    state = run.arrays["/plant/state"]
    assert [float(row[2]) for row in rows] == state["speed"].tolist()
    assert [int(row[0]) for row in rows] == state["t_ns"].tolist()


def test_every_topic_becomes_a_table_of_its_own(run: Run, tmp_path: Path) -> None:
    paths = export(run, tmp_path / "run.csv")
    assert {path.name for path in paths} == {path.name for path in tmp_path.iterdir()}
    assert len(paths) == len(run.arrays) + 1
    with open(tmp_path / "run.events.csv", newline="") as file:
        events = list(csv.DictReader(file))
    assert [event["kind"] for event in events] == ["mark", "mark"]
    assert json.loads(events[0]["data"]) == run.events[0]["data"]
    with open(tmp_path / "run.link_sensor.csv", newline="") as file:
        frames = list(csv.DictReader(file))
    assert [bytes.fromhex(frame["data [1]"]) for frame in frames] == run.arrays["/link/sensor"]["data"].tolist()


def test_a_text_of_an_event_is_no_formula(run: Run, tmp_path: Path) -> None:
    texts = ("=cmd|' /C calc'!A0", "+1", "-1", "@x", "\tx", "\rx", "a=1", "")
    said = [{**run.events[0], "message": text, "slot": -1} for text in texts]
    export(replace(run, events=said), tmp_path / "e.csv", ["/events"])
    with open(tmp_path / "e.csv", newline="") as file:
        found = list(csv.DictReader(file))
    assert [each["message"] for each in found] == [*(f"'{text}" for text in texts[:5]), r"\rx", *texts[6:]], "and no row"
    assert {each["slot"] for each in found} == {"-1"}


def test_numpy_reads_the_arrays_back(run: Run, tmp_path: Path) -> None:
    export(run, tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz", allow_pickle=False) as found:
        lengths, data = found["link_control_length"], found["link_control_data"]
        frames = [row[:length].tobytes() for row, length in zip(data, lengths, strict=True)]
        for topic, array in run.arrays.items():
            read = found[topic.strip("/").replace("/", "_")]  # the header of one with a gap could not be read
            assert read.dtype.names == tuple(name for name in array.dtype.names or () if name != "data")
            for name in read.dtype.names or ():
                np.testing.assert_array_equal(read[name], array[name])
    assert frames == run.arrays["/link/control"]["data"].tolist()


def test_matlab_reads_a_struct_of_columns_a_topic(run: Run, tmp_path: Path) -> None:
    export(run, tmp_path / "run.mat")
    found = loadmat(tmp_path / "run.mat", simplify_cells=False)
    for topic, array in run.arrays.items():
        struct = found[topic.strip("/").replace("/", "_")][0, 0]
        for name in set(array.dtype.names or ()) - {"data"}:
            np.testing.assert_array_equal(struct[name][:, 0], array[name])
    frames = found["link_control"][0, 0]
    read = [row[:length].tobytes() for row, length in zip(frames["data"], frames["length"][:, 0], strict=True)]
    assert read == run.arrays["/link/control"]["data"].tolist()


def test_of_no_frame_numpy_reads_no_byte(run: Run, tmp_path: Path) -> None:
    export(replace(run, arrays={"/link/control": run.arrays["/link/control"][:0]}), tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz", allow_pickle=False) as found:
        assert {name: array.shape for name, array in found.items()} == {
            "link_control_data": (0, 0), "link_control_length": (0,), "link_control": (0,),
        }  # fmt: skip


@pytest.mark.parametrize("ending", [".csv", ".npz", ".log", ".blf"])
def test_an_export_replaces_nothing_unasked(log: Path, run: Run, tmp_path: Path, ending: str) -> None:
    mine = tmp_path / ("x.plant_state.csv" if ending == ".csv" else f"x{ending}")
    mine.write_text("mine")
    done = CliRunner().invoke(command, [str(log), "-o", str(tmp_path / f"x{ending}")])
    assert isinstance(done.exception, HilError) and "exists already" in str(done.exception)
    assert mine.read_text() == "mine" and [p.name for p in tmp_path.iterdir()] == [mine.name]
    assert CliRunner().invoke(command, [str(log), "-o", str(tmp_path / f"x{ending}"), "--force"]).exit_code == 0
    assert mine.read_bytes() != b"mine"


def test_an_export_follows_no_link(run: Run, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    for name in (".x.part.csv", "x.csv"):
        (tmp_path / name).symlink_to(victim)
    export(run, tmp_path / "x.csv", ["/plant/state"], replace=True)
    assert victim.read_text() == "precious" and not (tmp_path / "x.csv").is_symlink()


def packets(run: Run) -> list[tuple[float, int, bytes]]:
    """When, as what and what: a frame stands where its slot's lateness put it, an answer a round trip later."""
    sensor, control, timing = run.arrays["/link/sensor"], run.arrays["/link/control"], run.arrays["/timing/slot"]
    begin, late = datetime(2000, 1, 1, tzinfo=UTC).timestamp(), dict(zip(timing["slot"], timing["lateness_us"]))
    trip = dict(zip(timing["slot"], np.nan_to_num(timing["round_trip_us"])))
    found = [(begin + f["t_ns"] / 1e9 + late[f["slot"]] / 1e6, 0x100, f["data"]) for f in sensor]
    found += [(begin + f["t_ns"] / 1e9 + (late[f["slot"]] + trip[f["slot"]]) / 1e6, 0x140, f["data"]) for f in control]
    return sorted(found, key=lambda packet: packet[0])


@pytest.mark.parametrize("ending", [".log", ".blf", ".mf4", ".asc"])
def test_a_can_log_holds_the_frames_of_the_link(run: Run, tmp_path: Path, ending: str) -> None:
    target = tmp_path / f"run{ending}"
    assert export(run, target) == [target]
    with can.LogReader(target) as reader:
        messages = list(reader)
    expected = packets(run)
    assert [(m.arbitration_id, bytes(m.data)) for m in messages] == [(i, data) for _, i, data in expected]
    began = expected[0][0] - messages[0].timestamp if ending == ".asc" else 0.0  # its times count from the first frame
    assert [m.timestamp + began for m in messages] == pytest.approx([t for t, _, _ in expected], abs=2e-6)
    assert all(m.is_fd and m.bitrate_switch and not m.is_extended_id for m in messages)


def test_without_asammdf_a_message_names_the_extra(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(HilError, match=r"\.mf4 needs asammdf: pip install 'hilrig\[mf4\]'"):
        export(run, tmp_path / "run.mf4")
    assert not list(tmp_path.iterdir())


def test_channels_of_frames_say_their_can_identifiers(tmp_path: Path) -> None:
    """As ``hil dbc`` has them: of each node by its name, those of the session's link."""
    experiment = load_experiment("multisensor-published", ["duration=0.1"])
    run_session(experiment, path=tmp_path / "x.mcap")
    with open(tmp_path / "x.mcap", "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    reported = {channel.topic: channel.metadata for channel in summary.channels.values()}
    ids = {f"can_id.{name}": f"{0x100 + 16 * i:#x}-{0x10F + 16 * i:#x}" for i, name in enumerate(experiment.network.nodes)}
    assert reported["/link/sensor"] == ids and reported["/link/control"] == {"can_id.control": "0x140-0x17f"}
    rig = rig_of(load_experiment("dc-motor-hinf"))
    assert link_of(rig, "can:hil:x?base=0x300").channel_metadata(rig)["/link/sensor"] == {"can_id.sensor": "0x300-0x33f"}


def test_peaks_text_format_takes_classic_frames_only(run: Run, tmp_path: Path) -> None:
    with pytest.raises(HilError, match=r"classic frames only as \.trc, .* export \.asc instead"):
        export(run, tmp_path / "run.trc")
    assert not list(tmp_path.iterdir())
    export(replace(run, metadata={**run.metadata, "link": "can:hil:rig0?fd=0"}), tmp_path / "run.trc", ["/link/sensor"])
    with can.LogReader(tmp_path / "run.trc") as reader:
        assert b"".join(bytes(m.data) for m in reader) == b"".join(run.arrays["/link/sensor"]["data"])


def test_a_can_log_of_a_classic_link_holds_its_classic_frames(run: Run, tmp_path: Path) -> None:
    classic = replace(run, metadata={**run.metadata, "link": "can:hil:rig0?fd=0&base=0x200"})
    export(classic, tmp_path / "run.log", ["/link/sensor"])
    with can.LogReader(tmp_path / "run.log") as reader:
        messages = list(reader)
    assert not any(m.is_fd for m in messages)
    assert [m.arbitration_id for m in messages[:4]] == [0x280, 0x281, 0x282, 0x280]
    assert b"".join(bytes(m.data) for m in messages) == b"".join(run.arrays["/link/sensor"]["data"])


def test_a_frame_that_no_can_bus_takes_is_named(run: Run, tmp_path: Path) -> None:
    frames = run.arrays["/link/sensor"].copy()
    frames["data"][3] = bytes(5000)
    big = replace(run, arrays={**run.arrays, "/link/sensor": frames})
    with pytest.raises(HilError, match=r"/link/sensor at 0\.003\d* s: 5000 bytes do not fit on CAN"):
        export(big, tmp_path / "run.log")
    assert not list(tmp_path.iterdir())


def test_a_can_log_without_frames_is_refused(run: Run, tmp_path: Path) -> None:
    with pytest.raises(HilError, match="no frames to write"):
        export(run, tmp_path / "run.log", ["/plant/state"])
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def bus_run() -> Run:
    """0.3 s on a CAN bus with time, its bits disturbed for a while."""
    fault = '[{at = "0.1 s", for = "50 ms", kind = "bit-errors", rate = 5e-3}]'
    experiment = load_experiment("dc-motor-busy-can", ["duration=0.3", f"fault={fault}"])
    return simulate(compose(experiment, certify=False), 0)


@pytest.mark.parametrize("ending", [".log", ".blf", ".asc"])
def test_a_can_log_of_a_run_with_a_can_bus_holds_the_frames_of_that_bus(bus_run: Run, tmp_path: Path, ending: str) -> None:
    export(bus_run, tmp_path / f"bus{ending}")
    with can.LogReader(tmp_path / f"bus{ending}") as reader:
        messages = list(reader)
    frames = bus_run.arrays["/link/bus"]
    whole = frames["operation"] == 0
    assert [m.is_error_frame for m in messages] == (~whole).tolist() and not whole.all()
    assert len({m.channel for m in messages} - {None}) == 1  # of an error, candump's format names none
    got = [(m.arbitration_id, len(m.data), m.is_fd, m.is_extended_id) for m in messages if not m.is_error_frame]
    assert got == [(can_id, length, False, False) for can_id, length in frames[["can_id", "length"]][whole].tolist()]
    seconds = (frames["end_ns"] / 1e9).tolist()
    began = messages[0].timestamp - seconds[0] if ending == ".asc" else datetime(2000, 1, 1, tzinfo=UTC).timestamp()
    assert [m.timestamp - began for m in messages] == pytest.approx(seconds, abs=2e-6)


def test_a_can_log_holds_one_bus_and_peaks_format_no_destroyed_frame(bus_run: Run, tmp_path: Path) -> None:
    export(bus_run, tmp_path / "link.log", ["/link/sensor"])
    with can.LogReader(tmp_path / "link.log") as reader:
        assert len(list(reader)) == len(bus_run.arrays["/link/sensor"])
    with pytest.raises(HilError, match=r"x\.log: --topic /link/bus: is another bus than the link's"):
        export(bus_run, tmp_path / "x.log", ["/link/sensor", "/link/bus"])
    with pytest.raises(HilError, match=r"this log has frames that were destroyed; export \.asc"):
        export(bus_run, tmp_path / "x.trc")
    frames = bus_run.arrays["/link/bus"].copy()
    frames["length"][0] = 9
    with pytest.raises(HilError, match=r"/link/bus at 0\.0\d+ s: .*; export \.csv instead"):
        export(replace(bus_run, arrays={**bus_run.arrays, "/link/bus": frames}), tmp_path / "x.log")
    assert [path.name for path in tmp_path.iterdir()] == ["link.log"]


def test_an_unknown_ending_or_topic_is_named(run: Run, tmp_path: Path) -> None:
    endings = r"\.log, \.blf, \.asc, \.trc, \.mf4, \.csv, \.npz, \.mat"
    with pytest.raises(HilError, match=rf"the ending '\.xls' names no format, expected {endings}"):
        export(run, tmp_path / "run.xls")
    with pytest.raises(HilError, match=rf"expected {endings}; pandas writes a topic as Parquet: pandas\.DataFrame"):
        export(run, tmp_path / "run.parquet")
    with pytest.raises(HilError, match=r"topic '/plant/stat': not in the log, expected one of /plant/state, "):
        export(run, tmp_path / "run.csv", ["/plant/stat"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["run.csv", "run.npz", "run.mat"])
def test_two_topics_of_one_name_do_not_replace_each_other(run: Run, tmp_path: Path, name: str) -> None:
    """A log that was made elsewhere may have such topics."""
    arrays, schemas = ({**both, "/plant_state": both["/plant/state"]} for both in (run.arrays, run.schemas))
    twins = replace(run, arrays=arrays, schemas=schemas)
    with pytest.raises(HilError, match="topics '/plant/state' and '/plant_state' have one name in an export, 'plant_state'"):
        export(twins, tmp_path / name, replace=True)
    assert not list(tmp_path.iterdir())
    export(twins, tmp_path / name, ["/plant_state"])


@pytest.mark.parametrize("name", ["run.csv", "run.npz", "run.mat", "run.log", "run.blf"])
def test_a_place_that_cannot_be_written_is_named(run: Run, tmp_path: Path, name: str) -> None:
    target = tmp_path / "absent" / name
    with pytest.raises(HilError, match=r"absent.*: cannot be written: No such file"):
        export(run, target)


def test_the_command_prints_the_files_it_wrote(log: Path, tmp_path: Path) -> None:
    target = tmp_path / "reference.csv"
    arguments = [str(log), "-o", str(target), "--topic", "/reference"]
    done = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert (done.exit_code, done.output) == (0, f"{target}\n")


MS = 1_000_000


def run_of(slots: Sequence[int], late_us: float = 0.0, timed: Sequence[int] = ()) -> Run:
    """Answers of slots in the order of the log; a slot of an odd number was timed late; `timed`: the order of the timings."""
    answers = np.empty(len(slots), [("t_ns", "<i8"), ("slot", "<i8"), ("data", object)])
    answers["slot"], answers["t_ns"] = slots, np.array(slots) * MS
    answers["data"] = [k.to_bytes(4, "little") for k in slots]
    timing = np.zeros(len(slots), [("lateness_us", "<f8"), ("round_trip_us", "<f8"), ("slot", "<i8")])
    timing["slot"] = timed or np.sort(slots)
    timing["lateness_us"] = np.where(timing["slot"] % 2, late_us, 0.0)
    timing["round_trip_us"] = np.where(timing["slot"] % 3, np.nan, 100.0)
    return Run(arrays={"/link/control": answers, "/timing/slot": timing}, schemas={})


def slots_of(run: Run) -> list[int]:
    return [int.from_bytes(data, "little") for _, data in measured_frames(run, "/link/control")]


@pytest.mark.parametrize("late_us", [0.0, 1700.0])
def test_frames_stand_in_the_order_of_time(late_us: float) -> None:
    rng = np.random.default_rng(0)
    slots = [int(k) for start in range(0, 9000, 30) for k in rng.permutation(np.arange(start, start + 30))]
    found = [*measured_frames(run_of(slots, late_us), "/link/control")]
    instants = (k * MS + (k % 2) * int(late_us * 1000) + (k % 3 == 0) * 100_000 for k in slots)
    expected = sorted(zip(instants, (k.to_bytes(4, "little") for k in slots)))
    assert found == expected


@pytest.mark.parametrize("timed", [(2, 3, 0, 1), (0, 1, 3, 2), (3, 2, 1, 0)])
def test_timings_in_any_order_are_those_of_their_slots(timed: tuple[int, ...]) -> None:
    found = [t for t, _ in measured_frames(run_of(range(4), 300.0, timed), "/link/control")]
    assert found == [100_000, MS + 300_000, 2 * MS, 3 * MS + 400_000]


def test_few_frames_wait_for_one_that_came_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_HELD", 8)
    slots = [0, 1, 3, 2, 4, 5, 7, 6, *range(8, 20_000)]
    assert slots_of(run_of(slots)) == sorted(slots)
    with pytest.raises(HilError, match=r"/link/control: the frames are out of order by 0\.0501 s; more than 8 would have"):
        slots_of(run_of([*range(1, 52), 1, *range(52, 200)]))


def test_a_piece_at_a_time_is_read() -> None:
    class Counted(Arrays):
        alive = 0

        def pieces(self, topic: str, rows: int) -> Iterator[Any]:
            for piece in super().pieces(topic, rows):
                self.alive = len(piece)
                yield piece

    run = run_of(range(10_000))
    arrays = Counted(run.arrays)
    first, _ = next(measured_frames(replace(run, arrays=arrays), "/link/control"))
    assert first == 100_000 and 0 < arrays.alive < 10_000
