"""`hil doctor` has a remedy only for what is wrong."""

from __future__ import annotations

import errno
import os
from typing import Any, NoReturn

import pytest

from hil.bench import links
from hil.cli import doctor


@pytest.mark.parametrize(("free", "said"), [(240.0, "auto takes one CPU"), (90.0, 'timing.affinity = "free" may be faster here')])
def test_one_comparison_of_round_trips_is_no_fault(free: float, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def measured(*args: Any, **options: Any) -> list[dict[str, Any]]:
        return [{"p50_us": free, "note": ""}, {"p50_us": 263.0, "note": ""}]

    monkeypatch.setattr(links, "bench_links", measured)
    fine, finding, remedy = doctor._zenoh_cpus()
    assert fine and said in finding and not remedy


@pytest.mark.slow
def test_round_trips_over_zenoh_are_measured() -> None:
    fine, finding, _ = doctor._zenoh_cpus()
    assert fine and "us (median) on one CPU" in finding


def test_what_is_fine_has_no_remedy() -> None:
    checks = [doctor._vcan(), ("hil vcan", *doctor.what_would_run()), doctor._zenoh(),
              doctor._scheduler(), doctor._idle(), doctor._clock(),
              doctor._cpus(), doctor._packages(), doctor._tool("sh", "dash", "scripts")]  # fmt: skip
    for what, fine, finding, remedy in checks:
        assert finding and bool(remedy) is not fine, what


@pytest.mark.parametrize(
    ("number", "found", "helps"),
    [(errno.EAFNOSUPPORT, "this kernel has no CAN", "user-mode kernel"), (errno.ENODEV, "no vcan0: ", "ip link")],
)
def test_a_kernel_without_can_is_not_told_to_add_a_link(
    number: int, found: str, helps: str, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    def refused(*_: object) -> NoReturn:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(doctor.socket, "socket", refused)
    _, fine, finding, remedy = doctor._vcan()
    assert not fine and finding.startswith(found) and remedy.startswith("hil vcan -- COMMAND")
    assert helps in remedy and ("ip link" in remedy) == (number == errno.ENODEV)


@pytest.mark.parametrize(("median", "fine"), [(999.9, True), (1000.0, False)])
def test_a_clock_is_judged_by_the_median_and_its_worst_is_shown(median: float, fine: bool) -> None:
    what, found, said, remedy = doctor.clock_check("tsc", [5000.0, 10.0, median])
    assert (what, found, bool(remedy)) == ("clock", fine, not fine)
    assert said == "tsc; a 2 ms sleep ends 1000 us late (median), 5000 us at worst"
