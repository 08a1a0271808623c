"""Which errors are messages to the user, and which are faults of a program."""

from __future__ import annotations

import pytest

from design.errors import DesignError
from hil.errors import DiskFull, ExperimentError, HilError, is_message
from plants.errors import PlantError
from transport import TransportError


@pytest.mark.parametrize(
    ("error", "message"),
    [(HilError, True), (ExperimentError, True), (DiskFull, True), (DesignError, True), (PlantError, True), (TransportError, True),
     (ValueError, False), (KeyError, False), (KeyboardInterrupt, False)],
)  # fmt: skip
def test_an_error_of_our_packages_is_a_message_and_any_other_a_fault(error: type[BaseException], message: bool) -> None:
    assert is_message(error) is message


def test_what_the_user_mends_ends_with_2_and_a_full_disk_with_1() -> None:
    assert (HilError.status, ExperimentError.status, DiskFull.status) == (2, 2, 1)
