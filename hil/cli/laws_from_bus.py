"""``hil laws --from-bus``: the network laws that a CAN bus with time makes of a loop's packets, as files for experiments."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hil.design_questions.bus_law import BusLaw
    from transport.laws.protocols import NetworkLaw


def laws_of_bus(
    name: str, sets: tuple[str, ...], output: Path | None, force: bool
) -> tuple[str, float, float, dict[str, tuple[BusLaw, NetworkLaw]]]:  # fmt: skip
    """Return an experiment's name, its period and deadline in s, and the law of each way over its bus; write their files.

    Args:
        name: of the experiment.
        sets: changes of its fields.
        output: file; of two ways law.toml becomes law.sc.toml and law.ca.toml. None: none is written.
        force: replace files that are there.

    Raises:
        HilError: no such bus, too few packets, or a file that cannot be written.
    """
    from hil.cli.working import Working
    from hil.compose.loop import compose
    from hil.design_questions.bus_law import estimated_laws, exact_laws, to_estimate_from
    from hil.experiment import load_experiment
    from hil.experiment.load import parse_table
    from hil.files.outputs import check_output, write_output
    from hil.rig.can_bus import can_bus_of
    from hil.runtime.simulated import simulate

    experiment = load_experiment(name, sets)
    loop = compose(experiment, certify=False)
    bus = can_bus_of(loop.rig)
    files: dict[str, Path] = {}
    if output is not None and bus is not None:
        ways = ("sc", "ca") if bus.table.control else ("sc",)
        files = files_of(output, ways)
    for path in files.values():
        check_output(path, fresh=not force, remedy="choose another name or add --force")
    found = exact_laws(loop)
    if found is None:
        loop = compose(to_estimate_from(experiment), certify=False)
        with Working(f"run of {experiment.name}"):
            found = estimated_laws(loop, simulate(loop, experiment.seed).arrays)
    laws: dict[str, Any] = {way: (law, parse_table("hil.laws", law.spec, "law")) for way, law in found.items()}
    for way, path in files.items():
        write_output(path, found[way].text, replace=force)
    period_s = float(experiment.period)
    return experiment.name, period_s, experiment.timing.deadline * period_s, laws


def files_of(output: Path, ways: Collection[str]) -> dict[str, Path]:
    """Return the file of every way; that of one way is `output` itself.

    >>> files_of(Path("law.toml"), ("sc", "ca"))["sc"].name
    'law.sc.toml'
    """
    return {way: output if len(ways) == 1 else output.with_name(f"{output.stem}.{way}{output.suffix}") for way in ways}


def bound_said(law: BusLaw) -> str:
    """Return the largest delay of a way, in words."""
    if law.worst_ms is None:
        return f"no bound: {law.no_bound}"
    return f"a response takes at most {law.worst_ms:g} ms, so that no age is above {law.largest_age}"
