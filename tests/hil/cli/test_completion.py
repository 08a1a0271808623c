"""Completion: what the shell is offered, through the script that it reads."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hil.cli.completion import SHELLS, script
from hil.experiment import shipped
from tests.hil.cli.conftest import Hil

Offered = Callable[..., list[list[str]]]


@pytest.fixture
def offered(cli: Hil, monkeypatch: pytest.MonkeyPatch) -> Offered:
    """Return for each line what is offered for its last word, as bash asks for it."""

    def asked(line: str) -> list[str]:
        for name, value in (("_HIL_COMPLETE", "bash_complete"), ("COMP_WORDS", line), ("COMP_CWORD", str(line.count(" ")))):
            monkeypatch.setenv(name, value)
        status, out, _ = cli()
        assert status == 0
        return [each.partition(",")[2] for each in out.splitlines() if each]

    return lambda *lines: list(map(asked, lines))


def test_commands_experiments_and_keys_are_offered(offered: Offered) -> None:
    commands, experiments, keys, laws, nothing = offered(
        "hil re", "hil run dc-motor-h", "hil run dc-motor-hinf --set plant.", "hil sweep dc-motor-hinf --set network.sc.law",
        "hil run no-such --set plant.",
    )  # fmt: skip
    assert {"replay", "report", "reproduce", "recover"} <= set(commands)
    assert {"dc-motor-hinf", "dc-motor-h2"} <= set(experiments)
    grid, bounds, controllers, topics = offered(
        "hil sweep dc-motor-hinf --grid per", "hil sweep dc-motor-hinf --range plant.ga", "hil list controllers des",
        "hil guide vc",
    )  # fmt: skip
    assert grid == ["period="] and bounds == ["plant.gain="] and controllers == ["designed"] and topics == ["vcan"]
    assert {"plant.gain=", "plant.friction.coulomb_v="} <= {*keys} and "network.sc.law.matrix=" in laws and nothing == []


@pytest.mark.parametrize("shell", SHELLS)
def test_install_writes_below_the_home_only(cli: Hil, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: str) -> None:
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
    status, out, _ = cli("completion", "install", shell)
    (written,) = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert status == 0 and str(written) in out and written.read_text() == script(shell)
    assert "_HIL_COMPLETE" in written.read_text()
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", "~")  # as for a user whom the machine does not know
    status, _, err = cli("completion", "install", shell)
    assert status == 2 and err.startswith("hil: ") and "Set HOME, or XDG_" in err


@pytest.mark.parametrize(("shell", "begins"), [("/bin/zsh", "#compdef hil"), ("/bin/tcsh", "_hil_completion() {"), ("", "_hil")])
def test_the_script_is_for_the_running_shell_and_for_bash_where_it_is_another(
    cli: Hil, shell: str, begins: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SHELL", shell)
    assert cli("completion", "show")[1].strip().startswith(begins)


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_takes_the_script(tmp_path: Path) -> None:
    (tmp_path / "hil").write_text(f"#!/bin/sh\nexec {sys.executable} -m hil \"$@\"\n")
    (tmp_path / "hil").chmod(0o755)
    (tmp_path / "script").write_text(script("bash"))
    ask = (
        f"source {tmp_path}/script; complete -p hil; compopt() {{ :; }}\n"
        "COMP_WORDS=(hil run dc-motor-hinf --set plant.ga); COMP_CWORD=4; _hil_completion hil; echo ${COMPREPLY[@]}"
    )
    done = subprocess.run(
        ["bash", "--norc", "-c", ask], env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert "_hil_completion hil" in done.stdout and done.stdout.splitlines()[-1] == "plant.gain="


def test_completion_runs_nothing_that_an_experiment_names(offered: Offered, tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    (tmp_path / "evil.py").write_text(f"open({str(ran)!r}, 'w').close()\n")
    motor = shipped()["dc-motor-hinf"].read_text()
    experiment = tmp_path / "e.toml"
    for plant in ('kind = "evil:Plant"\nmass = 1.0', 'kind = "fmu"\nfile = "evil.fmu"'):
        experiment.write_text(motor.replace('kind = "dc-motor"', plant).replace('measures = ["', 'measures = ["evil:x", "'))
        keys, limits = offered(f"hil run {experiment} --set plant.", f"hil run {experiment} --set limits.after")
        assert "plant.kind=" in keys and limits == ["limits.after_trip="] and not ran.exists()
    assert {"plant.file=", "plant.measured="} <= set(keys)


def test_completion_offers_no_key_that_a_shell_would_run(offered: Offered, tmp_path: Path) -> None:
    keys = ("$(touch ran)", "`touch ran`", "a;touch ran", "x\\nplain,$(touch ran)", "\\u001b[2J", "a b", "*")
    lines = "".join(f'"{key}" = 1\n' for key in keys)
    experiment = tmp_path / "e.toml"
    experiment.write_text(f"{lines}seed = 3\n[plant]\n{lines}good-key_1 = 2\n")
    everything, plant = offered(f"hil run {experiment} --set ", f"hil run {experiment} --set plant.")
    assert plant == ["plant.good-key_1="] and "seed=" in everything
    assert [key for key in everything if set(key) & set("$`;*, \x1b") or "touch" in key] == []


@pytest.mark.parametrize(("asked", "words", "message"), [
    ("bash_complete", {}, "_HIL_COMPLETE: 'bash_complete' without COMP_WORDS"),
    ("fish_complete", {"COMP_WORDS": "hil "}, "_HIL_COMPLETE: 'fish_complete' without COMP_CWORD"),
    ("zsh_complete", {"COMP_WORDS": "hil ", "COMP_CWORD": "one"}, "COMP_CWORD: 'one'"),
    ("1", {}, "_HIL_COMPLETE: '1'; expected bash_complete"),
])  # fmt: skip
def test_a_question_that_no_script_asks_is_one_line(
    cli: Hil, monkeypatch: pytest.MonkeyPatch, asked: str, words: dict[str, str], message: str
) -> None:
    for name in ("COMP_WORDS", "COMP_CWORD"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"_HIL_COMPLETE": asked, **words}.items():
        monkeypatch.setenv(name, value)
    status, out, err = cli("list")
    assert status == 2 and out == "" and err.startswith(f"hil: {message}") and err.count("\n") == 1
