"""Gains and rows that know for how long a delay has lasted: what is counted is the chain's mode, and the certificate is of it."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from design.controllers import GainIndex, SendAll
from design.processes.delay_chain import DelayChain
from design.tracking import row_sojourns_of, with_every_row
from design.tracking.design_file import load_design
from hil.api.questions import design
from hil.compose import compose
from hil.errors import ExperimentError, HilError
from hil.experiment import load_experiment, shipped
from hil.rig.delay_chains import delay_chain
from hil.rig.loop import Loop
from hil.runtime.nodes.actuator_node import OK, ActuatorNode, row_index
from hil.runtime.nodes.safety import Safety
from hil.runtime.virtual import simulate
from hil.session.replay.replay import what_if
from hil.sweeps.batch_delivery import applied_rows
from tests.hil.runtime.nodes.test_rig import drive, kinds, statuses
from transport.laws.age import MarkovAge
from transport.laws.semi_markov import SemiMarkovAge, augmented_chain
from transport.laws.sojourn import Geometric, Table, Uniform
from transport.packets import SELECTIONS, ControlPacket, encode_control

BURSTY = SemiMarkovAge(
    matrix=((0.0, 1.0, 0.0), (0.8, 0.0, 0.2), (0.5, 0.5, 0.0)),
    sojourn=(Uniform(low=5, high=15), Table(probabilities=(0.5, 0.2, 0.3)), Table(probabilities=(0.7, 0.3))),
    initial="uniform",
)


def test_table_counts_the_slots_of_every_stay() -> None:
    table = GainIndex((3, 0, 2))
    assert [table.at(tau) for tau in (0, 0, 0, 0, 2, 2, 2, 0, 0)] == [0, 1, 2, 2, 3, 4, 4, 0, 1]
    assert [table.at(tau) for tau in (1, 1, 9, 9, 9)] == [3, 4, 3, 4, 4]  # delays without gains of their own


@pytest.mark.parametrize("sojourns", [2, 4, 40, (3, 1, 2)])
def test_count_of_the_controller_is_the_label_of_the_chain(sojourns: int | tuple[int, ...]) -> None:
    chain, augmented = delay_chain(BURSTY, sojourns), augmented_chain(BURSTY)
    assert chain is not None
    label_of = {(int(m), int(s)): int(label) for m, s, label in zip(augmented.modes, augmented.slots, chain.label, strict=True)}
    table, law, stay = GainIndex(chain.sojourns), BURSTY.start(np.random.default_rng(5)), 0
    last, seen = -1, set()
    for mode, tau in itertools.islice(iter(law.draw, None), 5000):
        stay = stay + 1 if mode == last else 1
        last = mode
        index = table.at(tau)
        assert index == label_of[mode, stay]
        seen.add(index)
    assert seen == set(chain.label.tolist())


def test_a_delay_that_never_comes_has_the_table_that_its_label_gives_it() -> None:
    later = SemiMarkovAge(matrix=BURSTY.matrix, sojourn=BURSTY.sojourn, ages=(1, 2, 3))
    by_delay, by_stay = delay_chain(later), delay_chain(later, 2)
    assert by_delay is not None and by_stay is not None
    assert by_delay.sojourns == (1, 1, 1, 1)  # labels are delays, so 0 has a table of its own that is not used
    assert by_stay.sojourns == (0, 2, 2, 2)


def test_a_stay_is_not_reported_where_the_receiver_measures_another_one() -> None:
    gap = SemiMarkovAge(matrix=BURSTY.matrix, sojourn=BURSTY.sojourn, ages=(0, 1, 3), allow_gaps=True)
    chain = delay_chain(gap)
    assert chain is not None and sorted(set(chain.delay.tolist())) == [0, 1, 2, 3]  # 2 on the way from 1 to 3
    with pytest.raises(ValueError, match="the receiver measures other stays"):
        delay_chain(gap, 2)


def test_log_shows_the_gain_of_the_slot() -> None:
    loop = compose(load_experiment("dc-motor-ours-bursty"))
    run = simulate(loop, 3)
    rows, y, r = (run.arrays[topic] for topic in ("/controller/rows", "/plant/measurement", "/reference"))
    gains, stay = np.array(loop.controller.gains)[..., 0, 0], 0
    for k in range(60, 200):
        tau = rows["tau"][k]
        stay = next(n for n in itertools.count(1) if rows["tau"][k - n] != tau)
        at = sum(loop.controller.sojourns[:tau]) + min(stay, loop.controller.sojourns[tau]) - 1
        expected = gains[at] * (y["angle"][k - tau] - r["angle"][k])
        found = [rows[name][k] for name in rows.dtype.names if name.startswith("row")]
        np.testing.assert_allclose(found, expected, rtol=2e-6, atol=1e-7)  # float32 on the wire


def test_shipped_design_is_for_the_law_that_it_runs_over() -> None:
    loop = compose(load_experiment("dc-motor-ours-bursty"))
    sc = loop.chains.sc
    document = load_design(shipped()["dc-motor-ours-bursty"].parent / "designs" / "dc-motor-bursty-h2-sojourns.json").document
    assert loop.controller.sojourns == sc.sojourns == (3, 3, 2)
    np.testing.assert_allclose(document["problem"]["sc"]["transition"], sc.matrix, atol=1e-15)
    assert document["problem"]["sc"]["labels"] == sc.label.tolist()
    assert loop.certificate is not None
    assert loop.certificate["h2_norm"] == pytest.approx(document["norms"]["h2"], rel=1e-9)
    assert json.loads(json.dumps(loop.certificate))["stable"]


@pytest.mark.parametrize(
    ("name", "sets", "message"),
    [
        ("dc-motor-ours-h2", ["controller.sojourns=3"], "controller.sojourns: only a semi-Markov law takes it"),
        ("dc-motor-ours-h2", ["controller.sojourns=0"], "sojourns: 0, expected at least 1"),
        ("dc-motor-ours-bursty", ["network.sc.law.ages=[0, 1, 1]", "network.sc.max_age=2"],
         "sojourns: several modes have one delay"),
        ("dc-motor-ours-bursty", ["network.sc.law.ages=[0, 1, 3]", "network.sc.law.allow_gaps=true"],
         "controller.sojourns: this delay may grow by more than one per slot"),
    ],
)
def test_what_no_controller_can_count_is_refused(name: str, sets: list[str], message: str) -> None:
    with pytest.raises(ExperimentError, match=message):
        compose(load_experiment(name, sets))


def test_counts_must_cover_the_tables_and_the_law() -> None:
    one = ((0.0,),)
    with pytest.raises(ValueError, match=r"sojourns: \[2, 2\], expected counts whose sum is the number of tables, 3"):
        SendAll(gains=((one,), (one,), (one,)), sojourns=(2, 2))
    model = replace(compose(load_experiment("dc-motor-ours-h2"), certify=False).model, tau_max=3)
    with pytest.raises(ValueError, match="2 tables, but tau reaches 3"):
        SendAll(gains=((one, one), (one, one))).start(model)
    with pytest.raises(ValueError, match="but the delay reaches 2"):
        delay_chain(BURSTY, (2, 2))
    with pytest.raises(ValueError, match=r"\[2, 0, 2\], but the delay reaches 2"):
        delay_chain(BURSTY, (2, 0, 2))
    later = SemiMarkovAge(matrix=BURSTY.matrix, sojourn=BURSTY.sojourn, ages=(1, 2, 3))
    assert delay_chain(later, (2, 2, 2, 2)) is not None, "a delay that never comes may have tables"
    assert delay_chain(MarkovAge(matrix=((0.5, 0.5), (0.7, 0.3))), (1, 1)) is not None


NAME, S = "dc-motor-ours-stays", 4
LAW = SemiMarkovAge(
    matrix=((0.0, 1.0, 0.0), (0.8, 0.0, 0.2), (0.5, 0.5, 0.0)),
    sojourn=(Uniform(low=2, high=5), Geometric(p=0.4), Table(probabilities=(0.7, 0.3))),
    initial=(1.0, 0.0, 0.0),
)
GEOMETRIC = "{kind='semi-markov',matrix=[[0,1],[1,0]],sojourn=[{law='uniform',low=1,high=3},{law='geometric',p=0.3}]}"


def loop_of(*sets: str) -> Loop:
    return compose(load_experiment(NAME, sets))


@pytest.fixture(scope="module")
def loop() -> Loop:
    return loop_of()


@pytest.mark.parametrize("stays", [2, 3, 4, 7])
def test_what_the_actuator_counts_is_the_label_of_the_chain(stays: int) -> None:
    chain, augmented = delay_chain(LAW, (stays,) * 3), augmented_chain(LAW, least=stays)
    assert chain is not None and row_sojourns_of(chain) == stays
    known = {(int(m), int(s)): int(label) for m, s, label in zip(augmented.modes, augmented.slots, chain.label, strict=True)}
    last = {mode: max(slots for m, slots in known if m == mode) for mode, _ in known}
    node = ActuatorNode(1, 2, Safety((), (), 10**6, 1), row_sojourns=stays)
    rows = tuple((float(row),) for row in range(3 * stays))
    draw, before, stay, measured, seen = LAW.start(np.random.default_rng(5)).draw, -1, 0, [], set()
    for k in range(4000):
        mode, d = draw()
        before, stay = mode, stay + 1 if mode == before else 1
        packet = ControlPacket(k - d, 0, 0, 0, SELECTIONS.index("applied"), rows)
        applied = node.apply(k, [(k - d, packet)])
        measured.append(d)
        expected = known[mode, min(stay, last[mode])]
        assert applied.row == expected == int(applied.u[0])
        assert row_index("applied", d, k - d, measured, 2, stays) == expected, "replay has the whole record"
        seen.add(expected)
    assert seen == set(chain.label.tolist())
    held = (np.arange(4000) - np.array(measured)).astype(np.int32)[:, None]
    assert [row_index("applied", d, k - d, measured, 2, stays) for k, d in enumerate(measured)] == (
        applied_rows("applied", held, 2, stays)[:, 0].tolist()
    ), "and so do all runs at once"


def test_a_stay_begins_anew_where_a_packet_was_missing() -> None:
    node, rows = ActuatorNode(1, 1, Safety((), (), 10**6, 1), row_sojourns=3), tuple((float(row),) for row in range(6))

    def at(k: int, g: int | None) -> int:
        packet = ControlPacket(k if g is None else g, 0, 0, 0, SELECTIONS.index("applied"), rows)
        return node.apply(k, [] if g is None else [(g, packet)]).row

    sent = [None, 0, 1, 2, None, None, 6, 7, 8, 9, 10]
    assert [at(k, g) for k, g in enumerate(sent)] == [-1, 3, 4, 5, -1, -1, 0, 1, 2, 2, 2]


def test_the_log_shows_the_row_of_the_slot(loop: Loop) -> None:
    run = simulate(loop, 3)
    applied, rows, y, r = (run.arrays[n] for n in ("/actuator/applied", "/controller/rows", "/plant/measurement", "/reference"))
    K, d, taken = np.array(loop.controller.gains)[0, :, 0, 0], applied["d"].tolist(), set()  # type: ignore[attr-defined]
    names = [name for name in rows.dtype.names or () if name.startswith("row")]
    assert len(names) == loop.rows == 2 * S
    for k in range(10, 400):
        stay = next(n for n in itertools.count(1) if d[k - n] != d[k])
        at, g = d[k] * S + min(stay, S) - 1, k - d[k]
        assert applied["row"][k] == at
        assert applied["voltage"][k] == rows[names[at]][g]
        assert applied["voltage"][k] == pytest.approx(K[at] * (y["angle"][g] - r["angle"][g]), rel=2e-6, abs=1e-7)
        taken.add(at)
    assert taken == {0, 1, 2, 3, 4, 5}, "d = 1 lasts two slots at most"


def test_rows_of_stays_that_never_come_repeat_the_last(loop: Loop) -> None:
    K = np.array(loop.controller.gains)  # type: ignore[attr-defined]
    assert (K[:, 6:] == K[:, 5:6]).all() and len(np.unique(K[:, :6])) == 6


def test_rows_of_a_design_stand_where_the_actuator_looks() -> None:
    chain = DelayChain(transition=[[0, 1, 0], [0, 0, 1], [1, 0, 0]], delays=[0, 1, 1], labels=[0, 3, 4])
    K = np.arange(5.0).reshape(1, 5, 1, 1)
    assert row_sojourns_of(chain) == 3
    assert with_every_row(K, chain, 3).ravel().tolist() == [0, 0, 0, 3, 4, 4]
    with pytest.raises(ValueError, match=r"row_sojourns: 2, but the chain of network\.ca distinguishes 3"):
        with_every_row(K, chain, 2)
    with pytest.raises(ValueError, match="labels"):
        row_sojourns_of(DelayChain(transition=[[0, 1, 0], [0, 0, 1], [1, 0, 0]], delays=[0, 1, 1], labels=[0, 1, 2]))


def test_the_certificate_is_of_the_rows_that_run(loop: Loop) -> None:
    """Second moments of own matrices: x(k+1) = A x + B K[row of (d, stay)] y(k - d), over (d, stay) as the law says it."""
    model, K = loop.model, np.array(loop.controller.gains)[0, :, 0, 0]  # type: ignore[attr-defined]
    modes = [(0, 1), (0, 2), (0, 3), (0, 4), (1, 1), (1, 2)]
    follows = {0: {1: 1.0}, 1: {2: 1.0}, 2: {3: 0.5, 4: 0.5}, 3: {4: 1.0}, 4: {0: 0.5, 5: 0.5}, 5: {0: 1.0}}
    n = 3  # x, y(k - 1)
    moments = np.zeros((6 * n * n, 6 * n * n))
    for i, (d, stay) in enumerate(modes):
        F = np.zeros((n, n))
        F[:2, :2], F[2, :2] = model.A, model.C[0]
        F[:2] += K[d * S + stay - 1] * np.outer(model.B[:, 0], np.array([0.0, 0.0, 1.0]) if d else [*model.C[0], 0.0])
        for j, chance in follows[i].items():
            moments[j * 9 : (j + 1) * 9, i * 9 : (i + 1) * 9] = chance * np.kron(F, F)
    assert loop.verdict is not None and loop.verdict.state == "certified"
    assert loop.verdict.number == pytest.approx(np.abs(np.linalg.eigvals(moments)).max(), rel=1e-6)


@pytest.mark.parametrize(("gain", "state"), [(-0.05, "certified"), (3.0, "refused")])
@pytest.mark.parametrize("side", ["sc", "ca"])
def test_gains_of_stays_that_no_hazard_distinguishes_are_in_the_certificate(side: str, gain: float, state: str) -> None:
    """A geometric stay is one mode of its chain; gains that change within it were certified by those of its first slot."""
    if side == "sc":
        gains = [[[[-0.05]], [[-0.05]]]] * 4 + [[[[gain]], [[gain]]]]
        more = f"gains={gains},sojourns=[3,2]"
    else:
        row = [[[-0.05]]] * 5 + [[[gain]]]
        more = f"gains={[row] * 3},row_sojourns=3"
    sets = [f"network.{side}.law={GEOMETRIC}", f"controller={{kind='send-all',{more}}}", "allow_uncertified=true"]
    verdict = compose(load_experiment("dc-motor-hinf", sets)).verdict
    assert verdict is not None and verdict.state == state


def test_replay_with_the_same_controller_is_what_was(loop: Loop) -> None:
    series = what_if(simulate(loop, 5), loop.controller, "send-all", experiment=loop.experiment)
    there = np.isfinite(series["send-all_voltage"])
    assert there.sum() > 900
    np.testing.assert_array_equal(series["send-all_voltage"][there], series["recorded_voltage"][there])


def test_a_design_file_has_the_rows_of_its_chain(loop: Loop, tmp_path: Path) -> None:
    found = design(NAME, row_sojourns=S, starts=1)
    assert found.gains.shape == (1, 6, 1, 1) and found.certificate.h2_norm == pytest.approx(1.16362, rel=1e-4)
    path = found.save(tmp_path / "mine.json")
    given = f"controller={{kind='designed',file='{path}'}}"
    named = loop_of(given)
    assert isinstance(named.controller, SendAll) and named.controller.row_sojourns == S and named.rows == 2 * S
    assert named.gains is not None and named.gains.origin == "stored"
    assert named.certificate is not None and named.certificate["h2_norm"] == pytest.approx(found.certificate.h2_norm, rel=1e-6)
    other = loop_of(given, "plant.gain=160.0")
    assert other.gains is not None and "B of the plant differs" in other.gains.note and other.rows == 2 * S
    assert other.verdict is not None and other.verdict.certified


CASES = [
    (["controller.row_sojourns=0"], "row_sojourns: 0, expected at least 1"),
    (["controller.information='generated'"], "row_sojourns: 4, but information is 'generated'; it needs 'applied'"),
    (["network.ca.law={kind='markov',matrix=[[0.5,0.5],[0.7,0.3]]}"], "row_sojourns: only a semi-Markov law takes it"),
    (["network.ca.law.ages=[0,0]"], "row_sojourns: several modes have one delay"),
    (["network.ca.law.ages=[0,2]", "network.ca.law.allow_gaps=true"], "row_sojourns: this delay may grow by more than one"),
    (["controller={kind='send-all',gains=[[[[-0.05]],[[-0.05]]]],row_sojourns=2}"], r"\[tau\]\[4\]\[1\]\[1\].* 2 row_sojourns"),
    (["controller={kind='send-all',gains=[[[[-0.05]]]],selection='constant',row_sojourns=2}"], "row_sojourns: 2, but selection"),
    (["controller.row_sojourns=200"], "controller.row_sojourns: 200 needs 400 rows, a packet carries 255"),
    (["controller.row_sojourns=1000000000"], "controller.row_sojourns: 1000000000 needs 2000000000 rows"),
]  # fmt: skip


@pytest.mark.parametrize(("sets", "message"), CASES)
def test_what_cannot_be_counted_is_refused_by_its_field(sets: list[str], message: str) -> None:
    with pytest.raises(ExperimentError, match=message):
        compose(load_experiment(NAME, sets))


def test_a_design_with_more_rows_than_a_packet_has_is_refused_before_its_chain_is_built() -> None:
    with pytest.raises(HilError, match="row_sojourns: 1000000000 needs 2000000000 rows, a packet carries 255"):
        design(NAME, row_sojourns=1_000_000_000)


@pytest.mark.parametrize("information", ["tau", "generated", "both"])
def test_a_design_by_another_rule_is_refused(information: str) -> None:
    with pytest.raises(HilError, match=f"row_sojourns: 2, but information is '{information}'"):
        design(NAME, row_sojourns=2, information=information)


@pytest.mark.parametrize(("rows", "refused"), [(2, True), (8, False), (6, True)])
def test_an_answer_has_a_row_for_every_d_and_stay(loop: Loop, rows: int, refused: bool) -> None:
    applied = SELECTIONS.index("applied")
    sink = drive(loop, lambda k: encode_control(ControlPacket(k, 0, 0, 0, applied, ((0.1,),) * rows)), 3)
    taken = statuses(loop, sink)
    assert (OK in taken) is not refused and ("control refused" in kinds(sink)) is refused
