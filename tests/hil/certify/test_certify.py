"""The one door for certificates: what it says is of the loop that runs, and of no other."""

from __future__ import annotations

import dataclasses
import json
import re
from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

import hil
from design.requests.scheduled import RobustScheduled
from design.verdict import Verdict
from hil.api.experiment_source import load_experiment as changed
from hil.certify import CertificationProblem
from hil.certify.certify import certifiers, certify
from hil.compose import compose
from hil.errors import ExperimentError, ForeignVerdict, HilError
from hil.experiment import load_experiment
from hil.rig import port_of
from hil.rig.loop import Loop, digest_of
from hil.runtime.virtual import simulate
from plants import DCMotor, LinearPlant


@cache
def composed(name: str, *sets: str) -> Loop:
    return compose(load_experiment(name, [*sets, "allow_uncertified=true"]))


def test_a_motor_over_chains_is_certified_with_its_radius_and_the_keys_of_before() -> None:
    certificate = composed("dc-motor-h2").certificate
    assert certificate is not None
    assert certificate["kind"] == "mean-square stability" and certificate["state"] == "certified"
    assert certificate["number"] == certificate["mean_square_radius"] < certificate["limit"] == 1.0
    assert certificate["stable"] and certificate["h2_norm"] > 0 and len(certificate["digest"]) == 64
    assert json.loads(json.dumps(certificate)) == certificate


def test_the_number_that_decides_turns_the_verdict() -> None:
    gains = [composed("dc-motor-local", f"controller.gain=[[{gain}]]").verdict for gain in (-0.05, -0.4515)]
    assert [v.state for v in gains if v] == ["certified", "refused"]
    with pytest.raises(ExperimentError, match=r"refused: .*radius 1\.054"):
        compose(load_experiment("dc-motor-local", ["allow_uncertified=false"]))


INTEGRAL = "{kind='send-all',selection='constant',integral=true,gains=[[[[-0.1,-0.002]]],[[[-0.1,-0.002]]],[[[-0.1,-0.002]]]]}"


@pytest.mark.usefixtures("moments_of_low_degree")
@pytest.mark.parametrize(
    ("name", "sets", "why"),
    [
        ("dc-motor-packets", ("network.ca.law={kind='packet',latency={trace=['10 ms']}}",
                              "network.sc.law={kind='packet',latency='10 ms'}"), "its latencies are a recorded trace"),
        ("dc-motor-h2", ('network.ca.law={kind="trace", ages=[0, 1, 0], past_end="refuse"}', "duration=0.1"),
         "ends after 3 slots"),
        ("dc-motor-smith", ("controller={kind='constant'}",), "[controller] Constant states no gains or matrices"),
        ("dc-motor-h2-friction", (f"controller={INTEGRAL}",),
         "a driver that saturates, rounds or has a dead zone, dry friction, an encoder"),
    ],
)
def test_what_no_theory_knows_is_undecided_and_needs_leave(name: str, sets: tuple[str, ...], why: str) -> None:
    with pytest.raises(ExperimentError, match=rf"(?s)undecided: .*{re.escape(why)}.*allow_uncertified"):
        compose(load_experiment(name, [*sets, "allow_uncertified=false"]))


def test_viscous_friction_moves_the_pole_of_the_loop_that_is_judged() -> None:
    """The verdict is that of a motor whose pole is the sum of both, under the gains and the u* of the nominal one."""
    viscous, faster = (
        composed("dc-motor-h2", "controller={kind='local',gain=[[-0.45]]}", change).verdict
        for change in ("plant.friction.viscous_v_s_per_rad=0.02", f"plant.pole={3.5287 + 172.38 * 0.02!r}")
    )
    assert viscous is not None and faster is not None
    assert viscous.number == pytest.approx(faster.number, rel=1e-12)
    nominal = composed("dc-motor-h2", "controller={kind='local',gain=[[-0.45]]}").verdict
    assert nominal is not None and nominal.number is not None and viscous.number is not None
    assert nominal.number > 1.0 > viscous.number  # another state of the verdict, too


@pytest.mark.usefixtures("moments_of_low_degree")
def test_dry_friction_is_no_linear_claim_saturation_has_a_region_and_a_load_leaves_the_claim() -> None:
    linear, practical, regional = "mean-square stability", "practical stability", "stability in a region"
    for change, state, kind in (
        ("plant.friction.viscous_v_s_per_rad=0.001", "certified", linear),
        ("plant.friction.coulomb_v=0.001", "certified", practical),
        ("plant.encoder.step_rad=1e-6", "certified", practical),
        ("plant.driver.saturation_v=12.0", "certified", regional), ("plant.driver.saturation_v=0.1", "certified", practical),
        ("plant.load.torque_v=0.1", "certified", linear),
    ):
        verdict = composed("dc-motor-h2", change).verdict
        assert verdict is not None and (verdict.state, verdict.kind) == (state, kind), change


FALSE_CERTIFICATES = [
    pytest.param("vtol-fault", ("network.sc.law.age=60", "network.ca.law.age=60"), "refused", marks=pytest.mark.slow),
    ("vtol-fault", ("plant.fault_effectiveness=-60", "plant.initial_fault=2"), "refused"),
    pytest.param(
        "smjls-robust", ("plant.uncertainty_scale=12", "plant.sigma=1.0", "plant.rho=1.0"), "refused", marks=pytest.mark.slow
    ),
]


@pytest.mark.parametrize(("name", "sets", "state"), FALSE_CERTIFICATES)
def test_gains_of_one_plant_are_not_certified_over_another(name: str, sets: tuple[str, ...], state: str) -> None:
    """The gains that the shipped experiment runs, over the plant and network that were changed after the design."""
    gains = composed(name).controller
    experiment = load_experiment(name, [*sets, "allow_uncertified=true"])
    with pytest.raises(ExperimentError, match=f"no certificate of .*{state}"):
        compose(replace(experiment, controller=gains, allow_uncertified=False))
    loop = compose(replace(experiment, controller=gains), certify=False)
    assert any(event["kind"] == "safety" for event in simulate(loop, 0).events)  # and rightly so


@pytest.mark.parametrize(
    ("name", "sets"),
    [
        pytest.param("vtol-fault", ("plant.fault_effectiveness=-60", "plant.initial_fault=2"), marks=pytest.mark.slow),
        ("smjls-robust", ("plant.uncertainty_scale=12", "plant.sigma=1.0", "plant.rho=1.0", "controller.sections=1")),
    ],
)
def test_gains_that_are_solved_for_the_changed_plant_are_certified_only_as_they_hold_it(name: str, sets: tuple[str, ...]) -> None:
    loop = composed(name, *sets)
    assert loop.verdict is not None and loop.verdict.certified
    for seed in range(2):
        run = simulate(loop, seed)
        assert not [event for event in run.events if event["kind"] == "safety"], seed
        measured = run.arrays["/plant/measurement"]
        tenth = len(measured) // 10
        size = sum(measured[name] ** 2 for name in loop.experiment.plant.tracked)
        assert size[-tenth:].mean() < 0.2 * size[:tenth].mean(), seed


@pytest.mark.parametrize(
    ("sets", "state"),
    [
        (("network.sc.law.age=1", "network.ca.law.age=1"), "certified"),
        (('network.sc.law={kind="iid", probabilities=[0.5, 0.5]}',), "undecided"),
        # 164 states with delayed inputs
        pytest.param(("network.sc.law.age=40", "network.ca.law.age=40"), "undecided", marks=pytest.mark.slow),
        pytest.param(("network.sc.law.age=60", "network.ca.law.age=60"), "refused", marks=pytest.mark.slow),
    ],
)
def test_delays_that_the_sampled_theory_knows_are_judged_and_others_are_undecided(sets: tuple[str, ...], state: str) -> None:
    """Of gains that were designed for the plant without them."""
    experiment = load_experiment("vtol-fault", [*sets, "allow_uncertified=true"])
    verdict = compose(replace(experiment, controller=composed("vtol-fault").controller)).verdict
    assert verdict is not None and verdict.state == state
    assert "not decided at T = 0.001 s" in verdict.reason or state != "undecided"


@pytest.mark.slow
def test_robust_gains_are_solved_for_the_plant_that_runs_and_not_for_an_example() -> None:
    sound, broken = (
        composed("vtol-fault", f"plant.fault_effectiveness={share}").controller.schedule_of_modes()  # type: ignore[attr-defined]
        for share in (0.5, -1.0)
    )
    assert not np.allclose(sound.gain, broken.gain)


def test_a_plant_that_does_not_jump_is_no_plant_for_robust_scheduled_gains() -> None:
    with pytest.raises(ExperimentError, match=r"controller\.kind: needs a plant that jumps"):
        compose(load_experiment("vtol-h2", ['controller={kind="robust-scheduled"}']))


def test_a_method_that_the_plant_does_not_call_for_is_refused_by_its_field() -> None:
    with pytest.raises(ExperimentError, match=r"controller\.method: 'delayed-hinf' is not for this plant, which has no delay"):
        compose(load_experiment("smjls-robust", ['controller.method="delayed-hinf"']))


def test_a_verdict_on_another_loop_is_refused() -> None:
    loop = composed("dc-motor-h2")
    other = composed("dc-motor-h2", "plant.gain=170.0")
    assert loop.verdict is not None and other.verdict is not None and loop.verdict.digest != other.verdict.digest
    with pytest.raises(ForeignVerdict):
        dataclasses.replace(loop, verdict=other.verdict)
    with pytest.raises(ForeignVerdict):
        dataclasses.replace(loop, controller=composed("dc-motor-hinf").controller)

    def careless(loop: CertificationProblem) -> Verdict:
        return Verdict(kind="mean-square stability", state="certified", reason="of something else", digest="0" * 64)

    with pytest.raises(ForeignVerdict):
        certify(to_certify(loop), (careless, *certifiers()))


def test_everything_that_decides_is_in_the_digest_and_seed_and_schedule_are_not() -> None:
    def digest(*sets: str) -> str:
        verdict = composed("dc-motor-h2", *sets).verdict
        assert verdict is not None
        return verdict.digest

    same = digest()
    assert digest("seed=7", "duration=3", 'links.uri="memory:"') == same
    for change in ("plant.pole=3.5", "period=0.06", 'network.ca.law={kind="constant", age=0}', 'controller.selection="applied"'):
        assert digest(change) != same, change


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tabled(DCMotor):
    table: dict[object, float] = dataclasses.field(default_factory=lambda: {1: 0.5, "a": 0.0})


def test_a_plant_whose_table_has_keys_without_an_order_is_refused_with_its_field() -> None:
    with pytest.raises(HilError, match=r"dc-motor-h2: plant.table: keys without an order \(int, str\)"):
        compose(hil.load_experiment("dc-motor-h2", plant=Tabled()))
    compose(hil.load_experiment("dc-motor-h2", plant=Tabled(table={2: 0.5, 10: 0.0})))


def to_certify(loop: Loop) -> CertificationProblem:
    sc, ca = loop.chains.sc, loop.chains.ca
    return CertificationProblem(
        plant=loop.experiment.plant, controller=loop.controller, model=loop.model, sc=sc, ca=ca,
        digest=digest_of(loop.experiment, loop.controller, loop.model),
    )  # fmt: skip


def test_a_further_kind_of_loop_gets_its_certificate_by_a_certifier_of_its_own() -> None:
    loop = to_certify(composed("dc-motor-smith", "controller={kind='constant'}"))

    def passive(loop: CertificationProblem) -> Verdict | None:
        return Verdict(kind="passivity", state="certified", reason="energy", number=0.1, digest=loop.digest)

    assert certify(loop).state == "undecided"
    assert certify(loop, (*certifiers(), passive)).kind == "passivity"


def test_a_wall_over_what_is_no_device_under_one_force_is_undecided() -> None:
    for name in ("omni-push", "omni-theorem61"):
        loop = to_certify(composed(name))  # its plant states no port
        verdict = certify(loop)
        assert (verdict.kind, verdict.state) == ("passivity", "undecided") and loop.port is None
        assert verdict.reason.startswith("a wall is certified over a passive device: position, speed and one force")
    assert port_of(LinearPlant(A=((0.0, 1.0), (-1.0, 0.0)), B=((0.0,), (0.0,)), C=((1.0, 0.0),))) is None  # no force moves it


def test_a_request_says_which_of_its_fields_is_wrong() -> None:
    for field, value in (("gain_bound", -1.0), ("decay", float("nan")), ("sections", -1)):
        with pytest.raises(ValueError, match=f"{field}: "):
            RobustScheduled(**{field: value})
    assert RobustScheduled(sections=3).sections == 3


@pytest.mark.parametrize("trigger", ["", 'trigger = { kind = "dead-band", threshold = 0.01 }'])
@pytest.mark.parametrize(("delayed", "state"), [(0.9, "refused"), (0.3, "certified"), (0.0, "certified")])
def test_delayed_states_count_with_and_without_a_trigger(tmp_path, delayed: float, state: str, trigger: str) -> None:
    """x(k+1) = 0.5 x(k) + 0.9 x(k-1) grows; 0.5 x(k) alone does not: the verdict turns with the matrix A_1."""
    path = tmp_path / "delayed.toml"
    path.write_text(f"""
        name = "delayed"
        period = "50 ms"
        duration = "5 s"
        allow_uncertified = true
        [plant]
        kind = "delayed-states"
        A = [[0.5]]
        delayed = [[[{delayed}]]]
        B = [[1.0]]
        weight = [[1.0]]
        initial_state = [1.0]
        [controller]
        kind = "send-all"
        gains = [[[[0.0]]]]
        [links]
        uri = "memory:"

        [network]
        sc.law = {{ kind = "constant", age = 0 }}
        ca.law = {{ kind = "constant", age = 0 }}
        [network.nodes.all]
        outputs = ["x1"]
        {trigger}
    """)
    verdict = compose(load_experiment(path)).verdict
    assert verdict is not None and verdict.state == state
    grows = float(np.abs(np.roots([1.0, -0.5, -delayed])).max())
    assert verdict.number == pytest.approx(grows**2, rel=1e-6)


def test_loops_over_plants_with_delayed_states_grow_as_their_verdicts_say() -> None:
    """A node that sends in every third slot, by a table or a state of the controller's own: runs of 240 slots, whatever grows."""
    rng, states = np.random.default_rng(4), set()
    for n in range(8):
        A, delayed, B = rng.normal(0, 0.5, (2, 2)), rng.normal(0, 0.4, (2, 2, 2)), rng.normal(0, 1, (2, 1))
        feedback = {"kind": "local", "gain": rng.normal(0, 0.2, (1, 2)).tolist()}
        if n % 2:
            feedback = {"kind": "output-feedback", "A": [[0.4]], "B": [[0.3, 0.1]], "C": [[-0.3]], "D": [[-0.1, 0.0]]}
        loop = compose(changed("multisensor-published", **{
            "plant": {"kind": "delayed-states", "A": A.tolist(), "delayed": delayed.tolist(), "B": B.tolist(),
                      "weight": np.eye(2).tolist(), "initial_state": [1.0, -1.0]},
            "controller": feedback, "network.nodes": {"all": {"outputs": ["x1", "x2"], "clock": {"every": 3}}},
            "network.media": {}, "limits": {"watchdog_slots": 1000}, "allow_uncertified": True, "duration": 12,
        }))  # fmt: skip
        assert loop.verdict is not None and loop.verdict.number is not None
        run = simulate(loop, 0).arrays["/plant/state"]
        sizes = np.hypot(run["x1"], run["x2"])
        lasting = np.flatnonzero(sizes > 1e-4 * sizes.max() if loop.verdict.certified else sizes > 0.0)[-1]
        first, last = np.log(sizes[lasting // 2 - 12 : lasting // 2].max()), np.log(sizes[lasting - 12 : lasting].max())
        assert (last - first) / (lasting - lasting // 2) == pytest.approx(0.5 * np.log(loop.verdict.number), abs=0.03)
        states.add(loop.verdict.state)
    assert states == {"certified", "refused"}


def test_a_proof_that_overflows_says_undecided() -> None:
    experiment = load_experiment("dc-motor-local")
    states = {}
    for gain in (-0.03, -0.4515, 1e160):
        law = dataclasses.replace(experiment.controller, gain=((gain,),))  # as an object: a file is refused such a number
        certificate = compose(replace(experiment, controller=law, allow_uncertified=True)).certificate
        states[gain] = certificate["state"], "double precision" in certificate["reason"]
    assert states == {-0.03: ("certified", False), -0.4515: ("refused", False), 1e160: ("undecided", True)}
