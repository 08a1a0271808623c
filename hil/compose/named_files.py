"""Files that an experiment names, read from beside it: recorded ages, latencies, traffic. It then needs no other file."""

from __future__ import annotations

from pathlib import Path

from msgspec.structs import replace

from hil.errors import ExperimentError, HilError
from hil.experiment import Experiment
from hil.experiment.table_check import fault_at
from hil.rig.traffic_file import MOST, line_of
from transport.can_bus_model.can_frame import CanFrame
from transport.errors import FieldError
from transport.laws.protocols import NetworkLaw, load_files, slots_served
from transport.wire.fields import frame_length


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


ENDINGS = (".log", ".asc", ".blf")


def with_recorded_traffic(e: Experiment) -> Experiment:
    """Return an experiment with the frames of its recorded traffic in it, from time 0 on.

    Raises:
        ExperimentError: the file cannot be read, or has no time stamps.
    """
    media = dict(e.network.media)
    for name, medium in e.network.media.items():
        if medium.traffic_file.endswith(ENDINGS):
            try:
                lines = _lines(Path(e.folder) / medium.traffic_file)
            except HilError as error:
                raise ExperimentError(e.name, [f"network.media.{name}.traffic_file: {error}"]) from error
            media[name] = replace(medium, recorded=(*medium.recorded, *lines), traffic_file="")
    return replace(e, network=replace(e.network, media=media))


def _lines(path: Path) -> list[str]:
    from hil.log.read.foreign_logs import can_frames  # python-can is imported for a recording alone

    found: list[tuple[float, CanFrame]] = []
    for i, message in enumerate(can_frames(path)):
        if message.is_error_frame:
            continue
        data = b"" if message.is_remote_frame else bytes(message.data)
        try:
            frame = CanFrame(
                identifier=message.arbitration_id, extended=message.is_extended_id, remote=message.is_remote_frame,
                dlc=message.dlc if message.is_remote_frame else None, fd=message.is_fd,
                data=data.ljust(frame_length(len(data)), b"\0") if message.is_fd else data,
                bitrate_switch=message.is_fd and message.bitrate_switch,
                error_state=message.is_fd and message.error_state_indicator,
            )  # fmt: skip
        except FieldError as error:
            raise HilError(f"{path}: frame {i + 1}: {error}") from error
        found.append((message.timestamp, frame))
        if len(found) > MOST:
            raise HilError(f"{path}: more than {MOST} frames")
    if not found:
        raise HilError(f"{path}: no frame")
    if len(found) > 1 and all(at == found[0][0] for at, _ in found):
        raise HilError(f"{path}: every frame has the time stamp {found[0][0]:g}; a recording with time stamps is needed")
    first = min(at for at, _ in found)
    return [line_of(round((at - first) * 1e9), frame) for at, frame in sorted(found, key=lambda each: each[0])]
