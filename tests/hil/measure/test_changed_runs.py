"""A run that was changed: no number of it is compared with the experiment that it began with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hil.errors import HilError
from hil.experiment import load_experiment
from hil.measure.view import view_of
from hil.pages.live.script import Scripted
from hil.pages.sections.theory import section
from hil.session import Session, run_session
from hil.session.replay.recorded import Asked

MOSTLY_LATE = {"kind": "markov", "matrix": [[0.05, 0.95], [0.05, 0.95]]}
LOSSY = {"kind": "packet", "latency": "1 ms", "loss": 0.8}


def run_with(tmp_path: Path, *asked: Asked) -> Session:
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
    assert kept["state"] == "certified" and kept["reason"].endswith("changed 1 times, and certified each time")
    (tmp_path / "a.mcap").unlink()
    lost = certificate_of(run_with(tmp_path, (60, "network.ca.law", LOSSY), (70, "network.ca.law", MOSTLY_LATE)))
    assert lost["state"] == "refused" and lost["reason"].startswith("certified until slot 60, where network.ca.law was changed")
    (tmp_path / "a.mcap").unlink()
    assert "changed" not in certificate_of(run_with(tmp_path, (50, "reference", [1.0])))["reason"]


def test_no_theory_is_shown_of_another_loop_than_that_which_ran(tmp_path: Path) -> None:
    plain = run_with(tmp_path).run
    (tmp_path / "a.mcap").unlink()
    changed = run_with(tmp_path, (50, "reference", [1.0])).run
    assert section(view_of(plain)) is not None
    assert section(view_of(changed)) is None
