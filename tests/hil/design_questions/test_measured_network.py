"""A network that was measured: a design for it, and a verdict over all that the measurement leaves possible."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

from design.requests.tracking import solve_tracking
from hil.design_questions import problem_for, tracking_target
from hil.design_questions.measured_network import measured, over_network, region_verdict
from hil.experiment import load_experiment
from tests.hil.cli.conftest import Hil
from tests.hil.cli.conftest import cli as cli
from tests.transport.law_fit.synthetic_laws import DEADLINE, LAWS, T, record_of
from transport.law_fit import fit_law


def test_from_a_log_to_a_certified_controller(cli: Hil, tmp_path: Path) -> None:
    """Two commands: the second designs for what the first measured, and certifies all that it leaves possible."""
    law = "{kind='packet',latency={dist='uniform',loc='1 ms',scale='50 ms'},loss=0.01}"
    run = ["run", "dc-motor-packets", "--set", f"network.sc.law={law}", "--set", f"network.ca.law={law}"]
    assert cli(*run, "--set", "allow_uncertified=true", "--duration", "300", "-o", "link.mcap")[0] in (0, 3)
    design = ("design", "dc-motor", "--starts", "1", "--information", "constant", "--json", "--network")
    status, out, err = cli(*design, "link.mcap")
    assert status == 0, err
    said = json.loads(out)
    assert said["verdict"]["state"] == "certified"
    assert said["network"]["sc"]["class"] == said["network"]["ca"]["class"] == "independent"
    region = said["network"]["region"]
    assert region["state"] == "certified" and "6000 packets leave possible" in region["reason"]
    assert said["verdict"]["number"] <= region["tail_radius"] < 1.0
    assumed = [each for each in region["assumptions"] if "come independently of each other" in each]
    assert [each[:22] for each in assumed] == ["packets of network.sc ", "packets of network.ca "]
    assert all(each.endswith("; none that comes more than 1 slot late, as none in the record does, is taken") for each in assumed)
    assert all("a correlation of neighbours below 0.065 is often missed; behind a late or lost one" in each for each in assumed)
    assert cli(*run, "--set", "allow_uncertified=true", "--duration", "20", "-o", "short.mcap")[0] in (0, 3)
    status, out, err = cli(*design, "short.mcap")
    assert status == 0, err
    region = json.loads(out)["network"]["region"]
    assert region["state"] == "undecided"
    assert 400 < int(region["reason"].partition("about ")[2].split()[0]) < 6000


def test_what_comes_until_the_deadline_of_the_experiment_counts_in_its_slot(cli: Hil, tmp_path: Path) -> None:
    """After 40 ms of 50: in time by a deadline at 0.9 of a slot, and a slot late by one at 0.6, the default."""
    run = [f"--set=network.{way}.law={{kind='packet', latency='40 ms'}}" for way in ("sc", "ca")]
    assert cli("run", "dc-motor-packets", *run, "--set=allow_uncertified=true", "--duration=16", "-o", "link.mcap")[0] in (0, 3)
    shipped = files("hil.experiments").joinpath("dc-motor-hinf.toml").read_text(encoding="utf-8")
    (tmp_path / "later.toml").write_text(f"{shipped}\n[timing]\ndeadline = 0.9\n", encoding="utf-8")
    status, out, err = cli("design", "later.toml", "--network", "link.mcap", "--starts=1", "--information=constant", "--json")
    assert status == 0, err
    assert [json.loads(out)["network"][way]["max_age"] for way in ("sc", "ca")] == [0, 0]


def test_ages_that_never_came_and_friction_are_named_beside_a_region() -> None:
    """Counted ages say nothing of an older one; and what the plant has beyond its model is in no verdict on a region."""
    fit = fit_law(record_of(LAWS[13][1], 6000, [1]), T, DEADLINE)
    way = measured(fit, holds_input=False)
    assert fit.law_class == "markov"
    target = over_network(tracking_target("dc-motor"), way, way)
    design = solve_tracking(problem_for(target, starts=1))
    found = region_verdict(target, design, way, way)
    assert found.certified and f"no age is above {way.at.max_age}, the largest in the record" in found.assumptions
    rubbing = target._replace(of=load_experiment("dc-motor-h2-friction").plant)
    assert region_verdict(rubbing, design, way, way).state == "undecided"
