"""`hil.assert_probability` and `hil.assert_law`: what they decide, what they print, and how often they err."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

import hil
from design.monte_carlo.confidence import SequentialTest
from hil.compose import compose
from hil.measure.network_paths import network_metrics
from hil.session import simulated_session
from transport import MarkovAge
from transport.law_tests import law_p_value


def test_a_condition_that_always_holds_passes_in_the_fewest_runs() -> None:
    reported = hil.assert_probability("dc-motor-hinf", lambda s: s.status == 0, at_least=0.5, margin=0.4, alpha=1e-2, duration=2)
    assert reported == (
        "dc-motor-hinf: required 0.5, observed 8 of 8 runs; "
        "a true probability of 0.5 or less would give this with probability at most 0.01"
    )


def test_it_gives_the_seeds_that_failed_and_stops_at_once() -> None:
    seen = []

    def odd(session: hil.Session) -> bool:
        seen.append(session.summary["seed"])
        return bool(seen[-1] % 2)

    with pytest.raises(AssertionError, match=r"required 0\.9, observed \d+ of \d+ runs; .*failed seeds: 8, 10, 12") as caught:
        hil.assert_probability("dc-motor-hinf", odd, at_least=0.9, duration=1, first_seed=7)
    assert str(caught.value).endswith("; to see one: hil run dc-motor-hinf --seed 8 --set duration=1")
    assert seen == list(range(7, 7 + len(seen))) and len(seen) < 40


def test_too_few_runs_are_undecided_and_fail() -> None:
    first = iter([False])
    with pytest.raises(AssertionError, match=r"too few to tell 0\.5 from 0\.9"):
        hil.assert_probability(
            "dc-motor-hinf", lambda s: next(first, True), at_least=0.5, margin=0.4, alpha=1e-2, most_runs=8, duration=1
        )


@pytest.mark.parametrize(("at_least", "runs"), [(0.9, 128), (0.999, 13_806)])
def test_runs_that_cannot_suffice_are_refused_before_any_is_made(at_least: float, runs: int) -> None:
    """At 0.999 the default of 10,000 runs failed also where it always holds, beside "fails with probability at most beta"."""
    most = min(runs - 1, 10_000)
    with pytest.raises(hil.HilError, match=f"most_runs: {most}; to tell {at_least:g} from .* takes {runs} runs at least"):
        hil.assert_probability("dc-motor-hinf", lambda s: pytest.fail("ran"), at_least=at_least, most_runs=most)
    test = SequentialTest(p0=at_least, p1=0.5 * (1.0 + at_least), alpha=1e-3, beta=1e-3)
    assert test.decide(runs, runs) == "at least p1" and test.decide(runs - 1, runs - 1) is None


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"at_least": 1.0}, "at_least: 1;"),
        ({"at_least": 0.9, "margin": 0.2}, "margin: 0.2;"),
        ({"at_least": 0.9, "margin": 0.0}, "margin: 0;"),
        ({"at_least": 0.5, "alpha": 2.0}, "alpha: 2;"),
    ],
)
def test_numbers_that_mean_nothing_are_reported_by_the_users_own_name(wrong: dict[str, float], field: str) -> None:
    with pytest.raises(hil.HilError, match=f"^assert_probability: {field} expected"):
        hil.assert_probability("dc-motor-hinf", lambda s: True, **wrong)


def test_a_condition_without_an_answer_is_no_failed_run() -> None:
    with pytest.raises(hil.HilError, match=r"^assert_probability: holds: returned None of seed 0; expected True or False$"):
        hil.assert_probability("dc-motor-hinf", lambda s: None, at_least=0.9, duration=1)


def test_a_session_of_it_has_the_numbers_of_a_run_with_a_log() -> None:
    loop = compose(hil.load_experiment("dc-motor-hinf", duration=3))
    light, logged = simulated_session(loop, 4), hil.run("dc-motor-hinf", seed=4, duration=3)
    of_a_link = {"accepted_from", "link_counters", "controller_counters"}  # there is none
    for key in set(logged.summary) - {"wall_s", "log"} - of_a_link:
        assert light.summary[key] == logged.summary[key], key
    assert light.status == logged.status and repr(light) == repr(logged)
    stopped = {"limits.state.angle": 1.0}
    assert simulated_session(compose(hil.load_experiment("dc-motor-hinf", duration=3, **stopped)), 4).status == 3


@pytest.mark.slow
def test_the_assertion_on_a_law_errs_as_rarely_as_it_says() -> None:
    """100 seeds at alpha 5 %: the number of wrong failures lies in the binomial's range that is left with 1 in 10^6."""
    loop = compose(hil.load_experiment("dc-motor-hinf", duration=5))
    failed = 0
    for seed in range(100):
        session = simulated_session(loop, seed)
        try:
            hil.assert_law(session, "sc", alpha=0.05)
        except AssertionError:
            failed += 1
    assert binom.ppf(5e-7, 100, 0.05) <= failed <= binom.isf(5e-7, 100, 0.05)


@pytest.mark.parametrize(("off", "slots", "least"), [(0.2, 1000, 0.9), (0.1, 5000, 0.9), (0.2, 200, 0.0), (0.1, 1000, 0.0)])
def test_the_assertion_on_a_law_has_the_power_that_it_states(off: float, slots: int, least: float) -> None:
    """At 1e-6, 30 chains of which one probability is off: the binomial's 1e-6 quantiles of 0.9 below, or of 0.3 above."""
    rows = ((0.5, 0.5, 0.0), (0.6, 0.3, 0.1), (0.3, 0.6, 0.1))
    other = np.cumsum(((0.5 - off, 0.5 + off, 0.0), *rows[1:]), axis=1)
    rng, seen = np.random.default_rng(0), 0
    for _ in range(30):
        modes = [0]
        for chance in rng.random(slots - 1).tolist():
            modes.append(int((chance >= other[modes[-1], :2]).sum()))
        seen += law_p_value(MarkovAge(matrix=rows), np.array(modes)) < 1e-6
    assert seen >= binom.ppf(1e-6, 30, least) if least else seen <= binom.isf(1e-6, 30, 0.3)


def test_the_assertion_on_a_law_finds_another_law() -> None:
    session = hil.run("dc-motor-hinf", seed=1)
    draws = session.arrays["/network/sc"]
    other = MarkovAge(matrix=((0.4, 0.6, 0.0), (0.6, 0.2, 0.2), (0.8, 0.1, 0.1)))
    network = session.summary["network"] | {"sc": network_metrics(draws, other, "markov")}
    wrong = hil.Session(log=session.run, summary=session.summary | {"network": network}, status=0)
    with pytest.raises(AssertionError, match=r"sc: not the law 'markov': p = .* < 1e-06; modes \["):
        hil.assert_law(wrong, "sc")
    assert hil.assert_law(session, "sc") == session.summary["network"]["sc"]["p_value"]


def test_a_side_that_is_none_and_a_run_too_short_for_a_test_are_reported() -> None:
    short, session = (hil.run("dc-motor-hinf", duration=duration) for duration in (0.5, 5))
    with pytest.raises(hil.HilError, match="side 'cs'; expected one of 'sc', 'ca', 'sensor'"):
        hil.assert_law(session, "cs")
    for alpha in (float("nan"), 0.0, 2.0):  # below which no p-value is, or every one
        with pytest.raises(hil.HilError, match=r"assert_law: alpha: .*; expected a number between 0 and 1"):
            hil.assert_law(session, "sc", alpha=alpha)
    with pytest.raises(hil.HilError, match="sc: the law 'markov' has no test, was changed, or the run is too short for it"):
        hil.assert_law(short, "sc")
    assert np.isfinite(hil.assert_law(session, "ca", alpha=1e-9))
