"""`hil new`: what it writes runs and passes its own tests as it stands; `hil show`: the file of a shipped experiment."""

from __future__ import annotations

import ast
import os
import re
import subprocess
from pathlib import Path

import pytest

from hil.cli.guide import pages
from hil.cli.new import PARTS, files_of
from hil.experiment import load_experiment, shipped
from hil.rig import rig_of
from hil.rig.session_link import link_of
from tests.hil.cli.conftest import Hil
from tests.warm_hil import hil_command

NAMES = {"plant": "cart", "controller": "pd", "law": "calm", "measure": "effort", "experiment": "first-try"}


def test_every_part_is_written_runs_and_passes_its_own_tests(cli: Hil, tmp_path: Path) -> None:
    for part, name in NAMES.items():
        status, out, err = cli("new", part, name, "-o", "mine")
        assert status == 0, err
        assert f"hil run mine/{name.replace('-', '_')}.toml" in out
        status, _, err = cli("run", f"mine/{name.replace('-', '_')}.toml", "--duration", "1")
        assert status == 0, err
    words, env = ("-q", "-p", "no:cacheprovider", "-p", "hil.api.pytest_plugin"), {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = hil_command(*words, "mine", cwd=tmp_path, program="pytest", env=os.environ | env)
    assert done.returncode == 0, done.stdout + done.stderr
    written = "".join(path.read_text() for path in Path("mine").glob("test_*.py"))
    assert f"{len(re.findall('^def test_', written, re.M))} passed" in done.stdout


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("plant", "9"), "expected lower-case letters"),
        (("plant", "../cart"), "expected lower-case letters"),
        (("plant", "Cart"), "expected lower-case letters"),
        (("law", "numpy"), "take another: hil new law my_numpy"),
        (("law", "class"), "take another: hil new law my_class"),
        (("law", "json"), "take another: hil new law my_json"),
        (("plant", "design"), "take another: hil new plant my_design"),
        (("plant", "hil"), "take another: hil new plant my_hil"),
        (("plant", "conftest"), "take another: hil new plant my_conftest"),
        (("plant", "a" * 10_000), "expected lower-case letters"),
        (("plant", "\u0430bc"), "expected lower-case letters"),
        (("plant", "cart\n"), "expected lower-case letters"),
        (("plant", "cart", "-o", "b/" * 3000), "no path to a file: File name too long"),
        (("part", "x"), "is not one of"),
        (("plant", "cart", "--language", "c"), "for a controller, not for a plant"),
        (("controller", "pd", "--keyed"), "only for a program (--language python or c)"),
        (("controller", "pd", "--link", "can"), "only for a program (--language python or c)"),
        (("controller", "pd", "--for", "omni-1khz"), "--for: only for a program (--language python or c)"),
        (("controller", "pd", "--language", "c", "--link", "zenoh"), "use --link can, or python"),
        (("controller", "pd", "--language", "c", "--for", "nosuch"), "no experiment 'nosuch'"),
    ],
)
def test_a_name_that_will_not_do_is_refused_and_nothing_is_written(cli: Hil, words: tuple[str, str], says: str) -> None:
    status, _, err = cli("new", *words)
    assert status == 2 and says in err and not list(Path().iterdir())


def test_a_program_of_its_own_is_written_for_an_experiment_and_says_what_it_lacks(cli: Hil) -> None:
    words = ("--language", "python", "--for", "dc-motor-h2", "--link", "zenoh", "--keyed")
    status, out, err = cli("new", "controller", "drive", *words)
    assert status == 0 and not err and "wrote drive.py" in out
    text = Path("drive.py").read_text()
    assert "hil rig dc-motor-h2 --link 'zenoh:tcp/127.0.0.1:7447?auth=KEYFILE'" in text and "[[-0.198]]" in text
    assert "@" not in text.replace("@property", "") and "#?" not in text and not re.search("^(import|from) hil", text, re.M)
    Path("a wall.toml").write_text(shipped()["omni-push"].read_text())
    status, out, err = cli("new", "controller", "walls", "--language", "c", "--for", "a wall.toml")
    assert status == 0 and "answers zeros until you write its law" in err and Path("packet_codes.h").is_file()
    assert "hil rig 'a wall.toml' --link " in out
    status, out, err = cli("new", "controller", "walls", "--language", "c", "--for", "omni-push")
    assert status == 2 and "exists already" in err and "note:" not in err  # of a program that is not written, nothing is said


@pytest.mark.parametrize(("language", "at"), [("python", "can:hil:rig0"), ("c", "can:socketcan:INTERFACE")])
def test_the_rig_beside_a_program_has_the_frames_that_the_program_has(cli: Hil, language: str, at: str) -> None:
    """They were those of a link by default: neither heard the other."""
    own, options = 'control_can_id = 0x2c0\nuri = "can:hil:rig7?fd=0&timed=1&base=0x200"\n', "fd=0&base=0x200&auth=KEYFILE"
    Path("classic.toml").write_text(f"{shipped()['vtol-h2'].read_text()}\n[links]\n{own}")
    status, out, err = cli("new", "controller", "drive", "--language", language, "--for", "classic.toml", "--keyed")
    assert status == 0, err
    text = "".join(path.read_text() for path in Path().glob("drive.*"))
    assert f"hil rig classic.toml --link '{at}?{options}'" in text
    assert f"hil rig classic.toml --link '{at.replace('INTERFACE', 'vcan0')}?{options}'" in out
    if language == "python":
        rig = link_of(rig_of(load_experiment("classic.toml")), f"{at}?{options}").identifiers
        assert rig is not None and f"SENSORS = {rig.sensors} " in text and f"CONTROL = {rig.control}\n" in text
    Path("classic.toml").rename("my loop.toml")
    assert cli("new", "controller", "drive", "--language", language, "--for", "my loop.toml", "-o", "more")[0] == 0
    assert f"hil rig 'my loop.toml' --link '{at}?" in "".join(path.read_text() for path in Path("more").glob("drive.*"))


def test_two_programs_of_one_folder_share_the_codes_of_their_packets_if_they_are_the_same(
    cli: Hil, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("--language", "c", "--for", "dc-motor-h2")
    assert cli("new", "controller", "one", *words)[0] == 0
    monkeypatch.setattr("time.ctime", lambda: "a second later")  # cantools dates its files
    status, out, err = cli("new", "controller", "two", *words)
    assert (status, err) == (0, "") and "wrote two.c" in out and "packet_codes.h" not in out
    Path("packet_codes.h").write_text("of other packets")
    status, _, err = cli("new", "controller", "three", *words)
    assert status == 2 and "packet_codes.h: exists already; it is of another program" in err and not Path("three.c").exists()


def test_files_that_exist_are_kept_without_force(cli: Hil) -> None:
    Path("test_cart.py").write_text("mine")
    status, _, err = cli("new", "plant", "cart")
    assert status == 2 and "test_cart.py: exists already" in err and [p.name for p in Path().iterdir()] == ["test_cart.py"]
    assert cli("new", "plant", "cart", "--force")[0] == 0 and Path("test_cart.py").read_text() != "mine"
    assert cli("new", "plant", "cart", "--force")[0] == 0  # its own module is no other one


def test_a_folder_that_cannot_be_made_is_one_message(cli: Hil) -> None:
    Path("file").write_text("")
    status, _, err = cli("new", "plant", "cart", "-o", "file/below")
    assert status == 2 and "file/below: cannot be made" in err and "Traceback" not in err


def test_the_guide_shows_what_is_written() -> None:
    shown = re.findall(r"```python\n(.*?)```", pages()["first-plugin"].read_text(encoding="utf-8"), re.S)
    parts = [part for part in PARTS if part != "experiment"]
    assert shown == [files_of(part, NAMES[part])[f"{NAMES[part]}.py"] for part in parts]


def test_show_prints_a_shipped_experiment_that_runs_as_a_file(cli: Hil) -> None:
    status, out, _ = cli("show", "dc-motor-hinf")
    assert status == 0 and out == shipped()["dc-motor-hinf"].read_text(encoding="utf-8")
    Path("mine.toml").write_text(out)
    assert cli("run", "mine.toml", "--duration", "1")[0] == 0
    status, _, err = cli("show", "dc-motor-hin")
    assert status == 2 and "did you mean 'dc-motor-hinf'?" in err
    assert "did you mean 'dc-motor-hinf'?" in cli("show", "dc-motor")[2] and "did you" not in cli("show", "nope")[2]


BEYOND = 'x"""; import os; """ "; } * int x; \''


@pytest.mark.parametrize("language", ["python", "c"])
def test_the_name_of_an_experiment_becomes_no_line_of_a_program(language: str, cli: Hil, tmp_path: Path) -> None:
    """It stands in a comment, and in the VERSION of the DBC that the codec in C is made of."""
    text = shipped()["dc-motor-hinf"].read_text()
    for folder, name in (("plain", "dc-motor-hinf"), ("hostile", BEYOND)):
        Path(folder).mkdir()
        Path(folder, "e.toml").write_text(text.replace('name = "dc-motor-hinf"', f"name = '''{name}'''"))
        status, _, err = cli("new", "controller", "mine", "-o", folder, "--language", language, "--for", f"{folder}/e.toml")
        assert status == 0, err
    for path in Path("plain").glob("mine*"):
        lines, others = (Path(folder, path.name).read_text().splitlines() for folder in ("plain", "hostile"))
        differ = [other for line, other in zip(lines, others, strict=True) if line != other]
        assert len(differ) <= 3 and not any(sign in line for line in differ[:1] for sign in ('; """', "*/ ")), differ
    if language == "python":
        found = [ast.dump(node) for node in ast.parse(Path("hostile/mine.py").read_text()).body[1:]]
        assert found == [ast.dump(node) for node in ast.parse(Path("plain/mine.py").read_text()).body[1:]]
    else:
        words = ["cc", "-std=c99", "-Wall", "-Werror", "-fsyntax-only", "-I", "hostile", "hostile/mine.c", "hostile/hilrig.c"]
        assert subprocess.run(words, capture_output=True).returncode == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--language python", ("hil rig dc-motor-hinf --link can:hil:rig0", "python drive.py rig0   # in another terminal")),
        ("--language python --link zenoh", ("--link zenoh:tcp/127.0.0.1:7447", "python drive.py tcp/127.0.0.1:7447 ")),
        ("--language c", ("cc -std=c99 -O2 -o drive drive.c hilrig.c", "--link can:socketcan:vcan0", "./drive vcan0 ")),
        ("--language c --keyed", ("./drive vcan0   # with the key: the first lines of drive.c",)),
    ],
)
def test_a_program_comes_with_the_commands_that_start_it(
    words: str, said: tuple[str, ...], cli: Hil, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, _ = cli("new", "controller", "drive", *words.split())
    assert status == 0 and all(each in out for each in said), out
