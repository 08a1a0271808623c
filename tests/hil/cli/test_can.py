"""`hil can bridge`: what it refuses."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from hil.cli.can import can as command
from hil.errors import HilError


def test_a_bridge_to_an_interface_that_is_not_there_and_impossible_rates_are_refused() -> None:
    for rate, said in (("501k", "bitrate: 501000 bit/s: no whole part of 80000000 Hz; the nearest possible is 500000"),
                       ("500k", "vcan9: ")):  # fmt: skip
        with pytest.raises(HilError) as caught:
            CliRunner().invoke(
                command, ["bridge", "cli", "vcan9", "--bitrate", rate], catch_exceptions=False, standalone_mode=False
            )  # fmt: skip
        assert said in str(caught.value)
