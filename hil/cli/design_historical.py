"""``hil design EXPERIMENT`` of gains over historical data: what they cost, and how far that is from the best possible."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from hil.cli.json_output import print_json
from hil.errors import HilError

if TYPE_CHECKING:
    from design.controllers.sensor_nodes import Uses
    from hil.experiment import Experiment


@runtime_checkable
class OverHistory(Protocol):
    """A controller, or the request for one, that says which of the samples its gains use."""

    uses: Uses


def experiment_over_history(subject: str) -> Experiment | None:
    """Return the experiment of a name with several sensor nodes, or with gains over historical data; None for any other name."""
    from hil.experiment import load_experiment
    from hil.plugins.registry import names
    from hil.rig.normal_form import rig_of

    if subject in names("hil.plants") or ":" in subject:
        return None
    experiment = load_experiment(subject)
    return experiment if len(rig_of(experiment).sensors) > 1 or isinstance(experiment.controller, OverHistory) else None


def command(experiment: Experiment, orders: bool, spread: bool, as_json: bool) -> None:
    """Print what gains over historical data cost."""
    from hil.cli.working import Working
    from hil.compose.loop import compose
    from hil.design_questions.historical_bounds import judge_historical

    try:
        with Working(f"{experiment.name}: what its gains cost"):
            found = judge_historical(compose(experiment), orders=orders, spread=spread)
    except ValueError as error:
        raise HilError(f"{experiment.name}: {error}") from error
    if as_json:
        print_json(found)
        return
    for line in lines(found):
        print(line)


def lines(found: dict[str, Any]) -> list[str]:
    """Return a judgement as lines for people."""
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
    said.append("gains [phase][j], of x(k - j):")
    for i, phase in enumerate(found["gains"]):
        for j, rows in enumerate(phase):
            said += [f"  [{i}][{j}] " + " ".join(f"{entry:10.5g}" for entry in row) for row in rows]
    return said
