"""A table of gains with a state of its own: judged as it runs, and told apart by age where the state alone depends on it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pytest

import hil
from design.controllers import IntegralAction, LoopModel, SendAll, SeveralSamples, controller_traits
from design.controllers.contract import ControllerTraits
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
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


def test_an_integral_beside_a_state_is_certified_and_with_a_clamp_ends_within() -> None:
    table = "controller={kind='designed', order=1, integral=0.01, reference_weight=3}"
    whole = compose(load_experiment(NAME, [table, "duration=1"]))
    clamp = "controller.integral_limit=[5.0]"
    clamped = compose(load_experiment(NAME, [table, "duration=1", clamp]))
    assert isinstance(whole.controller, SendAll) and np.shape(whole.controller.state_gains) == (3, 1, 3)
    assert whole.verdict is not None and clamped.verdict is not None and whole.verdict.certified
    assert clamped.verdict.certified and "with a clamped integral it ends" in clamped.verdict.reason


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
    Own.state_gains = np.array([[[1.0, 0.5]]])  # type: ignore[assignment]
    check_table(Own(), model)  # type: ignore[arg-type]
    assert controller_traits(Own()).state_gains == (((1.0, 0.5),),)


def test_what_an_object_alone_has_is_said_and_a_class_made_of_a_protocol_is_none() -> None:
    class Plain: ...

    class Named(SeveralSamples):
        samples = 2

    @runtime_checkable
    class Both(SeveralSamples, IntegralAction, Protocol): ...

    plain: Any = Plain()
    assert controller_traits(plain) == ControllerTraits() and not isinstance(plain, SeveralSamples)
    plain.samples = 3
    assert controller_traits(plain).samples == 3 and isinstance(plain, SeveralSamples)
    assert isinstance(Named(), SeveralSamples) and not isinstance(plain, Named)
    assert not isinstance(plain, Both) and controller_traits(Named()).samples == 2
    plain.integral = True
    assert isinstance(plain, Both)


def test_a_design_and_its_file_have_the_verdict_of_the_loop_that_runs_them(shipped: Loop, tmp_path: Path) -> None:
    found = hil.design("dc-motor", order=1, R=0.5, reference_weight=3.0, starts=1)
    found.save(tmp_path / "one.json")
    table = f"controller={{kind='designed', file='{tmp_path}/one.json'}}"
    verdict, slower = (compose(load_experiment(NAME, [table, *sets])).verdict for sets in ((), ("plant.gain=150",)))
    assert verdict is not None and slower is not None and verdict.certified and slower.certified
    assert found.verdict.number == pytest.approx(verdict.number, rel=1e-12) and slower.number != verdict.number
    document = json.loads((tmp_path / "one.json").read_text())
    for order in (2, -1, "1", 1.0):
        (tmp_path / "one.json").write_text(json.dumps(document | {"problem": document["problem"] | {"order": order}}))
        with pytest.raises(HilError, match=r"problem\.order: .*, expected a whole number of states that the gains have rows for"):
            compose(load_experiment(NAME, [table]))
