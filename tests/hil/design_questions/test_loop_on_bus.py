"""A loop's packets on a CAN bus: the laws that it makes of them, exact or estimated, and the place to take on it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from msgspec.structs import replace

from hil.cli.design import command as design
from hil.cli.design.experiment import _judge_place
from hil.cli.laws import command as laws
from hil.compose import compose
from hil.design_questions import loop_on_bus
from hil.design_questions.loop_on_bus import Judged, Place, estimated_laws, places_of, recommended
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.runtime.virtual import simulate
from transport.law_fit import LawFit, fit_law
from transport.law_fit.packet_record import PacketRecord
from transport.law_tests import analysis

BUSY = "dc-motor-busy-can"
TWO = '{name="a", can_id=1, data="0102", period="50 ms"}, {name="b", can_id=2, length=0, period="25 ms"}'
KNOWN = f"network.media.bus.traffic=[{TWO}]"


def bus_laws(*arguments: str) -> str:
    result = CliRunner().invoke(laws, [BUSY, "--from-bus", *arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


def test_the_law_of_a_bus_is_exact_where_its_ages_repeat() -> None:
    slow = ("--set", KNOWN, "--set", "network.media.bus.bitrate=10000", "--json")
    found = json.loads(bus_laws(*slow))["laws"]
    assert found["sc"]["exact"] and found["ca"]["exact"] and found["sc"]["packets"] == 0
    assert found["sc"]["spec"] == {"kind": "constant", "age": 1} and found["ca"]["spec"] == {"kind": "constant", "age": 0}
    assert 10.0 < found["sc"]["worst_ms"] < 60.0 and found["sc"]["largest_age"] == 1


def test_the_law_of_the_busy_bus_is_estimated_with_a_bound_and_an_experiment_includes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its shares are those of the run: ages 1 in a third of the slots; and a loop without the bus runs under the file."""
    monkeypatch.setattr(loop_on_bus, "LEAST_SLOTS", 300)
    text = bus_laws("--set", "duration=15", "-o", str(tmp_path / "law.toml"))
    assert "estimated: ages that are a semi-Markov chain, from 300 packets" in text and "no age is above 1" in text
    assert "latencies are 30 ms less than on the bus" in " ".join(text.split())
    assert "at most 30.256 ms" in text and f'ca.law = {{ file = "{tmp_path}/law.ca.toml" }}' in text
    base = ("network.media={}", f"network.sc={{law={{file={str(tmp_path / 'law.sc.toml')!r}}}, max_age=2}}")
    one = load_experiment(BUSY, (*base, f"network.ca={{law={{file={str(tmp_path / 'law.ca.toml')!r}}}, max_age=1}}"))
    assert one.network.sc.law.mode_ages == (0, 1)
    shares = analysis.analyse_law(one.network.sc.law, 0.05, 0.01).age_shares
    assert shares[1] == pytest.approx(0.328, abs=0.02)
    assert analysis.analyse_law(one.network.ca.law, 0.05, 0.01).age_shares == (1.0,)
    assert "largest_age = 1" in (tmp_path / "law.sc.toml").read_text()
    with pytest.raises(HilError, match=r"law\.sc\.toml"):
        bus_laws("--set", KNOWN, "-o", str(tmp_path / "law.toml"))


def test_a_bus_with_bit_errors_leaves_no_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_on_bus, "LEAST_SLOTS", 300)
    disturbed = ("--set", KNOWN, "--set", "network.media.bus.bit_error_rate=1e-5", "--set", "duration=15", "--json")
    unbounded = json.loads(bus_laws(*disturbed))["laws"]["sc"]
    assert unbounded["worst_ms"] is None and "bit_error_rate" in unbounded["no_bound"]


NODES = """
name = "nodes"
period = "50 ms"
duration = "5 s"
allow_uncertified = true
plant = { kind = "dc-motor", tachometer = true }
controller = { kind = "local", gain = [[-0.2, -0.02]] }
limits = { watchdog_slots = 1000 }
[network]
sc = { law = { kind = "constant", age = 0 }, max_age = 9 }
ca = { law = { kind = "constant", age = 0 }, max_age = 9 }
[network.nodes.angle]
outputs = ["angle"]
[network.nodes.speed]
outputs = ["speed"]
clock = { every = 3, phase = 1 }
[network.media.bus]
kind = "can"
nodes = ["angle", "speed"]
bitrate = 8000
buffer = "fifo"
traffic = [{ name = "a", can_id = 1, data = "0102030405060708", period = "150 ms" }]
"""


def laws_of_nodes(folder: Path, *arguments: str) -> str:
    (folder / "nodes.toml").write_text(NODES)
    result = CliRunner().invoke(laws, [str(folder / "nodes.toml"), "--from-bus", *arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


def test_every_node_has_a_law_and_the_loop_under_them_is_that_over_the_bus(tmp_path: Path) -> None:
    """The clock of the second node is in its ages, and the files make the same loop, in the same phases, without the bus."""
    text = laws_of_nodes(tmp_path, "-o", str(tmp_path / "law.toml"))
    assert "node speed, over the bus to the controller" in text and "nodes.speed.law = { file" in " ".join(text.split())
    found = json.loads(laws_of_nodes(tmp_path, "--json"))["laws"]
    assert list(found) == ["sc.angle", "sc.speed", "ca"] and all(law["exact"] for law in found.values())
    assert found["sc.speed"]["largest_age"] >= 2 + found["sc.angle"]["spec"].get("age", 1)
    files = {name: f"{{file={str(tmp_path / f'law.{name}.toml')!r}}}" for name in found}
    over = load_experiment(str(tmp_path / "nodes.toml"))
    under = load_experiment(str(tmp_path / "nodes.toml"), (
        "network.media={}", f"network.nodes.angle.law={files['sc.angle']}",
        f"network.nodes.speed={{outputs=['speed'], law={files['sc.speed']}}}", f"network.ca.law={files['ca']}",
    ))  # fmt: skip
    one, other = (compose(each) for each in (over, under))
    assert one.verdict is not None and other.verdict is not None and one.verdict.number == pytest.approx(other.verdict.number)
    first, second = (simulate(loop, 0).arrays["/plant/state"]["angle"] for loop in (one, other))
    assert first[20:].tolist() == pytest.approx(second[20:].tolist(), rel=1e-5, abs=1e-6) or one.verdict.state == "refused"


def test_laws_of_several_nodes_are_estimated_from_the_packets_of_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_on_bus, "LEAST_SLOTS", 300)
    found = json.loads(laws_of_nodes(tmp_path, "--set", "network.media.bus.bit_error_rate=1e-4", "--json"))["laws"]
    assert [law["packets"] for law in found.values()] == [900, 300, 900] and not found["sc.speed"]["exact"]


def test_recorded_ages_are_those_that_the_controller_measures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.design_questions.loop_on_bus.fit_law", _no_law)
    e = load_experiment(BUSY, ("duration=15", "network.media.bus.bit_error_rate=1e-4"))
    loop = compose(e, certify=False)
    run = simulate(loop, 0).arrays
    recorded = estimated_laws(loop, run)["sc"].spec["ages"]
    assert recorded == np.maximum(run["/controller/rows"]["tau"], 0).tolist()[30:]


def _no_law(record: PacketRecord, *more: float) -> LawFit:
    return replace(fit_law(record, *more), law_class="none")


A, B, C = (f'{{name="{n}", can_id={i:#x}, length=8, period="{p} ms"}}' for n, i, p in (("a", 16, 5), ("b", 17, 5), ("c", 128, 3)))
FEW = f"network.media.bus.traffic=[{A}, {B}, {C}]"


def test_places_keep_the_other_messages_where_there_is_room_and_move_them_up_elsewhere() -> None:
    found = places_of(load_experiment("dc-motor-busy-can", (FEW,)))
    assert [(each.above, each.can_id, each.moved) for each in found] == [(0, 0, 3), (1, 0x11, 2), (2, 0x12, 0), (3, 0x81, 0)]
    moved = found[1].experiment.network.media["bus"].traffic
    assert [message.can_id for message in moved] == [0x10, 0x31, 0xA0]
    assert found[1].experiment.links.control_can_id == 0x21


def test_where_errors_destroy_frames_no_place_is_in_time_for_certain() -> None:
    errors = ("network.media.bus.bit_error_rate=1e-6", "allow_uncertified=true", "duration=0.5")
    place = places_of(load_experiment("dc-motor-busy-can", (FEW, *errors)))[0]
    found = _judge_place(place)
    assert (found.bounds_ms, found.in_time) == ((None, None), False)


def test_a_place_is_recommended_by_certificate_deadline_cost_and_then_modesty() -> None:
    places = places_of(load_experiment("dc-motor-busy-can", (FEW,)))
    costs = (10.0, 10.05, 10.06, 14.0)
    judged = [
        Judged(place=place, cost=cost, state="certified", bounds_ms=(1.0, 1.0), in_time=True)
        for place, cost in zip(places, costs)
    ]
    assert recommended(judged, free=False) is judged[2] and recommended(judged, free=True) is judged[2]
    late = [replace(each, in_time=each is judged[3]) for each in judged]
    assert recommended(late, free=False) is late[3]
    doubtful = [replace(each, state="undecided" if each is not judged[1] else "certified") for each in judged]
    assert recommended(doubtful, free=False) is doubtful[1] and recommended(doubtful, free=True) is doubtful[2]
    assert recommended([replace(each, cost=None) for each in judged], free=False) is None


def test_the_place_that_leaves_the_others_theirs_is_said_apart_from_a_better_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def judged(place: Place) -> Judged:
        return Judged(
            place=place, cost=10.0 if place.moved else 14.0, state="certified", bounds_ms=(1.0, 1.0), in_time=True
        )  # fmt: skip

    monkeypatch.setattr("hil.cli.design.experiment._judge_place", judged)
    monkeypatch.setattr(
        "hil.design_questions.loop_on_bus.places_of", lambda e, found=places_of: found(load_experiment(e.name, (FEW,)))
    )
    done = CliRunner().invoke(design, ["--can-id", "dc-motor-busy-can", "--json"], catch_exceptions=False)
    found = json.loads(done.output)
    assert found["recommended"]["moved"] == 0 < found["with_others_moved"]["moved"]
    assert found["recommended"]["cost"] == 14.0 > found["with_others_moved"]["cost"] == 10.0


TWO_UNITS = """
name = "two"
period = "50 ms"
duration = "1 s"
plant = { kind = "state-space", A = [[-1]], B = [[1]], C = [[1], [2]], outputs = [["y", "rad"], ["z", "m"]] }
controller = { kind = "local", gain = [[0, 0]] }
network.sc.law = { kind = "constant", age = 0 }
network.ca.law = { kind = "constant", age = 0 }
network.nodes.both.outputs = ["y", "z"]
network.media.bus = { kind = "can", nodes = ["both"], bitrate = 125_000 }
limits = { input = [10.0], watchdog_slots = 10 }
"""


def test_squared_errors_of_several_units_are_no_cost_of_a_place(tmp_path: Path) -> None:
    (tmp_path / "two.toml").write_text(TWO_UNITS)
    with pytest.raises(HilError, match="two: --can-id: its outputs have several units"):
        CliRunner().invoke(design, ["--can-id", str(tmp_path / "two.toml")], catch_exceptions=False)


OTHER_MEASURES = '\n[report]\nmeasures = ["cost"]\n'


def test_the_command_runs_every_place_and_writes_a_page(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    shown = load_experiment("dc-motor-busy-can").text
    head, _, rest = shown.partition("traffic = [")
    traffic = 'traffic = [{ name = "a", can_id = 0x40, length = 8, period = "2 ms" }'
    file.write_text(head.replace('duration = "50 s"', 'duration = "3 s"').partition("[[disturbance]]")[0] + "[network]"
                    + head.partition("[network]")[2] + traffic + rest[rest.index("]") :] + OTHER_MEASURES)  # fmt: skip
    page = tmp_path / "place.html"
    done = CliRunner().invoke(design, ["--can-id", str(file), "--json", "-o", str(page)], catch_exceptions=False)
    found = json.loads(done.output)
    first, second = found["places"]
    assert (first["can_id"], second["can_id"]) == (0, 0x41) and first["moved"] == 0
    assert first["sensor_bound_ms"] < second["sensor_bound_ms"] < 50.0 and first["in_time"] and second["in_time"]
    assert first["cost"] > 0 and second["cost"] > 0 and first["certificate"] == "certified"
    assert (
        found["recommended"] == second
        and found["with_others_moved"] in found["places"]
        and "Cost over priority" in page.read_text()
        and "squared error (rad² s)" in page.read_text()
        and "network.nodes.motor.can_id=0x41, links.control_can_id=0x51" in page.read_text()
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["dc-motor-hinf", "--can-id"], "no medium of kind 'can'"),
        (["dc-motor-busy-can", "--can-id", "--objective", "h2"], "--objective: not with --can-id"),
    ],
)
def test_what_does_not_fit_is_refused(words: list[str], said: str) -> None:
    with pytest.raises(HilError, match=said):
        CliRunner().invoke(design, words, catch_exceptions=False, standalone_mode=False)
