"""What a user waits for: whole commands in processes of their own, beside the start of Python with numpy in the same run."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.bench.processes import HIL, NUMPY, spent

Row = dict[str, Any]

EXPERIMENT = "dc-motor-hinf"
REAL_S = 2.0


def bench_commands(
    progress: Callable[[str], None] = lambda text: None, *, runs: int = 1000, real: bool = True, real_s: float = REAL_S
) -> list[Row]:
    """Return CPU and wall time of commands beside ``python -c "import numpy"``.

    Args:
        progress: told what is being done.
        runs: of the sweeps.
        real: whether a session in real time is measured too, and what it takes beyond its length.
        real_s: this length, s.
    """
    with tempfile.TemporaryDirectory(prefix="hilrig-bench-") as folder:
        log, slot = str(Path(folder) / "run.mcap"), str(Path(folder) / "slot.mcap")
        sweep = [*HIL, "sweep", EXPERIMENT, "--runs", str(runs), "--json"]
        commands: list[tuple[str, list[str], float | None, str]] = [
            ("hil --help", [*HIL, "--help"], None, ""),
            ("hil run, one slot", [*HIL, "run", EXPERIMENT, "--duration", "50 ms", "-o", slot, "--quiet"], 0.35, "CPU s"),
            ("hil run, 1000 slots", [*HIL, "run", EXPERIMENT, "-o", log, "--quiet"], None, ""),
            ("hil report of it", [*HIL, "report", log], 1.5, "wall s"),
            (f"hil sweep --runs {runs}, every core", sweep, 1.5 if runs == 1000 else None, "wall s"),
            (f"hil sweep --runs {runs} --jobs 1", [*sweep, "--jobs", "1"], None, ""),
        ]
        if real:
            file = str(Path(folder) / "real.mcap")
            session = [*HIL, "run", EXPERIMENT, "--clock", "real", "--link", f"can:hil:bench{os.getpid()}"]
            session += ["--duration", f"{real_s:g}", "-o", file, "--quiet"]
            commands.append((f"hil run --clock real, beyond its {real_s:g} s", session, 1.0, "wall s"))
        peer = spent(NUMPY)
        rows = []
        for name, command, goal, of in commands:
            progress(name)
            cpu, wall, _ = spent(command)
            if "beyond" in name:
                wall -= real_s
            found = {"CPU s": round(cpu, 3), "wall s": round(wall, 3)}
            rows.append({
                "command": name, **found, "goal s": goal, "goal of": of or None,
                "met": None if goal is None else found[of] <= goal,
                "numpy CPU s": round(peer.cpu_s, 3), "ratio": round(cpu / peer.cpu_s, 1),
            })  # fmt: skip
    return rows
