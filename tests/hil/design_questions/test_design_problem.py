"""The models that a design begins with, beside the plants that they are of; and mixed designs between the pure ones."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.linalg import expm

import hil.design_questions as design_problem
from design.controllers import SendAll, nested
from design.requests.tracking import solve_tracking
from hil.cli.design import command
from hil.compose import compose
from hil.design_questions import PRINTED_VTOL, compromises, problem_for, target_of, tracking_target, verdict_on
from hil.errors import HilError
from hil.experiment import load_experiment
from plants import VTOL

FAST: dict[str, Any] = {"information": "constant", "starts": 1}


def test_the_printed_vtol_is_the_zero_order_hold_of_the_plant_to_four_decimals() -> None:
    model = VTOL().model()
    (n, m), T = model.B.shape, 0.01
    held = expm(T * np.block([[model.A, model.B], [np.zeros((m, n + m))]]))[:n]
    A, B, C = map(np.array, PRINTED_VTOL)
    assert np.abs(A - held[:, :n]).max() < 0.7e-4 and np.abs(B - held[:, n:]).max() < 0.7e-4 and np.array_equal(C, model.C)
    printed = tracking_target("vtol")
    assert np.array_equal(printed.A, A) and np.array_equal(printed.B, B) and printed.period_s == T
    assert np.allclose(tracking_target("vtol", T).A, held[:, :n], atol=1e-12)


def test_an_option_that_no_design_has_is_named_with_those_that_there_are() -> None:
    with pytest.raises(HilError, match=r"design: no option is called 'start'.*starts.*There are: "):
        problem_for(tracking_target("dc-motor"), start=3)


def test_gains_that_lean_on_turns_which_shorter_frames_break_are_not_certified_by_a_design() -> None:
    """`hil run` finds an order of the bus's ages in which these gains grow."""
    target = tracking_target("dc-motor-ours-busy-can")
    verdict = verdict_on(target, solve_tracking(problem_for(target, starts=1)))
    assert verdict.state == "undecided" and "certified but for what is left out: frames on the bus that" in verdict.reason


def test_a_design_is_certified_over_a_bus_on_which_frames_of_every_length_make_the_same_ages() -> None:
    """`hil run` certifies it with the same radius: at 1 Mbit/s every packet is in time, whatever its bits and rows are."""
    said = ("media.bus.bitrate=1000000", "sc.max_age=0", "ca.max_age=0")
    fast = load_experiment("dc-motor-ours-busy-can", [f"network.{each}" for each in said])
    target = target_of(fast, "fast")
    design = solve_tracking(problem_for(target, **FAST))
    gains = SendAll(gains=nested(design.gains), selection="constant")
    run = compose(msgspec.structs.replace(fast, controller=gains, kinds={**fast.kinds, "controller": "send-all"})).verdict
    verdict = verdict_on(target, design)
    assert run is not None and run.state == verdict.state == "certified" and verdict.number == pytest.approx(run.number, rel=1e-9)


@pytest.mark.parametrize(("bound", "state"), [("", "undecided"), (", discard_older=3", "certified")])
def test_latencies_without_a_bound_leave_a_design_undecided_as_they_leave_its_run(bound: str, state: str) -> None:
    law = f"{{kind='packet', latency={{dist='gamma', a=2.0, scale='8 ms'}}{bound}}}"
    target = target_of(load_experiment("dc-motor-packets", [f"network.{way}.law={law}" for way in ("sc", "ca")]), "late")
    verdict = verdict_on(target, solve_tracking(problem_for(target, **FAST)))
    assert verdict.state == state and ("have no bound" in verdict.reason) == (not bound)


def test_a_design_is_judged_over_the_modes_that_a_run_reaches() -> None:
    """The law begins in age 0 and never comes to age 2, in which these gains grow: `hil run` certifies them."""
    law = "{kind='markov', matrix=[[0.5, 0.5, 0], [0.5, 0.5, 0], [0, 0.05, 0.95]], initial=[1, 0, 0]}"
    said = {"ca.law": law, "ca.max_age": "2", "sc.law": "{kind='constant', age=0}", "sc.max_age": "0"}
    experiment = load_experiment("dc-motor-packets", [f"network.{name}={value}" for name, value in said.items()])
    target = target_of(experiment, "stays")
    design = solve_tracking(problem_for(target, **FAST))
    steep = msgspec.structs.replace(design, gains=np.full_like(design.gains, -0.35))
    gains = {"controller": SendAll(gains=nested(steep.gains), selection=steep.selection)}
    run = compose(msgspec.structs.replace(experiment, **gains, kinds={**experiment.kinds, "controller": "send-all"})).verdict
    verdict = verdict_on(target, steep)
    assert verdict_on(target._replace(reached=None), steep).state == "refused"
    assert run is not None and run.state == verdict.state == "certified" and verdict.number == pytest.approx(run.number, rel=1e-9)


def test_another_period_makes_other_ages_of_latencies() -> None:
    """A latency of 45 ms is late by one slot of 50 ms, and by two of 25 ms, whose deadline is at 15 ms."""
    law = {"network.sc.law": "{kind='packet', latency='45 ms'}", "network.sc.max_age": "3"}
    experiment = load_experiment("dc-motor-packets", [f"{name}={value}" for name, value in law.items()])
    assert [target_of(experiment, "slow", each).sc.max_delay for each in (None, 0.025)] == [1, 2]
    with pytest.raises(HilError, match=r"period: nan s, expected a number > 0"):
        target_of(experiment, "slow", float("nan"))


def test_a_mixed_design_lies_between_the_pure_ones_in_both_norms() -> None:
    told: list[str] = []
    hinf, mixed, h2 = compromises(
        tracking_target("dc-motor"), lambda stage, *_: told.append(stage.partition(",")[0]), weights=(0.3,), **FAST
    )
    assert list(dict.fromkeys(told)) == ["design 1 of 3", "design 2 of 3", "design 3 of 3"]
    assert hinf.hinf < mixed.hinf < h2.hinf and hinf.h2 > mixed.h2 > h2.h2
    assert mixed.level is not None and mixed.hinf <= mixed.level * (1.0 + 1e-6)
    assert mixed.level == pytest.approx(hinf.hinf**0.7 * h2.hinf**0.3)
    assert {each.state for each in (hinf, mixed, h2)} == {"certified"}


def test_what_meets_a_tighter_level_meets_a_looser_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search for the looser level that ends above what is known does not bend the curve upwards."""
    known: Any = design_problem.solve_tracking

    def worse(problem: Any, progress: Any = None) -> Any:
        bound = problem.hinf_bound
        looser = bound is not None and bound > 19.0
        return known(replace(problem, objective="hinf", hinf_bound=None) if looser else problem)

    monkeypatch.setattr(design_problem, "solve_tracking", worse)
    found = compromises(tracking_target("dc-motor"), weights=(0.2, 0.8), **FAST)
    assert found[2].level is not None and found[2].level > 19.0
    assert found[2].h2 == found[1].h2 and found[2].weight == 0.8


def test_the_command_prints_the_curve_and_writes_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(design_problem.compromises, "__defaults__", (None, (0.3,)))
    page = tmp_path / "curve.html"
    asked = ["dc-motor", "--trade-off", "--information", "constant", "--starts", "1", "--json", "-o", str(page)]
    done = CliRunner().invoke(command, asked, catch_exceptions=False)
    designs = json.loads(done.output)["designs"]
    assert [each["weight"] for each in designs] == [0.0, 0.3, 1.0] and len(designs[1]["gains"]) == 3
    assert "H2 norm against H-infinity norm" in page.read_text()


@pytest.mark.parametrize("other", ["--objective=h2", "--hinf-bound=17", "--local=lqr"])
def test_what_fixes_one_design_is_refused(other: str) -> None:
    with pytest.raises(HilError, match=f"{other.partition('=')[0]}: not with --trade-off"):
        CliRunner().invoke(command, ["dc-motor", "--trade-off", other], catch_exceptions=False)


def test_a_plant_whose_h2_design_is_the_hinf_design_has_no_curve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(design_problem, "SAME", 1.0)
    with pytest.raises(HilError, match="nothing to trade"):
        compromises(tracking_target("dc-motor"), **FAST)
