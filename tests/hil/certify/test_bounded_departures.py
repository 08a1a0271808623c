"""Friction, dead zones, encoders and dead bands over a stable linear loop: where it ends, beside runs and beside a lie."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from design.controllers import SendAll
from design.errors import NotStable
from design.jump_linear.leaving import ultimate_bound
from design.networked_loop import polytope
from design.processes.delay_chain import DelayChain
from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate
from plants import DCMotor, Departure, LinearPlant
from tests.hil.certify.many_runs import many_runs

pytestmark = pytest.mark.usefixtures("moments_of_low_degree")

Array = NDArray[np.float64]
NO_AGES = {"kind": "local", "gain": [[-0.05, -0.006]]}
AGES = {"kind": "send-all", "selection": "constant", "gains": [[[[-0.05, -0.006]]], [[[-0.04, -0.006]]]]}
INTEGRAL = {"kind": "send-all", "selection": "constant", "integral": True, "gains": [[[[-0.1, -0.002]]]] * 3}
AT_ONCE = {"kind": "constant", "age": 0}
BAND = {"kind": "dead-band", "threshold": 0.05}
LOSSY_BUS = {"kind": "round-robin", "nodes": ["angle", "speed"], "loss": 0.1}
DRY = {"coulomb_v": 0.0017, "static_v": 0.0026}
CASES: list[tuple[str, dict[str, Any]]] = [
    ("dc-motor-h2", {"plant.friction": DRY}),
    ("dc-motor-h2", {"plant.driver": {"dead_zone_v": 0.0033, "pwm_step_v": 0.001}}),
    ("dc-motor-h2", {"plant.encoder": {"step_rad": 0.0038}}),
    ("dc-motor-h2", {"plant.friction": DRY | {"viscous_v_s_per_rad": 0.002}, "plant.encoder": {"step_rad": 0.0038}}),
    ("dc-motor-two-nodes", {"controller": NO_AGES, "network.nodes.angle.trigger": BAND}),
    ("dc-motor-two-nodes", {
        "controller": NO_AGES, "network.nodes.angle.trigger": BAND,
        "network.media": {"bus": {"kind": "round-robin", "nodes": ["angle", "speed"]}}, "plant.encoder": {"step_rad": 0.01},
    }),
    ("dc-motor-h2", {"plant.encoder": {"step_rad": 0.0038}, "controller": {
        "kind": "output-feedback", "A": [[0.5]], "B": [[0.1]], "C": [[-0.01]], "D": [[-0.05]],
    }}),
]  # fmt: skip


def composed(name: str, **changes: Any) -> Loop:
    calm = {"reference": [], "disturbance": [], "duration": 12, "allow_uncertified": True, "plant.initial_angle_rad": 1.0}
    return compose(load_experiment(name, **calm | changes))


@pytest.mark.parametrize(("name", "changes"), CASES)
def test_runs_end_within_the_bound_and_it_is_not_idle(name: str, changes: dict[str, Any]) -> None:
    """12 runs from 1 rad, which they have forgotten by then (0.92^150): within the bound, and not 40 times below it."""
    loop = composed(name, **changes)
    assert loop.verdict is not None and loop.verdict.certified and loop.verdict.kind == "practical stability"
    compared = ("departs from its model by no more than it says", "moves as its model says")
    assert any(said in each for said in compared for each in loop.verdict.assumptions)
    bounds: Any = loop.verdict.details["ends_within"]
    states, _ = many_runs(loop, 12)
    for output, bound in bounds.items():
        level = float(np.sqrt(np.mean(states[output][150:] ** 2, axis=1)).max())
        assert level <= bound
        if output == "angle":
            assert level > bound / 40


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("dc-motor-h2", {"plant.driver": {"saturation_v": 0.058}, "controller": INTEGRAL}),
        ("dc-motor-two-nodes", {"network.nodes.angle.trigger": BAND, "controller": AGES}),
        ("dc-motor-two-nodes", {"network.nodes.angle.trigger": BAND | {"kind": "error"}, "controller": NO_AGES}),
        ("dc-motor-two-nodes", {"network.nodes.angle.trigger": BAND, "controller": NO_AGES, "network.media": {"bus": LOSSY_BUS}}),
    ],
)  # fmt: skip
def test_what_has_no_bound_stays_undecided(name: str, changes: dict[str, Any]) -> None:
    loop = composed(name, **changes)
    assert loop.verdict is not None and loop.verdict.state == "undecided"


FAR = {"plant.initial_angle_rad": 1e3, "limits": {"watchdog_slots": 1000}, "duration": 8}


@pytest.mark.parametrize(("name", "changes"), [
    ("dc-motor-h2", {"plant.friction": DRY, "controller": {"kind": "local", "gain": [[-0.4515]]}}),
    ("dc-motor-h2", {"plant.encoder": {"step_rad": 0.0038}, "controller": {"kind": "local", "gain": [[-0.4515]]}}),
    ("dc-motor-two-nodes", {"controller": {"kind": "local", "gain": [[-0.6, -0.02]]}, "network.nodes.angle.trigger": BAND}),
    ("dc-motor-h2", {"controller": INTEGRAL | {"gains": [[[[-0.5, -0.002]]]] * 3, "integral_limit": [5.0]}}),
])  # fmt: skip
def test_what_grows_grows_from_afar_whatever_bounded_departures_do(name: str, changes: dict[str, Any]) -> None:
    loop = composed(name, **FAR, **changes)
    assert loop.verdict is not None and loop.verdict.state == "refused" and "it grows from far enough" in loop.verdict.reason
    assert loop.verdict.kind == "practical stability" and (loop.verdict.number or 0.0) > 1.0
    squared = np.mean([simulate(loop, seed).arrays["/plant/state"]["angle"] ** 2 for seed in range(8)], axis=0)
    assert squared[-40:].max() > 20.0 * squared[:40].max()


@pytest.mark.parametrize(("kind", "a", "gain"), [("error", 1.0, -0.05), ("magnitude", 1.25, -1.25)])
def test_a_stable_loop_goes_far_from_rest_under_a_trigger_that_looks_at_no_sample_sent(kind: str, a: float, gain: float) -> None:
    """Why both stay undecided: x(k+1) = a x + u drifts by less than the threshold a slot, for ever, or jumps to 0, where silence
    begins, and grows by 1.25 in every second slot, until 24 bits of a command in a frame show. A dead band keeps its bound.
    """
    rate = float(np.log(a))
    plant = LinearPlant(A=((rate,),), B=((rate / (a - 1.0) if rate else 1.0,),), C=((1.0,),), initial_state=(1.0,))
    reached = {}
    for trigger in (kind, "dead-band"):
        node = {"outputs": ["y1"], "law": AT_ONCE, "trigger": {"kind": trigger, "threshold": 0.2}}
        loop = compose(load_experiment(
            "dc-motor-h2", plant=plant, reference=[], disturbance=[], allow_uncertified=True, period="1 s", duration=200,
            controller={"kind": "local", "gain": [[gain]]},
            network={"sc": {"law": AT_ONCE}, "ca": {"law": AT_ONCE}, "nodes": {"all": node}},
            limits={"input": [1e12]},
        ))  # fmt: skip
        assert loop.verdict is not None
        run = np.abs(simulate(loop, 0, ["/plant/state"]).arrays["/plant/state"]["x1"])
        reached[trigger] = loop.verdict.state, float(run.max()), float(run[-20:].max())
    assert reached[kind][0] == "undecided" and reached[kind][1] > (5.0 if kind == "error" else 1e4)
    assert reached["dead-band"][0] == "certified" and reached["dead-band"][2] < 0.5


def clamped(limit: float, gain: tuple[float, float] = (-0.1, -0.002), **changes: Any) -> Loop:
    table = INTEGRAL | {"gains": [[[list(gain)]]] * 3, "integral_limit": [limit]}
    return composed("dc-motor-h2", controller=table, **changes)


def test_a_loop_with_a_clamped_integral_ends_within_a_bound_that_is_as_wide_as_the_limit() -> None:
    """The bound takes any signal up to the limit; of these gains the sum alone stays far below it."""
    bounds: list[Any] = []
    for limit in (1.0, 4.0):
        loop = clamped(limit)
        verdict = loop.verdict
        assert verdict is not None and verdict.certified and verdict.kind == "practical stability"
        assert "a clamped integral" in verdict.reason
        bounds.append(verdict.details["ends_within"])
        angle = many_runs(loop, 6)[0]["angle"][150:]
        assert (np.sqrt(np.mean(angle**2, axis=0)) <= bounds[-1]["angle"]).all()
    assert bounds[1]["angle"] == pytest.approx(4.0 * bounds[0]["angle"], rel=1e-6)
    # 0.002 V per rad slot times 1 rad slot, held for ever, moves the angle by 0.002 / 0.1 in the steady state: not less than that
    assert bounds[0]["angle"] > 0.02


def test_an_integral_that_leads_away_swings_for_ever_within_the_bound() -> None:
    """Linear, without the clamp, this loop diverges: what keeps it is the clamp alone."""
    loop = clamped(0.2, (-0.1, -0.2))
    free = composed("dc-motor-h2", controller={
        "kind": "send-all", "selection": "constant", "integral": True, "gains": [[[[-0.1, -0.2]]]] * 3,
    })  # fmt: skip
    assert free.verdict is not None and free.verdict.state == "refused"
    assert loop.verdict is not None and loop.verdict.certified
    bounds: Any = loop.verdict.details["ends_within"]
    ended = [simulate(loop, seed, ["/plant/state"]).arrays["/plant/state"][150:] for seed in range(6)]
    level = max(float(np.sqrt(np.mean(run["angle"] ** 2))) for run in ended)
    assert bounds["angle"] / 40 < level <= bounds["angle"]


def test_a_clamped_integral_over_an_unstable_rest_is_refused_and_without_a_sum_of_bounds_undecided() -> None:
    for loop, state in ((clamped(1.0, (-2.0, -0.002)), "refused"), (clamped(1.0, (0.0, -0.1)), "undecided")):
        assert loop.verdict is not None and loop.verdict.state == state and "a clamped integral" in loop.verdict.reason


def test_a_supply_that_saturates_is_left_where_the_limit_of_the_sum_takes_it() -> None:
    """From anywhere while 0.002 times the limit is below the 0.058 V of the supply; undecided beyond."""
    supply: dict[str, Any] = {"plant.driver": {"saturation_v": 0.058}}
    small, large = (clamped(limit, **supply).verdict for limit in (1.0, 40.0))
    assert small is not None and small.certified
    assert large is not None and large.state == "undecided"


class Flatterer(DCMotor):
    """Says that its friction is half of what it is."""

    def departures(self) -> tuple[Departure, ...]:
        return tuple(each._replace(bounds=tuple(0.5 * b for b in each.bounds)) for each in DCMotor.departures(self))


@pytest.mark.parametrize("changes", [{"friction": {"coulomb_v": 0.01}}, {"encoder": {"step_rad": 0.01}}])
def test_a_plant_that_departs_by_more_than_it_says_is_refused(changes: dict[str, Any]) -> None:
    import msgspec

    plant = msgspec.convert(changes, DCMotor)
    lie = Flatterer(friction=plant.friction, encoder=plant.encoder)
    verdict = compose(load_experiment("dc-motor-h2", plant=lie, allow_uncertified=True)).verdict
    assert verdict is not None and verdict.state == "refused" and "departures() says at most" in verdict.reason


def test_what_signals_within_a_slot_move_is_the_sum_of_its_parts() -> None:
    """Held signals add up to B F; in every direction the worst signal that changes within the slot is found, but for the rest."""
    from scipy.linalg import expm

    from hil.certify.bounded_departures import _moved

    motor, fine = DCMotor(), 640
    loop = composed("dc-motor-h2", **{"plant.friction": DRY})
    columns = _moved(motor, loop.model, np.array([0.5]))
    np.testing.assert_allclose(columns[:, :-2].sum(axis=1), 0.5 * loop.model.B[:, 0], rtol=1e-9)
    A, B, h = np.array(motor.model().A), np.array(motor.model().B)[:, 0], 0.05 / fine
    response = np.array([expm(A * (k + 0.5) * h) @ B for k in range(fine)]) * h * 0.5
    for angle in np.linspace(0.0, np.pi, 60):
        row = np.array([np.cos(angle), np.sin(angle) / 50.0])  # what comes early may be against what comes late
        worst, parts, rest = np.abs(response @ row).sum(), *(np.abs(row @ c).sum() for c in (columns[:, :-2], columns[:, -2:]))
        assert parts <= worst * (1.0 + 1e-6) <= (parts + rest) * (1.0 + 2e-6)
        assert rest < 0.1 * np.abs(row) @ np.abs(response).sum(axis=0)


def test_a_plant_that_moves_in_slots_is_moved_by_what_an_input_adds_in_one() -> None:
    from hil.certify.bounded_departures import _moved

    loop = compose(load_experiment("multisensor-event"))
    forces = np.arange(1.0, 1.0 + loop.model.B.shape[1])
    np.testing.assert_array_equal(_moved(loop.experiment.plant, loop.model, forces), loop.model.B * forces)


def test_the_bound_of_a_scalar_loop_is_that_of_its_worst_signal() -> None:
    """|x| ends within 1 / (1 - a) for x' = a x + e, where a constant e comes; of two modes by chance a is that of E x^2."""
    one = ultimate_bound(np.array([[[0.9]]]), np.ones((1, 1)), np.ones((1, 1, 1)), np.ones((1, 1)))
    assert 10.0 <= one[0] <= 10.0 * 1.002
    A, P = np.array([[[0.2]], [[0.9]]]), np.full((2, 2), 0.5)
    both = ultimate_bound(A, P, np.ones((2, 1, 1)), np.ones((1, 1)))
    share = np.sqrt(0.5 * (0.2**2 + 0.9**2))
    assert 1.0 / (1.0 - share) <= both[0] <= 1.002 / (1.0 - share)
    with pytest.raises((NotStable, np.linalg.LinAlgError)):
        ultimate_bound(np.array([[[1.0 + 1e-12]]]), np.ones((1, 1)), np.ones((1, 1, 1)), np.ones((1, 1)))


def sum_beside_a_state(limit: float, weight: float, samples: int = 1) -> Loop:
    """A table on the samples, the clamped sum, and two states of its own, which the sum moves: `weight` times alone by K."""
    K = np.full((3, 2, 1, samples + 3), -0.01)
    K[..., 0], K[..., samples] = -0.1, -0.02 * weight
    own = np.array([[[0.2, *[0.1] * (samples - 1), 0.05, 0.5, 0.1], [0.1, *[0.0] * (samples - 1), 0.2 - 0.1 * tau, 0.0, 0.3]]
                    for tau in range(3)])  # fmt: skip
    table = {"kind": "send-all", "gains": K.tolist(), "state_gains": own.tolist(), "samples": samples, "integral": True}
    return composed("dc-motor-h2", controller={**table, "integral_limit": [limit]})


def outputs_under(loop: Loop, sums: Array, runs: int) -> Array:
    """The angle over slots and runs of a loop whose sums are a given signal, packet by packet."""
    controller, rng = loop.controller, np.random.default_rng(5)
    assert isinstance(controller, SendAll) and loop.chains.sc is not None and loop.chains.ca is not None
    K, own = np.array(controller.gains)[:, :, 0], np.array(controller.state_gains)
    A, B, (C,), chances = loop.model.A, loop.model.B, loop.model.C, [loop.chains.sc.matrix, loop.chains.ca.matrix]
    x, xi, ages, every = np.zeros((runs, 2)), np.zeros((runs, 2)), [np.zeros(runs, dtype=int)] * 2, np.arange(runs)
    y, packets = [x @ C] * (3 + controller.samples), [np.zeros((runs, 2))] * 2
    seen = np.zeros((len(sums), runs))
    for k, s in enumerate(sums):
        ages = [(rng.random(runs)[:, None] > P.cumsum(axis=1)[age]).sum(axis=1) for P, age in zip(chances, ages)]
        y, seen[k] = [x @ C, *y[:-1]], x @ C
        known = np.column_stack([*(np.array(y)[ages[0] + i, every] for i in range(controller.samples)), np.full(runs, s), xi])
        packets = [np.einsum("irk,ik->ir", K[ages[0]], known), packets[0]]
        xi = np.einsum("ick,ik->ic", own[ages[0]], known)
        x = x @ A.T + np.array(packets)[ages[1], every, ages[1]][:, None] * B[:, 0]
    return seen


@pytest.mark.parametrize(("weight", "samples"), [(1.0, 1), (0.0, 1), (-1.0, 2)])
def test_a_clamped_sum_ends_within_that_moves_a_state_of_the_controllers_own(weight: float, samples: int) -> None:
    """Whatever the sum does within its limit: it stays at the limit, or goes from end to end."""
    own, other = (sum_beside_a_state(limit, weight, samples) for limit in (2.0, 4.0))
    loop, wider = own.verdict, other.verdict
    assert loop is not None and wider is not None and loop.certified and loop.kind == "practical stability"
    bound, twice = (verdict.details["ends_within"]["angle"] for verdict in (loop, wider))  # type: ignore[index]
    levels = []
    for slots in (400, 40, 25, 16, 8):
        sums = 2.0 * np.where(np.arange(400) // slots % 2, -1.0, 1.0)
        seen = outputs_under(own, sums, 600)
        levels.append(float(np.sqrt(np.mean(seen[200:] ** 2, axis=1)).max()))
    assert 0.3 * bound < max(levels) < bound and twice == pytest.approx(2.0 * bound)


def test_a_clamped_sum_is_that_of_the_slot_whatever_the_age_of_the_sample_beside_it() -> None:
    """Ages alternate: a sum that was kept with its sample would act by +1, then by -a, and be gone; x(k+1) = a x(k) + b u."""
    a, b = np.exp(-0.1), 1.0 - np.exp(-0.1)
    gains, still = [[[[0.0, 1.0, 0.0]]], [[[0.0, -a, 0.0]]]], [[[0.0, 0.0, 0.0]]] * 2
    verdict = composed(
        "dc-motor-hinf", plant={"kind": "state-space", "A": [[-1.0]], "B": [[1.0]], "C": [[1.0]]}, period=0.1, limits={},
        controller={"kind": "send-all", "selection": "constant", "integral": True, "integral_limit": [1.0], "gains": gains,
                    "state_gains": still},
        reference=[], disturbance=[],
        **{"network.sc.law": {"kind": "markov", "matrix": [[0.0, 1.0], [1.0, 0.0]]}, "network.ca.law": AT_ONCE},
    ).verdict  # fmt: skip
    assert verdict is not None and verdict.kind == "practical stability"
    from_end_to_end = b * (1.0 + a**2) / (1.0 - a**2)  # sums 1, -1, 1, ...
    bound = verdict.details["ends_within"]["y1"]  # type: ignore[index]
    assert from_end_to_end < bound < 2.0 * from_end_to_end


def relative(share: float, **changes: Any) -> Loop:
    trigger = {"kind": "relative", "threshold": share}
    return composed("dc-motor-two-nodes", **{"controller": NO_AGES, "network.nodes.angle.trigger": trigger} | changes)


def test_a_relative_trigger_is_certified_to_a_share_and_its_runs_go_to_rest_with_fewer_packets() -> None:
    loop = relative(0.1)
    assert loop.verdict is not None and loop.verdict.certified and loop.verdict.kind == "mean-square stability"
    assert loop.verdict.number is not None and 0.5 < loop.verdict.number < 1.0 and "up to 10 %" in loop.verdict.reason
    run = simulate(loop, 1, ["/plant/state"]).arrays["/plant/state"]
    assert np.abs(run["angle"][-20:]).max() < 1e-4
    larger = relative(0.9, controller={"kind": "local", "gain": [[-0.15, -0.018]]}).verdict
    assert larger is not None and larger.state == "undecided" and "no quadratic family" in larger.reason
    both = relative(0.1, **{"network.nodes.speed.trigger": BAND}).verdict
    assert both is not None and both.state == "undecided" and "beside a relative one" in both.reason
    lossy = relative(0.1, **{"network.media": {"bus": LOSSY_BUS}}).verdict
    assert lossy is not None and lossy.state == "undecided"


def test_where_no_family_is_sought_over_a_relative_trigger_the_reason_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    trigger, clamped = {"kind": "relative", "threshold": 0.1}, INTEGRAL | {"integral_limit": [1.0]}
    node = {"network.nodes": {"sensor": {"outputs": ["angle"], "trigger": trigger}}}
    away = relative(0.1, controller={"kind": "local", "gain": [[0.05, 0.0]]})
    limited = composed("dc-motor-h2", controller=clamped, **node)
    monkeypatch.setattr(polytope, "MOST_UNKNOWNS", 1)
    for loop, without, what in (
        (away, "refused", "a relative trigger"),
        (limited, "certified", "a clamped integral beside a relative trigger"),
        (relative(0.1), "certified", "a relative trigger: a quadratic family has more than 1 unknowns here"),
    ):
        assert loop.verdict is not None and loop.verdict.state == "undecided" and not loop.verdict.details["stable"]
        assert loop.verdict.reason.startswith(f"{without} without {what}; not decided with it (")


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_shares_that_change_in_every_slot_never_grow_faster_than_the_family(share: float) -> None:
    """Second moments of the loop whose shares are drawn at random, 60 periodic orders: 0 above the number."""
    from design.networked_loop.closed_loop import loop_structure

    at_once, late = {"kind": "constant", "age": 0}, {"kind": "constant", "age": 1}
    loop = relative(share, **{"network.ca.law": late} | {f"network.nodes.{name}.law": at_once for name in ("angle", "speed")})
    assert loop.verdict is not None and loop.verdict.certified
    A, B, C = loop.model.A, loop.model.B, loop.model.C
    K, a_slot = np.array([[[[-0.05, -0.006]]]]), DelayChain(transition=[[1.0]], delays=[1])

    def closed(wrong: float) -> Any:
        return loop_structure(A, B, np.diag([1.0 + wrong, 1.0]) @ C, [[1.0]], a_slot, "constant").matrices(K)[0]

    rng = np.random.default_rng(3)
    for _ in range(60):
        whole = np.eye(len(closed(0.0)))
        length = int(rng.integers(1, 7))
        for wrong in rng.choice([-share, share, 0.0], size=length):
            whole = closed(wrong) @ whole
        assert np.abs(np.linalg.eigvals(whole)).max() ** (2.0 / length) <= loop.verdict.number


def test_what_grows_is_not_refused_where_a_supply_bounds_it() -> None:
    """The motor with a supply swings for ever within a bound that the linear loop leaves."""
    changes = {"plant.driver": {"saturation_v": 5.0}, "plant.friction": DRY, "controller": {"kind": "local", "gain": [[-0.4515]]}}
    loop = composed("dc-motor-h2", **FAR | {"plant.initial_angle_rad": 1.0}, **changes)
    assert loop.verdict is not None and loop.verdict.state == "undecided"


def test_a_dead_band_over_delayed_states_ends_within_its_bound() -> None:
    """x(k+1) = 0.6 x(k) + 0.35 x(k-1) + u: what a sample is wrong by lasts, and the bound counts it."""
    loop = compose(load_experiment("multisensor-published", **{
        "plant": {"kind": "delayed-states", "A": [[0.6]], "delayed": [[[0.35]]], "B": [[1.0]], "weight": [[1.0]],
                  "initial_state": [3.0]},
        "controller": {"kind": "local", "gain": [[-0.01]]}, "network.media": {}, "limits": {}, "duration": 30,
        "network.nodes": {"all": {"outputs": ["x1"], "trigger": {"kind": "dead-band", "threshold": 0.5}}},
    }))  # fmt: skip
    assert loop.verdict is not None and loop.verdict.kind == "practical stability" and loop.verdict.certified
    bound = loop.verdict.details["ends_within"]["x1"]  # type: ignore[index]
    assert bound >= 0.99 * 0.01 * 0.5 / (1.0 - 0.59 - 0.35)  # a sample that is wrong by 0.5 for ever, in the rest of the loop
    end = np.abs(simulate(loop, 0).arrays["/plant/state"]["x1"][300:]).max()
    assert end <= bound
