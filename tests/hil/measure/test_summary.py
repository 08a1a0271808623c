"""The summary of a run; of one that was changed, no number is compared with the experiment that it began with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.read import Run
from hil.measure.network_paths import network_metrics, network_paths
from hil.measure.summary import run_timing, summarise, timing_metrics
from hil.measure.view import view_of
from hil.pages.live.script import Scripted
from hil.pages.sections.theory import section
from hil.runtime.virtual import simulate
from hil.session import Session, run_session
from hil.session.replay.recorded import ChangeRequest
from tests.hil.pages.runs import run_of
from transport.laws.age import MarkovAge

SUMMED = {
    "dc-motor-hinf": ["duration=8"], "dc-motor-two-nodes": ["duration=5", 'report.measures=["tracking", "cost"]'],
    "dc-motor-busy-can": ["duration=1"], "omni-push": ["duration=2", "disturbance=[]"], "vtol-h2": ["duration=8"],
    "dc-motor-packets": ["duration=8"],
}  # fmt: skip


def summed() -> str:
    """What is said of some runs, numbers to seven digits."""
    runs = {name: run_of(name, *sets) for name, sets in SUMMED.items()}
    runs["timed"] = run_of("dc-motor-hinf", "duration=8", timed=True)
    found = {name: summarise(view_of(run)) for name, run in runs.items()}
    return json.dumps(json.loads(json.dumps(found), parse_float=lambda text: float(f"{float(text):.7g}")), indent=1) + "\n"


def test_published_gains_reach_the_error_of_the_reference_computation() -> None:
    """12.03, sd 0.41 over 10,000 runs: eight seeds lie within 5 standard errors (false alarm below 1e-6)."""
    loop = compose(load_experiment("dc-motor-hinf"), certify=False)
    found = [summarise(view_of(simulate(loop, seed), loop.experiment))["metrics"] for seed in range(8)]
    assert np.mean([f["sse"] for f in found]) == pytest.approx(12.03, abs=5 * 0.41 / np.sqrt(8))
    assert np.mean([f["sse_after_5s"] for f in found]) == pytest.approx(0.0305, abs=5 * 0.0058 / np.sqrt(8))


def test_the_summary_of_a_run_is_as_it_is_printed() -> None:
    """`print(summed(), end="")` prints the file: who changes what is measured changes it too."""
    assert json.loads(summed()) == json.loads((Path(__file__).parents[2] / "data/summaries.json").read_text())


def test_run_stopped_by_safety_names_the_reason() -> None:
    summary = summarise(view_of(run_of("dc-motor-local")))
    assert summary["safety"] is not None and "limit" in summary["safety"]
    assert summary["slots"] < 1000
    json.dumps(summary, allow_nan=False)


def test_summary_survives_a_run_that_ended_at_once() -> None:
    run = run_of("dc-motor-hinf", 'duration="50 ms"')
    json.dumps(summarise(view_of(run)), allow_nan=False)


def test_summary_survives_a_log_torn_between_two_records_of_one_slot() -> None:
    run = run_of("dc-motor-hinf", 'duration="5 s"')
    run.arrays["/reference"] = run.arrays["/reference"][:-1]
    run.arrays["/actuator/applied"] = run.arrays["/actuator/applied"][:-3]
    assert summarise(view_of(run))["metrics"]["sse"] > 9.0


def test_a_log_without_what_the_network_did_is_summed_up_without() -> None:
    run = run_of("dc-motor-hinf", 'duration="5 s"')
    whole = summarise(view_of(run))
    del run.arrays["/network/sc"]
    run.arrays["/network/ca"] = run.arrays["/network/ca"][:0]
    found = summarise(view_of(run))
    nothing = {"mode_counts": [], "transition_counts": [], "p_value": None, "lost": 0, "late": 0, "duplicated": 0, "fates": {}}
    assert found["network"]["sc"] == {"through": "markov law", "law": "markov"} | nothing
    assert found["network"]["ca"] == {"through": "markov law", "law": "markov"} | nothing
    assert found["metrics"] == whole["metrics"]
    path = network_paths(view_of(run))[1]
    assert (path.side, path.node, path.kind, path.medium, path.changed) == ("ca", "", "markov", "", False)


def test_a_log_that_does_not_say_what_ran_is_still_counted() -> None:
    run = run_of("dc-motor-hinf", 'duration="5 s"')
    known, found = summarise(view_of(run)), summarise(view_of(replace(run, resolved={})))
    assert (found["controller"], found["slots"], found["duration_s"]) == ("", 100, 5.0)
    assert found["metrics"] == known["metrics"] and [*found["network"]["nodes"]] == ["sensor"]
    for side in ("sc", "ca"):
        unknown = {"through": "? law", "law": "?", "p_value": None}
        assert found["network"][side] == known["network"][side] | unknown and known["network"][side]["through"] == "markov law"


def test_record_agrees_with_its_own_law_and_not_with_another() -> None:
    run = run_of("dc-motor-hinf")
    experiment = load_experiment("dc-motor-hinf")
    draws = run.arrays["/network/sc"]
    own = network_metrics(draws, experiment.network.sc.law, "markov")["p_value"]
    other = network_metrics(draws, MarkovAge(matrix=((0.1, 0.9, 0.0), (0.1, 0.1, 0.8), (0.2, 0.2, 0.6))), "markov")
    assert own is not None and own > 1e-3  # fixed seed: no false alarm
    assert other["p_value"] < 1e-6


def test_law_that_cannot_be_made_again_is_still_counted() -> None:
    draws = run_of("dc-motor-hinf").arrays["/network/ca"]
    found = network_metrics(draws, None, "foreign")
    assert found["law"] == "foreign" and sum(found["mode_counts"]) == 1000 and found["p_value"] is None


def test_a_mode_that_no_network_has_takes_no_memory_for_its_pairs() -> None:
    draws = run_of("dc-motor-hinf").arrays["/network/ca"].copy()
    draws["mode"][-1] = np.iinfo(draws["mode"].dtype).max
    found = network_metrics(draws, None, "foreign")
    assert found["mode_counts"] == [] and found["transition_counts"] == []


def test_timing_verdict_names_every_reason() -> None:
    n = 1000
    quiet = np.full(n, 30.0)
    zeros, some = np.zeros(n), np.arange(n) < 5
    assert timing_metrics(quiet, quiet, zeros, zeros, period_s=1e-3)["valid"]
    bad = timing_metrics(quiet + 200.0, quiet, some, some, period_s=1e-3)
    assert not bad["valid"] and len(bad["why"]) == 3 and bad["first_late_slot"] == 0
    assert bad["lateness_us"]["max"] == 230.0


def test_a_quantile_is_said_only_where_there_are_slots_enough_for_it() -> None:
    late = np.full(200, 30.0)
    late[-1] = 400.0
    found = timing_metrics(late, late, np.zeros(200), np.zeros(200), period_s=1e-3)
    assert found["lateness_us"]["p99"] < 40.0 and found["lateness_us"]["p99_9"] is None and found["valid"]
    few = timing_metrics(late[-50:], late[-50:], np.zeros(50), np.zeros(50), period_s=1e-3)
    assert few["lateness_us"]["p99"] is None and few["why"] == ["max of the lateness is 400 us, above a tenth of the period"]


@pytest.mark.parametrize(("clock", "valid"), [("real", False), ("virtual", True)])
def test_a_session_without_a_slot_has_no_valid_timing(clock: str, valid: bool) -> None:
    run = Run(arrays={}, schemas={}, metadata={"clock": clock}, resolved={"period": 0.05})
    assert run_timing(view_of(run))["valid"] is valid


MOSTLY_LATE = {"kind": "markov", "matrix": [[0.05, 0.95], [0.05, 0.95]]}
LOSSY = {"kind": "packet", "latency": "1 ms", "loss": 0.8}


def run_with(tmp_path: Path, *asked: ChangeRequest) -> Session:
    sets = ["duration=10", "limits.watchdog_slots=1000"]
    return run_session(load_experiment("dc-motor-hinf", sets), path=tmp_path / "a.mcap", onlooker=Scripted(asked))


def certificate_of(session: Session) -> dict[str, Any]:
    found: dict[str, Any] = session.summary["certificate"]
    return found


def test_draws_of_a_law_that_was_changed_are_not_compared_with_the_first(tmp_path: Path) -> None:
    import hil

    session = run_with(tmp_path, (100, "network.ca.law", MOSTLY_LATE))
    network = session.summary["network"]
    assert network["ca"]["p_value"] is None and network["ca"]["through"] == "markov law, changed in the run"
    assert network["sc"]["p_value"] > 1e-6, "the other direction draws on"
    with pytest.raises(HilError, match="was changed"):
        hil.assert_law(session, "ca")


def test_certificate_of_a_changed_run_is_that_of_all_that_ran(tmp_path: Path) -> None:
    kept = certificate_of(run_with(tmp_path, (50, "reference", [1.0]), (100, "network.ca.law", MOSTLY_LATE)))
    assert kept["state"] == "certified" and kept["reason"].endswith("changed once, and certified again")
    (tmp_path / "a.mcap").unlink()
    lost = certificate_of(run_with(tmp_path, (60, "network.ca.law", LOSSY), (70, "network.ca.law", MOSTLY_LATE)))
    assert lost["state"] == "refused" and lost["reason"].startswith("certified until slot 60, where network.ca.law was changed")
    assert kept["stable"] and not lost["stable"]
    (tmp_path / "a.mcap").unlink()
    assert "changed" not in certificate_of(run_with(tmp_path, (50, "reference", [1.0])))["reason"]


def test_no_theory_is_shown_of_another_loop_than_that_which_ran(tmp_path: Path) -> None:
    plain = run_with(tmp_path).run
    (tmp_path / "a.mcap").unlink()
    changed = run_with(tmp_path, (50, "reference", [1.0])).run
    assert section(view_of(plain)) is not None
    assert section(view_of(changed)) is None
