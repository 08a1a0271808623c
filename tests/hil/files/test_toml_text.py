"""A foreign TOML file is refused before it costs time, and what experiments need is let through."""

from __future__ import annotations

import tomllib

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hil.experiment import shipped
from hil.files.toml_text import DEEPEST, parse_toml, toml_value


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (".".join(["a"] * 40_000) + " = 1", "nested too deeply: the key of line 1 has 40000 parts"),  # 18 s in tomllib
        ("[" + ".".join(["a"] * 40_000) + "]\n", "nested too deeply"),
        ("x = {" + ".".join(["a"] * 40_000) + " = 1}", "nested too deeply"),
        ("\n".join(["# .", ".".join(["'a'"] * 40) + " = 1"]), "the key of line 2 has 40 parts"),
        ("a = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("a = " + "{a=" * 5000 + "1" + "}" * 5000, "nested too deeply"),
        ("a = " + "9" * 4301, "a number has more than 400 digits"),
        ("a = 1." + "9" * 100_000, "a number has more than 400 digits"),
    ],
)
def test_text_that_costs_too_much_is_refused(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        parse_toml(text)


@pytest.mark.parametrize(
    "text",
    ['a = "' + "." * 1000 + "[[[[" * 100 + '"', "# " + "." * 1000, 'a = """\n' + "{." * 500 + '"""',
     "a = '''" + "9" * 1000 + "'''"],
)
def test_what_stands_in_strings_and_comments_is_no_nesting(text: str) -> None:
    assert parse_toml(text) == tomllib.loads(text)


def test_what_is_closed_again_leaves_no_room_for_more() -> None:
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_toml("a = " + "[[]," * (DEEPEST + 1) + "]" * (DEEPEST + 1))


def test_as_deep_as_is_allowed_is_read() -> None:
    key = ".".join(["a"] * DEEPEST)
    assert parse_toml(f"{key} = 1") == tomllib.loads(f"{key} = 1")


@pytest.mark.parametrize("name", sorted(shipped()))
def test_every_shipped_experiment_is_read_as_tomllib_reads_it(name: str) -> None:
    text = shipped()[name].read_text()
    assert parse_toml(text) == tomllib.loads(text)


@given(st.text(alphabet="ab.=[]{}\"'\\#\n1_ ,", max_size=60))
@example('"\\')
@example('a = """x""""')
def test_any_text_is_read_as_tomllib_reads_it_or_refused(text: str) -> None:
    try:
        expected = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        with pytest.raises(tomllib.TOMLDecodeError):
            parse_toml(text)
    else:
        assert parse_toml(text) == expected


VALUES = st.recursive(
    st.booleans() | st.integers(-(2**62), 2**62) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("ab _-é😀", min_size=1), inner, max_size=3),
)


@given(VALUES)
def test_what_is_written_is_read_back(value: object) -> None:
    assert tomllib.loads(f"v = {toml_value(value)}")["v"] == value
