"""`hil list`: what there is, what it is, and the keys of every plug-in."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from hil.cli.list import DEEPEST, _keys
from hil.plugins import registry
from plants.dc_motor import DCMotor
from tests.hil.cli.conftest import Hil
from transport import TransportError, open_link

GROUPS: tuple[registry.Group, ...] = ("hil.plants", "hil.controllers", "hil.laws", "hil.links", "hil.measures")
EVERY = [(group, name) for group in GROUPS for name in registry.names(group)]


def test_a_kind_shows_keys_types_defaults_and_meaning(cli: Hil) -> None:
    status, out, _ = cli("list", "laws", "iid")
    assert status == 0 and "iid, from hilrig" in out and "(required)" in out
    found = json.loads(cli("list", "plants", "dc-motor", "--json")[1])
    assert found["keys"]["gain"]["type"] == "number" and float(found["keys"]["gain"]["default"]) > 0


@pytest.mark.parametrize("group, name", EVERY)
def test_every_key_of_every_plug_in_of_ours_is_explained(cli: Hil, group: str, name: str) -> None:
    status, out, _ = cli("list", group[4:], name)
    assert status == 0 and out.startswith(f"{name}, from ")
    found = json.loads(cli("list", group[4:], name, "--json")[1])
    assert found["about"] and [key for key, said in found["keys"].items() if not said["meaning"] and key != "uri"] == []
    assert not [key for key, said in found["keys"].items() if re.search(r"\bNone\b", said["meaning"])], "no file can say None"


BROKEN = {
    "worn_tank.py": "raise ValueError('worn out')\n",
    "odd_tank.py": """
from dataclasses import dataclass
from functools import cache
@dataclass
class Own:
    A: type
@dataclass
class DCMotor:
    A: int
""",
    "worn-1.0.dist-info/METADATA": "Name: worn\nVersion: 1.0\n",
    "worn-1.0.dist-info/entry_points.txt": """
[hil.plants]
own = worn_tank:DCMotor
odd = odd_tank:Own
another = odd_tank:DCMotor
[hil.links]
worn = worn_tank:Link
""",
}


def test_a_package_that_cannot_be_loaded_is_named_and_the_rest_works(
    cli: Hil, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "worn-1.0.dist-info").mkdir()
    for name, text in BROKEN.items():
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(registry, "_found", cache(registry._found.__wrapped__))
    found = json.loads(cli("list", "--json")[1])["plugins"]["plants"]
    assert {name for name, package in found.items() if package == "worn"} == {"own", "odd", "another"}
    assert "vtol-fault, another (from worn)," in " ".join(cli("list")[1].split())
    why = "plant plug-in own = worn_tank:DCMotor, of the package worn, cannot be loaded: ValueError: worn out"
    assert why in " ".join(cli("list", "plants")[1].split())
    status, out, said = cli("schema")
    plants = {each["properties"]["kind"].get("const"): each for each in json.loads(out)["properties"]["plant"]["oneOf"]}
    assert status == 0 and plants["own"].keys() == plants["odd"].keys() == {"type", "properties", "required"}
    assert "gain" in plants["dc-motor"]["properties"] and "A" in plants["another"]["properties"]
    keys = "the schema lets its table have any keys"
    odd = "'odd' of the package worn: type <class 'type'> is not supported"
    assert said.splitlines() == [f"hil: {odd}; {keys}", f"hil: {why}; {keys}"]
    assert registry.kind_of_class("hil.plants", DCMotor) == "dc-motor", "though another has a class of that name"
    with pytest.raises(TransportError, match="plug-in worn = worn_tank:Link, of the package worn: ValueError: worn out"):
        open_link("worn:", "rig")


def test_lines_fit_eighty_columns_and_nothing_is_cut_in_a_pipe(cli: Hil, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    said = json.loads(cli("list", "--json")[1])["experiments"]
    out = cli("list")[1]
    assert all(" ".join(text.split()) in out for text in said.values()) and max(map(len, said.values())) > 80
    monkeypatch.setenv("COLUMNS", "80")
    for arguments in ((), ("controllers",), ("plants",), ("laws",), ("controllers", "designed")):
        assert max(map(len, cli("list", *arguments)[1].splitlines())) <= 80


@pytest.mark.parametrize(
    ("words", "keys"),
    [
        (("plants", "omni"), ("hand.stiffness_n_per_m: number = 0.0", "hand.push.tremor_n: number = 0.0")),
        (("controllers", "virtual-wall"), ("wall.materials.N.stiffness_n_per_m: number  (required)", "'theorem-6.1'")),
        (("laws", "packet"), ("loss.p_gb: number  (required)",)),
    ],
)
def test_keys_of_a_table_inside_another_are_listed_as_they_are_set(
    cli: Hil, words: tuple[str, ...], keys: tuple[str, ...]
) -> None:
    out = cli("list", *words)[1]
    assert all(key in out for key in keys) and max(map(len, out.splitlines())) <= 80


@dataclass
class Nest:
    inner: Nest | None = None


def test_a_table_that_holds_itself_is_listed_to_the_fourth_table_within(capsys: pytest.CaptureFixture[str]) -> None:
    _keys(Nest, "")
    assert capsys.readouterr().out.splitlines() == [f"{'inner.' * level}inner: table" for level in range(DEEPEST + 1)]


def test_types_and_defaults_are_those_of_a_file(cli: Hil) -> None:
    out = " ".join(cli("list", "controllers", "designed")[1].split())
    for key in ("objective: 'h2', 'hinf' or 'mixed' = 'h2' ", "hinf_bound: number mixed only", "list of numbers = [] "):
        assert key in out
    assert "gain: matrix" in cli("list", "controllers", "local")[1]
    for group, name in EVERY:
        said = json.loads(cli("list", group[4:], name, "--json")[1])["keys"].values()
        assert not [each["type"] for each in said if re.search(r"tuple|Literal|float|\bint\b|dict|None|Union", each["type"])]


def test_an_experiment_is_pointed_to_the_command_that_prints_it(cli: Hil) -> None:
    status, _, err = cli("list", "dc-motor-h2")
    assert status == 2 and "hil show dc-motor-h2 prints its file" in err


def test_a_plants_name_is_answered_with_the_experiment_to_begin_with(cli: Hil) -> None:
    status, _, err = cli("run", "dc-motor")
    assert status == 2 and "did you mean 'dc-motor-hinf'?" in err


def test_a_kind_in_place_of_its_table_is_answered_with_the_table(cli: Hil) -> None:
    status, _, err = cli("run", "dc-motor-hinf", "--set", "plant=dc-motor")
    assert status == 2 and "as a table: { kind = 'dc-motor' }" in err


def test_an_unknown_kind_is_guessed(cli: Hil) -> None:
    status, _, err = cli("list", "laws", "markow")
    assert status == 2 and "did you mean 'markov'" in err


def test_an_unknown_field_without_a_near_one_names_the_valid_ones(cli: Hil) -> None:
    status, _, err = cli("run", "dc-motor-hinf", "--set", "timing.colour=1", "--set", "zzz=1")
    assert status == 2 and "timing.colour: unknown field; there are deadline, priority" in err
    assert "zzz: unknown field; there are name, description" in err and "folder" not in err


def test_no_two_experiments_of_a_plant_read_alike_at_80_columns(cli: Hil, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    _, out, _ = cli("list")
    lines = [line.split(maxsplit=1) for line in out.partition("plants (hil list")[0].splitlines() if line.startswith("  ")]
    said = [text for _, text in lines]
    assert len(said) > 40 and len(set(said)) == len(said)
