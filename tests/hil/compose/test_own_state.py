"""A table of gains with a state of its own: judged as it runs, and told apart by age where the state alone depends on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from design.controllers import LoopModel, SendAll
from hil.compose import compose
from hil.experiment import load_experiment
from hil.measure.prediction import predict
from hil.plugins.checks import check_table
from hil.rig.loop import Loop
from hil.rig.loop_chains import loop_chains

NAME = "dc-motor-ours-memory"


def listed(values: Any) -> str:
    return str(np.asarray(values).tolist())


def loop_of(controller: SendAll, state_gains: Any, *sets: str) -> Loop:
    table = f"{{kind='send-all', selection='applied', gains={listed(controller.gains)}, state_gains={listed(state_gains)}}}"
    return compose(load_experiment(NAME, [f"controller={table}", "allow_uncertified=true", "duration=1", *sets]))


@pytest.fixture(scope="module")
def shipped() -> Loop:
    return compose(load_experiment(NAME, ["duration=1"]))


def test_what_runs_is_certified_and_a_state_that_goes_on_otherwise_is_not(shipped: Loop) -> None:
    controller = shipped.controller
    assert isinstance(controller, SendAll) and np.shape(controller.state_gains) == (3, 2, 3)
    assert shipped.verdict is not None and shipped.verdict.certified and 0.6 < shipped.verdict.number < 0.7
    again = loop_of(controller, controller.state_gains).verdict
    assert again is not None and again.number == shipped.verdict.number
    turned = loop_of(controller, -np.array(controller.state_gains)).verdict
    assert turned is not None and turned.state == "refused"
    assert predict(shipped, 20) is None  # the theory of the error knows no state of the controller


def test_ages_are_distinguished_that_the_state_alone_knows(shipped: Loop) -> None:
    controller = shipped.controller
    assert isinstance(controller, SendAll)
    alike = SendAll(gains=controller.gains[:1] * 3, state_gains=controller.state_gains)
    clock = "network.nodes={angle={outputs=['angle'], clock={every=2}, law={kind='constant', age=0}}}"
    for state_gains, labels in ((alike.state_gains, 2), (alike.state_gains[:1] * 3, 1)):
        loop = loop_of(alike, state_gains, clock, "network.sc.law={kind='constant', age=0}", "network.sc.max_age=2")
        sc = loop_chains(loop.rig, loop.chains, loop.controller, loop.model).sc
        assert sc is not None and len(set(sc.label.tolist())) == labels


def test_a_strangers_state_has_to_fit_its_table() -> None:
    class Own:
        selection, state_gains = "constant", (((1.0, 0.5, 0.0),),)

        def table(self, model: LoopModel) -> np.ndarray:
            return np.zeros((1, 1, 1, 2))

        def start(self, model: LoopModel) -> None: ...

    model = LoopModel(A=np.eye(1), B=np.eye(1), C=np.eye(1), period_s=0.1, tau_max=0, d_max=0)
    with pytest.raises(AssertionError, match=r"state_gains of shape \(1, 1, 3\), expected \(1, 1, 2\)"):
        check_table(Own(), model)  # type: ignore[arg-type]
