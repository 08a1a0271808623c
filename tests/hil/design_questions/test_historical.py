"""``hil design`` of several sensor nodes, and gains that keep to a largest input."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from design.requests.historical import HistoricalDesigned
from hil.certify.historical_loop import judge_historical
from hil.cli import cli
from hil.cli.design.experiment import historical_lines, is_over_history
from hil.compose import compose
from hil.design_questions import tracking_target
from hil.errors import HilError
from hil.experiment import load_experiment, shipped
from hil.measure.cost import Cost
from hil.measure.view import view_of
from hil.runtime.virtual import simulate

SHORT = [f"network.nodes.{name}.buffer=1" for name in ("first", "second", "third", "fourth")]


def test_cost_bounds_and_gains_are_printed() -> None:
    """The bounds of the review: 1.7588 for any causal controller with packets of three samples, 1.6471 with the whole state."""
    found = json.loads(CliRunner().invoke(cli, ["design", "multisensor-ours", "--json"]).stdout)
    assert found["mean_cost"] <= 1.8130 and found["bound_causal"] == pytest.approx(1.7588, abs=1e-4)
    assert found["bound_full_state"] == pytest.approx(1.6471, abs=1e-4) and 0.0 < found["gap"] <= 0.031
    assert found["cost"] == pytest.approx(55.197, abs=1e-3) and found["verdict"]["state"] == "certified"
    table = f"controller={{kind='historical', gains={found['gains']}}}"
    again = compose(load_experiment("multisensor-ours", [table]))
    assert again.verdict is not None and again.verdict.details["cost"] == pytest.approx(found["cost"], rel=1e-12)
    shown = CliRunner().invoke(cli, ["design", "multisensor-newest", "--spread"]).stdout
    assert "standard deviation of runs  0\n" in shown  # one order has none; tests/hil/runtime/nodes has that of random turns
    assert "bound, any causal controller  1.78145 (ours is 113.97 % above)" in shown and "[3][0]" in shown


def test_gains_over_history_of_the_only_node_are_judged_and_others_are_designed(tmp_path: Path) -> None:
    """`network.sc` is one node, and a node with a name is no reason to ask for gains over historical data."""
    text = shipped()["multisensor-newest"].read_text()
    one = text[: text.index("[network.nodes.first]")] + text[text.index("[network]") :]
    one = one.replace('kind = "published-historical"\ngains = "newest"', 'kind = "historical-designed"\nuses = "history"')
    (tmp_path / "one.toml").write_text(one)
    found = json.loads(CliRunner().invoke(cli, ["design", str(tmp_path / "one.toml"), "--json"]).stdout)
    assert found["uses"] == "history" and 0.0 <= found["gap"] < 0.5 and np.array(found["gains"]).shape[:2] == (1, 1)
    motor = shipped()["dc-motor-h2"].read_text() + '\n[network.nodes.encoder]\noutputs = ["angle"]\n'
    (tmp_path / "motor.toml").write_text(motor)
    assert tracking_target(str(tmp_path / "motor.toml")).plant == "dc-motor"
    assert not is_over_history({"subject": str(tmp_path / "motor.toml")})


LATE = """
name = "late"
period = "50 ms"
duration = "1 s"
[plant]
kind = "delayed-states"
A = [[1.1]]
delayed = []
B = [[1.0]]
initial_state = [1.0]
weight = [[1.0]]
[network]
sc.law = { kind = "constant", age = 0 }
ca.law = { kind = "constant", age = 1 }
[limits]
input = [100.0]
watchdog_slots = 10
[controller]
"""


def test_what_is_designed_and_its_mean_cost_are_of_commands_that_come_late(tmp_path: Path) -> None:
    """From x(0) = 1 the cost is 1 + 1.1^2 + (1.21 + k)^2 + ...: the least of a grid of k."""
    (tmp_path / "late.toml").write_text(f"{LATE}kind = 'historical-designed'\nmemory = 0\n")
    found = judge_historical(compose(load_experiment(str(tmp_path / "late.toml"))))

    def summed(k: float) -> float:
        x, late, total = 1.0, 0.0, 0.0
        for _ in range(400):
            x, late, total = 1.1 * x + late, k * x, total + x * x
        return total

    assert found["gains"][0][0][0][0] == pytest.approx(min(np.arange(-0.9, -0.1, 1e-3), key=summed), abs=2e-3)
    assert found["mean_cost"] == pytest.approx(summed(found["gains"][0][0][0][0]), rel=1e-9)
    assert found["mean_cost"] == pytest.approx(found["cost"], rel=1e-9) and found["bound_causal"] == pytest.approx(1 + 1.1**2)


UNSEEN = LATE.replace("1.1", "0.1").replace("age = 1", "age = 0").replace("[]", "[[[0.3]]]\ninitial_history = [[2.0]]")
LOSSY = """
kind = "historical"
uses = "current-packet"
gains = [[[[0.2]], [[-0.3]]]]
[network.nodes.only]
outputs = ["x1"]
buffer = 2
[network.media.bus]
kind = "round-robin"
nodes = ["only"]
loss = 0.4
"""


def test_the_spread_is_of_runs_whose_first_past_no_sensor_has_seen(tmp_path: Path) -> None:
    """Over all 2^10 outcomes of ten slots; what follows is below 1e-5 of it."""
    (tmp_path / "unseen.toml").write_text(UNSEEN + LOSSY)
    found = judge_historical(compose(load_experiment(str(tmp_path / "unseen.toml"))), spread=True)
    costs, chances = [], []
    for came in product((0, 1), repeat=10):
        x, before, seen, total = 1.0, 2.0, 0.0, 0.0
        for received in came:
            total += x * x
            x, before, seen = 0.1 * x + 0.3 * before + received * (0.2 * x - 0.3 * seen), x, x
        costs.append(total)
        chances.append(0.6 ** sum(came) * 0.4 ** (10 - sum(came)))
    mean = np.dot(chances, costs)
    assert found["cost"] == pytest.approx(mean, rel=1e-5)
    assert found["cost_sd"] == pytest.approx(np.sqrt(np.dot(chances, (np.array(costs) - mean) ** 2)), rel=1e-4)


def test_every_order_of_the_turns_is_tried() -> None:
    newest = compose(load_experiment("multisensor-newest", SHORT))
    orders = judge_historical(newest, orders=True)["orders"]
    assert len(orders) == 6 and orders[0] == {
        "nodes": ["first", "second", "third", "fourth"],
        "mean_cost": pytest.approx(2.0319, abs=1e-4),
    }


def test_a_judgement_says_each_cost_once_and_why_there_is_no_bound() -> None:
    found = {"experiment": "mine", "uses": "newest", "cost": 3.0, "mean_cost": 2.5, "bound_causal": 2.0, "gap": 0.25,
             "bound_full_state": 1.5, "gains": [[[[0.1, 0.2]]], [[[0.3, 0.4]]]]}  # fmt: skip
    said = historical_lines(found, "V per rad")
    assert [line.split()[-1] for line in said[:3]] == ["newest", "3", "2.5"] and "2 (ours is 25.00 % above)" in said[3]
    assert [line.split() for line in said[-2:]] == [["[0][0]", "0.1", "0.2"], ["[1][0]", "0.3", "0.4"]]
    undecided = historical_lines(found | {"bound_causal": None, "gap": None, "cost_sd": 0.7}, "V per rad")
    assert "undecided: which node's packet arrives is not a Markov chain of its own" in undecided[4]
    assert undecided[2].split()[-1] == "0.7" and len(undecided) == len(said) + 1


def test_gains_over_a_history_of_random_turns_are_refused_before_any_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("design.historical_data.sensor_schedule.undecided_because", lambda nodes: pytest.fail("went on"))
    with pytest.raises(HilError, match="over random turns only the current packet has gains of its own"):
        compose(load_experiment("multisensor-lossy", ["controller.uses=history"]))


def test_over_a_lossy_order_the_bound_is_known_and_the_orders_are_not_tried() -> None:
    gains = [[[[0.01 * (i == l) for l in range(4)]]] for i in range(4)]
    table = f"controller={{kind='historical', uses='current-packet', gains={gains}}}"
    lossy = compose(load_experiment("multisensor-ours", [table, *SHORT, "network.media.bus.loss=0.1"]))
    found = judge_historical(lossy)
    assert found["cost"] > 0 and 1.78145 < found["bound_causal"] < found["mean_cost"]
    assert found["gap"] == pytest.approx(found["mean_cost"] / found["bound_causal"] - 1.0)
    with pytest.raises(HilError, match="--orders: needs turns in a fixed order"):
        judge_historical(lossy, orders=True)


def test_a_run_says_what_no_controller_goes_below_even_where_its_own_cost_is_undecided() -> None:
    """54.756: the linear quadratic regulator with the whole state; a quarter of it from half of x(0)."""
    for name, known in (("multisensor-published", True), ("multisensor-event", False)):
        gains = "controller={kind='published-historical', gains='historical'}"
        found = compose(load_experiment(name, [gains])).certificate
        assert found is not None and found["bound_full_state"] == pytest.approx(54.7557, abs=1e-3)
        assert ("cost" in found) == known and found["state"] == ("certified" if known else "undecided")
    least = compose(load_experiment("multisensor-event", [gains, "plant.initial_state=[-2.0, 1.5, -3.0, 0.5]"])).certificate
    assert least is not None and least["bound_full_state"] == pytest.approx(54.7557 / 4, abs=1e-3)


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["multisensor-ours", "--gain-bound", "3"], "--gain-bound: not with gains over historical data"),
        (["multisensor-ours", "-o", "x.json"], "-o: not with gains over historical data"),
        (["dc-motor", "--orders"], "--orders: belongs to gains over historical data"),
        (["dc-motor", "--spread"], "--spread: belongs to gains over historical data"),
        (["dc-motor-two-nodes"], "hil design judges gains over historical data"),
    ],
)
def test_what_means_nothing_is_refused(args: list[str], says: str) -> None:
    with pytest.raises(HilError, match=says):
        CliRunner().invoke(cli, ["design", *args], catch_exceptions=False, standalone_mode=False)


def test_gains_keep_to_the_published_largest_input_and_cost_less() -> None:
    """(5.17), I(0) = 1: largest input 15.93 and J = 149.5; the newest sample alone."""
    sets = ["network.media.bus.phase=0",
            "controller={kind='historical-designed', uses='newest', start='given', peak_input=15.93}"]
    loop = compose(load_experiment("multisensor-ours", sets))
    found = Cost().of(view_of(simulate(loop, 0), loop.experiment))
    assert found["peak_input"] is not None and 0.97 * 15.93 < found["peak_input"] <= 15.93 * (1 + 1e-6)
    assert found["cost"] is not None and found["cost"] < 149.47
    with pytest.raises(HilError, match=r"controller\.peak_input: needs turns in a cycle"):
        compose(load_experiment("multisensor-ours", ["controller.start=given", "controller.peak_input=3",
                                                    "network.media.bus.loss=0.1",
                                                     "controller.uses=newest"]))  # fmt: skip


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"peak_input": -1.0, "start": "given"}, "peak_input: -1.0, expected a finite number above 0"),
        ({"peak_input": 2.0}, "peak_input: bounds one run"),
        ({"peak_input": 2.0, "start": "given", "input_weight": 1.0}, "peak_input: sets the input weight itself"),
    ],
)
def test_a_largest_input_that_cannot_be_matched_is_refused(given: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        HistoricalDesigned(**given)  # type: ignore[arg-type]
