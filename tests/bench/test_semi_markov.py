"""Every synthesis that is measured reaches its number with a certificate that checks out."""

from __future__ import annotations

import pytest

from tests.bench.semi_markov import BenchCase, bench_cases


@pytest.mark.slow  # the same numbers are asserted, more cheaply, in the tests of each synthesis
@pytest.mark.parametrize("case", bench_cases(), ids=lambda case: case.name)
def test_case_reaches_its_requirement_and_the_certificate_proves_it(case: BenchCase) -> None:
    reached, certificate = case.run()
    assert case.met(reached), f"{case.quantity} {reached:.4g}, required {case.sense} {case.required}"
    assert certificate.certified and certificate.sound and certificate.check() > 0
    assert not case.met(case.required * (0.9 if case.sense == ">=" else 1.1))
