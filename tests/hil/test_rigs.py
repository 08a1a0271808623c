"""The rigs of Chapters 2 to 4 and the VTOL of Chapter 7: they run like any other, in virtual and in real time."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hil.compose import compose
from hil.compose.judged import DELAYED
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.runtime.virtual import simulate
from hil.session import run_session
from hil.session.replay.replay import verify


def test_published_fault_tolerant_gains_are_refused_and_with_leave_stopped_by_safety(tmp_path: Path) -> None:
    session = run_session(load_experiment("vtol-fault-published"), path=tmp_path / "a.mcap")
    assert session.status == 3
    assert session.run.certificate["state"] == session.run.certificate["verdict"] == "refused"
    assert "in the long run second moments are multiplied by at least 1" in session.run.certificate["reason"]


@pytest.mark.parametrize("name", ["smjls-robust", "vtol-delayed", "vtol-fault"])
def test_our_gains_bring_their_certificate_into_the_log_and_the_log_verifies(tmp_path: Path, name: str) -> None:
    session = run_session(load_experiment(name, ["duration=2"]), path=tmp_path / "a.mcap")
    assert session.status == 0
    assert session.run.certificate["continuous_time"] == "certified" and session.run.certificate["sound"]
    assert session.run.certificate["state"] == session.run.certificate["verdict"] == "certified"
    assert session.run.resolved["controller"]["kind"] == "scheduled"
    ideal = {"smjls-robust": "decay_rate alone is", "vtol-delayed": "gamma alone is"}
    said = f"{ideal.get(name, 'gamma and decay_rate alone are')} of the feedback that acts at every instant, without delays"
    assert said in session.run.certificate["assumptions"], "what is not claimed of the sampled loop is said"
    assert (DELAYED in session.run.certificate["assumptions"]) == (name == "vtol-delayed"), "the run compares no delay inside"
    assert verify(session.run).difference is None


def test_fault_that_the_controller_does_not_see_is_in_the_log_only() -> None:
    run = simulate(compose(load_experiment("vtol-fault", ["duration=3"]), certify=False), 1)
    state, seen = run.arrays["/plant/state"], run.arrays["/plant/measurement"]
    assert set(np.unique(state["fault_mode"])) == {1.0, 2.0}
    assert "fault_mode" not in (seen.dtype.names or ())
    assert (state["fault_mode"] != seen["detected_mode"]).any()


@pytest.mark.realtime
@pytest.mark.parametrize(
    "name", ["smjls-robust", *(pytest.param(name, marks=pytest.mark.slow) for name in ("vtol-fault", "vtol-delayed"))]
)
def test_rig_with_random_modes_in_real_time_is_the_virtual_run_up_to_the_first_late_slot(tmp_path: Path, name: str) -> None:
    experiment = load_experiment(name, ["duration=1", "period=10 ms", "limits.watchdog_slots=50", "allow_uncertified=true"])
    real = run_session(experiment, clock="real", link=f"can:hil:rigs{os.getpid()}", path=tmp_path / "real.mcap")
    virtual = simulate(compose(experiment, certify=False), experiment.seed)
    late = real.summary["timing"]["first_late_slot"]
    end = 100 if late is None else late + 1
    np.testing.assert_array_equal(real.run.arrays["/plant/state"][:end], virtual.arrays["/plant/state"][:end])


@pytest.mark.parametrize(("slots", "suffices"), [(40, True), (39, False)])
def test_a_recording_that_just_suffices_is_taken(slots: int, suffices: bool) -> None:
    law = f"network.sc.law={{kind='trace', ages={[0] * slots}, past_end='refuse'}}"
    experiment = load_experiment("dc-motor-hinf", ["duration=2", law, "allow_uncertified=true"])
    if suffices:
        assert compose(experiment).experiment.slots == 40
    else:
        with pytest.raises(HilError, match="the recording has 39 slots, the run has 40"):
            compose(experiment)


def test_a_packet_that_would_carry_more_values_than_it_can_is_refused() -> None:
    plant = f"plant={{kind='state-space', A=[[-1.0]], B=[[1.0]], C={[[1.0]] * 70}}}"
    sets = [plant, "controller={kind='constant'}", "reference=[]", "disturbance=[]", "limits={}"]
    with pytest.raises(HilError, match="samples: 1 of 70 outputs, a packet carries 1 to 63 values"):
        compose(load_experiment("dc-motor-hinf", [*sets, "allow_uncertified=true"]))
