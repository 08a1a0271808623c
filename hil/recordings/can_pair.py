"""One CAN bus seen twice: the same frames in two logs, the sender's and the receiver's, by identifier and data."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from hil.errors import HilError
from hil.log.read.can_log import can_frames
from hil.recordings.recording import THERE, Recording, Way

MOST_FRAMES = 5_000_000


def read_can_pair(sender: Path, receiver: Path, can_id: int | None, clocks: int) -> Recording:
    """Pair the frames of two logs.

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
            raise HilError(f"{path}: no frame{'' if can_id is None else f' of identifier {can_id:#x}'}")
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
    others = sum(map(len, came.values()))
    notes = [f"{int(np.isnan(received).sum())} of {len(sent)} frames are in {sender} alone: lost"]
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
