"""A link is probed with our own frames, and its log is read back; the other end must be there."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from hil.log.read.run import read_run
from hil.log.recordings.read import read_recording
from hil.log.recordings.recording import packet_records
from tests.hil.cli.conftest import Hil, cli

__all__ = ["cli"]


def test_a_probed_link_gives_both_directions(cli: Hil, tmp_path: Path) -> None:
    status, _, err = cli("probe", f"can:hil:probe-{os.getpid()}", "--both", "--seconds", "2", "--rate", "200", "-o", "link.mcap")
    assert status == 0, err
    assert "one clock" in err
    records, _ = packet_records(read_recording([tmp_path / "link.mcap"]))
    run = read_run(tmp_path / "link.mcap")
    found = run.arrays["/probe/packet"]
    assert len(found) == 400
    assert (np.diff(found["sent_ns"]) > 0).all()
    came = found["received_ns"] > 0
    assert came.mean() > 0.5
    both = records["sc"].latency_s[came] + records["ca"].latency_s
    np.testing.assert_allclose(both, (found["received_ns"] - found["sent_ns"])[came] * 1e-9, atol=1e-9)
    assert (both > 0).all()
    status, _, err = cli("probe", "can:hil:other", "--both", "-o", "link.mcap")
    assert status == 2 and "exists already" in err


def test_without_another_end_nothing_is_written(cli: Hil, tmp_path: Path) -> None:
    status, _, err = cli("probe", f"can:hil:alone-{os.getpid()}", "--seconds", "1", "-o", "link.mcap")
    assert status == 2
    assert "hil probe --answer" in err
    assert not (tmp_path / "link.mcap").exists()
    for link in ("local:", "memory:", "cann:hil:x"):
        assert cli("probe", link, "-o", "link.mcap")[0] == 2
    assert cli("probe", "can:hil:x", "--answer", "--both")[0] == 2
