"""Which points a grid and a box may have, up to their number, and what is refused in one line."""

from __future__ import annotations

import pytest

from hil.errors import HilError
from hil.sweeps import points
from hil.sweeps.points import grid, latin_hypercube


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (["plant.gain"], "grid 'plant.gain': expected key=a,b,c"),
        (["=1,2"], "grid '=1,2': expected key=a,b,c"),
        (["a=1,,2"], "grid 'a=1,,2': expected key=a,b,c"),
        (["a=1", "a =2"], "grid a: named twice"),
        (["a=1,2,3", "b=1,2"], "grid: 6 points; at most 4"),
    ],
)
def test_a_grid_that_is_none_is_refused(asked: list[str], message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(points, "MOST_POINTS", 4)
    with pytest.raises(HilError, match=message):
        grid(asked)
    assert grid(["a=1,2", "b=1,2"]).values == (("1", "1"), ("1", "2"), ("2", "1"), ("2", "2"))


@pytest.mark.parametrize(
    ("asked", "count", "message"),
    [
        (["a=1:2"], 0, "points: 0; expected 1 to 4"),
        (["a=1:2"], 5, "points: 5; expected 1 to 4"),
        (["a=1"], 2, "range 'a=1': expected key=low:high"),
        (["a=1:2:3"], 2, "range 'a=1:2:3': expected key=low:high"),
        (["a=2:1"], 2, "the lower first, in one unit"),
        (["a=1:1"], 2, "the lower first, in one unit"),
        (["a=1:inf"], 2, "two finite numbers"),
        (["a=1s:2ms"], 2, "in one unit"),
        (["=1:2"], 2, "range '=1:2': the key is missing or repeated"),
        (["a=1:2", "a=1:3"], 2, "range 'a=1:3': the key is missing or repeated"),
    ],
)
def test_a_box_that_is_none_is_refused(asked: list[str], count: int, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(points, "MOST_POINTS", 4)
    with pytest.raises(HilError, match=message):
        latin_hypercube(asked, count)
    assert len(latin_hypercube(["a=1:2"], 1).values) == 1


@pytest.mark.parametrize("period", ["period=10ms:50ms", "period=10:50ms"])
def test_every_key_takes_one_value_in_each_part_of_its_range(period: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(points, "MOST_POINTS", 4)
    found = latin_hypercube([period, "plant.gain=100:200"], 4, seed=3)
    assert found.keys == ("period", "plant.gain")
    periods, gains = zip(*found.values)
    assert all(value.endswith(" ms") for value in periods)
    assert sorted(int((float(value.split()[0]) - 10.0) // 10.0) for value in periods) == [0, 1, 2, 3]
    assert sorted(int((float(value) - 100.0) // 25.0) for value in gains) == [0, 1, 2, 3]
    assert found == latin_hypercube([period, "plant.gain=100:200"], 4, seed=3)
    assert found != latin_hypercube([period, "plant.gain=100:200"], 4, seed=4)
