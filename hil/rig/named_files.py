"""Files that an experiment names, read from beside it: recorded ages, latencies, traffic. It then needs no other file."""

from __future__ import annotations

from pathlib import Path

from msgspec.structs import replace

from hil.errors import ExperimentError, HilError
from hil.experiment.nodes import can_faults_of
from hil.experiment.table_check import fault_at
from hil.experiment.tables import Experiment
from transport.laws import NetworkLaw, load_files, slots_served


def with_named_files(e: Experiment) -> Experiment:
    """Return an experiment with every file read that it names: it needs nothing but itself then.

    Raises:
        ExperimentError: see `with_law_files` and `with_traffic_files`.
    """
    return with_traffic_files(with_law_files(e))


def with_law_files(e: Experiment) -> Experiment:
    """Return an experiment with the files read that its network laws name.

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


def with_traffic_files(e: Experiment) -> Experiment:
    """Return an experiment with the messages and recorded frames of its files of background traffic in it.

    Raises:
        ExperimentError: a file cannot be read, is faulty, or is a recording without time stamps.
    """
    media = dict(e.network.media)
    for name, medium in e.network.media.items():
        if not medium.traffic_file:
            continue
        from hil.rig.traffic_file import RECORDINGS, read_recorded, read_traffic

        path = Path(e.folder) / medium.traffic_file
        try:
            if path.suffix in RECORDINGS:
                media[name] = replace(medium, recorded=(*medium.recorded, *read_recorded(path)), traffic_file="")
            else:
                media[name] = replace(medium, traffic=(*medium.traffic, *read_traffic(path)), traffic_file="")
        except HilError as error:
            raise ExperimentError(e.name, [f"network.media.{name}.traffic_file: {error}"]) from error
        fields = media[name].__struct_fields__
        faults = list(can_faults_of({field: getattr(media[name], field) for field in fields}))
        if faults:
            raise ExperimentError(e.name, [f"network.media.{name}.{fault}" for fault in faults])
    return replace(e, network=replace(e.network, media=media))
