"""Of a loop whose controller is an external program nothing is claimed."""

from __future__ import annotations

from hil.api.experiment_source import load_experiment
from hil.compose import compose


def test_the_verdict_on_an_external_controller_is_undecided_and_says_what_the_named_one_is_worth() -> None:
    experiment = load_experiment("dc-motor-hinf")
    own, external = compose(experiment).verdict, compose(experiment, external=True).verdict
    assert own is not None and external is not None and own.certified
    assert external.state == "undecided" and external.reason.startswith("the controller is not the experiment's")
    assert external.number is None and not external.assumptions and external.digest == own.digest
    assert str(external.details["the named controller would be"]).startswith("certified, mean-square stability: ")
