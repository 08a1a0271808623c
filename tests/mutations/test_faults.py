"""The table of faults fits the code; that each is killed is shown by `make mutations`."""

from __future__ import annotations

import pytest

from tests.mutations.faults import ROOT, Fault, faults


@pytest.mark.parametrize("fault", faults(), ids=lambda fault: fault.name)
def test_the_fault_can_be_put_in_and_its_tests_are_there(fault: Fault) -> None:
    text = (ROOT / fault.file).read_text()
    faulty = fault.put_into(text)
    assert faulty != text
    if fault.file.endswith(".py"):
        compile(faulty, fault.file, "exec")
    for test in fault.tests:
        path, _, name = test.partition("::")
        assert (ROOT / path).exists() and name.partition("[")[0] in (ROOT / path).read_text()


def test_every_fault_has_a_name_of_its_own() -> None:
    names = [fault.name for fault in faults()]
    assert len(set(names)) == len(names)
