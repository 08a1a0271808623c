"""A misspelt word of the command line, of an experiment and of a program is one message with the nearest name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import hil
from hil.log.read.export import export
from hil.session import Session
from tests.hil.cli.conftest import Hil


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("sweep", "dc-motor-hinf", "gird=1"), "--grid"),
        (("run", "dc-motor-hinf", "plant.gain=3"), "--set plant.gain=3"),
        (("run", "dc-motor-hinf", "--clock", "reel"), "real"),
        (("run", "dc-motor-hinf", "--clock=reel"), "real"),
        (("list", "plant"), "plants"),
        (("new", "plnt", "cart"), "plant"),
        (("can", "analyze", "x"), "analyse"),
    ],
)
def test_a_misspelt_word_is_asked_for_by_the_nearest_that_there_is(cli: Hil, words: tuple[str, ...], meant: str) -> None:
    status, out, err = cli(*words)
    assert status == 2 and not out
    assert f"id you mean '{meant}'?" in err and err.count("id you mean") == 1


@pytest.mark.parametrize("words", [("sweep", "vtol-h2", "--set", "seed=1", "much"), ("run", "vtol-h2", "--clock", "xyz")])
def test_a_word_that_is_near_nothing_is_not_guessed(cli: Hil, words: tuple[str, ...]) -> None:
    status, _, err = cli(*words)
    assert status == 2 and words[-1] in err and "id you mean" not in err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("laws", "dc-motor-hinf", "--csv"), "No such option '--csv'.\n"),
        (("run", "dc-motor-hinf", "--duratoin", "3"), "Did you mean '--duration'?"),
        (("live", "dc-motor-hinf", "--speed", "fast"), "'fast' is not a number from 0.001 to 1000.\n"),
        (("live", "dc-motor-hinf", "--speed", "0"), "0.0 is not a number from 0.001 to 1000.\n"),
        (("probe", "can:hil:x", "--rate", "nan"), "nan is not a number from 0.1 to 10000.\n"),
        (("design", "wall", "--stiffness", "nan"), "nan is not a number above 0.\n"),
        (("keys",), "Usage: hil keys [OPTIONS] COMMAND [ARGS]...\n\n  Make keys"),
        *(((*words, ""), "the name is empty; is a variable of the shell not set?")
          for words in (("report",), ("run", "dc-motor-hinf", "-o"), ("sweep", "dc-motor-hinf", "--csv"),
                        ("identify", "law"), ("new", "plant", "cart", "-o"), ("design", "dc-motor", "--network"))),
        (("identify", "law", "x.csv", "--deadline", "1"), "1.0 is not a number above 0 below 1.\n"),
        *((("identify", "law", "x.log", "--can-id", number), "expected a CAN identifier such as 0x101")
          for number in ("-1", "0x20000000", "first")),
        *((("identify", "law", "x.log", "--can-id", number), "x.log: a CAN log has no") for number in ("0", "0x1fffffff")),
        (("live", "dc-motor-hinf", "--port", "99999"), "99999 is not a whole number from 0 to 65535.\n"),
        (("run", "dc-motor-hinf", "--seed", "x"), "'x' is not a whole number.\n"),
        (("list", "nope"), "Error: 'nope' is not one of plants, controllers, laws, links, measures.\n"),
        (("check", "laws"), "Error: Missing argument 'KIND'.\n"),
        (("check",), "Error: Missing argument: one of plants, controllers, laws, links, measures.\n"),
    ],
)
def test_a_wrong_option_is_answered_with_what_was_expected(cli: Hil, words: tuple[str, ...], said: str) -> None:
    status, out, err = cli(*words)
    assert status == 2 and not out and said in err


def test_an_experiment_beside_is_meant_by_its_name_without_its_ending(cli: Hil, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("")
    assert "did you mean 'a.toml'?" in cli("run", "a")[2]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("nodes.angle.id=1", "nodes: unknown field; did you mean 'network.nodes'?"),
        ("links.sc.law.kind='iid'", "links.sc: unknown field; did you mean 'network.sc'?"),
        ("network.law.kind='iid'", "network.law: unknown field; did you mean 'network.sc.law'?"),
        ("law.kind='iid'", "law: unknown field; did you mean 'network.sc.law'?"),
        ('fault=[{kind="bus-of", at="1 s"}]', "did you mean 'bus-off'?"),
        ('fault=[{kind="bus-off", at="1 s", for="1 s", node="angel"}]', "no node 'angel'; did you mean 'angle'? (there"),
        ('network.nodes.angle.outputs=["angel"]', "has no output 'angel'; did you mean 'angle'? (there are: angle, speed)"),
        ('network.media={air={kind="random", nodes=["sped"]}}', "no node 'sped'; did you mean 'speed'?"),
        ("kind=3", "there are name, "),  # fields that are no keys of a file are not offered
    ],
)
def test_a_misspelt_name_of_an_experiment_is_answered_by_the_nearest(change: str, said: str) -> None:
    with pytest.raises(hil.HilError) as found:
        hil.run("dc-motor-two-nodes", duration=1, **_changes(change))
    assert said in str(found.value)


def _changes(text: str) -> dict[str, object]:
    import tomllib

    key, _, value = text.partition("=")
    return {key: tomllib.loads(f"value = {value}")["value"]}


@pytest.fixture(scope="module")
def session() -> Session:
    return hil.run("dc-motor-hinf", duration=1)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda s: hil.sweep("vtol-h2", gird={"period": [1]}), "hil.sweep: no argument is called 'gird'; did you mean 'grid'?"),
        (lambda s: hil.run("dc-motor-hinf", clok="real"), "hil.run: no argument is called 'clok'; did you mean 'clock'?"),
        (lambda s: hil.run("dc-motor-hinf", durration=1), "durration: unknown field; did you mean 'duration'?"),
        (lambda s: hil.report(s, outptu="a.html"), "hil.report: no argument is called 'outptu'; did you mean 'output'?"),
        (lambda s: hil.design("dc-motor", objectve="h2"), "no option is called 'objectve'; did you mean 'objective'?"),
        (lambda s: hil.assert_law(s, "scc"), "did you mean 'sc'?"),
        (lambda s: s.arrays["/plant/mesurement"], "did you mean '/plant/measurement'? it has /plant/state"),
        (lambda s: export(s.run, Path("a.csv"), topics=["/plant/stat"]), "did you mean '/plant/state'?"),
    ],
)
def test_a_misspelt_name_of_a_program_is_answered_by_the_nearest(
    session: Session, call: Callable[[Session], object], said: str
) -> None:
    with pytest.raises(hil.HilError) as found:
        call(session)
    assert said in str(found.value)


def test_python_asks_for_the_nearest_name_of_the_package() -> None:
    with pytest.raises(AttributeError) as found:
        hil.swep  # noqa: B018
    assert (found.value.name, found.value.obj) == ("swep", hil)  # of these Python makes its "Did you mean: 'sweep'?"
    with pytest.raises(AttributeError, match=r"'reproduced'$"):
        hil.reproduced  # noqa: B018
