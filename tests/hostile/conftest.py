"""How many hostile inputs were tried, and at which boundary, at the end of a run."""

from __future__ import annotations

from collections import Counter

import pytest


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Add up what the tests counted, those of all workers."""
    tried: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    read: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    for outcome in ("passed", "failed"):
        for report in terminalreporter.getreports(outcome):
            said = dict(report.user_properties)
            if "attack" in said:
                tried[str(said["attack"])] += int(str(said["tried"]))
                failed[str(said["attack"])] += int(str(said["failed"]))
            if "boundary" in said:
                read[str(said["boundary"])] += int(str(said["read"]))
                refused[str(said["boundary"])] += int(str(said["refused"]))
    if tried and config.getoption("--hil-hostile"):
        terminalreporter.section("attacks")
        for name in sorted(tried):
            terminalreporter.line(f"{name:<44} {tried[name]:>6,} tried {failed[name]:>4,} failed")
    if not read | refused or not config.getoption("--hil-hostile"):
        return
    terminalreporter.section("hostile inputs")
    for name in sorted(read.keys() | refused.keys()):
        terminalreporter.line(f"{name:<16} {read[name]:>9,} read {refused[name]:>9,} refused")
    terminalreporter.line(f"{'all':<16} {read.total():>9,} read {refused.total():>9,} refused: {(read + refused).total():,}")
