"""`hil can analyse`: tables of traffic and experiments, with bounds beside what was measured."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli.can import can as command
from hil.errors import HilError
from tests.hostile.watchdog import within
from tests.transport.can_analysis.sae import BOUNDS_MS, SAE


def run(*words: str) -> str:
    done = CliRunner().invoke(command, ["analyse", *words], catch_exceptions=False, standalone_mode=False)
    return done.output


@pytest.fixture
def sae(tmp_path: Path) -> Path:
    rows = [f"{each.name},{each.identifier:#x},{each.period_ns / 1e6:g} ms,{each.length}" for each in SAE]
    (tmp_path / "sae.csv").write_text("\n".join(["name,can_id,period,length", *rows]))
    return tmp_path / "sae.csv"


def test_a_table_of_traffic_has_its_bounds_and_what_was_measured_below_them(sae: Path, tmp_path: Path) -> None:
    page = tmp_path / "bus.html"
    found = json.loads(run(str(sae), "--bitrate", "125k", "--duration", "2", "--json", "-o", str(page)))
    assert [each["bound_ms"] for each in found["messages"]] == list(BOUNDS_MS) and round(found["load"], 4) == 0.8574
    assert "Load at most" in page.read_text()
    assert all(0 < each["measured_ms"] <= each["bound_ms"] for each in found["messages"])
    assert found["messages"][2]["delayed_by"] == ["SAE 1", "SAE 2"]
    assert "every message meets its deadline" in page.read_text() and "SAE 17" in page.read_text()
    assert "every message meets its deadline" in run(str(sae), "--bitrate", "125k", "--duration", "0.1")


def test_errors_and_too_slow_a_bus_are_said(sae: Path) -> None:
    worse = json.loads(run(str(sae), "--bitrate", "125k", "--duration", "0.1", "--errors", "2", "--json"))
    assert all(each["bound_ms"] > bound for each, bound in zip(worse["messages"], BOUNDS_MS))
    said = run(str(sae), "--bitrate", "100k", "--duration", "1")
    assert "The messages need 107.2 % of the bus" in said and "may miss their deadline" in said and "none" in said


def test_an_experiment_is_run_and_analysed() -> None:
    found = json.loads(run("dc-motor-busy-can", "--duration", "1", "--json"))
    own = {each["name"]: each for each in found["messages"]}
    assert own["motor"]["bound_ms"] == 39.656 and 0 < own["controller"]["measured_ms"] < own["controller"]["bound_ms"]


def test_a_late_clock_of_a_sensor_node_counts_in_the_bounds_of_what_it_delays() -> None:
    """Two of its packets come 50 ms apart instead of 100, and the last message waits for both of them."""
    below = (f'{{can_id={0x10 + i}, data="0000000000000000", period="100 ms", offset="50 ms"}}' for i in range(5))
    sets = ("nodes.motor.clock={every=2, jitter=1}", "nodes.motor.can_id=1", "media.bus.bitrate=10000", "media.bus.control=false")
    words = [word for each in (*sets, f"media.bus.traffic=[{','.join(below)}]") for word in ("--set", f"network.{each}")]
    found = json.loads(run("dc-motor-busy-can", "--duration", "4", *words, "--json"))["messages"]
    assert all(0 < each["measured_ms"] <= each["bound_ms"] for each in found) and found[-1]["measured_ms"] > 78


def test_bounds_say_what_they_assume_of_errors() -> None:
    """Random bit errors at any rate leave no bound; with --errors nodes must stay error active."""
    words = ["dc-motor-busy-can", "--duration", "1", "--set", "network.media.bus.bit_error_rate=1e-4"]
    found = json.loads(run(*words, "--json"))
    assert found["disturbed"] and all(each["bound_ms"] is None and not each["in_time"] for each in found["messages"])
    assert "no bound: the experiment disturbs its bus" in run(*words)
    allowed = json.loads(run(*words, "--errors", "1", "--json"))
    assert not allowed["disturbed"] and allowed["messages"][0]["bound_ms"] > 0
    assert allowed["assumes"] == "errors come at most 1 at once and one more in every 1 s, and no node becomes error passive"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["x.csv"], "x.csv: cannot be read: No such file"),
        (["sae.csv"], "sae.csv says no bit rate, such as 500k"),
        (["sae.csv", "--bitrate", "501k"], "--bitrate: 501000 bit/s: no whole part of 80000000 Hz; the nearest possible is "),
        (["dc-motor-hinf"], "dc-motor-hinf: no medium of kind 'can'"),
        (["dc-motor-busy-can", "--bitrate", "500k"], "--bitrate: is for messages in a .csv or .dbc"),
    ],
)
def test_what_cannot_be_analysed_is_refused(words: list[str], said: str, sae: Path) -> None:
    with pytest.raises(HilError) as caught:
        run(*(str(sae) if word == sae.name else word for word in words))
    assert said in str(caught.value)


def traffic(folder: Path, count: int, period: str, name: str = "m", extended: int = 0) -> str:
    rows = [f"{name}{i},{i},{period},8,{extended}" for i in range(count)]
    (folder / "t.csv").write_text("\n".join(["name,can_id,period,length,extended", *rows]))
    return str(folder / "t.csv")


@pytest.mark.parametrize(
    ("count", "period", "name", "said"),
    [
        (1999, "1 ms", "m", "1999 messages, at most 1000"),
        (900, "1 ms", "m", "frames would wait in the end, at most 20000 are simulated; --duration"),
        (2, "1 s", "n" * 1000, "name: 1001 characters, expected 128 at most"),
    ],
    ids=["many", "overloaded", "long names"],
)
def test_traffic_that_would_take_minutes_is_refused(count: int, period: str, name: str, said: str, tmp_path: Path) -> None:
    with within(), pytest.raises(HilError, match=said):
        run(traffic(tmp_path, count, period, name), "--bitrate", "500k")


def test_as_many_messages_as_are_allowed_take_no_minutes(tmp_path: Path) -> None:
    """The load of the messages above was added up anew for each, in fractions: 2000 of them took half a minute."""
    rows = [f"m{i},{i},{9000 + 7 * i} ms,8" for i in range(1000)]
    (tmp_path / "t.csv").write_text("\n".join(["name,can_id,period,length", *rows]))
    with within():
        found = json.loads(run(str(tmp_path / "t.csv"), "--bitrate", "500k", "--duration", "0.1", "--json"))
    assert len(found["messages"]) == 1000 and all(each["in_time"] for each in found["messages"])


@pytest.mark.parametrize(
    "line",
    [
        "BO_ 1 M: 99999999 A", "BO_ 1 M: 8 A\n SG_ S : 0|99999999@1+ (1,0) [0|0] \"\" A", "BO_ 1 M\n:\n+99999999 A",
        "BO_ 1 M: // 8\n99999999 A", "BO_ 1 M: 8 A SG_ S : 0 |\n99999999 @1+ (1,0) [0|0] \"\" A",
        'CM_ "\\";\nBO_ 1 M: 99999999 A',
    ],
)  # fmt: skip
def test_a_dbc_with_a_message_of_a_hundred_million_bits_is_refused_at_once(line: str, tmp_path: Path) -> None:
    (tmp_path / "t.dbc").write_text(f'VERSION ""\nBU_: A\n{line}\n')
    with within(), pytest.raises(HilError, match=r"is no DBC: .*no message has so many bits"):
        run(str(tmp_path / "t.dbc"), "--bitrate", "500k")


def test_a_dbc_of_empty_lines_costs_no_minutes_and_a_comment_may_hold_any_number(tmp_path: Path) -> None:
    said = 'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\nCM_ "ticket: 1234567 |1234567@ \\" // :";\n'
    cycle = 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 100;\n'
    (tmp_path / "t.dbc").write_text(said + 50_000 * "\n" + cycle)
    with within():
        found = json.loads(run(str(tmp_path / "t.dbc"), "--bitrate", "500k", "--duration", "0.1", "--json"))
    assert [each["name"] for each in found["messages"]] == ["M"]


def test_messages_of_a_dbc_that_say_no_cycle_time_are_named(tmp_path: Path) -> None:
    head = 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 0;\n'
    (tmp_path / "t.dbc").write_text('VERSION ""\nBU_: A\n' + "".join(f"BO_ {i} M{i}: 8 A\n" for i in range(1, 6)) + head)
    with pytest.raises(HilError, match=r"t\.dbc: no message that is sent again and again: none says its cycle time by GenMsg"):
        run(str(tmp_path / "t.dbc"), "--bitrate", "500k")
    with (tmp_path / "t.dbc").open("a") as file:
        file.write('BA_ "GenMsgCycleTime" BO_ 3 10;\n')
    said = " ".join(run(str(tmp_path / "t.dbc"), "--bitrate", "500k", "--duration", "0.1").split())
    assert "no node is off the bus, and nothing without GenMsgCycleTime is sent (4: M1, M2, M4, ...)." in said


def test_a_dbc_whose_cycle_time_is_no_number_of_seconds_is_refused(tmp_path: Path) -> None:
    cycle = 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 0;\nBA_ "GenMsgCycleTime" BO_ 1 1e400;\n'
    (tmp_path / "t.dbc").write_text(f'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n{cycle}')
    with pytest.raises(HilError, match=r"t\.dbc: message M: "):
        run(str(tmp_path / "t.dbc"), "--bitrate", "500k")
