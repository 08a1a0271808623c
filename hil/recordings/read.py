"""Files of packets by their endings: our logs, tables, CAN logs of one bus seen twice, captures of ping."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from hil.errors import HilError
from hil.recordings.recording import BACK, THERE, Recording

CAN_ENDINGS = (".log", ".asc", ".blf")
ENDINGS = (".mcap", ".csv", *CAN_ENDINGS, ".pcap")


def shipped_recordings() -> dict[str, Path]:
    """Return the recordings that come with the package, by name."""
    folder = Path(str(resources.files("hil"))) / "recordings" / "shipped"
    return {path.stem: path for path in sorted(folder.glob("*.mcap"))}


def read_recording(paths: Sequence[Path], *, can_id: int | None = None, one_clock: bool = False) -> Recording:
    """Read one file, or two that belong together: tables of both directions, or two logs of one bus.

    Args:
        paths: the files, or the name of a shipped recording; of two tables the first is from the sensor to the controller, of two
            CAN logs the first is the sender's.
        can_id: of CAN logs only frames of this identifier.
        one_clock: both time stamps are of one clock.

    Raises:
        HilError: what cannot be read, or is no record of packets; the message has the file and the remedy.
    """
    paths = [shipped_recordings().get(str(path), path) for path in paths]
    endings = {path.suffix.lower() for path in paths}
    said = " and ".join(map(str, paths))
    for path in paths:
        if path.suffix.lower() not in ENDINGS:
            raise HilError(f"{path}: the ending {path.suffix!r} names no record of packets, expected one of {', '.join(ENDINGS)}")
    if can_id is not None and not endings <= set(CAN_ENDINGS):
        raise HilError(f"{said}: --can-id: belongs to CAN logs ({', '.join(CAN_ENDINGS)})")
    if endings <= set(CAN_ENDINGS):
        if len(paths) != 2:
            raise HilError(
                f"{said}: a CAN log has no latencies by itself; expected two of one bus: the sender's, then the receiver's"
            )
        from hil.recordings.can_pair import read_can_pair

        return read_can_pair(paths[0], paths[1], can_id, clocks=1 if one_clock else 2)
    if endings == {".csv"} and len(paths) == 2:
        from hil.recordings.table import read_latencies

        there, back = (read_latencies(path, one_clock=one_clock) for path in paths)
        if any(len(each.ways) != 1 or THERE not in each.ways for each in (there, back)):
            raise HilError(f"{said}: two tables are both directions; expected latencies or time stamps, and no round trips")
        ways = {THERE: there.ways[THERE], BACK: back.ways[THERE]}
        return Recording(source=said, ways=ways, clocks=max(there.clocks, back.clocks), notes=there.notes + back.notes)
    if len(paths) != 1:
        raise HilError(f"{said}: expected one file, or two CAN logs of one bus, or two tables (.csv) of both directions")
    if endings == {".csv"}:
        from hil.recordings.table import read_latencies

        return read_latencies(paths[0], one_clock=one_clock)
    if endings == {".pcap"}:
        from hil.recordings.ping_capture import read_ping_capture

        return read_ping_capture(paths[0])
    from hil.recordings.own_log import read_own_log

    return read_own_log(paths[0])
