"""Gates of the tests around a real vcan0; the mark `vcan` itself is gated by tests/conftest.py."""

from __future__ import annotations

import os

import pytest


@pytest.fixture
def boots_kernels(request: pytest.FixtureRequest) -> None:
    """For tests that start ``hil vcan`` themselves: only on demand, as the first start may build a kernel."""
    if "vcan" not in request.config.getoption("--hil-require"):
        pytest.skip("boots kernels; `make test-vcan` runs it (--hil-require=vcan)")


@pytest.fixture
def virtual_time() -> None:
    """For tests that assert exact times."""
    if "VCAN_VIRTUAL_TIME" not in os.environ:
        pytest.skip("needs virtual time: hil vcan --virtual-time, as `make test-vcan` does")
