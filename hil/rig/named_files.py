"""Files that an experiment names, read from beside it: recorded ages, latencies, traffic. It then needs no other file.

Background traffic is a CSV table, a DBC whose messages say their cycle time (GenMsgCycleTime), or recorded frames: each is a line
of an experiment, such as ``12000000 123#1122``, nanoseconds and the frame as candump writes it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from hil.errors import ExperimentError, HilError, located
from hil.experiment.nodes import TrafficTable, can_faults_of
from hil.experiment.table import Seconds
from hil.experiment.table_check import fault_at
from hil.experiment.tables import Experiment
from hil.files import open_regular
from hil.files.can_logs import CAN_LOG_ENDINGS, can_frames
from transport.can_bus_model import CanFrame
from transport.dbc import check_places, read_dbc, start_numbers
from transport.errors import FieldError
from transport.laws import NetworkLaw, load_files, slots_served
from transport.wire import frame_length

if TYPE_CHECKING:
    from transport.can_bus_model import Due


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

        path = Path(e.folder) / medium.traffic_file
        try:
            if path.suffix in CAN_LOG_ENDINGS:
                media[name] = replace(medium, recorded=(*medium.recorded, *read_recorded(path)), traffic_file="")
            else:
                media[name] = replace(medium, traffic=(*medium.traffic, *read_traffic(path)[0]), traffic_file="")
        except HilError as error:
            raise ExperimentError(e.name, [f"network.media.{name}.traffic_file: {error}"]) from error
        fields = media[name].__struct_fields__
        faults = list(can_faults_of({field: getattr(media[name], field) for field in fields}))
        if faults:
            raise ExperimentError(e.name, [f"network.media.{name}.{fault}" for fault in faults])
    return replace(e, network=replace(e.network, media=media))


LARGEST = 16_000_000
_FLAGS = {"0": False, "no": False, "false": False, "1": True, "yes": True, "true": True}
_CELLS: Final[dict[str, tuple[Callable[[str], Any], str]]] = {
    **dict.fromkeys(("period", "offset", "jitter"), (Seconds.parse, "a duration such as 25ms")),
    **dict.fromkeys(("can_id", "length"), (lambda cell: int(cell, 0), "a whole number such as 18 or 0x12")),
    **dict.fromkeys(("extended", "fd"), (lambda cell: _FLAGS[cell.lower()], "yes or no")),
}
"""What a cell of a column is read by, and what it holds; any other is text."""


def read_traffic(path: Path, *, start_values: bool = False) -> tuple[tuple[TrafficTable, ...], tuple[str, ...]]:
    """Return the messages of a file that ends in .csv or .dbc, and the names of those that say no cycle time.

    Args:
        path: a CSV file has a head with the keys of a traffic table, ``can_id`` and ``period`` among them.
        start_values: whether the messages of a DBC have the start values of their signals as data, in place of random ones.

    Raises:
        HilError: it cannot be read, or says something that no message has; with the line or the name of the message.
    """
    if path.suffix not in (".csv", ".dbc"):
        raise HilError(f"{path}: the ending {path.suffix!r} names no table of traffic, expected .csv or .dbc")
    with located(path, OSError, ValueError), open_regular(path, "a table of traffic") as file:
        text = file.read(LARGEST + 1).decode("utf-8-sig" if path.suffix == ".csv" else "cp1252")
    if len(text) > LARGEST:
        raise HilError(f"{path}: more than {LARGEST} characters")
    found, others = (_of_csv(path, text), ()) if path.suffix == ".csv" else _of_dbc(path, text, start_values)
    if not found:
        missing = "" if path.suffix == ".csv" else ": none says its cycle time by GenMsgCycleTime"
        raise HilError(f"{path}: no message that is sent again and again{missing}")
    return found, others


def _of_csv(path: Path, text: str) -> tuple[TrafficTable, ...]:
    import csv  # loaded where there is such a file

    lines = text.splitlines()
    separator = ";" if lines and ";" in lines[0] else ","
    rows, found = csv.DictReader(lines, delimiter=separator), []
    try:
        names = list(rows.fieldnames or ())
        unknown = set(names) - set(TrafficTable.__struct_fields__)
        missing = {"can_id", "period"} - set(names)
        if unknown or missing:
            known = ", ".join(TrafficTable.__struct_fields__)
            said = f"no column {min(missing)!r}" if missing else f"an unknown column {min(unknown, key=str)!r}"
            raise HilError(f"{path}: line 1: {said}, expected some of {known}")
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise HilError(f"{path}: line 1: two columns are called {twice!r}, expected one")
        for row in rows:
            found.append(_table({key: value.strip() for key, value in row.items() if value and value.strip()}))
    except csv.Error as error:  # of the head, too
        raise HilError(f"{path}: is no table: {error}") from error
    except (ValueError, AttributeError, TypeError) as error:
        raise HilError(f"{path}: line {rows.line_num}: {error}") from error
    return tuple(found)


def _table(fields: dict[str, Any]) -> TrafficTable:
    values: dict[str, Any] = {}
    for key, value in fields.items():
        read, wanted = _CELLS.get(key, (str, "text"))
        try:
            values[key] = read(value)
        except (ValueError, KeyError) as error:
            raise ValueError(f"{key}: {value!r:.60}, expected {wanted}") from error
    return _sound(values)


def _sound(values: dict[str, Any]) -> TrafficTable:
    faults = list(TrafficTable.faults(values))
    if faults:
        raise ValueError("; ".join(faults))
    try:
        return TrafficTable(**values)
    except TypeError as error:
        raise ValueError(str(error)) from error


def _of_dbc(path: Path, text: str, start_values: bool) -> tuple[tuple[TrafficTable, ...], tuple[str, ...]]:
    with located(path, ValueError):
        database = read_dbc(text)
    found = []
    for message in database.messages:
        if message.cycle_time:
            with located(f"{path}: message {message.name}", ValueError, TypeError, OverflowError):
                values = {
                    "name": message.name, "can_id": message.frame_id, "period": Seconds(message.cycle_time / 1000),
                    "length": message.length, "extended": message.is_extended_frame, "fd": bool(message.is_fd),
                    "node": message.senders[0] if message.senders else "",
                }  # fmt: skip
                if start_values:
                    check_places(message)
                    values["data"] = message.encode(start_numbers(message), scaling=False, strict=False).hex()
                found.append(_sound(values))
    return tuple(found), tuple(message.name for message in database.messages if not message.cycle_time)


MOST: Final = 100_000
LONGEST_S: Final = 1e9
"""Of a recording: a line has its time in ns, of at most 18 digits."""
_LINE: Final = r"(\d{1,18}) ([0-9A-F]{3}|[0-9A-F]{8})(#R([0-8]?)|##([0-3])([0-9A-F]*)|#([0-9A-F]*))"


def line_of(at_ns: int, frame: CanFrame) -> str:
    """Return the line of a frame.

    >>> line_of(12_000_000, CanFrame(identifier=0x123, data=b"12"))
    '12000000 123#3132'
    """
    identifier = f"{frame.identifier:08X}" if frame.extended else f"{frame.identifier:03X}"
    if frame.remote:
        return f"{at_ns} {identifier}#R{frame.dlc or ''}"
    flags = f"#{frame.bitrate_switch | frame.error_state << 1}" if frame.fd else ""
    return f"{at_ns} {identifier}#{flags}{frame.data.hex().upper()}"


def read_recorded(path: Path) -> list[str]:
    """Return the frames of a recording as lines of an experiment, from time 0 on.

    Args:
        path: ends in one of `CAN_LOG_ENDINGS`.

    Raises:
        HilError: it cannot be read, has no frame, or no time stamps.
    """
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
    first, last = min(at for at, _ in found), max(at for at, _ in found)
    if not last - first < LONGEST_S:
        raise HilError(f"{path}: frames lie {last - first:g} s apart, expected less than {LONGEST_S:g}; are these two clocks?")
    return [line_of(round((at - first) * 1e9), frame) for at, frame in sorted(found, key=lambda each: each[0])]


def due_of(line: str, node: int = 0) -> Due:
    """Return the frame of a line.

    Args:
        line: of `line_of`.
        node: number of the sender.

    Raises:
        ValueError: it is none.
    """
    found = re.fullmatch(_LINE, line)
    if found is None:
        raise ValueError(f"{line!r:.60}, expected nanoseconds and a frame, as in '12000000 123#1122'")
    from transport.can_bus_model import Due  # loaded where there is a bus

    at, identifier, kind, dlc, flags, flexible, classic = found.groups()
    data = bytes.fromhex(flexible or classic or "")
    frame: dict[str, Any] = {"data": data}
    if kind.startswith("#R"):
        frame = {"remote": True, "dlc": int(dlc or 0)}
    elif flags is not None:
        padded = data.ljust(frame_length(min(len(data), 64)), b"\0")
        frame = {"fd": True, "data": padded, "bitrate_switch": bool(int(flags) & 1), "error_state": bool(int(flags) & 2)}
    return Due(int(at), node, CanFrame(identifier=int(identifier, 16), extended=len(identifier) == 8, **frame))
