"""What README and guide show is run: Python, TOML and commands; their names and numbers are the code's."""

from __future__ import annotations

import json
import re
import shlex
import sys
import tempfile
import tomllib
import types
from collections.abc import Iterator
from contextlib import chdir
from inspect import signature
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import pytest

import hil as face
from design.controllers import LoopModel
from hil.cli import COMMANDS, cli
from hil.cli.guide import pages
from hil.design_questions.plant_uncertainty import interval
from hil.experiment import parse_experiment, shipped
from hil.measure.check import check_measure
from hil.measure.view import view_of
from hil.pages.sections import check_section
from hil.plugins.checks import check_controller
from hil.session import run_session
from plants import DCMotor, Plant, check_plant
from tests.hil.pages.runs import run_of
from tests.waiting import until
from transport import open_link

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PROSE = {"README": README, **pages()}
TEXT = {name: path.read_text(encoding="utf-8") for name, path in PROSE.items()}
PLUGINS = "own-plant-law-controller"


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.S)


def commands(text: str) -> list[list[str]]:
    """Return every `hil ...` line that a page shows, as words."""
    lines = re.findall(r"^ {4}(hil [a-z].*)$", text, re.M) + re.findall(r"^\$ (hil .*)$", text, re.M)
    return [shlex.split(line, comments=True)[1:] for line in lines]


COMMAND_LINES = [(name, words) for name, text in TEXT.items() for words in commands(text)]


def module_of(name: str, *code: str) -> dict[str, Any]:
    """Run code in a module that can be imported, so that what it makes can be pickled."""
    module = types.ModuleType(name)
    sys.modules[name] = module
    for block in code:
        exec(compile(block, name, "exec"), vars(module))
    return vars(module)


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """The plug-ins of the guide, as written there."""
    with chdir(tmp_path_factory.mktemp("guide")):
        yield module_of("guide_plugins", *blocks(TEXT[PLUGINS], "python"))
    del sys.modules["guide_plugins"]


def test_the_readme_is_short_and_no_page_is_wide() -> None:
    assert len(TEXT["README"].splitlines()) <= 120
    for name, text in TEXT.items():
        assert max(map(len, text.splitlines())) <= 130, name


def test_a_command_in_a_block_has_the_prompt_by_which_the_tests_find_it() -> None:
    for name, text in TEXT.items():
        shown = [line for block in blocks(text, "(?:console|sh|bash)") for line in block.splitlines()]
        assert not [line for line in shown if line.startswith("hil ")], name


@pytest.mark.parametrize("name", sorted(set(TEXT) - {PLUGINS}))
def test_python_of_a_page_runs(name: str, hil: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = blocks(TEXT[name], "python")
    if not code:
        return
    monkeypatch.chdir(tmp_path)
    scope = module_of(f"page_{name.replace('-', '_')}", *code)
    for key, value in list(scope.items()):
        if key.startswith("test_") and len(signature(value).parameters) == 1:  # one with a program beside it has its own test
            value(hil)
        elif key == "Damped":
            check_plant(value(rate=2.0))


def test_plug_ins_of_the_guide_pass_their_checks(shown: dict[str, Any]) -> None:
    check_plant(shown["Damped"](rate=2.0))
    check_plant(shown["Pendulum"](), period_s=0.05)
    d = shown["Damped"]().model().discretise(0.05)
    check_controller(shown["Proportional"](), LoopModel(A=d.A, B=d.B, C=d.C, period_s=0.05, tau_max=2, d_max=1))
    view = view_of(run_of("dc-motor-hinf", "duration=1"))
    assert "Measure" in check_measure(shown["Effort"](), view)[0]
    (said,) = check_section(shown["Effort"](), view)
    assert said == "Effort is a DrawsSection: the page of a run has its section, here 'Effort'"
    (entries,) = blocks(TEXT[PLUGINS], "toml")
    for group in tomllib.loads(entries)["project"]["entry-points"].values():
        assert all(target.partition(":")[2] in shown for target in group.values())


def test_the_file_of_the_guide_beside_an_experiment_is_a_plug_in(tmp_path: Path) -> None:
    (tmp_path / "my_module.py").write_text(blocks(TEXT[PLUGINS], "python")[0])
    (tmp_path / "mine.toml").write_text(shipped()["dc-motor-hinf"].read_text())
    kinds = {"plant": {"kind": "my_module:Damped"}, "controller": {"kind": "my_module:Proportional"}}
    changes = kinds | {"report.measures": ["tracking", "my_module:Effort"], "limits.state": {}, "duration": 2}
    assert face.run(tmp_path / "mine.toml", **changes).metrics["effort"] > 0


def test_the_device_of_the_guide_is_certified_at_its_wall(tmp_path: Path) -> None:
    (code,), (*_, text) = (blocks(TEXT["haptic-walls"], language) for language in ("python", "toml"))
    (tmp_path / "held.py").write_text(code)
    (tmp_path / "held.toml").write_text(text)
    session = face.run(tmp_path / "held.toml", duration=1)
    verdict = session.summary["certificate"]
    assert (session.status, verdict["state"], verdict["kind"]) == (0, "certified", "passivity")
    assert session.metrics["largest_force"] > 3.0


def test_the_plant_of_the_guide_that_is_not_linear_is_undecided_and_runs(tmp_path: Path) -> None:
    (code,) = (block for block in blocks(TEXT[PLUGINS], "python") if "class Pendulum" in block)
    (tmp_path / "pendulum.py").write_text(code)
    (tmp_path / "mine.toml").write_text(shipped()["dc-motor-hinf"].read_text())
    changes = {"plant": {"kind": "pendulum:Pendulum"}, "controller": {"kind": "local", "gain": [[-0.01]]}}
    session = face.run(tmp_path / "mine.toml", **changes, duration=2, allow_uncertified=True, **{"limits.state": {}})
    assert session.status == 0 and session.summary["certificate"]["state"] == "undecided"


def test_the_controller_of_the_guide_that_predicts_settles_sooner_than_the_published_one(shown: dict[str, Any]) -> None:
    own = face.run("dc-motor-hinf", controller=shown["Horizon"](), allow_uncertified=True, duration=10)
    published = face.run("dc-motor-hinf", duration=10)
    assert own.status == 0 and own.summary["certificate"]["state"] == "undecided"
    said = re.search(r"it settles in (\S+) s \(seed 0\), where the published gains take (\S+) s", TEXT[PLUGINS])
    assert said is not None and own.metrics["settling_time_s"] == pytest.approx(float(said[1]))
    assert published.metrics["settling_time_s"] == pytest.approx(float(said[2]))


def test_the_controller_of_the_guide_is_certified_by_its_table_and_undecided_without(tmp_path: Path) -> None:
    (code,) = (block for block in blocks(TEXT["first-plugin"], "python") if "class Pd" in block)
    begin, end = code.index("    def table("), code.index("    def start(")
    (tmp_path / "pd.py").write_text(code)
    (tmp_path / "bare.py").write_text(code[:begin] + code[end:])
    (mine := tmp_path / "mine.toml").write_text(shipped()["dc-motor-hinf"].read_text())
    with_table = face.run(mine, controller={"kind": "pd:Pd"}, duration=1)
    assert with_table.summary["certificate"]["state"] == "certified"
    with pytest.raises(face.HilError, match=r"undecided: .* states no gains or matrices"):
        face.run(mine, controller={"kind": "bare:Pd"}, duration=1)
    allowed = face.run(mine, controller={"kind": "bare:Pd"}, duration=1, allow_uncertified=True)
    assert allowed.status == 0 and allowed.summary["certificate"]["state"] == "undecided"


def test_the_experiment_of_the_guide_runs_and_is_certified(tmp_path: Path) -> None:
    (text,) = blocks(TEXT["experiments"], "toml")
    session = run_session(parse_experiment(text), path=tmp_path / "a.mcap")
    assert session.status == 0 and session.summary["certificate"] is not None


@pytest.mark.parametrize(("name", "words"), COMMAND_LINES, ids=lambda v: v if isinstance(v, str) else "-".join(v)[:40])
def test_a_command_line_that_is_shown_is_one(name: str, words: list[str]) -> None:
    """Parsed by the command itself: an option, an argument or a choice that is not there is refused."""
    context = click.Context(cli)
    command = cli.get_command(context, words[0])
    assert command is not None, f"{name}: hil {words[0]}"
    while isinstance(command, click.Group) and len(words) > 1:
        words = words[1:]
        command = command.get_command(context, words[0])
        assert command is not None, f"{name}: {words[0]}"
    known = set(shipped()) | {"dc-motor", "vtol"}
    words = [w for w in words if w != "..."]
    command.make_context(words[0], list(words[1:]))
    assert not {w for w in words if re.fullmatch(r"(dc-motor|vtol|smjls)[a-z0-9-]*", w)} - known, name


@pytest.mark.slow
def test_commands_on_a_log_run_one_after_the_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    for log in ("run.mcap", "runs/another.mcap"):
        face.run("dc-motor-hinf", duration=2, log=log)
    ran = 0
    for words in commands(TEXT["logs-and-reports"]):
        if words[0] == "recover" or {"--onto", "--process", "--auth"} & set(words):  # a torn log, a bus, a key that is not here
            continue
        with pytest.raises(SystemExit) as end:
            cli.main(words, prog_name="hil")
        assert end.value.code in (None, 0), words
        ran += 1
    assert ran == 10 and (tmp_path / "run.html").exists() and (tmp_path / "run.plant_state.csv").stat().st_size > 1000


def test_an_uncertainty_that_is_shown_is_one_of_its_plant(tmp_path: Path) -> None:
    cart = blocks(TEXT["first-plugin"], "python")[0]
    plants: dict[str, Plant] = {"dc-motor": DCMotor(), "cart.toml": module_of("guide_cart", cart)["Cart"]()}
    pairs = [(words[1], pair) for _, words in COMMAND_LINES for pair in pairwise(words)]
    shown = [(plant, said) for plant, (option, said) in pairs if option == "--uncertainty"]
    assert {interval(plants[plant], said).name for plant, said in shown} == {"gain", "pole", "damping"}


def test_names_in_the_text_exist() -> None:
    for name, text in TEXT.items():
        used = set(re.findall(r"`hil ([a-z-]+)", text))
        assert used <= set(COMMANDS), name
        found = set(re.findall(r"\b(?:dc-motor|vtol|smjls)-[a-z0-9-]+[a-z0-9]\b", text))
        assert found - {"dc-motor-hinf-virtual-seed0", "dc-motor-hinf-live-seed0"} <= set(shipped()), name
        topics = set(re.findall(r"hil guide ([a-z]+(?:-[a-z]+)*)", text))
        assert topics <= set(pages()), name
    rows = re.findall(r"^\| (`[a-z-]+`.*?) \|", TEXT["README"].partition("| `hil guide")[2], re.M)
    assert sorted(re.findall(r"`([a-z-]+)`", " ".join(rows))) == sorted(pages())


def test_the_table_of_contents_names_every_page() -> None:
    index = next(iter(pages().values())).with_name("index.md").read_text(encoding="utf-8")
    (tree,) = blocks(index, r"\{toctree\}")
    assert tree.split() == [*pages(), "api"]  # the reference is for `make docs` alone


def test_key_expressions_of_the_guide_are_those_of_the_link() -> None:
    import zenoh

    uri = f"zenoh:unixsock-stream/{tempfile.mkdtemp()}/rig"
    received: list[str] = []
    config = zenoh.Config()
    for key, value in (("mode", '"peer"'), ("scouting/multicast/enabled", "false"), ("listen/endpoints", "[]"),
                       ("connect/endpoints", json.dumps([uri.partition(":")[2]]))):  # fmt: skip
        config.insert_json5(key, value)
    with open_link(uri, "rig") as rig, zenoh.open(config) as session:
        session.declare_subscriber("**", lambda sample: received.append(str(sample.key_expr)))

        def anything() -> bool:
            rig.send(b"hello")
            return bool(received)

        until(anything, "a sample of the link")
    assert received and f"`{received[0]}`" in TEXT["wire-format"]
