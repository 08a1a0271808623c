"""The frame of the command line, and the small commands."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from hil.cli import COMMANDS
from hil.cli import doctor as doctor_page
from hil.cli.terminal import visible
from hil.experiment import shipped
from tests.hil.cli.conftest import Hil
from tests.waiting import until


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_and_refuses_an_unknown_option(cli: Hil, command: str) -> None:
    status, out, _ = cli(command, "--help")
    assert status == 0 and out.startswith(f"Usage: hil {command}")
    status, _, err = cli(command, "--nosuch")
    assert status == 2 and "--nosuch" in err


def test_a_mistyped_command_is_guessed(cli: Hil) -> None:
    status, _, err = cli("rum")
    assert status == 2 and "Did you mean 'run'?" in err


def test_list_names_all_that_ships(cli: Hil) -> None:
    found = json.loads(cli("list", "--json")[1])
    assert set(found["experiments"]) == set(shipped())
    assert {"hinf", "h2", "local", "smith", "constant"} <= set(found["plugins"]["controllers"])
    text = cli("list")[1]
    assert "dc-motor-hinf" in text and "semi-markov" in text


def test_schema_is_json_and_knows_the_tables(cli: Hil) -> None:
    out = cli("schema")[1]
    schema = json.loads(out)
    assert out.startswith('{\n  "'), "people read it, too"
    assert schema["$schema"].startswith("https://json-schema.org/") and "plant" in schema["properties"]


def test_doctor_gives_a_remedy_for_all_that_is_missing(
    doctor: list[dict[str, Any]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever this machine has at this moment: what is printed is what was found."""
    monkeypatch.setenv("COLUMNS", "80")
    assert {"package ownership", "clock", "SocketCAN"} <= {check["what"] for check in doctor}
    assert [check["what"] for check in doctor if not check["ok"] and not check["remedy"]] == []
    for check in doctor:
        doctor_page.show([(check["what"], check["ok"], check["finding"], check["remedy"])])
        shown = capsys.readouterr().out
        assert shown.startswith("ok  " if check["ok"] else "missing  ")
        assert ("remedy: " in shown) == bool(check["remedy"])
        reported = f"{shown[:7]} {check['what']}: {check['finding']}" + (f" remedy: {check['remedy']}" if check["remedy"] else "")
        assert shown.split() == visible(reported).split()
        assert all(len(line) <= 80 or len(line.split()) == 1 for line in shown.splitlines())  # a path is never cut


def test_doctor_prints_a_line_for_every_check(cli: Hil, doctor: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_page, "_zenoh_cpus", lambda: (True, "not measured", ""))
    status, out, _ = cli("doctor", "--link", "can:socketcan:can0")
    assert status == 0 and all(f"{check['what']}: " in out for check in doctor)


def test_doctor_names_the_possible_commanders_in_one_line(doctor: list[dict[str, Any]]) -> None:
    (line,) = (check for check in doctor if "commands accepted" in str(check))
    assert "commands accepted from" in line.values() and "anyone on the CAN bus can0" in str(line)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["rig", "nosuch"], "no experiment 'nosuch'"),
        (["rig", "dc-motor-hinf", "--link", "foo:bar"], "no link is called 'foo'"),
        (["rig", "dc-motor-hinf", "--wait", "0"], "--wait: 0; expected more than 0 s"),
        (["rig", "dc-motor-hinf", "--wait", "0.2", "--link", "can:hil:nobodyrig"], "no controller answered on can:hil:nobodyrig"),
        (["run", "dc-motor-hinf", "--wait", "9"], "--wait: only with --external"),
        (["run", "dc-motor-hinf", "--seed", str(2**87)], "seed: an integer of 88 bits, at most 64 are allowed\n"),
        (["run", "dc-motor-hinf", "--seed", str(2**63)], "seed: 9223372036854775808 is not between 0 and 2^63 - 1"),
        (["controller", "nosuch"], "no experiment 'nosuch'"),
        (["controller", "dc-motor-hinf", "--link", ""], "link '': no scheme"),
        (["controller", "dc-motor-hinf", "--link", "foo:bar"], "no link is called 'foo'"),
        (["controller", "dc-motor-hinf", "--link", "local:"], "the controller runs in the rig's own process"),
        (["laws", "nosuch"], "no experiment 'nosuch'"),
        (["bench", "nosuch"], "nosuch"),
        (["bench", "timing", "--duration", "-1"], "'--duration': -1 s"),
        (["bench", "links", "--duration", "nan"], "'--duration': 'nan' is not a duration"),
        (["bench", "links", "--rate", "0"], "'--rate': 0.0 is not a number from 1 to 100000"),
        (["bench", "links", "--rate", "1e300"], "'--rate': 1e+300 is not a number from 1 to 100000"),
        (["bench", "links", "--rate", "1e-300"], "'--rate': 1e-300 is not a number"),
        (["bench", "timing", "--duration", "1e9"], "'--duration': 1e+09 s, expected a duration from 0.001 s"),
        (["reproduce", "ch1"], "is not one of ch2"),
        (["reproduce", "ch2", "-o", "no/x.html"], "no folder no"),
    ],
)
def test_bad_input_is_one_message_and_status_2(cli: Hil, arguments: list[str], says: str) -> None:
    status, out, err = cli(*arguments)
    assert (status, out) == (2, "") and says in err and "Ctrl-C" not in err
    assert says.count("\n") in (0, err.count("\n"))  # one fault, one line


def test_a_file_that_is_not_there_is_answered_with_the_one_that_is_near(cli: Hil) -> None:
    Path("my_cart.toml").write_text("")
    assert "did you mean 'my_cart.toml'?" in cli("run", "my-cart.toml")[2]
    assert "did you mean 'dc-motor-hinf'?" in cli("run", "dc-motor-hinf.toml")[2]


def test_an_interrupted_command_says_so_in_one_line(cli: Hil, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_CAN_DIR", str(tmp_path))

    def interrupt() -> None:
        until((tmp_path / "stop").exists, "a program on the channel")
        os.kill(os.getpid(), signal.SIGTERM)

    beside = Thread(target=interrupt)
    beside.start()
    status, _, err = cli("controller", "dc-motor-hinf", "--link", "can:hil:stop")
    beside.join()
    *before, last = filter(None, err.splitlines())
    assert (status, last) == (143, "hil: interrupted")
    assert before in ([], ["hil: controller of dc-motor-hinf on can:hil:stop; Ctrl-C ends it"])


def test_ctrl_c_while_a_class_is_made_is_an_interrupt(cli: Hil, monkeypatch: pytest.MonkeyPatch) -> None:
    def load(_name: str) -> None:
        raise RuntimeError("Error calling __set_name__") from KeyboardInterrupt()

    monkeypatch.setattr("hil.cli.import_module", load)
    status, _, err = cli("list")
    assert status == 130 and err.split() == ["hil:", "interrupted"]
