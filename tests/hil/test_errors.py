"""Which errors are messages to the user, and which are faults of a program."""

from __future__ import annotations

import pytest

from design.errors import DesignError
from hil.errors import DiskFull, ExperimentError, HilError, Terminated, exit_status, is_message, located
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
    assert (exit_status(KeyboardInterrupt()), exit_status(Terminated(15))) == (130, 143)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (FileNotFoundError(2, "No such file or directory", "b.csv"), "a.csv: No such file or directory; choose another"),
        (OSError("short read"), "a.csv: short read; choose another"),
        (HilError("line 3: no number"), "a.csv: line 3: no number; choose another"),
    ],
)
def test_a_fault_is_told_with_its_place_and_another_kind_passes(fault: Exception, message: str) -> None:
    with pytest.raises(HilError) as found, located("a.csv", OSError, HilError, advice="choose another"):
        raise fault
    assert str(found.value) == message and found.value.__cause__ is fault
    with pytest.raises(ValueError, match=r"^no number$"), located("a.csv", OSError, HilError):
        raise ValueError("no number")
