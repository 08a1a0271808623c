"""A weight of a user's own: what it changes, what it may not break, and when it changes nothing."""

import numpy as np
import pytest

from design.errors import FieldError
from design.passivity.condition import is_passive_over
from design.passivity.synthesis import Weight, stiffest_coupler
from design.passivity.transparency import low_pass

SET = {"period_s": 0.001, "damping_n_s_per_m": 7.0}
RISING = Weight((1.0, -0.97), (1.0, -0.9))


def test_a_weight_lowers_what_it_weighs_and_the_coupler_stays_proved():
    plain, found = (stiffest_coupler(range(7), weight=w, **SET) for w in (None, RISING))
    assert RISING.peak(found.coupler) < 0.995 * RISING.peak(plain.coupler)
    assert found.coupler.static_compliance_m_per_n > 1.05 * plain.coupler.static_compliance_m_per_n
    assert all(is_passive_over(found.coupler, 0.001, 7.0, d) for d in range(7))


def test_no_other_safe_coupler_weighs_less():
    """The program is convex: a safe coupler near the answer, moved in any direction and made safe again, is no better."""
    found = stiffest_coupler(range(4), weight=RISING, **SET).coupler
    rng, least = np.random.default_rng(0), RISING.peak(found)
    for _ in range(10):
        taps = np.array(found.taps_m_per_n) * (1.0 + 0.05 * rng.standard_normal(24))
        for _ in range(200):
            moved = type(found)(taps_m_per_n=tuple(taps.tolist()))
            if all(is_passive_over(moved, 0.001, 7.0, d) for d in (3, 2, 1, 0)):  # the longest delay asks for most
                break
            taps[0] *= 1.01
        assert RISING.peak(moved) > 0.9998 * least


def test_a_weight_that_is_largest_at_rest_leaves_the_stiffest_coupler():
    a, g = low_pass(3.0, 0.001)
    slow = Weight((0.0, g), (1.0, -a))
    plain, found = (stiffest_coupler(range(7), weight=w, **SET) for w in (None, slow))
    assert slow.peak(found.coupler) == pytest.approx(plain.coupler.static_compliance_m_per_n, rel=1e-6)


@pytest.mark.parametrize(
    ("numerator", "denominator", "message"),
    [
        ((), (1.0,), "numerator: "),
        ((0.0,), (1.0,), "numerator: "),
        ((float("nan"),), (1.0,), "numerator: "),
        ((1.0,), (1.0, -1.0), r"denominator: \[1\.0, -1\.0\] has a pole of modulus 1,"),
        ((1.0,), (0.0, 1.0), "denominator: "),
    ],
)
def test_bad_weights_are_refused_by_name(numerator, denominator, message):
    with pytest.raises(FieldError, match=f"^{message}"):
        Weight(numerator, denominator)
