"""What a soak showed: it holds, it does not, or the machine was too busy to tell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

from hil.measure.timing import LATENESS_SHARE, OVERRUN_SHARE

Found = Literal["holds", "does not hold", "undecided"]

LOG_SHARE: Final = 0.1
"""Largest share by which a log is longer or shorter than predicted."""

STATUS: Final[Mapping[Found, int]] = {"holds": 0, "does not hold": 1, "undecided": 4}
"""Exit status of `hil bench soak`; 4 says of a run too that the machine did not keep its times."""

SAFETY: Final = 3


def judge(row: Mapping[str, Any], groups: Mapping[str, Mapping[str, Any]], *, period_us: float) -> tuple[Found, list[str]]:
    """Return what a soak showed, and why if it does not hold or is undecided.

    What a busy machine does to a rig is no fault of the rig: late answers, overruns, a plant that runs away meanwhile and is
    stopped by safety. The machine was busy where cyclictest, in the same minutes and at the same priority, was late by more
    than a tenth of the period in 1 % of its cycles or missed more than 0.1 % of them; without cyclictest, where the run says
    so of itself. Memory that grows, records that were dropped and a log of another size are faults on any machine.

    Args:
        row: of the long session: `status`, `safety`, `slots`, `slots_expected`, `dropped`, `log_ratio`, `memory`,
            `timing_why`, `cyclictest_us`, `cyclictest_missed_share`, see `hil.bench.soak.bench_soak`.
        groups: how many sessions, to `statuses` and `dropped` of the short ones.
        period_us: sample period, us.
    """
    busy = _busy(row, period_us)
    faults = [f"{each['process']}: memory grows" for each in row["memory"] if each["grows"]]
    if row["dropped"]:
        faults.append(f"{row['dropped']} records of the log were dropped")
    if abs(row["log_ratio"] - 1.0) > LOG_SHARE:
        faults.append(f"the log has {row['log_ratio']:.3f} of its predicted length")
    late: list[str] = []
    if row["status"] == SAFETY:
        late.append(f"stopped by safety after {row['slots']} of {row['slots_expected']} slots: {row['safety']}")
    elif row["status"] != 0 or row["slots"] < row["slots_expected"]:
        faults.append(f"ended with status {row['status']} after {row['slots']} of {row['slots_expected']} slots")
    late += row["timing_why"]
    for how, group in groups.items():
        if group["dropped"]:
            faults.append(f"{how}: {group['dropped']} records were dropped")
        for status, count in group["statuses"].items():
            if status == str(SAFETY):
                late.append(f"{how}: {count} stopped by safety")
            elif status != "0":
                faults.append(f"{how}: {count} ended with status {status}")
    if faults:
        return "does not hold", faults + late
    if not late:
        return "holds", []
    if busy:
        return "undecided", [f"the machine was too busy to decide: {busy}", *late]
    return "does not hold", late


def _busy(row: Mapping[str, Any], period_us: float) -> str | None:
    """Return what shows that the machine was too busy, None if nothing does."""
    if row["cyclictest_us"] is None:
        return "no cyclictest stood beside it, and the run did not keep its times" if row["timing_why"] else None
    p99, missed = row["cyclictest_us"]["p99"], row["cyclictest_missed_share"]
    if p99 > LATENESS_SHARE * period_us:
        return f"p99 of cyclictest's lateness was {p99:.0f} us"
    return f"cyclictest missed {missed:.2%} of its cycles" if missed > OVERRUN_SHARE else None
