"""The joint of the Phantom Omni."""

import math

import numpy as np
import pytest

from plants.omni import Omni


def test_a_torque_step_has_its_closed_form():
    """angle(t) = (t - (1 - e^(-at))/a)/b, a = b/m."""
    run = Omni().start(np.random.default_rng(0))
    a = 1.9857 / 0.7943
    for k in range(1, 101):
        run.advance(50_000_000, (1.0,))
        t = 0.05 * k
        assert run.measure()[0] == pytest.approx((t + math.expm1(-a * t) / a) / 1.9857, rel=1e-11)


@pytest.mark.parametrize(("field", "value"), [("inertia", 0.0), ("damping", -1.0), ("initial_angle_rad", math.nan)])
def test_parameters_out_of_range_are_refused_by_name(field, value):
    with pytest.raises(ValueError, match=f"^{field}: "):
        Omni(**{field: value})
