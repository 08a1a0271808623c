"""The files that network laws name (recorded ages, latencies), read from beside the experiment."""

from __future__ import annotations

from msgspec.structs import replace

from hil.errors import ExperimentError
from hil.experiment import Experiment
from hil.experiment.table_check import fault_at
from transport.laws.protocols import NetworkLaw, load_files, slots_served


def with_law_files(e: Experiment) -> Experiment:
    """Return an experiment with the files read that its network laws name: it needs nothing but itself then.

    Raises:
        ExperimentError: a file is missing or faulty, or a recording is shorter than the run.
    """
    sc, ca = e.network.sc, e.network.ca
    sc, ca = replace(sc, law=_loaded_law(e, sc.law, "network.sc")), replace(ca, law=_loaded_law(e, ca.law, "network.ca"))
    nodes = {
        name: node if node.law is None else replace(node, law=_loaded_law(e, node.law, f"network.nodes.{name}"))
        for name, node in e.network.nodes.items()
    }
    return replace(e, network=replace(e.network, sc=sc, ca=ca, nodes=nodes))


def _loaded_law(e: Experiment, law: NetworkLaw, path: str) -> NetworkLaw:
    try:
        loaded = load_files(law, e.folder)
    except ValueError as error:
        raise ExperimentError(e.name, [fault_at(f"{path}.law", error)]) from error
    served = slots_served(loaded)
    if served is not None and served < e.slots:
        said = f"the recording has {served} slots, the run has {e.slots}; past_end = 'repeat' repeats the recording"
        raise ExperimentError(e.name, [f"{path}.law: {said}"])
    return loaded
