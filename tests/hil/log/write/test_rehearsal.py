"""A burst is rehearsed with the records of every kind of session, and nothing of it stays."""

import os
import resource
from pathlib import Path

import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.topics import channels_of
from hil.log.write import pump as pumping
from hil.log.write.mcap_sink import REAL_FLUSH_BYTES
from hil.log.write.pump import PumpReport, pump, rehearse


@pytest.mark.parametrize("name", ["dc-motor-1khz", "omni-1khz", "dc-motor-two-nodes"])
@pytest.mark.parametrize("on_can", [True, False])
def test_every_record_of_a_session_is_rehearsed(name: str, on_can: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    channels = channels_of(compose(load_experiment(name), certify=False), on_can=on_can)
    reports, seen, files = [], set(), os.listdir("/proc/self/fd")

    def watched(fd, sink, table) -> PumpReport:
        taps = {topic: lambda t_ns, payload, topic=topic: seen.add(topic) for topic in table}
        chunks = []
        ended = sink._writer._chunk_ended
        sink._writer._chunk_ended = lambda data, messages: (chunks.append(len(data)), ended(data, messages))
        reports.append((pump(fd, sink, table, taps=taps), chunks))
        return reports[-1][0]

    monkeypatch.setattr(pumping, "pump", watched)
    rehearse(channels)
    report, chunks = reports[0]
    assert seen == set(channels) and report.complete and report.malformed == 0 == report.dropped
    assert max(chunks) >= REAL_FLUSH_BYTES  # one that is as long as they become
    assert os.listdir("/proc/self/fd") == files
    assert not Path(os.devnull).is_file()


def test_a_rehearsal_for_which_no_descriptor_is_left_costs_nothing() -> None:
    """It runs in the thread that keeps the log: what it raised would cost the log of the session."""
    channels = channels_of(compose(load_experiment("dc-motor-1khz"), certify=False))
    before, files = resource.getrlimit(resource.RLIMIT_NOFILE), os.listdir("/proc/self/fd")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(map(int, files)) + 8, before[1]))
    taken: list[int] = []
    try:
        with pytest.raises(OSError, match="Too many open files"):
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        rehearse(channels)  # none for the pipe
        for fd in (taken.pop(), taken.pop()):
            os.close(fd)
        rehearse(channels)  # none for the log
    finally:
        for fd in taken:
            os.close(fd)
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
    assert os.listdir("/proc/self/fd") == files
