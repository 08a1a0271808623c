"""An experiment on a CAN bus that takes time: what it logs, what it sums up, what its page shows, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.cli.page_text import print_summary
from hil.compose import compose
from hil.errors import ExperimentError
from hil.experiment import load_experiment
from hil.log.run import records_sha256
from hil.measure.bus_load import bus_of
from hil.measure.view import view_of
from hil.pages import Table
from hil.pages.run_page import render_report
from hil.pages.sections.traffic import can_bus
from hil.runtime.virtual import simulate
from hil.session import simulated_session
from hil.sweeps.lockstep import supports_batch

NAME = "dc-motor-busy-can"
ENGINE = ('{name="a", can_id=1, period="5 ms", node="engine"}', '{name="b", can_id=2, period="9 ms", node="engine"}')
SHARED = f"network.media.bus.traffic=[{', '.join(ENGINE)}]"


@pytest.fixture(scope="module")
def session():  # type: ignore[no-untyped-def]
    return simulated_session(compose(load_experiment(NAME, duration="4")), 0)


def test_frames_never_overlap_and_the_lowest_identifier_that_waits_is_sent(session) -> None:  # type: ignore[no-untyped-def]
    frames = session.run.arrays["/link/bus"]
    assert len(frames) > 5000
    slots, period_ns = frames["t_ns"] // 50_000_000, 50_000_000
    assert (frames["t_ns"] == slots * period_ns).all() and slots[0] == 0 and slots[-1] == 79
    assert (frames["start_ns"][1:] >= frames["idle_ns"][:-1]).all()
    assert (frames["start_ns"] >= frames["queued_ns"]).all()
    for i in range(2000):  # who was queued by the start of a frame and came later had a higher identifier
        waiting = frames[i + 1 : i + 40]
        waiting = waiting[waiting["queued_ns"] <= frames["start_ns"][i]]
        assert (waiting["can_id"] > frames["can_id"][i]).all()


def test_the_bus_makes_the_delay_and_no_response_is_beyond_its_bound(session) -> None:  # type: ignore[no-untyped-def]
    found = bus_of(view_of(session.run, session.experiment))
    assert found is not None and 0.7 < found.load < found.stated_load < 0.9
    for message in found.messages:
        assert message.bound_ms is not None and (message.response_worst_ms or 0.0) <= message.bound_ms
    own = {each.name: each for each in found.messages if each.node in found.own_nodes}
    assert set(own) == {"motor", "controller"} and own["motor"].frames == 80
    ages = session.run.arrays["/controller/rows"]["tau"]
    assert set(ages.tolist()) == {0, 1} and 0.1 < float(np.mean(ages)) < 0.6
    assert session.summary["network"]["bus"]["frames"] == found.frames
    certificate = session.summary["certificate"]
    assert certificate["state"] == "certified" and "in any order that the bus leaves possible" in certificate["reason"]


def test_the_page_shows_the_bus_its_messages_and_a_time_line(session) -> None:  # type: ignore[no-untyped-def]
    page = render_report(view_of(session.run, session.experiment))
    assert "CAN bus" in page and "Messages by priority" in page and "The bus around the longest wait" in page
    assert "SAE 17" in page and "motor waits" in page
    view = view_of(session.run, session.experiment)
    found, section = bus_of(view), can_bus(view)
    assert found is not None and section is not None
    messages = section.blocks[0]
    assert isinstance(messages, Table)
    load = [row[messages.columns.index("load, %")] for row in messages.rows]
    assert sum(load) == pytest.approx(100.0 * found.load, rel=1e-3)  # type: ignore[arg-type]


def test_the_page_has_the_load_of_nodes_that_send_several_messages() -> None:
    loop = compose(load_experiment(NAME, ["duration=1", SHARED]), certify=False)
    page = render_report(view_of(simulate(loop, 0), loop.experiment))
    assert "Load by node" in page and "engine" in page


def test_a_way_over_the_bus_is_called_by_the_bus_and_not_by_the_law_behind_it(session, capsys) -> None:  # type: ignore[no-untyped-def]
    print_summary(session.summary)
    lines = capsys.readouterr().out.splitlines()
    for way in ("to controller", "to actuator"):
        line = next(line for line in lines if line.startswith(way))
        assert line.removeprefix(way).strip().startswith("CAN bus, 125 kbit/s; lost 0")
    assert not any("law" in line for line in lines)
    page = render_report(view_of(session.run, session.experiment))
    assert "CAN bus, 125 kbit/s" in page and "Sensor to controller: age of what was used" in page
    slower = ["duration=1", 'network.ca.law={kind="iid", probabilities=[0.5, 0.5]}']
    changed = compose(load_experiment(NAME, slower), certify=False)
    assert simulated_session(changed, 0).summary["network"]["ca"]["through"] == "CAN bus, 125 kbit/s, then iid law"


def test_a_seed_is_a_run_bit_for_bit_and_another_seed_another_bus() -> None:
    loop = compose(load_experiment(NAME, duration="1"), certify=False)
    first = records_sha256(simulate(loop, 0))
    assert records_sha256(simulate(loop, 0)) == first != records_sha256(simulate(loop, 1))


def test_runs_of_a_sweep_are_not_computed_at_once() -> None:
    loop = compose(load_experiment(NAME, duration="1"), certify=False)
    assert not supports_batch(loop)


def test_disturbed_bits_are_sent_again_and_put_nodes_into_other_states() -> None:
    experiment = load_experiment(NAME, duration="2", sets=["network.media.bus.bit_error_rate=0.002"])
    run = simulate(compose(experiment, certify=False), 0)
    frames = run.arrays["/link/bus"]
    broken = frames[frames["operation"] == 1]
    assert 0.05 < len(broken) / len(frames) < 0.4 and (broken["error_bit"] >= 0).all()
    assert (frames["error_bit"][frames["operation"] == 0] == -1).all()
    reported = [event for event in run.events if event["kind"] == "bus status"]
    assert reported and all("TEC" in event["message"] for event in reported)
    found = bus_of(view_of(run, experiment))
    assert found is not None and found.errors == len(broken) and all(each.bound_ms is None for each in found.messages)


def test_a_bus_with_a_data_bit_rate_carries_can_fd() -> None:
    run = simulate(compose(load_experiment(NAME, duration="1", sets=["network.media.bus.dbitrate=1000000"]), certify=False), 0)
    frames = run.arrays["/link/bus"]
    own = frames[np.isin(frames["can_id"], (0x100, 0x140))]
    assert set(own["flags"].tolist()) == {12} and len(own) == 40


def test_more_traffic_than_the_bus_carries_runs_and_the_motor_is_not_received(capsys: pytest.CaptureFixture[str]) -> None:
    more = "network.media.bus.traffic=[{name='flood', can_id=1, length=8, period='0.9 ms'}]"
    experiment = load_experiment(NAME, duration="1", sets=[more, "limits.watchdog_slots=1000"])
    done = simulated_session(compose(experiment, certify=False), 0)
    run = done.run
    print_summary(done.summary)
    assert " % of it: those of low priority are not sent, or ever later" in " ".join(capsys.readouterr().out.split())
    found = bus_of(view_of(run, experiment))
    assert found is not None and found.stated_load > 1 and found.load > 0.99
    assert {each.name: each.bound_ms is None for each in found.messages} == {"flood": True, "motor": True, "controller": True}


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("network.media.bus.bitrate=501000",
         "network.media.bus.bitrate: 501000 bit/s: no whole part of 80000000 Hz; the nearest possible is"),
        ("network.media.bus.dbitrate=100000", "network.media.bus.dbitrate: 100000 bit/s, expected 125000 to 10000000"),
        ("network.media.bus.bit_error_rate=2", "network.media.bus.bit_error_rate: 2, expected a probability"),
        ("network.media.bus.loss=0.1", "network.media.bus.loss: a CAN bus repeats what was destroyed"),
        ("network.media.bus.kind='round-robin'", "network.media.bus.bitrate: for a medium of kind 'can' only"),
        ("network.media.bus.traffic=[{can_id=0x800, period=1}]", "traffic[0].can_id: 0x800, expected 0 to 0x7ff (11 bits)"),
        ("network.media.bus.traffic=[{can_id=-1, period=1}]", "traffic[0].can_id: -0x1, expected 0 to 0x7ff (11 bits)"),
        ("network.media.bus.traffic=[{can_id=0x20000000, extended=true, period=1}]", "expected 0 to 0x1fffffff (29 bits)"),
        ("network.media.bus.traffic=[{can_id=1, period=0}]", "traffic[0].period: 0 s is not between 10 us and 1 h"),
        ("network.media.bus.traffic=[{can_id=1, period=1, length=12}]",
         "traffic[0].length: 12 bytes, expected 0 to 8, or fd = true"),
        ("network.media.bus.traffic=[{can_id=1, period=1, data='xy'}]", "traffic[0].data: 'xy', expected bytes in hexadecimal"),
        ("network.media.bus.traffic=[{can_id=0x100, period=1}]", "traffic[0].can_id: 0x100 is the identifier of 'motor' already"),
        ("network.media.bus.traffic=[{can_id=1, period=1}, {can_id=1, period=2, name='b'}]",
         "traffic[1].can_id: 0x1 is the identi"),
        ("network.media.bus.traffic=[{name='motor', can_id=1, period=1}]", "traffic[0].name: 'motor' is a node of the rig"),
        ("network.media.bus.traffic=[{can_id=1, period=1, fd=true}]",
         "traffic[0].fd: the bus has no dbitrate, expected one for CAN FD"),
        ("network.media.bus.traffic_file='none.csv'", "network.media.bus.traffic_file: "),
    ],
)  # fmt: skip
def test_what_no_bus_is_refused_with_its_path(override: str, said: str) -> None:
    with pytest.raises(ExperimentError) as caught:
        compose(load_experiment(NAME, sets=[override]))
    assert said in str(caught.value)


CANDUMP = "(100.000000) can0 123#1122334455667788\n(100.004000) can0 18FF0001#00\n(100.0045) can0 200#R2\n"


def test_a_recording_is_sent_again_in_its_order_and_at_its_times(tmp_path: Path) -> None:
    (tmp_path / "car.log").write_text(CANDUMP)
    text = Path("hil/experiments", f"{NAME}.toml").read_text()
    (tmp_path / "own.toml").write_text(text.replace("bitrate = 125_000", "bitrate = 125_000\ntraffic_file = 'car.log'"))
    loop = compose(load_experiment(tmp_path / "own.toml", duration="1"), certify=False)
    table = loop.experiment.resolved()["network"]["media"]["bus"]
    assert table["recorded"] == ["0 123#1122334455667788", "4000000 18FF0001#00", "4500000 200#R2"] and not table["traffic_file"]
    run = simulate(loop, 0)
    frames = run.arrays["/link/bus"]
    sent = [frame for frame in frames if frame["can_id"] in (0x123, 0x18FF0001, 0x200)]
    assert [(int(f["can_id"]), int(f["queued_ns"]), int(f["flags"])) for f in sent] == [
        (0x123, 0, 0), (0x18FF0001, 4_000_000, 1), (0x200, 4_500_000, 2),
    ]  # fmt: skip
    found = bus_of(view_of(run, loop.experiment))
    assert found is not None and all(each.bound_ms is None for each in found.messages)
    reported = [each.name for each in found.messages if each.node == "recording"]
    assert reported == ["recorded 0x123", "recorded 0x200", "recorded 0x18ff0001"]


def refusal_of_traffic(folder: Path, name: str, text: str) -> str:
    """The message by which an experiment with such a `traffic_file` is refused."""
    (folder / name).write_text(text)
    experiment = Path("hil/experiments", f"{NAME}.toml").read_text()
    (folder / "own.toml").write_text(experiment.replace("bitrate = 125_000", f"bitrate = 125_000\ntraffic_file = '{name}'"))
    with pytest.raises(ExperimentError) as caught:
        compose(load_experiment(folder / "own.toml"), certify=False)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("(0.0) can0 123#11\n(0.0) can0 124#11\n", "car.log: every frame has the time stamp 0; a recording with time"),
        ("(0.0) can0 100#11\n(0.1) can0 124#11\n", "recorded[0]: 0x100 is the identifier of 'motor' already"),
        ("nothing\n", "car.log: is no CAN log"),
    ],
)
def test_a_recording_that_cannot_be_sent_is_refused(tmp_path: Path, text: str, said: str) -> None:
    assert said in refusal_of_traffic(tmp_path, "car.log", text)


CSV = "name,can_id,period,length,jitter,extended\nspeed,0x123,10 ms,4,1 ms,\nlamp,0x18FF0000,0.5,1,,yes\n"
DBC = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 291 Speed: 4 ECU
BO_ 292 Never: 4 ECU
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 291 20;
"""


def test_traffic_is_read_from_a_table_and_from_a_dbc_and_stands_in_the_resolved_experiment(tmp_path: Path) -> None:
    (tmp_path / "more.csv").write_text(CSV)
    (tmp_path / "car.dbc").write_text(DBC)
    text = Path("hil/experiments", f"{NAME}.toml").read_text()
    for file, names in (("more.csv", ["speed", "lamp"]), ("car.dbc", ["Speed"])):
        (tmp_path / "own.toml").write_text(text.replace("bitrate = 125_000", f"bitrate = 125_000\ntraffic_file = '{file}'"))
        loop = compose(load_experiment(tmp_path / "own.toml"), certify=False)
        table = loop.experiment.resolved()["network"]["media"]["bus"]
        assert table["traffic_file"] == "" and [each["name"] for each in table["traffic"][17:]] == names
    lamp = compose(load_experiment(tmp_path / "own.toml"), certify=False).experiment.network.media["bus"].traffic[-1]
    assert (lamp.can_id, float(lamp.period), lamp.length, lamp.node) == (291, 0.02, 4, "ECU")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name,can_id\nx,1\n", "line 1: no column 'period'"),
        ("can_id,period,speed\n1,1,1\n", "line 1: an unknown column 'speed'"),
        ("can_id,period,can_id\n1,1,2\n", "line 1: two columns are called 'can_id', expected one"),
        ("can_id,period\n0x800,1\n", "line 2: can_id: 0x800, expected 0 to 0x7ff (11 bits)"),
        ("can_id,period\n1,1\nx,1\n", "line 3: can_id: 'x'"),
        ("can_id,period\n", "no message that is sent again and again"),
    ],
)
def test_a_faulty_table_of_traffic_is_refused_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    assert f"network.media.bus.traffic_file: {tmp_path}/bad.csv: {said}" in refusal_of_traffic(tmp_path, "bad.csv", text)
