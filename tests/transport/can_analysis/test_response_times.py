"""Bounds of response times: published sets, and what jitter, errors and too much load do to them."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from tests.transport.can_analysis.sae import BOUNDS_250_MS, BOUNDS_MS, SAE
from transport.can_analysis import ErrorBursts, PeriodicMessage, bus_load, response_times
from transport.can_bus_model import BitRates
from transport.errors import FieldError

MS = 1_000_000


def message(name: str, identifier: int, period_ms: float, **rest: int) -> PeriodicMessage:
    return PeriodicMessage(name=name, identifier=identifier, length=7, period_ns=round(period_ms * MS), **rest)  # type: ignore[arg-type]


ABC = [message("A", 1, 2.5, deadline_ns=5 * MS // 2), message("B", 2, 3.5, deadline_ns=3250_000)]
ABC += [message("C", 3, 3.5, deadline_ns=3250_000)]


def test_the_second_instance_of_the_lowest_message_is_the_slowest_one() -> None:
    found = response_times(ABC, BitRates(125_000))
    assert [each.intermission_ns for each in found] == [2_000_000, 3_000_000, 3_500_000]  # the analysis of 1994: 3.0 ms
    assert [each.in_time for each in found] == [True, True, False]
    assert [each.delayed_by for each in found] == [(), ("A",), ("A", "B")]
    assert round(float(bus_load(ABC, BitRates(125_000))), 4) == 0.9714


@pytest.mark.parametrize(("rate", "bounds"), [(125_000, BOUNDS_MS), (250_000, BOUNDS_250_MS)])
def test_the_bounds_of_the_sae_set_to_the_third_decimal(rate: int, bounds: tuple[float, ...]) -> None:
    found = response_times(SAE, BitRates(rate))
    assert [each.response_ns for each in found] == [round(bound * MS) for bound in bounds]
    assert round(float(bus_load(SAE, BitRates(rate))), 4) == round(0.8574 * 125_000 / rate, 4)


def test_the_bounds_of_the_sae_set_at_the_faster_rates() -> None:
    for rate, first, seventh, last in ((500_000, 354, 1254, 2504), (1_000_000, 177, 627, 1252)):
        found = [each.response_ns for each in response_times(SAE, BitRates(rate))]
        assert (found[0], found[6], found[-1]) == (first * 1000, seventh * 1000, last * 1000)


def test_jitter_of_one_message_delays_itself_and_those_below() -> None:
    calm = response_times(SAE, BitRates(125_000))
    late = [replace(each, jitter_ns=MS) if each.name == "SAE 2" else each for each in SAE]
    shaken = response_times(late, BitRates(125_000))
    assert shaken[0].response_ns == calm[0].response_ns
    assert shaken[1].response_ns == (calm[1].response_ns or 0) + MS
    assert all((a.response_ns or 0) >= (b.response_ns or 0) for a, b in zip(shaken, calm))
    assert sum((a.response_ns or 0) > (b.response_ns or 0) for a, b in zip(shaken[2:], calm[2:])) > 3


def test_one_error_costs_31_bits_and_the_longest_frame_again() -> None:
    one = [message("A", 1, 50.0)]
    calm, hit = (response_times(one, BitRates(125_000), e)[0] for e in (None, ErrorBursts(burst=1, interval_ns=10**9)))
    bits = 31 + 125
    assert (hit.response_ns or 0) - (calm.response_ns or 0) == bits * 8000
    two = response_times(one, BitRates(125_000), ErrorBursts(burst=2, interval_ns=10**9))[0]
    assert (two.response_ns or 0) - (calm.response_ns or 0) == 2 * bits * 8000


def test_a_message_beyond_the_load_of_the_bus_has_no_bound_and_the_others_keep_theirs() -> None:
    full = [*ABC, message("D", 4, 10.0)]
    found = response_times(full, BitRates(125_000))
    assert bus_load(full, BitRates(125_000)) > 1
    assert [each.response_ns is None for each in found] == [False, False, False, True]
    assert not found[-1].in_time
    assert response_times(ABC, BitRates(125_000), ErrorBursts(interval_ns=4 * MS))[-1].response_ns is None


def test_frames_of_exactly_the_whole_bus_have_a_bound_where_nothing_else_is_in_the_way() -> None:
    whole = [message("A", 1, 2.0), message("B", 2, 2.0)]  # 1 ms each
    assert [each.intermission_ns for each in response_times(whole, BitRates(125_000))] == [2 * MS, 2 * MS]
    assert response_times([replace(each, jitter_ns=1) for each in whole], BitRates(125_000))[-1].response_ns is None


def test_bounds_that_take_too_long_to_compute_are_none() -> None:
    whole = response_times(SAE, BitRates(125_000))
    some = response_times(SAE, BitRates(125_000), terms=100)
    last = next(i for i, each in enumerate(some) if each.response_ns is None)
    assert 0 < last < len(SAE) and some[:last] == whole[:last]
    assert all(each.response_ns is None and not each.in_time for each in some[last:])


def test_can_fd_with_bit_rate_switch_counts_both_rates() -> None:
    fast = PeriodicMessage(name="fd", identifier=1, length=64, period_ns=10 * MS, fd=True, bitrate_switch=True)
    found = response_times([fast], BitRates(500_000, 2_000_000))[0]
    assert found.frame_ns == 32 * 2000 + 679 * 500


def test_two_messages_with_one_identifier_and_impossible_rates_are_refused() -> None:
    with pytest.raises(FieldError, match=r"identifier: 'A' and 'B' have 0x1, expected one each"):
        response_times([message("A", 1, 5.0), message("B", 1, 5.0)], BitRates(125_000))
    with pytest.raises(FieldError, match=r"bitrate: 501000 bit/s.* the nearest possible is 500000"):
        BitRates(501_000)
    with pytest.raises(FieldError, match=r"bitrate: 2000000 bit/s, expected 5000 to 1000000; the nearest possible is 1000000"):
        BitRates(2_000_000)
    with pytest.raises(FieldError, match=r"dbitrate: 250000 bit/s, expected 500000 to 10000000; the nearest possible is 500000"):
        BitRates(500_000, 250_000)
    assert BitRates(83_333).bit == 24_000 and BitRates(33_333).bit == 60_000
