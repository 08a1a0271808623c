"""Constant, iid, Markov, semi-Markov and recorded ages: what is refused, and that the draws follow the law.

Statistics run with fixed seeds; every limit names the probability with which a right law would miss it (1e-6).
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from transport.draws import cumulative
from transport.laws import load_files, slots_served
from transport.laws.age import ConstantAge, IidAge, MarkovAge
from transport.laws.delay_states import long_run
from transport.laws.semi_markov import SemiMarkovAge, augmented_chain, mean_sojourn, remaining_sampler
from transport.laws.sojourn import DiscreteWeibull, Geometric, SojournLaw, Table, Uniform, hazards
from transport.laws.stochastic_matrix import closed_classes, stationary_row
from transport.laws.trace import TraceAge

LAMBDA = ((0.6, 0.4, 0.0), (0.7, 0.2, 0.1), (0.8, 0.1, 0.1))
PI = ((0.5, 0.5), (0.7, 0.3))
FIVE_SIGMA = 4.9  # two-sided normal tail 1e-6


def draws(law: Any, count: int, seed: int = 1) -> np.ndarray:
    draw = law.start(np.random.default_rng(seed)).draw
    return np.array([draw() for _ in range(count)])


Case = tuple[Callable[[], object], str]
REFUSED: list[Case] = [
    (
        lambda: MarkovAge(matrix=((0.5, 0.5, 0.0), (0.5, 0.5, 0.0), (0.5, 0.48, 0.0))),
        "matrix[2]: row sums to 0.98, expected 1",
    ),
    (lambda: MarkovAge(matrix=((1.1, -0.1), (0.5, 0.5))), "matrix[0][0]: 1.1 is no probability"),
    (lambda: MarkovAge(matrix=((float("nan"), 1.0), (0.5, 0.5))), "matrix[0][0]: nan is no probability"),
    (lambda: MarkovAge(matrix=((0.5, 0.5), (1.0,))), "matrix[1]: has 1 entries, expected 2"),
    (lambda: MarkovAge(matrix=((0.5, 0.5),)), "matrix[0]: has 2 entries, expected 1"),
    (lambda: MarkovAge(matrix=()), "matrix: got ()"),
    (lambda: MarkovAge(matrix="no"), "matrix: got 'no'"),  # type: ignore[arg-type]
    (lambda: MarkovAge(matrix=((0.5, "a"), (0.5, 0.5))), "matrix[0][1]: got 'a', expected a number"),  # type: ignore[arg-type]
    (lambda: MarkovAge(matrix=((0.6, 0.3, 0.1), *LAMBDA[1:])), "matrix[0][2]: 0.1 lets the age grow from 0 to 2"),
    (lambda: MarkovAge(matrix=PI, ages=(0, 2)), "matrix[0][1]: 0.5 lets the age grow from 0 to 2"),
    (lambda: MarkovAge(matrix=PI, ages=(0,)), "ages: has 1 entries"),
    (lambda: MarkovAge(matrix=PI, ages=(0, -1)), "ages[1]: got -1"),
    (lambda: MarkovAge(matrix=((1.0, 0.0), (0.5, 0.5))), "matrix[0]: mode 0 is never left"),
    (lambda: MarkovAge(matrix=PI, initial="often"), "initial: got 'often'"),  # type: ignore[arg-type]
    (lambda: MarkovAge(matrix=PI, initial=(0.5, 0.6)), "initial: row sums to 1.1"),
    (lambda: MarkovAge(matrix=((1, 0), (0, 1)), allow_absorbing=True), "initial: the stationary law is not unique"),
    (lambda: IidAge(probabilities=(0.5, 0.3, 0.2)), "probabilities[2]: 0.2 lets the age grow from 0 to 2"),
    (lambda: IidAge(probabilities=()), "probabilities: is empty"),
    (lambda: ConstantAge(age=-1), "age: got -1"),
    (lambda: ConstantAge(age=True), "age: got True"),
    (lambda: ConstantAge(age=10**9), "age: got 1000000000"),
    (TraceAge, "ages: expected either a list of ages or a file"),
    (lambda: TraceAge(ages=(0, 2)), "ages[1]: the age grows from 0 to 2"),
    (lambda: TraceAge(ages=(3, 0, 1)), "ages[0]: the age grows from 1 (the last) to 3"),
    (lambda: TraceAge(ages=(0,), past_end="stop"), "past_end: got 'stop'"),  # type: ignore[arg-type]
    (
        lambda: SemiMarkovAge(matrix=((0.1, 0.9), (1, 0)), sojourn=(Geometric(p=1),) * 2),
        "matrix[0][0]: 0.1, mode 0 follows itself",
    ),
    (
        lambda: SemiMarkovAge(matrix=((0, 1), (0, 1)), sojourn=(Geometric(p=1),) * 2),
        "matrix[1][1]: 1, mode 1 is never left",
    ),
    (lambda: SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Geometric(p=1),)), "sojourn: has 1 laws"),
    (lambda: Geometric(p=0), "p: got 0"),
    (lambda: Geometric(p=1e-9), "p: sojourns beyond 100000 slots"),
    (lambda: DiscreteWeibull(q=1.0, beta=1), "q: got 1"),
    (lambda: DiscreteWeibull(q=0.5, beta=0), "beta: got 0"),
    (lambda: DiscreteWeibull(q=0.5, beta=0.01), "beta: sojourns beyond"),
    (lambda: Uniform(low=0, high=2), "low: got 0"),
    (lambda: Uniform(low=3, high=2), "high: got 2"),
    (lambda: Table(probabilities=(0.5, 0.4)), "probabilities: row sums to 0.9"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_a_faulty_law_is_refused_with_the_entry_named(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError) as fault:
        make()
    assert str(fault.value).startswith(message)


def test_slot_0_does_not_pay_for_what_a_law_does_once(monkeypatch: pytest.MonkeyPatch) -> None:
    path = MarkovAge(matrix=((0.5, 0.5), (0.7, 0.3))).start(np.random.default_rng(0))
    monkeypatch.setattr(MarkovAge, "initial_law", lambda law: pytest.fail("computed in slot 0"))
    assert path.draw()[0] in (0, 1)


def test_a_row_sum_within_the_tolerance_is_accepted() -> None:
    MarkovAge(matrix=((0.5 + 9e-10, 0.5), (0.7, 0.3)))
    with pytest.raises(ValueError, match=r"matrix\[0\]: row sums to 1.000000002"):
        MarkovAge(matrix=((0.5 + 2e-9, 0.5), (0.7, 0.3)))


def test_an_entry_of_rounding_that_lets_an_age_grow_is_0_for_chain_and_draws_alike() -> None:
    row, free = (0.7, 0.3 - 1e-12, 1e-12), ((0.7, 0.2, 0.1), (0.8, 0.1, 0.1))
    law = MarkovAge(matrix=(row, *free), initial=(1.0, 0.0, 0.0))
    assert law.matrix == (row[:2] + (0.0,), *free)
    assert law.transition_matrix()[0, 2] == 0.0
    assert IidAge(probabilities=row).max_age == 1

    class AlwaysLast:  # the largest number that a stream gives
        def random(self, count: int) -> np.ndarray:
            return np.full(count, np.nextafter(1.0, 0.0))

    assert [law.start(AlwaysLast()).draw()[1] for law in (law, IidAge(probabilities=row))] == [0, 1]  # type: ignore[arg-type]
    path = law.start(AlwaysLast())  # type: ignore[arg-type]
    assert [path.draw()[1] for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match=r"matrix\[0\]\[2\]: 2e-12 lets the age grow from 0 to 2"):
        MarkovAge(matrix=((0.7, 0.3, 2e-12), *free))
    assert MarkovAge(matrix=(row, *free), allow_gaps=True).matrix[0] == row


def test_gaps_are_accepted_when_asked_for() -> None:
    law = IidAge(probabilities=(0.5, 0.3, 0.2), allow_gaps=True)
    assert law.max_age == 2
    assert TraceAge(ages=(0, 5), allow_gaps=True).max_age == 5


def test_laws_come_from_experiment_tables() -> None:
    table = {
        "matrix": [[0, 1], [1, 0]],
        "sojourn": [{"law": "uniform", "low": 1, "high": 3}, {"law": "geometric", "p": 0.5}],
    }
    law = msgspec.convert(table, SemiMarkovAge)
    assert law.sojourn == (Uniform(low=1, high=3), Geometric(p=0.5))
    assert msgspec.convert({"matrix": [list(r) for r in LAMBDA]}, MarkovAge) == MarkovAge(matrix=LAMBDA)
    assert msgspec.convert({"matrix": PI, "initial": [1, 0]}, MarkovAge).initial == (1.0, 0.0)


@pytest.mark.parametrize(
    "law",
    [
        ConstantAge(age=1),
        MarkovAge(matrix=LAMBDA),
        TraceAge(ages=(0, 1)),
        SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Table(probabilities=(0.5, 0.5)), Geometric(p=0.5))),
    ],
)
def test_a_law_survives_the_way_into_another_process(law: object) -> None:
    assert pickle.loads(pickle.dumps(law)) == law


def test_one_seed_gives_one_sequence() -> None:
    law = MarkovAge(matrix=LAMBDA)
    assert (draws(law, 3000) == draws(law, 3000)).all()
    assert (draws(law, 3000) != draws(law, 3000, seed=2)).any()


def test_an_entry_of_probability_zero_is_never_drawn() -> None:
    from bisect import bisect_right

    for row in ([0.7, 0.2, 0.1, 0.0], [0.0, 1.0, 0.0], [0.1] * 10 + [0.0]):
        for u in (0.0, 0.5, 1.0 - 2.0**-53):
            assert row[bisect_right(cumulative(row), u)] > 0.0


@pytest.mark.parametrize("matrix", [LAMBDA, PI])
def test_markov_transitions_have_the_shares_of_the_matrix(matrix: tuple[tuple[float, ...], ...]) -> None:
    modes = draws(MarkovAge(matrix=matrix), 200_000)[:, 0]
    counts = np.zeros((len(matrix),) * 2)
    np.add.at(counts, (modes[:-1], modes[1:]), 1)
    totals, p = counts.sum(axis=1, keepdims=True), np.array(matrix)
    # 9 and 4 binomial counts, each beyond 4.9 sigma with probability 1e-6
    assert (np.abs(counts - totals * p) <= FIVE_SIGMA * np.sqrt(totals * p * (1 - p))).all()


def test_markov_starts_in_its_initial_law() -> None:
    def first(initial: Any) -> np.ndarray:
        law = MarkovAge(matrix=LAMBDA, initial=initial)
        return np.bincount([law.start(np.random.default_rng(s)).draw()[0] for s in range(2000)], minlength=3) / 2000

    for initial, expected in [
        ("stationary", MarkovAge(matrix=LAMBDA).stationary()),
        ("uniform", np.full(3, 1 / 3)),
        ((0.0, 0.25, 0.75), np.array([0, 0.25, 0.75])),
    ]:
        assert np.abs(first(initial) - expected).max() <= FIVE_SIGMA * 0.5 / np.sqrt(2000)


def test_modes_may_share_an_age() -> None:
    law = MarkovAge(matrix=((0.5, 0.25, 0.25), (0.5, 0.5, 0), (0.9, 0, 0.1)), ages=(0, 1, 1))
    sample = draws(law, 1000)
    assert set(map(tuple, sample.tolist())) == {(0, 0), (1, 1), (2, 1)}


def test_stationary_law_of_the_published_chain() -> None:
    assert stationary_row(LAMBDA) @ np.array(LAMBDA) == pytest.approx(stationary_row(LAMBDA), abs=1e-14)
    assert MarkovAge(matrix=PI).stationary() == pytest.approx([7 / 12, 5 / 12])
    assert long_run(MarkovAge(matrix=LAMBDA))[1] == pytest.approx([2.5, 1.25, 1 / 0.9])


def test_closed_classes_and_transient_modes() -> None:
    chain = ((0.5, 0.5, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.25, 0.25, 0.25, 0.25))
    assert closed_classes(chain) == [[1, 2]]
    assert stationary_row(chain).tolist() == pytest.approx([0, 0.5, 0.5, 0])


ROWS = st.integers(1, 5).flatmap(
    lambda n: st.lists(st.lists(st.integers(0, 4), min_size=n, max_size=n).filter(any), min_size=n, max_size=n)
)


@settings(max_examples=50, deadline=None)
@given(weights=ROWS, seed=st.integers(0, 2**32))
def test_an_accepted_markov_age_never_grows_by_more_than_one(weights: list[list[int]], seed: int) -> None:
    matrix = [[w / sum(row) for w in row] for row in weights]
    try:
        law = MarkovAge(matrix=matrix, initial="uniform", allow_absorbing=True)  # type: ignore[arg-type]
    except ValueError as fault:
        i, j = map(int, str(fault).split(":")[0].removeprefix("matrix[").removesuffix("]").split("]["))
        assert matrix[i][j] > 0 and j > i + 1
        return
    ages = draws(law, 300, seed)[:, 1]
    assert (np.diff(ages) <= 1).all()
    assert ages.max() <= law.max_age


# Sojourn laws and semi-Markov ages

SOJOURNS: list[SojournLaw] = [
    Geometric(p=0.3),
    Geometric(p=1.0),
    DiscreteWeibull(q=0.8, beta=0.6),
    DiscreteWeibull(q=0.95, beta=2.0),
    Uniform(low=2, high=5),
    Table(probabilities=(0.5, 0.0, 0.0, 0.5, 0.0)),
]


def shares(law: SojournLaw) -> np.ndarray:
    """Pr(h = n), n = 1 .. support."""
    return -np.diff(law.survival(np.arange(law.support + 1)))


@pytest.mark.parametrize("law", SOJOURNS, ids=repr)
def test_sojourn_draws_follow_their_probabilities(law: SojournLaw) -> None:
    pmf, sample = shares(law), law.sampler()
    u = np.random.default_rng(7).random(50_000)
    counts = np.bincount([sample(x) for x in u.tolist()], minlength=len(pmf) + 1)[1:]
    spread = np.sqrt(len(u) * pmf[:12] * (1 - pmf[:12]))
    assert (np.abs(counts[:12] - len(u) * pmf[:12]) <= FIVE_SIGMA * spread + 1e-6).all()
    assert pmf.sum() == pytest.approx(1.0, abs=1e-11)
    assert mean_sojourn(law) == pytest.approx(pmf @ np.arange(1, len(pmf) + 1), rel=1e-8)
    assert sample(0.0) >= 1 and sample(1.0 - 2.0**-53) >= sample(0.5)


def test_hazard_falls_rises_or_stays() -> None:
    assert (np.diff(hazards(DiscreteWeibull(q=0.8, beta=0.6), 30)) < 0).all()
    assert (np.diff(hazards(DiscreteWeibull(q=0.95, beta=2.0), 20)) > 0).all()
    assert hazards(Uniform(low=2, high=4)).tolist() == pytest.approx([0, 1 / 3, 1 / 2, 1])


def test_a_geometric_weibull_is_the_geometric_law() -> None:
    weibull, geometric = DiscreteWeibull(q=0.7, beta=1.0), Geometric(p=0.3)
    assert shares(weibull)[:50] == pytest.approx(shares(geometric)[:50])


def test_a_law_that_is_written_in_lists_is_one_written_in_tuples() -> None:
    listed = SemiMarkovAge(matrix=[[0, 1], [1, 0]], sojourn=[Geometric(p=0.5)] * 2)  # type: ignore[arg-type]
    assert len({listed, SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Geometric(p=0.5),) * 2)}) == 1


BURSTY = SemiMarkovAge(
    matrix=((0, 1, 0), (0.6, 0, 0.4), (0.5, 0.5, 0)),
    sojourn=(DiscreteWeibull(q=0.9, beta=0.7), Uniform(low=1, high=3), Table(probabilities=(0.2, 0.0, 0.8))),
)


def test_semi_markov_spends_its_stationary_shares() -> None:
    runs = np.array([np.bincount(draws(BURSTY, 2000, s)[:, 0], minlength=3) / 2000 for s in range(100)])
    error = runs.std(axis=0, ddof=1) / 10
    assert (np.abs(runs.mean(axis=0) - BURSTY.stationary()) <= 5.4 * error).all()  # t with 99 dof, 3 tails of 5e-7


def test_semi_markov_is_stationary_from_its_first_slot() -> None:
    early = np.array([draws(BURSTY, 6, s)[:, 0] for s in range(800)])
    for k in range(6):
        shares = np.bincount(early[:, k], minlength=3) / len(early)
        assert np.abs(shares - BURSTY.stationary()).max() <= FIVE_SIGMA * 0.5 / np.sqrt(len(early))


def test_augmented_chain_is_the_semi_markov_law() -> None:
    # Beyond 1000 slots (probability 2e-6) the hazard of the heavy tail is held: an error of 2e-8, exact laws have none.
    chain = augmented_chain(BURSTY)
    assert chain.matrix.sum(axis=1) == pytest.approx(1.0)
    shares = stationary_row(chain.matrix)
    assert [shares[chain.modes == i].sum() for i in range(3)] == pytest.approx(BURSTY.stationary().tolist(), abs=1e-7)


def test_geometric_sojourns_make_a_markov_chain() -> None:
    markov = np.array(LAMBDA)
    leaving = 1 - np.diag(markov)
    embedded = (markov - np.diag(np.diag(markov))) / leaving[:, None]
    law = SemiMarkovAge(matrix=embedded.tolist(), sojourn=tuple(Geometric(p=p) for p in leaving.tolist()))
    assert augmented_chain(law).matrix == pytest.approx(markov)
    assert law.stationary() == pytest.approx(MarkovAge(matrix=LAMBDA).stationary())


def test_the_remaining_sojourn_of_a_geometric_law_is_geometric() -> None:
    remaining, fresh = remaining_sampler(Geometric(p=0.2)), Geometric(p=0.2).sampler()
    u = np.linspace(0.001, 0.999, 500).tolist()
    assert [remaining(x) for x in u] == [fresh(x) for x in u]


def test_a_mode_met_at_any_slot_of_a_fixed_sojourn_has_every_rest_equally_often() -> None:
    """A law with memory: of a sojourn of four slots one, two, three or four are left, each a quarter of the time."""
    remaining = remaining_sampler(Table(probabilities=(0.0, 0.0, 0.0, 1.0)))
    assert [remaining(u) for u in (0.1, 0.3, 0.6, 0.9)] == [1, 2, 3, 4]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_semi_markov_ages_never_grow_by_more_than_one(seed: int) -> None:
    assert (np.diff(draws(BURSTY, 400, seed)[:, 1]) <= 1).all()


# Recorded ages


def test_a_trace_repeats_or_refuses() -> None:
    law = TraceAge(ages=(0, 1, 0))
    assert draws(law, 7)[:, 1].tolist() == [0, 1, 0, 0, 1, 0, 0]
    assert slots_served(law) is None
    short = TraceAge(ages=(0, 1, 0), past_end="refuse")
    assert slots_served(short) == 3
    draw = short.start(np.random.default_rng(0)).draw
    assert [age for _, age in islice(iter(draw, None), 3)] == [0, 1, 0]
    with pytest.raises(ValueError, match="ages: the trace has 3 entries"):
        draw()


def test_a_trace_comes_from_a_file_beside_the_experiment(tmp_path: Path) -> None:
    (tmp_path / "plain.csv").write_text("# recorded\n0\n1\n\n2\n0\n")
    (tmp_path / "named.csv").write_text("slot, age\n0,0\n1,1\n")
    law = load_files(TraceAge(file="plain.csv"), tmp_path)
    assert law.ages == (0, 1, 2, 0)
    assert law.file == ""
    assert load_files(TraceAge(file="named.csv"), tmp_path).ages == (0, 1)
    assert load_files(ConstantAge(age=1), tmp_path) == ConstantAge(age=1)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "has no entries"),
        (b"age\n", "has no entries"),
        (b"0\n-1\n", "entry 1 is '-1'"),
        (b"0\n2\n", r"entry \[1\]: the age grows from 0 to 2"),
        (b"\xff\xfe\x00", "is no CSV text"),
    ],
)
def test_a_faulty_trace_file_is_refused_with_the_entry(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "trace.csv").write_bytes(content)
    with pytest.raises(ValueError, match=f"^file.*{message}"):
        load_files(TraceAge(file="trace.csv"), tmp_path)


def test_a_missing_trace_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^file: .*nowhere.csv: No such file"):
        load_files(TraceAge(file="nowhere.csv"), tmp_path)


def test_trace_statistics_are_those_of_the_trace() -> None:
    law = TraceAge(ages=(0, 0, 1, 2, 0, 1))
    assert law.stationary() == pytest.approx([1 / 2, 1 / 3, 1 / 6])
    assert law.mean_bursts() == pytest.approx([1.5, 1, 1])
