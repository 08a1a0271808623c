"""Loops whose nodes take turns, have clocks, share a bus, or whose ages are recorded: each verdict beside a reference.

Where nothing is drawn the reference is the rig itself, run; where chance plays, second moments without any age (see
`random_scheduled_loops`). A loop whose reference is within 2 % of the edge decides nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from design.controllers import Local, RowsLaw
from design.jump_linear import MJLS
from design.jump_linear.certificate import observed_part
from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.plugins.checks import check_statements
from hil.rig.loop_chains import settled
from hil.runtime.virtual import simulate
from tests.hil.compose.random_scheduled_loops import FAMILIES, clocked, composed, constant, experiment, grown, smith, table

NEAR = 0.02


def judged(family: str, seeds: range) -> tuple[dict[str, int], list[float]]:
    found, off = {"certified": 0, "refused": 0, "undecided": 0}, []
    for seed in seeds:
        changes, reference = FAMILIES[family](np.random.default_rng([list(FAMILIES).index(family), seed]))
        loop = composed(changes)
        verdict, growth = loop.verdict, reference(loop)
        assert verdict is not None and verdict.number is not None
        found[verdict.state] += 1
        off.append(abs(growth - verdict.number) / verdict.number)
        if abs(growth - 1.0) > NEAR:
            assert verdict.state == ("certified" if growth < 1.0 else "refused"), (family, seed, verdict.number, growth)
    return found, off


@pytest.mark.parametrize(
    ("seeds", "least"), [(range(1, 7), 1), pytest.param(range(63), 10, marks=pytest.mark.slow)], ids=["few", "500 in all"]
)
@pytest.mark.parametrize("family", FAMILIES)
def test_every_loop_is_decided_as_its_reference_says(family: str, seeds: range, least: int) -> None:
    found, off = judged(family, seeds)
    assert not found["undecided"] and min(found["certified"], found["refused"]) >= least
    assert np.median(off) < 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_a_late_sample_delays_no_other(seed: int) -> None:
    """Sample i is due at 3 i + J_i: the J add up to nothing."""
    changes, reference = FAMILIES["clocks that draw"](np.random.default_rng(seed))
    for node in changes["network.nodes"].values():
        node["clock"] = {"every": 3, "jitter": 2}
    loop = composed(changes)
    assert loop.verdict is not None and loop.verdict.number == pytest.approx(reference(loop), rel=1e-4)


def test_two_recordings_keep_their_phase() -> None:
    """Of the pairs of entries only those count that come about: shifted by one the second recording makes another loop."""
    plant = {"kind": "state-space", "A": [[1.0]], "B": [[1.0]], "C": [[1.0]], "initial_state": [1.0]}

    def number(ages: list[int]) -> float:
        made = experiment(np.random.default_rng(0), plant, controller={"kind": "local", "gain": [[-9.0]]})
        made["network.sc"] = {"max_age": 1, "law": {"kind": "trace", "ages": [0, 1]}}
        made["network.ca"] = {"max_age": 1, "law": {"kind": "trace", "ages": ages}}
        del made["network.nodes"]
        loop = composed(made)
        assert loop.verdict is not None and loop.verdict.number is not None
        assert loop.verdict.details["modes"] == 2
        return loop.verdict.number

    assert number([0, 1]) > 1.1 * number([1, 0]) or number([1, 0]) > 1.1 * number([0, 1])


ONE = {"outputs": ["y1"]}
LOSSY = {"kind": "packet", "latency": "60 ms", "loss": 0.1}
SHORT = {"kind": "trace", "ages": [0, 1, 0], "past_end": "refuse"}


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"network.nodes.n0": ONE | {"trigger": {"kind": "error", "threshold": 0.1}}}, "lets a node keep silent"),
        (
            {"network.nodes.n0": ONE | {"trigger": {"kind": "relative", "threshold": 0.1}},
             "network.media": {"bus": {"kind": "random", "nodes": ["n0"], "loss": 0.1}}},
            "network: network.media.bus.loss loses what a node sent last: network.nodes.n0.trigger (relative) lets",
        ),
        (
            {"network.nodes.n0": ONE | {"trigger": {"kind": "dead-band", "threshold": 0.1}},
             "controller": {"kind": "send-all", "selection": "constant", "gains": [[[[-0.5]]], [[[-0.4]]], [[[-0.4]]]]}},
            "[controller] has gains that know how old a sample is: network.nodes.n0.trigger (dead-band) lets",
        ),
        (
            {"network.nodes.n0": ONE | {"trigger": {"kind": "dead-band", "threshold": 0.1}},
             "controller": {"kind": "smith", "gain": [[-0.5]]}},
            "[controller] is judged over nodes that send in every slot: network.nodes.n0.trigger (dead-band) lets",
        ),
        (
            {"network.nodes.n0": ONE | {"trigger": {"kind": "relative", "threshold": 0.1}, "law": LOSSY}},
            "under a packet law whose ages change it is not known when what a silent node sent last has come",
        ),
        (
            {"network.nodes.n0": ONE | {"clock": {"every": 2}, "law": LOSSY | {"reordering": False, "duplication": 0.1}}},
            "network.nodes.n0.law: states no chain: packets wait for the copies of those before them",
        ),
        ({"network.nodes.n0": ONE | {"clock": {"every": 1031, "phase": 5}}, "duration": "0.5 s"}, "more than 1024 states"),
        ({"network.nodes.n0": ONE | {"law": SHORT}, "duration": "0.2 s"}, "the recording ends after 3 slots"),
    ],
)
def test_what_is_not_known_says_why(change: dict[str, Any], why: str) -> None:
    plant = {"kind": "state-space", "A": [[-1.0]], "B": [[1.0]], "C": [[1.0]]}
    made = experiment(np.random.default_rng(0), plant, controller={"kind": "local", "gain": [[-0.5]]}, **{"network.nodes": {}})
    loop = composed(made | change)
    assert loop.verdict is not None and loop.verdict.state == "undecided" and why in loop.verdict.reason


def test_a_node_that_never_gets_the_bus_is_named() -> None:
    """Its sample is held for ever, so that the radius is 1, whatever the gains are."""
    plant = {"kind": "state-space", "A": [[-1.0, 0.0], [0.0, -2.0]], "B": [[1.0], [1.0]], "C": [[1.0, 0.0], [0.0, 1.0]]}
    made = experiment(np.random.default_rng(0), plant, controller={"kind": "local", "gain": [[-0.5, -0.1]]})
    bus = {"kind": "can-arbitration", "nodes": ["n0", "n1"]}
    verdict = composed(made | {"network.media": {"bus": bus}}).verdict
    assert verdict is not None and verdict.state == "undecided"
    assert "no sample of network.nodes.n1 ever comes to the controller" in verdict.reason
    unstable = plant | {"A": [[1.0, 0.0], [0.0, -2.0]], "B": [[0.0], [1.0]]}  # no input reaches it, whatever is held
    verdict = composed(made | {"plant": unstable, "network.media": {"bus": bus}}).verdict
    assert verdict is not None and verdict.state == "refused" and verdict.number is not None and verdict.number > 1.05


def test_a_loop_whose_commands_never_come_is_not_refused() -> None:
    plant = {"kind": "state-space", "A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "initial_state": [1.0]}
    made = experiment(np.random.default_rng(0), plant)
    made["controller"] = {"kind": "output-feedback", "A": [[1.2]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]]}
    made["network.ca"] = {"max_age": 1, "law": {"kind": "packet", "latency": "90 ms", "discard_older": 0}}
    loop = composed(made)
    assert loop.verdict is not None and loop.verdict.state == "undecided", loop.verdict
    assert "no command ever comes to the actuator" in loop.verdict.reason
    assert abs(simulate(loop, 0, ["/plant/state"]).arrays["/plant/state"]["x1"][-1]) < 1e-3


@pytest.mark.parametrize("by_nodes", [False, True])
def test_a_loop_that_waits_for_a_node_for_ever_is_not_refused(by_nodes: bool) -> None:
    """The controller answers zeros until a packet of every node has come, which never happens: its gains do not act."""
    plant = {"kind": "state-space", "A": [[-1.0, 0.0], [0.0, -2.0]], "B": [[1.0], [1.0]], "C": [[1.0, 0.0], [0.0, 1.0]]}
    controller: dict[str, Any] = {"kind": "local", "gain": [[50.0, 0.0]]}
    if by_nodes:
        controller = {"kind": "send-all", "selection": "constant", "ages": [1, 1], "gains": [[[[50.0, 0.0]]]]}
    made = experiment(np.random.default_rng(0), plant | {"initial_state": [1.0, 1.0]}, controller=controller)
    made["network.nodes"]["n1"]["law"] = {"kind": "packet", "latency": "90 ms", "discard_older": 0}
    loop = composed(made)
    assert loop.verdict is not None and loop.verdict.state == "undecided", loop.verdict
    assert "no sample of network.nodes.n1 ever comes to the controller: none is in time under its law" in loop.verdict.reason
    assert np.abs(simulate(loop, 0, ["/plant/state"]).arrays["/plant/state"]["x1"][-1]) < 1e-3


def test_a_loop_whose_proof_overflows_says_for_which_node_it_waits() -> None:
    plant = {"kind": "state-space", "A": [[-1.0]], "B": [[1.0]], "C": [[1.0], [1.0]], "initial_state": [1.0]}
    made = experiment(np.random.default_rng(0), plant, controller=Local(gain=((1e160, 0.0),)))  # a file may not state it
    made["network.nodes"]["n1"]["law"] = {"kind": "packet", "latency": "90 ms", "discard_older": 0}
    verdict = composed(made).verdict
    assert verdict is not None and verdict.state == "undecided" and "cannot be computed in double precision" in verdict.reason
    assert "no sample of network.nodes.n1 ever comes to the controller" in verdict.reason


@pytest.mark.parametrize(
    ("name", "age", "same", "state"),
    [
        ("vtol-fault-published", 1, '{ kind = "packet", latency = "1.4 ms" }', "refused"),
        ("omni-push", 2, '{ kind = "packet", latency = "90 ms" }', "certified"),
        ("omni-push", 2, '{ kind = "trace", ages = [2, 2] }', "certified"),
    ],
)
def test_theories_of_ages_take_packets_and_recordings_of_constant_ages(name: str, age: int, same: str, state: str) -> None:
    laws = (f'{{ kind = "constant", age = {age} }}', same)
    made = [f"network.sc={{max_age = 2, law = {law}}}" for law in laws]
    one, other = (compose(load_experiment(name, [each, "allow_uncertified=true"])).verdict for each in made)
    assert one is not None and other is not None and one.state == state
    assert (one.state, one.reason) == (other.state, other.reason)
    assert one.number == pytest.approx(other.number, rel=1e-6)


def test_two_recordings_leave_a_theory_undecided_that_knows_no_phases() -> None:
    laws = (f'network.{way}.law={{ kind = "trace", ages = {ages} }}' for way, ages in (("sc", [1, 2, 3, 1]), ("ca", [1, 2, 1])))
    verdict = compose(load_experiment("omni-wifi", [*laws, "allow_uncertified=true"])).verdict
    assert verdict is not None and verdict.state == "undecided" and "which phases meet" in verdict.reason


def test_packets_of_a_constant_latency_are_a_constant_age_under_a_clock() -> None:
    made, _ = clocked(np.random.default_rng(7))
    for node in made["network.nodes"].values():
        node["law"] = constant(1)
    numbers = []
    for law in (constant(1), {"kind": "packet", "latency": "160 ms"}):
        for node in made["network.nodes"].values():
            node["law"] = law
        verdict = composed(made | {"timing": {"deadline": 0.8}}).verdict
        assert verdict is not None and verdict.number is not None
        numbers.append(verdict.number)
    assert numbers[0] == pytest.approx(numbers[1], rel=1e-12)


def test_an_offset_that_nothing_sees_is_left_out_and_one_that_grows_is_not() -> None:
    A = np.array([[0.5, 0.0], [0.3, 1.0]])
    for own, left in ((1.0, 1), (1.001, 0)):
        A[1, 1] = own
        system = MJLS(A=A, B=np.ones((2, 1)), C=np.zeros((1, 2)), transition=[[1.0]])
        part, count = observed_part(system, np.eye(1, 2))
        assert count == left and part.order == 2 - left
    assert part.radius() == pytest.approx(1.001**2)


@pytest.mark.parametrize("unit", [1.0, 1e8])
def test_what_acts_back_is_seen_in_any_unit(unit: float) -> None:
    """The sum of an output in units of 1e-8 of the state, in a loop that it makes unstable."""
    A = np.array([[0.46, -0.68 / unit], [unit, 1.0]])
    system = MJLS(A=A, B=np.ones((2, 1)), C=np.array([[-10.0, -14.0 / unit]]), transition=[[1.0]])
    part, count = observed_part(system, np.eye(1, 2))
    assert count == 0 and part.radius() == pytest.approx(0.46 + 0.68)


def test_the_predictor_answers_as_its_matrices_say_and_another_is_not_certified() -> None:
    changes, _ = smith(np.random.default_rng(3))
    loop = composed(changes | {"controller": {"kind": "smith", "gain": [[-0.02]]}})
    assert loop.verdict is not None and any("the controller answers as it says" in said for said in loop.verdict.assumptions)

    class Other:
        selection = "applied"

        def start(self, model: Any) -> Any:
            return loop.controller.start(model)

        def laws_of_ages(self, model: Any, ages: int) -> tuple[RowsLaw, ...]:
            reported = loop.controller.laws_of_ages(model, ages)  # type: ignore[attr-defined]
            return tuple(RowsLaw(A=law.A, B=law.B, C=1.01 * law.C, D=law.D) for law in reported)

    own = {name: value for name, value in changes.items() if name != "controller"}
    verdict = compose(load_experiment("dc-motor-h2", controller=Other(), **own)).verdict
    assert verdict is not None and verdict.state == "refused" and "does not answer as it says" in verdict.reason


@pytest.mark.parametrize(("max_age", "state"), [(2, "undecided"), (3, "certified")])
def test_a_predictor_knows_ages_that_a_table_does_not(max_age: int, state: str) -> None:
    """Latencies up to three slots: with max_age 2 the chain labels ages 2 and 3 alike, and the predictor does not."""
    changes, _ = smith(np.random.default_rng(3))
    law = {"kind": "packet", "latency": {"table": [[0, 0], [1, "330 ms"]]}}
    made = changes | {"network.sc": {"max_age": max_age, "law": law}}
    made.pop("network.nodes", None)
    verdict = composed(made | {"controller": {"kind": "smith", "gain": [[5.0]]}}).verdict
    assert verdict is not None and verdict.state == state, verdict.reason


def test_a_sample_that_waited_for_the_bus_is_new() -> None:
    """Over one gain and networks without delay nothing distinguishes ages; a sample still comes a slot late, as in the rig."""
    plant = {"kind": "state-space", "A": [[0.3, 1.0], [-1.0, 0.2]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0], [0.0, 1.0]],
             "initial_state": [1.0, 0.5]}  # fmt: skip
    made = experiment(np.random.default_rng(0), plant, controller={"kind": "local", "gain": [[-1.0, -3.0]]})
    for node in made["network.nodes"].values():
        node["clock"] = {"every": 3}
    loop = composed(made | {"network.media": {"bus": {"kind": "can-arbitration", "nodes": ["n0", "n1"]}}})
    assert loop.verdict is not None and loop.verdict.number == pytest.approx(grown(loop), rel=0.01)


def test_a_cycle_forgets_how_it_began() -> None:
    changes, _ = clocked(np.random.default_rng(11))
    loop = composed(changes | {"controller": table(np.random.default_rng(0), len(changes["plant"]["C"]))})
    from hil.rig.received_ages import received_ages

    chain = received_ages(loop.rig, loop.chains.arriving, 3)
    assert not isinstance(chain, str)
    late, _ = settled(chain, chain)
    assert late.modes < chain.modes and (late.matrix.sum(axis=0) > 0.0).all()


def test_one_gain_for_an_age_that_never_changes_is_decided_over_a_clock() -> None:
    law = {"kind": "constant", "age": 0}
    node = {"outputs": ["angle"], "law": law, "clock": {"every": 2}}
    found = compose(load_experiment(
        "dc-motor-h2", controller=[[-0.05]], **{"network.sc.law": law, "network.sc.max_age": 0, "network.nodes.sensor": node}
    )).verdict  # fmt: skip
    assert found is not None and found.certified, found


def test_a_recording_behind_a_bus_with_time_is_judged_as_it_runs() -> None:
    """Sensor packets travel on the bus, commands elsewhere; they are 0 and 1 slots old in turns."""
    plant = {"kind": "state-space", "A": [[1.0]], "B": [[1.0]], "C": [[1.0]], "initial_state": [1.0]}
    made = experiment(np.random.default_rng(0), plant, controller={"kind": "local", "gain": [[-6.0]]})
    made["network.nodes"] = {"n0": ONE}
    before = {"can_id": 1, "length": 8, "data": "5a" * 8, "period": made["period"]}
    made["network.media"] = {
        "bus": {"kind": "can", "nodes": ["n0"], "bitrate": 5000, "control": False, "traffic": [before]}
    }  # fmt: skip
    made["network.sc"] = {"max_age": 2, "law": constant(0)}
    made["network.ca"] = {"max_age": 1, "law": {"kind": "trace", "ages": [0, 1]}}
    loop = composed(made)
    assert loop.verdict is not None and loop.verdict.number == pytest.approx(grown(loop), rel=1e-3)


@pytest.mark.parametrize("wrong", [list, lambda laws: laws[:-1], lambda laws: (*laws[:-1], None)], ids=["list", "few", "none"])
def test_laws_of_ages_that_are_no_tuple_of_one_each_are_reported_to_their_author(wrong: Any) -> None:
    loop = compose(load_experiment("dc-motor-smith"), certify=False)

    @dataclass(frozen=True)
    class Own:
        selection: str = "applied"

        def start(self, model: Any) -> Any:
            return loop.controller.start(model)

        def laws_of_ages(self, model: Any, ages: int) -> Any:
            return wrong(loop.controller.laws_of_ages(model, ages))  # type: ignore[attr-defined]

    with pytest.raises(AssertionError, match=r"laws_of_ages\(model, \d+\) returned .*, expected so many RowsLaw in a tuple"):
        check_statements(Own(), loop.model)
