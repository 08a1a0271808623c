"""The bench of whole commands: each runs, and stands beside the start of Python with numpy."""

from __future__ import annotations

import pytest

from hil.errors import HilError
from tests.bench import commands
from tests.bench.processes import HIL, spent


@pytest.mark.slow  # eight processes; that every command runs is tested elsewhere
def test_every_command_runs_and_has_its_ratio() -> None:
    rows = commands.bench_commands(runs=20, real=False)
    assert [row["command"].split(",")[0] for row in rows[:4]] == ["hil --help", "hil run", "hil run", "hil report of it"]
    for row in rows:
        assert row["CPU s"] > 0.0 and row["ratio"] == pytest.approx(row["CPU s"] / row["numpy CPU s"], rel=0.1)


def test_a_command_that_fails_is_not_measured() -> None:
    with pytest.raises(HilError, match="exit status 2"):
        spent([*HIL, "run", "no-such-experiment"])
