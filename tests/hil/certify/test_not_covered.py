"""A loop that no certificate covers: the reason names the part, what it lacks and what would be judged."""

from __future__ import annotations

import numpy as np
import pytest

from design.controllers import LoopModel
from design.verdict import Verdict
from hil.certify import CertificationProblem, why_no_controller, why_no_history
from hil.certify.certify import judge
from hil.compose import compose
from hil.experiment import load_experiment
from plants.dc_motor import DCMotor


def verdict_on(name: str, *sets: str) -> Verdict:
    found = compose(load_experiment(name, [*sets, "allow_uncertified=true"])).verdict
    assert found is not None
    return found


COPIES = "{kind='packet', latency='90 ms', reordering=false, duplication=0.1}"


class NoSelection:
    def table(self, model: LoopModel) -> None: ...


class History:
    def history(self) -> None: ...


def test_a_controller_receives_what_it_may_state_and_what_it_lacks() -> None:
    assert "NoSelection has table(model) and lacks selection" in why_no_controller(NoSelection())
    assert "History has history() and lacks uses" in why_no_controller(History())
    said = why_no_controller(object())
    assert all(each in said for each in ("table(model)", "linear_law(model)", "schedule_of_modes()", "history()"))


def test_gains_over_history_name_the_state_that_is_not_measured_or_the_modes() -> None:
    motor = DCMotor()
    model = motor.model().discretise(0.05)
    loop = LoopModel(A=model.A, B=model.B, C=np.asarray(model.C)[:1], period_s=0.05, tau_max=0, d_max=0)
    assert "DCMotor: it does not measure speed" in why_no_history(motor, loop)
    turned = LoopModel(A=model.A, B=model.B, C=np.array([[1.0, 0.5]]), period_s=0.05, tau_max=0, d_max=0)
    assert "it does not measure speed" in why_no_history(motor, turned)
    jumping = load_experiment("smjls-robust").plant
    said = why_no_history(jumping, loop)  # type: ignore[arg-type]  # no unavailable plug-in
    assert "jumps between modes" in said and "schedule_of_modes()" in said


@pytest.mark.parametrize(
    ("name", "sets", "why"),
    [
        ("smjls-robust", ("controller={kind='local',gain=[[0.0,0.0,0.0]]}",), "jumps between modes, and no proof covers a table"),
        ("multisensor-published", (f"network.ca.law={COPIES}",), "states no chain: packets wait for the copies"),
    ],
)
def test_the_reason_names_the_part_and_what_is_judged(name: str, sets: tuple[str, ...], why: str) -> None:
    verdict = verdict_on(name, *sets)
    assert verdict.state == "undecided" and why in verdict.reason


def test_a_proof_that_needs_too_much_memory_leaves_the_loop_undecided() -> None:
    made = compose(load_experiment("dc-motor-h2"))

    def too_large(loop: CertificationProblem) -> Verdict:
        raise MemoryError("Unable to allocate 163. GiB")

    loop = CertificationProblem(
        plant=made.experiment.plant, controller=made.controller, model=made.model, sc=made.chains.sc, ca=made.chains.ca,
        digest="0" * 64,
    )  # fmt: skip
    said = judge(loop, (too_large,))
    assert said.state == "undecided" and "3 modes of sc times 2 modes of ca" in said.reason and "163. GiB" in said.reason
