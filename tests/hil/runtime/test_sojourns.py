"""Gains that know for how long the measured delay has lasted: the controller's count is the chain's mode."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from msgspec.structs import replace

from design.controllers import GainIndex, SendAll
from design.tracking.design_file import load_design
from hil.compose.loop import compose
from hil.errors import ExperimentError
from hil.experiment import load_experiment, shipped
from hil.rig.delay_chains import delay_chain
from hil.runtime.virtual import simulate
from transport.laws.age import MarkovAge
from transport.laws.semi_markov import SemiMarkovAge, augmented_chain
from transport.laws.sojourn import Table, Uniform

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
def test_what_cannot_be_counted_is_refused(name: str, sets: list[str], message: str) -> None:
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
    assert delay_chain(MarkovAge(matrix=((0.5, 0.5), (0.7, 0.3))), (1, 1)) is not None
