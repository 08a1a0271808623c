"""`hil run`: what it prints, its statuses, and what it refuses before anything is written."""

from __future__ import annotations

import json
import os
import re
import signal
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.log.read import read_run
from tests.hil.cli.conftest import Hil
from tests.waiting import LIMIT_S, until


def test_a_run_in_virtual_time_names_no_link(cli: Hil) -> None:
    _, out, _ = cli("run", "dc-motor-hinf", "--duration", "1")
    assert "dc-motor-hinf, seed 0, virtual time\n" in out and "memory:" not in out


def test_json_holds_every_promised_key(cli: Hil) -> None:
    status, out, _ = cli("run", "dc-motor-hinf", "--duration", "4", "--seed", "3", "--json")
    summary = json.loads(out)
    assert status == 0
    assert {"experiment", "seed", "clock", "link", "slots", "duration_s", "wall_s"} <= set(summary)
    metrics = {"sse", "sse_after_5s", "overshoot", "settling_time_s", "steady_state_error", "max_abs_u"}
    assert metrics <= set(summary["metrics"])
    for side in ("sc", "ca"):
        keys = {"law", "mode_counts", "transition_counts", "p_value", "lost", "late", "duplicated"}
        assert keys <= set(summary["network"][side])
    assert {"valid", "scheduler", "lateness_us", "round_trip_us", "overruns"} <= set(summary["timing"])
    assert {"path", "sha256", "messages", "dropped"} <= set(summary["log"])
    assert (summary["seed"], summary["slots"]) == (3, 80)


def test_a_second_run_takes_another_name_and_no_log_is_overwritten(cli: Hil, tmp_path: Path) -> None:
    for _ in range(2):
        assert cli("run", "dc-motor-hinf", "--duration", "1")[0] == 0
    _, second = sorted(tmp_path.glob("runs/*.mcap"))
    assert {path.name for path in tmp_path.glob("runs/*")} == {f"dc-motor-hinf-virtual-seed0{n}.mcap" for n in ("", "-2")}
    before = second.read_bytes()
    status, _, err = cli("run", "dc-motor-hinf", "--duration", "2", "-o", second)
    assert status == 2 and "exists already; choose another -o or add --force" in err and second.read_bytes() == before
    status, _, err = cli("run", "dc-motor-hinf", "--duration", "1s", "-o", ".")
    assert status == 2 and ".: exists already; expected a new file: it is no regular one" in err
    assert cli("run", "dc-motor-hinf", "--duration", "2", "-o", second, "--force")[0] == 0


def test_safety_ends_the_local_gain_with_status_3(cli: Hil) -> None:
    status, out, _ = cli("run", "dc-motor-local")
    assert status == 3 and "safe state" in out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nosuch"], "no experiment 'nosuch'"),
        ([""], "no experiment is named"),
        (["."], "is a folder"),
        (["n" * 300], "File name too long"),
        (["/dev/zero"], "is no regular file"),
        (["dc-motor-hinf", "--duration", "nan"], "duration: 'nan' is not a duration"),
        (["dc-motor-hinf", "--duration", "inf"], "duration: 'inf' is not a duration"),
        (["dc-motor-hinf", "--duration", "-1"], "duration: -1 s is shorter"),
        (["dc-motor-hinf", "--seed", "-1"], "seed: -1"),
        (["dc-motor-hinf", "--set", "plant.gian=1"], "did you mean 'gain'?"),
        (["dc-motor-hinf", "--link", "can:hil:rig0"], "--clock real"),
        (["dc-motor-hinf", "--link", ""], "--clock real"),
        (["dc-motor-hinf", "--clock", "real", "--link", ""], "link '': no scheme"),
        (["dc-motor-hinf", "--clock", "real", "--link", "memory:"], "lies within one process"),
        (["dc-motor-hinf", "--clock", "real", "--link", "can:virtual:a"], "lies within one process; expected a link between two"),
        (["dc-motor-hinf", "--clock", "real", "--external", "--link", "can:virtual:a"], "lies within one process"),
        (["dc-motor-hinf", "-o", "x" * 300 + ".mcap"], "File name too long"),
        (["dc-motor-hinf", "-o", "new/" + "x" * 300 + ".mcap"], "File name too long"),
        (["dc-motor-hinf", "-o", "/proc/self/x/y.mcap"], "cannot be"),
        (["dc-motor-hinf", "-o", "a/b/c.mcap", "--set", "network.sc.law={kind='constant', age=9}"], "the links reach tau = 9"),
        (["dc-motor-hinf", "-o", ".", "--force"], "Is a directory"),
    ],
)
def test_bad_input_is_one_message_status_2_and_nothing_written(
    cli: Hil, tmp_path: Path, arguments: list[str], says: str
) -> None:
    status, out, err = cli("run", *arguments)
    assert (status, out) == (2, "")
    assert says in err and "Traceback" not in err
    assert [*tmp_path.iterdir()] == []


LARGE = [[[[200.0 * (l == i) for l in range(4)]]] for i in range(4)]
GAINS = "controller={kind='historical', uses='current-packet', gains=%s}"


@pytest.mark.parametrize(
    ("sets", "says"),
    [
        (["network.nodes.second.buffer=2"], "controller.gains[0][5][0][1]: -0.0201, expected 0: in this phase"),
        (["network.nodes.second.buffer=7"],
         "network.nodes.second.buffer: 7 samples that are 0 slots late, but the gains reach back 5"),
        (["network.nodes.second.id=0"], "network.nodes.second.id: 0 is the number of node 'first' already"),
        (["network.nodes.second.can_id=0x110", "network.nodes.third.can_id=0x110"],
         "network.nodes.third.can_id: 0x110 is the identifier of node 'second' already"),
        ([GAINS % [[[[1.0] * 3]]]], "controller.gains: 1 x 3 matrices, expected 1 x 4: inputs and outputs"),
        ([GAINS % LARGE, *(f"network.nodes.{n}.buffer=1" for n in ("first", "second", "third", "fourth"))], "refused: E|X|^2 of"),
        (["network.media.bus={kind='random', nodes=['first', 'second', 'third', 'fourth'], matrix=[[1.0]]}"],
         "network.media.bus.matrix: 1 rows"),
    ],
)
def test_bad_gains_and_nodes_are_refused_by_their_entry_and_nothing_is_written(
    cli: Hil, tmp_path: Path, sets: list[str], says: str
) -> None:
    status, out, err = cli("run", "multisensor-published", *[word for each in sets for word in ("--set", each)])
    assert (status, out) == (2, "")
    assert says in err and "Traceback" not in err
    assert [*tmp_path.iterdir()] == []


def test_a_virtual_run_that_is_interrupted_closes_its_log(cli: Hil, tmp_path: Path) -> None:
    log = tmp_path / "long.mcap"

    def interrupt() -> None:
        until(lambda: log.exists() and log.stat().st_size > 100_000, "the log to grow")
        os.kill(os.getpid(), signal.SIGINT)

    beside = Thread(target=interrupt)
    beside.start()
    status, out, _ = cli("run", "dc-motor-hinf", "--duration", "100 h", "-o", log)
    beside.join()
    assert status == 130 and "interrupted" in out
    assert any(e["kind"] == "interrupted" for e in read_run(log).events)


def test_external_link_that_cannot_be_opened_leaves_no_log(cli: Hil, tmp_path: Path) -> None:
    link = ("--clock", "real", "--external", "--link", "can:socketcan:no-such-can")
    status, _, err = cli("run", "dc-motor-hinf", *link, "-o", "x.mcap")
    assert status == 2 and "no-such-can" in err
    assert list(tmp_path.iterdir()) == []


AGED = "network.sc.law={kind='constant', age=9}"


@pytest.mark.parametrize("refused", [("-o", "x.html"), ("--link", "local:"), ("--set", AGED)])
def test_a_rig_that_is_refused_waits_for_nobody(cli: Hil, tmp_path: Path, refused: tuple[str, str]) -> None:
    status, _, err = cli("rig", "dc-motor-hinf", "--link", "can:hil:refused", *refused)
    assert status == 2 and "waiting" not in err and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_runs_at_the_same_time_get_a_log_each(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hil", "run", "dc-motor-hinf", "--duration", "2", "--json"]
    runs = [subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) for _ in range(4)]
    paths = {json.loads(run.communicate(timeout=LIMIT_S)[0])["log"]["path"] for run in runs}
    assert len(paths) == 4 and all((tmp_path / path).stat().st_size > 1000 for path in paths)


def test_the_summary_says_units_certificate_and_every_output_on_eighty_columns(cli: Hil) -> None:
    for name, unit in (("vtol-ours-h2", "kn² s"), ("dc-motor-local", "rad² s")):
        status, out, err = cli("run", name, "--duration", "2", "--set", "allow_uncertified=true")
        assert status in (0, 3), err
        assert max(map(len, out.splitlines())) <= 80 and "{" not in out
        assert "certificate" in out and re.search(rf"^squared tracking error   \S+ {unit}$", out, re.M)


def test_a_run_whose_timing_is_not_valid_says_why() -> None:
    from hil.cli.page_text import timing_rows
    from hil.measure.summary import timing_metrics

    late = np.array([0, 1, 1])
    timing = timing_metrics(np.full(3, 10.0), np.full(3, np.nan), late, np.zeros(3), period_s=1e-3)
    timing["scheduler"] = "SCHED_FIFO 60"
    assert timing_rows(timing)[0] == ("timing", "NOT VALID: 2 of 3 slots had no answer in time; SCHED_FIFO 60")


def test_live_shows_what_it_is_asked_for(cli: Hil, tmp_path: Path, hil_log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[Any, dict[str, Any]]] = []

    def shown(what: Any, *_: object, opened: Callable[[Any], None], **about: Any) -> int:
        opened(SimpleNamespace(url="http://here", url_once=lambda: "http://once"))
        seen.append((what, about))
        return 0

    launched: list[str] = []
    monkeypatch.setattr("click.launch", launched.append)
    monkeypatch.setattr("hil.pages.live.watch.watch", shown)
    monkeypatch.setattr("hil.pages.live.watch.show_log", shown)
    words = ("--seed", "3", "--duration", "1", "--speed", "2", "--port", "9", "--paused")
    assert cli("live", "dc-motor-h2", "dc-motor-hinf", *words) == (0, "", "open http://here\n")
    ((asked, about),) = seen
    assert [(each.load(None).name, each.speed, each.paused, each.clock) for each in asked] == [
        (name, 2.0, True, "virtual") for name in ("dc-motor-h2", "dc-motor-hinf")
    ]
    assert [asked[0].load(again).seed for again in (None, 8)] == [3, 8] and about["port"] == 9
    assert not [*tmp_path.rglob("*.mcap")], "what was tried is let go"
    assert cli("live", hil_log)[2] == "open http://here\n" and len(seen[1][0].events) > 0 and not launched
    assert cli("live", hil_log, "--open")[0] == 0 and launched == ["http://once"]
    for more in (("--foxglove", "0"), ("--script", "a.toml")):
        assert "a log is shown alone" in cli("live", hil_log, *more)[2]


def test_a_script_whose_change_is_refused_leaves_no_log(cli: Hil, tmp_path: Path) -> None:
    script = tmp_path / "changes.jsonl"
    script.write_text('{"slot": 5, "field": "plant.gain", "value": "x"}\n')
    words = ("live", "dc-motor-local", "--duration", "0.5", "--script", script, "-o", tmp_path / "a.mcap")
    assert cli(*words)[::2] == (2, "hil: change: resolved experiment: plant.gain: expected a number, got text 'x'\n")
    assert [path.name for path in tmp_path.glob("*.mcap")] == []


def test_a_device_that_takes_no_log_stays(cli: Hil, tmp_path: Path) -> None:
    device = tmp_path / "full"
    try:
        os.mknod(device, stat.S_IFCHR | 0o666, os.makedev(1, 7))  # not that of the machine
    except PermissionError:
        pytest.skip("needs to make a device: CAP_MKNOD")
    status, _, reported = cli("run", "dc-motor-hinf", "--duration", "1", "-o", device, "--force")
    assert status == 2 and "No space left" in reported
    assert device.is_char_device()
