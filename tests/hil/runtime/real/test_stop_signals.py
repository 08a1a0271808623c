"""What a process was started to ignore it goes on ignoring; any other of the three stops a session in order."""

from __future__ import annotations

import signal

import pytest

from hil.runtime.real.ending import StopSignals

THREE = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.mark.parametrize("ignored", [signal.SIGINT, signal.SIGHUP])
def test_what_is_ignored_stays_ignored_and_sigterm_still_stops(ignored: int) -> None:
    before = signal.signal(ignored, signal.SIG_IGN)
    try:
        with StopSignals() as signals:
            signal.raise_signal(ignored)
            assert signals.seen is None
            signal.raise_signal(signal.SIGTERM)
            assert signals.seen == signal.SIGTERM
        assert signal.getsignal(ignored) == signal.SIG_IGN
    finally:
        signal.signal(ignored, before)


@pytest.mark.parametrize("number", THREE)
def test_each_stops_and_every_handler_comes_back(number: int) -> None:
    before, reported = [signal.getsignal(each) for each in THREE], []
    with StopSignals(reported.append) as signals:
        signal.raise_signal(number)
    assert signals.seen == number and reported == [number]
    assert [signal.getsignal(each) for each in THREE] == before
