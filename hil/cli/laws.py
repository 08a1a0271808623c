"""``hil laws``: what an experiment's network laws do in the long run, before anything runs."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.option_types import OUTPUT
from hil.cli.page_text import print_table
from hil.cli.terminal import Line, Working, json_option, print_folded, print_json, print_lines, visible, wants_json
from hil.errors import HilError

if TYPE_CHECKING:
    from hil.design_questions.loop_on_bus import BusLaw
    from transport.law_tests.analysis import LawAnalysis
    from transport.laws import NetworkLaw


NEGLIGIBLE = 1e-6


@click.command()
@click.argument("experiment", type=EXPERIMENT)
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field.")
@click.option("--from-bus", is_flag=True, help="Show the laws that EXPERIMENT's CAN bus with time makes of the loop's packets.")
@click.option("-o", "--output", type=OUTPUT, metavar="FILE.toml",
              help="--from-bus: write them here, for experiments: law.toml becomes law.sc.toml and law.ca.toml.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace files that are there.")
@json_option()
def command(experiment: str, sets: tuple[str, ...], from_bus: bool, output: Path | None, force: bool) -> None:
    """Show stationary law, mean bursts, ages and losses of EXPERIMENT's network: of every sensor node, and to the actuator."""
    if from_bus:
        _from_bus(experiment, sets, output, force)
        return
    if output is not None or force:
        raise HilError("-o: belongs to --from-bus; hil show prints an experiment with its laws")
    from hil.experiment import load_experiment
    from hil.rig import rig_of
    from hil.rig.named_files import with_law_files
    from transport.law_tests.analysis import analyse_law
    from transport.laws.delay_states import mode_transitions

    checked = with_law_files(load_experiment(experiment, sets))
    period_s = float(checked.period)
    deadline_s = checked.timing.deadline * period_s
    rig = rig_of(checked)
    nodes = {node.name: analyse_law(node.law, period_s, deadline_s, node.law_kind) for node in rig.sensors}
    ca = analyse_law(rig.ca_law, period_s, deadline_s, rig.ca_kind)
    if not wants_json():
        way = "sensor to controller (sc)"
        for name, found in nodes.items():
            _print(checked.name, period_s, way if len(nodes) == 1 else f"node {name}, {way}", found)
        _print(checked.name, period_s, "controller to actuator (ca)", ca)
        return

    def said(law: NetworkLaw, found: LawAnalysis) -> dict[str, Any]:
        matrix = mode_transitions(law)
        return _json(found) | {"transition_matrix": None if matrix is None else matrix.tolist()}

    shared = checked.network.sc.law
    sc = analyse_law(shared, period_s, deadline_s, checked.kinds.get("network.sc.law", "?"))
    of_nodes = {node.name: said(node.law, nodes[node.name]) for node in rig.sensors}
    laws = {"sc": said(shared, sc), "ca": said(rig.ca_law, ca)}
    print_json({"experiment": checked.name, "period_s": period_s, "deadline_s": deadline_s, "laws": laws, "nodes": of_nodes})


def _from_bus(name: str, sets: tuple[str, ...], output: Path | None, force: bool) -> None:
    """Show the law of each way over an experiment's bus, and write their files.

    Raises:
        HilError: no such bus, too few packets, or a file that cannot be written.
    """
    from hil.compose import compose
    from hil.design_questions.loop_on_bus import estimated_laws, exact_laws, to_estimate_from, ways_over
    from hil.experiment import load_experiment, parse_table
    from hil.files import check_output, write_output
    from hil.rig.can_bus import can_bus_of
    from hil.runtime.virtual import simulate
    from transport.law_tests.analysis import analyse_law

    experiment = load_experiment(name, sets)
    loop = compose(experiment, certify=False)
    bus = can_bus_of(loop.rig)
    ways = {} if bus is None else ways_over(loop.rig, bus)
    files = {} if output is None or bus is None else files_of(output, ways)
    for path in files.values():
        check_output(path, "a law", ".toml", force=force)
    found = exact_laws(loop)
    if found is None:
        loop = compose(to_estimate_from(experiment), certify=False)
        with Working(f"run of {experiment.name}"):
            found = estimated_laws(loop, simulate(loop, experiment.seed).arrays)
    for way, path in files.items():
        write_output(path, found[way].text, replace=force)
    period_s = float(experiment.period)
    deadline_s = experiment.timing.deadline * period_s
    shown = {
        way: analyse_law(parse_table("hil.laws", law.spec, "law"), period_s, deadline_s, law.spec["kind"])
        for way, law in found.items()
    }
    if wants_json():
        said = {way: _json(law) | {"analysis": _json(shown[way])} for way, law in found.items()}
        print_json({"experiment": experiment.name, "period_s": period_s, "laws": said})
        return
    for way, law in found.items():
        node = ways[way]
        title = "over the bus to the actuator (ca)" if node is None else "over the bus to the controller (sc)"
        if node is not None and way != "sc":
            title = f"node {loop.rig.sensors[node].name}, {title}"
        _print(experiment.name, period_s, title, shown[way], (law.how, bound_said(law)))
    for way, path in files.items():
        node = ways[way]
        field = f"nodes.{loop.rig.sensors[node].name}.law" if node is not None and way != "sc" else f"{way}.law"
        print(f'written: {visible(path)}; in an experiment: {visible(field)} = {{ file = "{visible(path)}" }}')


def _print(name: str, period_s: float, title: str, law: LawAnalysis, notes: Sequence[str] = ()) -> None:
    from hil.pages import Table

    click.echo(f"{click.style(visible(name), bold=True)}, {visible(title)}: {law.kind} law, T = {period_s * 1e3:g} ms")
    if len(law.stationary) > 1:  # one mode lasts for ever
        ages: Sequence[int | str] = law.mode_ages or ("-",) * len(law.stationary)
        rows = [
            (mode, age, f"{share:.4f}", f"{burst:.4g}", f"{burst * period_s:.4g}")
            for mode, (age, share, burst) in enumerate(zip(ages, law.stationary, law.mean_bursts))
        ]
        print_table(Table(columns=("mode", "age", "share of slots", "mean burst (slots)", "mean burst (s)"), rows=rows))
    shares = ", ".join(f"{age}: {share:.4f}" for age, share in enumerate(law.age_shares[:10]))
    if len(law.age_shares) > 10:
        shares += f", older: {max(0.0, 1.0 - sum(law.age_shares[:10])):.2g}"
    for note in notes:
        print_folded(note)
    sampled = "" if law.age_method == "exact" else " (from 50,000 simulated slots)"
    above = "above " if law.older > NEGLIGIBLE else ""
    lines = [
        Line("age of the newest packet", f"{shares or 'nothing ever arrives'}{sampled}"),
        Line("mean age", f"{above}{law.mean_age:.4g} slots = {law.mean_age * period_s * 1e3:.4g} ms"),
    ]
    if not math.isnan(law.mean_latency_s):
        lines.append(Line("mean latency", f"{law.mean_latency_s * 1e3:.4g} ms"))
    full = f", {law.overflow:.4g} at the full queue{sampled}" if law.overflow else ""
    lines.append(Line("lost", f"{law.loss_probability:.4g} of the packets{full}"))
    if not math.isnan(law.unused):
        lines.append(Line("never used", f"{law.unused:.4g} of the packets"))
    print_lines(lines)
    print()


def _json(found: object) -> dict[str, Any]:
    """Return a dataclass as JSON has it: neither infinity nor NaN, both become null."""
    plain: dict[str, Any] = json.loads(msgspec.json.encode(found, enc_hook=float))  # which is asked for numpy's numbers
    return plain


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
