"""Model following, the comparison: nearly as stiff as the wall for its own hand, unstable for nearly every other one."""

import numpy as np
import pytest

from design.controllers.contract import LoopModel
from design.controllers.wall import Wall
from design.jump_linear import MJLS
from design.passivity import HeldDevice
from design.passivity.model_following import contact_matrices, follow_wall
from hil.compose import compose
from hil.errors import ExperimentError
from hil.experiment import load_experiment
from hil.runtime.virtual import simulate
from tests.design.passivity.published import DAMPING, DEVICE, LAMBDA, PERIOD_S

LET = "allow_uncertified=true"
FOLLOW = 'controller={kind="model-following", material_chain=[[0.4, 0.3, 0.3], [0.3, 0.4, 0.3], [0.15, 0.15, 0.7]]}'


@pytest.fixture(scope="module")
def running():
    return start()


def start():
    law = follow_wall(Wall(), DEVICE, period_s=PERIOD_S, sc=3, ca=3, material_chain=LAMBDA)
    model = LoopModel(A=np.eye(2), B=np.ones((2, 1)), C=np.zeros((3, 2)), period_s=PERIOD_S, tau_max=3, d_max=3)
    return law.start(model)


def contact(running, device):
    return contact_matrices(running, device, period_s=PERIOD_S, sc=3, ca=3, materials=3)


def test_without_a_hand_it_is_nearly_the_wall_itself(running):
    """Second-moment radius 0.719, 1 N sinks in by 1.16 to 1.22 mm; 58.8 mm pass before any answer can come."""
    A = contact(running, DEVICE)
    b = np.zeros((A.shape[1], 1))
    b[:2, 0] = DEVICE.discretise(PERIOD_S)[1]
    loop = MJLS(A=A, B=b, C=b.T, transition=LAMBDA)
    assert loop.radius() == pytest.approx(0.719, abs=2e-3)
    for own in A:
        state, depth = np.zeros(len(own)), []
        for _ in range(200):
            state = own @ state + b[:, 0]
            depth.append(state[0])
        assert 1.1e-3 < depth[-1] < 1.25e-3
        assert max(depth) == pytest.approx(0.0588, abs=1e-4)


def test_nearly_every_other_passive_hand_makes_it_unstable(running):
    """Nearly all of 60 sampled hands; the stiffest coupler is stable for all of them, by theorem."""
    rng, unstable = np.random.default_rng(0), 0
    for m, b, k in rng.uniform(0.0, [2.0, 30.0, 800.0], (60, 3)).tolist():
        hand = HeldDevice(
            mass_kg=DEVICE.mass_kg, damping_n_s_per_m=DAMPING, hand_mass_kg=m, hand_damping_n_s_per_m=b, hand_stiffness_n_per_m=k
        )
        unstable += float(np.abs(np.linalg.eigvals(contact(running, hand))).max()) >= 1.0
    assert unstable >= 55


@pytest.mark.parametrize(("sc", "ca"), [(0, 0), (1, 0), (0, 2), (3, 3)])
def test_the_rig_moves_as_the_matrices_say_while_the_target_is_in_contact(sc, ca):
    sets = [FOLLOW, f"network.sc.law.age={sc}", f"network.ca.law.age={ca}", "allow_uncertified=true", "limits={}"]
    experiment = load_experiment("omni-push", sets, duration="1 s")
    loop = compose(experiment)
    x = simulate(loop, 0).arrays["/plant/state"]["position"]
    A = contact_matrices(loop.start_controller(), DEVICE, period_s=PERIOD_S, sc=sc, ca=ca, materials=3)[0]
    state, depth = np.zeros(len(A)), [0.0]
    for _ in range(len(x) - 1):
        state = A @ state
        state[:2] += DEVICE.discretise(PERIOD_S)[1]
        depth.append(float(state[0]))
    assert x == pytest.approx(depth, abs=2e-6)


def test_every_slot_passes_once_whether_it_is_answered_or_not():
    running = start()
    state, last = np.zeros(running.order), -1
    for k in (0, 1, 4):
        for _ in range(k - last):
            force, state = running.linear(state, 0.01, Wall().material)
        assert running.rows(k, 3, (0.01, 0.0, 0.0), ()) == ((force,),) and force != 0.0
        last = k


def test_it_is_refused_through_the_door_with_the_hand_that_decides():
    with pytest.raises(ExperimentError, match=r"passivity, refused: not stable when a passive hand of .* \(spectral radius 1\."):
        compose(load_experiment("omni-push", [FOLLOW]))
    loop = compose(load_experiment("omni-push", [FOLLOW, "allow_uncertified=true"]))
    assert loop.verdict is not None and loop.verdict.details["spectral_radius"] < 0.9 and loop.verdict.limit == 1.0


def test_it_is_judged_at_the_delays_that_happen_not_at_the_largest_that_it_may_be_made_for():
    later = [FOLLOW, "allow_uncertified=true", "network.sc.max_age=6"]
    loop = compose(load_experiment("omni-push", later))
    happens = contact_matrices(loop.start_controller(), DEVICE, period_s=PERIOD_S, sc=3, ca=3, materials=1)
    assert loop.model.tau_max == 6 and loop.verdict is not None
    assert loop.verdict.details["spectral_radius"] == pytest.approx(float(np.abs(np.linalg.eigvals(happens)).max()))


def test_the_wave_coupler_and_theorem_61_go_through_the_same_door():
    verdicts = {
        method: compose(load_experiment("omni-push", [f"controller.coupler={{method='{method}'}}", LET])).verdict
        for method in ("stiffest", "wave", "theorem-6.1")
    }
    assert {method: v.state for method, v in verdicts.items()} == {
        "stiffest": "certified", "wave": "certified", "theorem-6.1": "refused",
    }  # fmt: skip
    assert {v.kind for v in verdicts.values()} == {"passivity"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("force_weight=0.0", r"controller\.force_weight: 0\.0"),
        ("material_chain=[[1.0]]", r"controller\.material_chain\[0\]"),
        ("wall={chain=[[0.4, 0.3, 0.3], [0.3, 0.4, 0.3], [0.15, 0.15, 0.7]]}", r"controller\.wall\.chain"),
    ],
)
def test_what_cannot_be_followed_is_refused_with_its_place(change, message):
    with pytest.raises(ExperimentError, match=message):
        compose(load_experiment("omni-push", [f'controller={{kind="model-following", {change}}}']))
