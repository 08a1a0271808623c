"""Files of packets by their endings: our logs, tables, CAN logs of one bus seen twice, captures of ping."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np

from hil.errors import HilError
from hil.files.can_logs import CAN_LOG_ENDINGS, can_frames
from hil.log.read import read_run
from hil.log.recordings import BACK, THERE, Recording, Way
from hil.log.recordings.packet_files import (
    MOST_FRAMES,
    read_can_requests,
    read_captured_frames,
    read_latencies,
    read_ping_capture,
)
from hil.log.run import Run, StructuredArray
from hil.log.topics import CA, PROBE, SC
from transport.draws import DELIVERED, LOST, NO_MODE, OVERFLOW, SENT

ENDINGS = (".mcap", ".csv", *CAN_LOG_ENDINGS, ".pcap")


def shipped_recordings() -> dict[str, Path]:
    """Return the recordings that come with the package, by name."""
    folder = Path(str(resources.files("hil.log"))) / "recordings" / "shipped"
    return {path.stem: path for path in sorted(folder.glob("*.mcap"))}


def read_recording(
    paths: Sequence[Path], *, can_id: int | None = None, answer_id: int | None = None, one_clock: bool = False
) -> Recording:  # fmt: skip
    """Read one file, or two that belong together: tables of both directions, or two logs of one bus.

    Args:
        paths: the files, or the name of a shipped recording; of two tables the first is from the sensor to the controller, of two
            CAN logs the first is the sender's.
        can_id: of CAN logs only frames of this identifier.
        answer_id: of one CAN log the frames that answer those.
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
    if can_id is not None and not endings <= set(CAN_LOG_ENDINGS):
        raise HilError(f"{said}: --can-id: belongs to CAN logs ({', '.join(CAN_LOG_ENDINGS)})")
    if answer_id is not None:
        if can_id is None or can_id == answer_id or len(paths) != 1:
            raise HilError(f"{said}: --answer-id: is for one CAN log, with --can-id for the frames that are answered")
        return read_can_requests(paths[0], can_id, answer_id)
    if endings <= set(CAN_LOG_ENDINGS):
        if len(paths) != 2:
            raise HilError(
                f"{said}: a CAN log has no latencies by itself; expected two of one bus: the sender's, then the receiver's; or, "
                "of requests and their answers, --can-id and --answer-id"
            )
        return read_can_pair(paths[0], paths[1], can_id, clocks=1 if one_clock else 2)
    if endings == {".csv"} and len(paths) == 2:
        there, back = (read_latencies(path, one_clock=one_clock) for path in paths)
        if any(len(each.ways) != 1 or THERE not in each.ways for each in (there, back)):
            raise HilError(f"{said}: two tables are both directions; expected latencies or time stamps, and no round trips")
        ways = {THERE: there.ways[THERE], BACK: back.ways[THERE]}
        return Recording(source=said, ways=ways, clocks=max(there.clocks, back.clocks), notes=there.notes + back.notes)
    if len(paths) != 1:
        raise HilError(f"{said}: expected one file, or two CAN logs of one bus, or two tables (.csv) of both directions")
    if endings == {".csv"}:
        return read_latencies(paths[0], one_clock=one_clock)
    if endings == {".pcap"}:
        return read_captured_frames(paths[0]) or read_ping_capture(paths[0])
    return read_own_log(paths[0])


def read_own_log(path: Path) -> Recording:
    """Read a log of `hil probe`, or of a run.

    It holds what `hil probe` measured, or what the emulated network of a run did with every packet.

    Raises:
        HilError: it is no log, or has no packets.
    """
    run = read_run(path)
    if PROBE.name in run.arrays:
        return _probe(path, run)
    if SC.name not in run.arrays or CA.name not in run.arrays:
        raise HilError(f"{path}: has no packets; expected a log of `hil probe` or of a run")
    period = float(run.resolved.get("period", 0.0))
    if not period > 0.0:
        raise HilError(f"{path}: resolved.json: period: missing, expected seconds")
    nodes = run.arrays[SC.name]
    if "node" in (nodes.dtype.names or ()) and len(np.unique(nodes["node"])) > 1:
        raise HilError(f"{path}: several sensor nodes; a law is fitted to one")
    ways = {way: _emulated(f"{path}: {topic}", run.arrays[topic], period) for way, topic in ((THERE, SC.name), (BACK, CA.name))}
    notes = (f"{path}: the emulated network of a run, and no measured one: {run.metadata.get('experiment', '?')}",)
    return Recording(source=str(path), ways=ways, clocks=1, notes=notes)


def _emulated(said: str, draws: StructuredArray, period_s: float) -> Way:
    """A packet law says the latency of every packet; under an age law what was superseded has not come by then."""
    own = draws["mode"] != NO_MODE
    if np.isin(draws["reason"][own], (SENT, LOST, OVERFLOW)).all():
        slots = draws["packet_slot"][own]
        latency = np.where(draws["reason"][own] == SENT, draws["latency_s"][own], np.nan)
        return Way(sent_s=slots * period_s, difference_s=latency)
    slots = int(draws["slot"].max(initial=-1)) + 1
    arrived = draws[(draws["reason"] == DELIVERED) & (draws["packet_slot"] >= 0)]
    if (arrived["packet_slot"] > arrived["slot"]).any():
        raise HilError(f"{said}: a packet arrives before it is sent")
    latency, until = np.full(slots, np.nan), np.arange(slots, 0, -1, dtype=np.float64) * period_s
    newest = -1
    for slot, packet in zip(arrived["slot"].tolist(), arrived["packet_slot"].tolist()):
        if packet > newest:
            latency[packet] = (slot - packet) * period_s
            overtaken = np.arange(newest + 1, packet)
            until[overtaken] = (slot - overtaken) * period_s
            newest = packet
    return Way(sent_s=np.arange(slots, dtype=np.float64) * period_s, difference_s=latency, until_s=until)


def _probe(path: Path, run: Run) -> Recording:
    found = run.arrays[PROBE.name]
    sent, there, back = (found[name] * 1e-9 for name in ("sent_ns", "answered_ns", "received_ns"))
    came = found["received_ns"] > 0
    answered = np.flatnonzero(came)[np.argsort(there[came], kind="stable")]  # as they were sent back: some may have overtaken
    where = run.session.get("clocks", "2")
    return Recording(
        source=str(path), clocks=1 if where == "1" else 2,
        ways={THERE: Way(sent_s=sent, difference_s=np.where(came, there - sent, np.nan)),
              BACK: Way(sent_s=there[answered], difference_s=(back - there)[answered])},
        notes=(f"{path}: {int((~came).sum())} of {len(found)} round trips did not come back: on which way is not known, "
               "they are counted as lost on the way there",) if not came.all() else (),
    )  # fmt: skip


def read_can_pair(sender: Path, receiver: Path, can_id: int | None, clocks: int) -> Recording:
    """Pair the frames of two logs.

    They are the same frames in two logs of one bus, the sender's and the receiver's, by identifier and data.

    Args:
        sender, receiver: the logs (.log, .asc, .blf).
        can_id: only frames of this identifier; all by default.
        clocks: 1 if both programs read one clock, else 2.

    Raises:
        HilError: a log cannot be read, has no such frame, or its frames repeat and some were lost, so that none can be paired.
    """
    there, here = ([*_frames(path, can_id)] for path in (sender, receiver))
    for path, frames in ((sender, there), (receiver, here)):
        if not frames:
            which = "" if can_id is None else f" of identifier {can_id:#x}; what a log writes as 123 is --can-id 0x123"
            raise HilError(f"{path}: no frame{which}")
    counts, seen = Counter(key for key, _ in there), Counter(key for key, _ in here)
    broken = next((key for key, n in counts.items() if n > 1 and seen[key] != n), None)
    if broken is not None:
        raise HilError(
            f"{sender}: frame {broken[0]:#x} with the same data is there {counts[broken]} times, in {receiver} {seen[broken]} "
            "times: which was lost cannot be said; expected frames that differ, by a counter, or another --can-id"
        )
    came: dict[tuple[int, bytes], list[float]] = {}
    for key, t_s in here:
        came.setdefault(key, []).append(t_s)
    for times in came.values():
        times.reverse()
    sent = np.array([t_s for _, t_s in there])
    received = np.array([came[key].pop() if came.get(key) else np.nan for key, _ in there])
    if np.isnan(received).all():
        raise HilError(f"{sender} and {receiver}: no frame is in both; expected two logs of one bus at one time")
    others, both = sum(map(len, came.values())), np.flatnonzero(~np.isnan(received))
    outside, inside = len(sent) - 1 - int(both[-1]) + int(both[0]), slice(int(both[0]), int(both[-1]) + 1)
    sent, received = sent[inside], received[inside]
    if ".asc" in (sender.suffix, receiver.suffix) and np.nanmin(received - sent) < 0.0:
        raise HilError(
            f"{sender} and {receiver}: a frame is there before it was sent: the times of an .asc count from the beginning of "
            "its own file; expected two .log or two .blf"
        )
    notes = [f"{int(np.isnan(received).sum())} of {len(sent)} frames are in {sender} alone: lost"]
    if outside:
        notes.append(f"{outside} frames of {sender} come before the first or after the last that is in both: {receiver} may not "
                     "have run yet, or no more; left out")  # fmt: skip
    if others:
        notes.append(f"{others} frames are in {receiver} alone: left out")
    return Recording(
        source=f"{sender} and {receiver}", ways={THERE: Way(sent_s=sent, difference_s=received - sent)}, clocks=clocks,
        notes=tuple(notes),
    )  # fmt: skip


def _frames(path: Path, can_id: int | None):  # type: ignore[no-untyped-def]
    last = -np.inf
    for number, frame in enumerate(can_frames(path)):
        if number >= MOST_FRAMES:
            raise HilError(f"{path}: more than {MOST_FRAMES} frames")
        if frame.is_error_frame or frame.is_remote_frame:
            continue
        if frame.timestamp < last:
            raise HilError(f"{path}: frame {number}: time stamps run backwards, from {last:.6f} to {frame.timestamp:.6f}")
        last = frame.timestamp
        if can_id is None or frame.arbitration_id == can_id:
            yield (frame.arbitration_id, bytes(frame.data)), frame.timestamp
