"""`hil design --trigger`: threshold of an event trigger and gain together (Section 8.2.2)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from design.networked_loop import uncertainty
from design.tracking.synthesis import certified
from hil.cli.design import command
from hil.compose import compose
from hil.design_questions import problem_for, trigger_gains
from hil.design_questions.trigger_gains import (
    Candidate,
    candidates,
    gains_for_share,
    guaranteed,
    nominal_design,
    planned,
    trigger_question,
    unknowns_of,
)
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.pages import Figure
from hil.pages.designs import trigger_page
from hil.runtime.virtual import simulate
from hil.sweeps import trigger_cost
from hil.sweeps.shown import interval_of
from hil.sweeps.trigger_cost import TriggerPoint, check_chains, experiment_with, front, run_candidate, undecided

LARGE = 0.35
"""For which the search takes few steps; at 0.4 it takes six times as many."""


STAGES: list[tuple[str, int, int, float]] = []


@pytest.fixture(scope="module")
def large() -> list[Candidate]:
    """The node that sends in every slot, then the nominal gain and the one that knows the trigger, both at `LARGE`."""
    asked = trigger_question("dc-motor-ours-h2")._replace(thresholds=(LARGE,))
    return list(candidates(asked, lambda *said: STAGES.append(said), starts=1))


def test_every_point_of_the_search_says_for_which_threshold_it_is_and_what_it_has_reached(large: list[Candidate]) -> None:
    said = f"gains for {LARGE:.0%} wrong, guaranteed h2"
    found = [(value, done, count) for stage, done, count, value in STAGES if stage == said]
    values = [value for value, _, _ in found]
    assert len(found) > 3 and {each[1:] for each in found} == {(0, 1)}
    assert min(values) < values[0] and min(values) == pytest.approx(large[-1].bound, rel=1e-2)


def own(folder: Path, trigger: str) -> str:
    shown = load_experiment("dc-motor-ours-h2").text
    text, laws = shown.partition("[[disturbance]]")[0], shown.partition("[network]")[2]
    text = text.replace('duration = "50 s"', 'duration = "6 s"')
    file = folder / "own.toml"
    file.write_text(f'{text}[network.nodes.angle]\noutputs = ["angle"]\ntrigger = {trigger}\n[network]\n{laws}')
    return str(file)


def test_gains_that_know_the_trigger_are_certified_where_the_nominal_ones_are_not(large: list[Candidate]) -> None:
    asked = trigger_question("dc-motor-ours-h2")
    plain, aware = (compose(experiment_with(asked, each)).verdict for each in large[1:])
    assert plain is not None and plain.state == "undecided" and large[1].bound is None
    assert aware is not None and aware.state == "certified" and large[2].bound is not None
    assert abs(large[2].gain[0, 0]) < 0.6 * abs(large[1].gain[0, 0])


def test_gains_are_not_sought_at_the_edge_of_stability_where_no_gain_leaves_no_channel() -> None:
    """The search for gains that bear the error comes to a gain of 0, whose channel has the norm 0: the motor then drifts."""
    asked = trigger_question("dc-motor-1khz")
    nominal = nominal_design(asked.target, starts=1)
    found = gains_for_share(asked.target, nominal, 0.3)
    assert guaranteed(asked.target, nominal, 0.3) is None
    assert found.gains.max() < -0.1 and 0.0 < (guaranteed(asked.target, found, 0.3) or 0.0) < 0.6


@pytest.mark.parametrize("wrong", [-LARGE, -0.2, 0.0, 0.2, LARGE])
def test_no_share_that_stays_has_a_larger_norm_than_the_guarantee(large: list[Candidate], wrong: float) -> None:
    """The plant as it is, without the sample as a state, its output scaled."""
    target = trigger_question("dc-motor-ours-h2").target
    problem = problem_for(target._replace(C=(1.0 + wrong) * target.C), information="constant", Q=target.C)
    shape = problem.space().shape
    norm = certified(problem, np.broadcast_to(large[2].gain, shape), starts=(), evaluations=0).certificate.h2_norm
    assert norm is not None and large[2].bound is not None and 0.5 * large[2].bound < norm <= large[2].bound


def test_an_impulse_in_the_emulated_loop_costs_less_than_the_guarantee(large: list[Candidate]) -> None:
    """z = [angle; 0.01 u] over 40 runs whose node sends by the trigger: well below, as no error is the worst for ever."""
    asked = trigger_question("dc-motor-ours-h2")
    kick = "disturbance=[{at=1.0, samples=1, value=[1.0]}]"
    asked = asked._replace(sets=(*asked.sets, "reference=[]", kick, "duration=12"))
    loop, costs = compose(experiment_with(asked, large[2])), []
    for seed in range(40):
        run = simulate(loop, seed, ["/plant/state", "/actuator/applied"]).arrays
        applied = run["/actuator/applied"]["voltage"]
        costs.append(float(np.sum(run["/plant/state"]["angle"] ** 2) + 1e-4 * np.sum(applied**2)))
    bound = large[2].bound
    assert bound is not None and 0.25 * bound**2 < np.mean(costs) < 0.95 * bound**2


def test_the_front_keeps_certified_points_that_none_beats() -> None:
    def point(packets: float, cost: float, state: str = "certified", stopped: int = 0) -> TriggerPoint:
        one, two = (interval_of(np.full(3, value)) for value in (cost, packets))
        return TriggerPoint(Candidate(0.1, 0.0, np.zeros((1, 1)), 2.0), state, "", {}, one, two, stopped)

    points = [point(20, 1), point(9, 2), point(9, 3), point(8, 2.5), point(5, 1.5, "undecided"), point(4, 0.5, stopped=1)]
    points += [point(7, 4), point(8.5, 2.5)]  # the last costs as much as one that sends less
    assert front(points) == [points[6], points[3], points[1], points[0]]
    shown = trigger_page("dc-motor", "dead-band", ("V per rad", "rad² s"), points, front(points)).sections[0]
    (figure,) = (block for block in shown.blocks if isinstance(block, Figure))
    drawn = {line.label: [*line.x] for line in figure.series}
    assert drawn["not certified"] == [5.0] and drawn["best certified"] == [7.0, 8.0, 9.0, 20.0]
    assert points[0].bound == 2.0 and points[4].bound is None and points[5].to_json()["cost"] is None


def test_the_command_prints_the_points_and_writes_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, large: list[Candidate]
) -> None:  # fmt: skip
    monkeypatch.setattr(trigger_gains, "candidates", lambda asked, report, *, starts, **_: large if starts == 1 else [])
    monkeypatch.setattr(run_candidate, "__defaults__", (3,))
    page = tmp_path / "trigger.html"
    name = own(tmp_path, '{ kind = "relative", threshold = 0.2 }')
    done = CliRunner().invoke(command, [name, "--trigger", "--starts", "1", "--json", "-o", str(page)], catch_exceptions=False)
    found = json.loads(done.stdout)
    always, plain, aware = found["points"]
    assert found["trigger"] == "relative" and found["runs"] == 3
    assert [each["certificate"] for each in found["points"]] == ["certified", "undecided", "certified"]
    assert always["packets_per_s"]["mean"] > 19 > 2 * aware["packets_per_s"]["mean"]
    assert always["h2_bound"] < aware["h2_bound"] and plain["h2_bound"] is None
    assert always["cost"]["low"] < always["cost"]["mean"] < aware["cost"]["mean"] and aware["cost"]["n"] == 3
    assert always["on_front"] and aware["on_front"] and not plain["on_front"]
    written = page.read_text()
    heads = ("Squared error against packets", "gain, V per rad", "squared error (rad² s)", "not certified")
    assert all(said in written for said in heads)
    shown = CliRunner().invoke(command, [name, "--trigger", "--starts", "1"], catch_exceptions=False).stdout
    assert "undecided" in shown and f"{LARGE:.0%} wrong" in shown and "every slot" in shown


def test_a_dead_band_is_tried_in_multiples_of_its_own_and_ends_within_as_many(tmp_path: Path) -> None:
    asked = trigger_question(own(tmp_path, '{ kind = "dead-band", threshold = 0.1 }'))
    assert asked.kind == "dead-band" and asked.thresholds == (0.025, 0.05, 0.1, 0.2, 0.4)
    gain = np.array([[-0.1]])
    small, large = (run_candidate(asked, Candidate(threshold, 0.0, gain, None), runs=3) for threshold in asked.thresholds[1:3])
    assert small.state == large.state == "certified" and small.packets.value > large.packets.value
    assert large.ends_within["angle"] == pytest.approx(2.0 * small.ends_within["angle"], rel=1e-6)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (["dc-motor"], "name an experiment"),
        (["dc-motor-two-nodes"], "each node has a chain of ages of its own.*angle.trigger.threshold=LOW,HIGH"),
        (["dc-motor-ours-h2", "--information", "applied"], "--information: not with --trigger"),
    ],
)
def test_what_has_no_answer_is_refused(said: list[str], why: str) -> None:
    with pytest.raises(HilError, match=why):
        CliRunner().invoke(command, [*said, "--trigger"], catch_exceptions=False)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("dc-motor-packets", r"sensor\.law: under a packet law whose ages change"),
        ("dc-motor-ours-busy-can", r"network\.media\.bus: .* CAN bus with time .*motor\.trigger \(relative\)"),
        ("vtol-sensor-fault", "its plant jumps between modes"),
    ],
)
def test_a_loop_that_no_certificate_covers_with_a_trigger_is_refused_before_any_gain_is_sought(
    name: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    sought: list[object] = []
    monkeypatch.setattr(trigger_gains, "candidates", lambda *said, **_: sought.append(said) or iter(()))
    with pytest.raises(HilError, match=f"^{name}: --trigger: .*{why}"):
        CliRunner().invoke(command, [name, "--trigger"], catch_exceptions=False)
    assert not sought


@pytest.mark.parametrize("name", ["dc-motor-ours-h2", "dc-motor-bursty", "dc-motor-1khz"])
def test_a_loop_that_has_a_chain_with_a_trigger_is_asked(name: str) -> None:
    check_chains(trigger_question(name))


@pytest.mark.parametrize(
    ("trigger", "why"),
    [
        ('{ kind = "error", threshold = 0.1 }', r"trigger\.kind: 'error'"),
        ('{ kind = "dead-band", threshold = 0.0 }', r"trigger\.threshold: 0, expected one above 0"),
    ],
)
def test_a_trigger_without_a_bound_is_refused(tmp_path: Path, trigger: str, why: str) -> None:
    with pytest.raises(HilError, match=why):
        trigger_question(own(tmp_path, trigger))


def test_an_interrupt_before_the_first_point_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, large: list[Candidate]
) -> None:
    def interrupted(*_: object) -> TriggerPoint:
        raise KeyboardInterrupt

    monkeypatch.setattr(trigger_gains, "candidates", lambda *_, **__: iter(large))
    monkeypatch.setattr(trigger_cost, "run_candidate", interrupted)
    page = tmp_path / "trigger.html"
    done = CliRunner().invoke(command, ["dc-motor-ours-h2", "--trigger", "-o", str(page)])
    assert done.exit_code == 130 and not page.exists() and "nothing was written" in done.stderr


def test_an_interrupt_keeps_the_points_found_and_says_which_are_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, large: list[Candidate]
) -> None:
    def found(*_: object, **__: object) -> Iterator[Candidate]:
        yield from large[:2]
        raise KeyboardInterrupt

    monkeypatch.setattr(trigger_gains, "SHARES", (LARGE,))
    monkeypatch.setattr(trigger_gains, "candidates", found)
    monkeypatch.setattr(run_candidate, "__defaults__", (2,))
    page, name = tmp_path / "trigger.html", own(tmp_path, '{ kind = "relative", threshold = 0.2 }')
    done = CliRunner().invoke(command, [name, "--trigger", "--json", "-o", str(page)])
    said = json.loads(done.stdout)
    assert done.exit_code == 130 and "after 2 of 3 points" in done.stderr and said["interrupted"]
    assert [each["designed_for_share"] for each in said["points"]] == [0.0, 0.0]
    assert [(each["threshold"], each["designed_for_share"]) for each in said["undecided"]] == [(LARGE, LARGE)]
    assert "not reached" in said["undecided"][0]["why"] and "not reached" in page.read_text()


def test_candidates_come_in_the_order_of_the_plan(large: list[Candidate], tmp_path: Path) -> None:
    asked = trigger_question("dc-motor-ours-h2")._replace(thresholds=(LARGE,))
    assert planned(asked) == [(each.threshold, each.share) for each in large]
    band = trigger_question(own(tmp_path, '{ kind = "dead-band", threshold = 0.1 }'))
    found = [(each.threshold, each.share) for each in candidates(band, unknowns=0, starts=1)]
    assert planned(band) == found and len(found) == 1 + 4 * len(band.thresholds)


def test_a_budget_ends_the_search_with_what_was_found(large: list[Candidate], monkeypatch: pytest.MonkeyPatch) -> None:
    """Equations are counted beside the budget, by wrapping the solver; the gains are between the nominal and the best ones."""
    asked = trigger_question("dc-motor-ours-h2")._replace(thresholds=(LARGE,))
    nominal = nominal_design(asked.target, starts=1)
    equations = 60 + 60 + 60 + 20  # both norms, where the descent begins, and a part of the descent
    solved = []
    real = uncertainty.solve_bounded_real
    monkeypatch.setattr(uncertainty, "solve_bounded_real", lambda *said, **more: solved.append(1) or real(*said, **more))
    always, plain, aware = candidates(asked, unknowns=equations * unknowns_of(nominal), starts=1)
    assert not always.cut and not plain.cut and aware.cut and 0 < len(solved) <= equations
    assert aware.bound is not None and large[2].bound is not None and aware.bound >= large[2].bound * (1 - 1e-9)
    none = list(candidates(asked, unknowns=0, starts=1))
    assert [each.cut for each in none] == [False, True, True] and none[2].bound is None
    assert np.array_equal(none[2].gain, none[0].gain)
    points = [trigger_point(each) for each in (always, plain, aware)]
    (left,) = undecided(planned(asked), points)
    assert (left.threshold, left.designed_for_share) == (LARGE, LARGE) and "budget" in str(left)
    assert [each.to_json()["budget_spent"] for each in points] == [False, False, True]


def trigger_point(of: Candidate) -> TriggerPoint:
    one = interval_of(np.full(3, 1.0))
    return TriggerPoint(of, "certified", "", {}, one, one, 0)


def test_outputs_of_several_units_have_no_sum_of_squared_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "two_outputs.py").write_text(
        "from typing import ClassVar\n\nfrom plants import DCMotor\n\n\nclass Two(DCMotor):\n"
        "    tracked: ClassVar[tuple[str, ...]] = ('angle', 'speed')\n"
    )
    text = Path(own(tmp_path, '{ kind = "relative", threshold = 0.1 }')).read_text()
    text = text.replace('kind = "dc-motor"', 'kind = "two_outputs:Two"\ntachometer = true')
    before, after = text[: text.index("[controller]")], text[text.index("[network") :].replace('["angle"]', '["angle", "speed"]')
    (tmp_path / "own.toml").write_text(before + '[controller]\nkind = "local"\ngain = [[-0.1, 0.0]]\n' + after)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(HilError, match=r"--trigger: its outputs have several units"):
        check_chains(trigger_question(str(tmp_path / "own.toml")))


def test_a_wall_is_refused_before_anything_is_solved() -> None:
    with pytest.raises(HilError, match="omni-push: --trigger: its controller renders a wall"):
        trigger_question("omni-push")
