"""What a foreign controller answers is what it answered when its log was recorded; a change of it is shown."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from hil.cli.new_external import Language
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.read import read_run
from hil.session import run_session
from hil.session.replay.over_link import ask_process
from tests.generated_controllers import c_on_hil, generate, runs
from tests.process_replay import DATA, PROGRAMS, answering, asked
from tests.warm_hil import hil_command

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_foreign_controller_answers_as_in_its_log(name: str) -> None:
    found = asked(name)
    assert found.different == 0 and found.compared >= 35, [str(each) for each in found.differences]


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        (r"GAIN, PERIOD_NS = -0\.08,", "GAIN, PERIOD_NS = -0.0801,", "rows"),
        (r"echo, asked, sent = asked", "echo, asked, sent = (asked if seq == 0xFFFFFFFF else sha256())", "echo"),
        (r"y, sample_ns = values\[0\], stamp", "y, sample_ns = values[0], 0", "sample_ns"),
        (r"if flags & 0x40:", "if flags & 0x40 or seq == 7:", "answer"),
    ],
)
def test_a_change_of_the_program_is_named_by_slot_and_field(old: str, new: str, field: str, tmp_path: Path) -> None:
    text, changed = re.subn(old, new, PROGRAMS["foreign_controller"].read_text())
    assert changed == 1
    (tmp_path / "changed.py").write_text(text)
    with answering(tmp_path / "changed.py") as uri:
        found = ask_process(read_run(DATA / "foreign_controller.mcap"), uri, patience_s=5.0)
    assert found.different and field in {each.field for each in found.differences}, found
    assert f" {field} = " in "".join(map(str, found.differences))


def test_the_command_says_each_difference_and_has_a_status(tmp_path: Path) -> None:
    log = DATA / "foreign_controller.mcap"
    with answering(PROGRAMS["foreign_controller"]) as uri:
        done = hil_command("replay", str(log), "--process", uri, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "") and re.fullmatch(r"0 of \d+ answers differ\n", done.stdout)
    (tmp_path / "changed.py").write_text(PROGRAMS["foreign_controller"].read_text().replace("-0.08,", "0.5,"))
    with answering(tmp_path / "changed.py") as uri:
        done = hil_command("replay", str(log), "--process", uri, "--json", cwd=tmp_path)
    said = json.loads(done.stdout)
    assert done.returncode == 1 and said["different"] > 20 and said["differences"][0]["field"] == "rows"


def test_our_own_controller_answers_again_as_it_did(tmp_path: Path) -> None:
    """The recorded nonces are a chain, which our controller checks: the question before them is made of the first."""
    changes = ["duration=2", "reference.0.at=0.2", "limits.watchdog_slots=40"]
    experiment = load_experiment("dc-motor-hinf", changes)
    log = tmp_path / "own.mcap"
    run_session(experiment, clock="real", link="can:hil:ownreplay", path=log)
    program = [sys.executable, "-m", "hil", "controller", "dc-motor-hinf", "--link", "can:hil:ownreplay"]
    program += [word for each in changes for word in ("--set", each)]
    with subprocess.Popen(program, stderr=subprocess.DEVNULL) as process:
        try:
            found = ask_process(read_run(log), "can:hil:ownreplay")
        finally:
            process.terminate()
    assert found.different == 0 and found.compared > 20, [str(each) for each in found.differences]


@pytest.mark.parametrize("language", ["python", "c"])
def test_a_generated_program_answers_as_our_own_did_however_often_it_is_asked(tmp_path: Path, language: Language) -> None:
    """Its own state is that of every new session: a second replay was answered by the state that the first one had left."""
    experiment = load_experiment("dc-motor-ours-memory", ["duration=2", "reference.0.at=0.2", "limits.watchdog_slots=40"])
    log, channel = tmp_path / "own.mcap", f"again{language}"
    run_session(experiment, clock="real", link=f"can:hil:{channel}", path=log)
    loop = compose(experiment)
    words = generate(tmp_path, loop, language)
    with runs([*words, channel]) if language == "python" else c_on_hil(words, loop, channel):
        for _ in range(2):
            found = ask_process(read_run(log), f"can:hil:{channel}")
            assert found.different == 0 and found.compared > 20, [str(each) for each in found.differences]


def test_without_a_controller_it_says_so(tmp_path: Path) -> None:
    with pytest.raises(HilError, match=r"no controller answered on can:hil:nobodyreplay within 0\.2 s"):
        ask_process(read_run(DATA / "foreign_controller.mcap"), "can:hil:nobodyreplay", start_s=0.2)
