"""Of an experiment with gains over historical data: what they cost, and what no controller can go below."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import click

from hil.cli.design_question import Question, gain_unit
from hil.cli.terminal import Working
from hil.cli.terminal import answer as print_answer
from hil.errors import located

if TYPE_CHECKING:
    from design.controllers.sensor_nodes import Uses


@runtime_checkable
class OverHistory(Protocol):
    """A controller, or the request for one, that says which of the samples its gains use."""

    uses: Uses


def is_over_history(options: Mapping[str, Any]) -> bool:
    """Return whether the subject is an experiment with several sensor nodes, or with gains over historical data."""
    from hil.experiment import load_experiment
    from hil.plugins.registry import names
    from hil.rig import rig_of

    subject = options["subject"]
    if subject in names("hil.plants") or ":" in subject:
        return False
    experiment = load_experiment(subject)
    return len(rig_of(experiment).sensors) > 1 or isinstance(experiment.controller, OverHistory)


def answer(subject: str, orders: bool, spread: bool) -> None:
    """Print what gains over historical data cost."""
    from hil.certify.historical_loop import judge_historical
    from hil.compose import compose
    from hil.experiment import load_experiment

    experiment = load_experiment(subject)
    with located(experiment.name, ValueError), Working(f"{experiment.name}: what its gains cost"):
        found = judge_historical(compose(experiment), orders=orders, spread=spread)
    unit = gain_unit(experiment.plant.inputs, experiment.plant.states)
    print_answer(found, lambda: print(*historical_lines(found, unit), sep="\n"))


def historical_lines(found: dict[str, Any], unit: str) -> list[str]:
    """Return a judgement as lines for people.

    Args:
        found: as `judge_historical` returns it.
        unit: of the gains.
    """
    said = [f"{found['experiment']}, uses {found['uses']}", f"cost from the plant's start   {found['cost']:.6g}"]
    if "cost_sd" in found:
        said.append(f"  standard deviation of runs  {found['cost_sd']:.6g}")
    said.append(f"mean cost, x(0) ~ N(0, I)     {found['mean_cost']:.6g}")
    if found["bound_causal"] is None:
        said.append("bound, any causal controller  undecided: which node's packet arrives is not a Markov chain of its own")
    else:
        said.append(f"bound, any causal controller  {found['bound_causal']:.6g} (ours is {100 * found['gap']:.2f} % above)")
    said.append(f"bound, full state             {found['bound_full_state']:.6g}")
    said += [f"order {', '.join(each['nodes'])}: mean cost {each['mean_cost']:.6g}" for each in found.get("orders", ())]
    said.append(f"gains [phase][j] in {unit}, of x(k - j):")
    for i, phase in enumerate(found["gains"]):
        for j, rows in enumerate(phase):
            said += [f"  [{i}][{j}] " + " ".join(f"{entry:10.5g}" for entry in row) for row in rows]
    return said


QUESTION = Question(
    30, is_over_history,
    [click.Option(["--orders"], is_flag=True, help="Gains over historical data: try every order of the nodes' turns."),
     click.Option(["--spread"], is_flag=True,
                  help="Gains over historical data: the standard deviation of the cost over runs, too.")],
    answer, "gains over historical data, which [controller] asks for",
)  # fmt: skip
