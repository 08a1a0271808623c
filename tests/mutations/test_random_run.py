"""A run of random faults: its table, and when it fails."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path

import pytest

from tests.mutations import judge
from tests.mutations import random_run as run
from tests.mutations.judge import Judge, UndecidedError
from tests.mutations.random_faults import Place
from tests.mutations.random_run import BY_OWN, CHANCE, WANTED, Tried, limit, random_run, rule, table, too_few
from tests.mutations.reach import Reach

PLACES = [
    Place(file=f"hil/{room}/m.py", line=n, block="f#0", start=n, end=n, old="1", new="2", nth=n)
    for room in "ab"
    for n in range(30)
]


def test_the_table_counts_by_room_and_leaves_what_is_equivalent_out_of_the_share() -> None:
    done: list[Tried] = [(PLACES[0], "killed"), (PLACES[1], "survived"), (PLACES[2], "undecided"), (PLACES[3], "equivalent"),
                         (PLACES[4], "killed"), (PLACES[5], "killed"), (PLACES[30], "equivalent")]  # fmt: skip
    head, *lines = [line.split() for line in table(done)]
    assert head == ["room", "faults", "killed", "survived", "undecided", "equivalent", "share"]
    assert lines == [
        ["hil/a", "6", "3", "1", "1", "1", "60%", "to", "80%"],
        ["hil/b", "1", "0", "0", "0", "1", "-"],
        ["all", "7", "3", "1", "1", "2", "60%", "to", "80%"],
    ]


@pytest.mark.parametrize("number", [0, 1, 2, 12, 30, 300])
def test_no_more_may_survive_than_would_once_in_a_thousand_draws_of_what_is_wanted(number: int) -> None:
    k = limit(number)
    for survivors, fails in ((0, False), (k, False), (k + 1, True)):
        if survivors <= number:
            done: list[Tried] = [(PLACES[0], "survived")] * survivors + [(PLACES[0], "undecided")] * (number - survivors)
            assert too_few(done) is too_few([*done, (PLACES[0], "equivalent")]) is fails
    assert run.more_than(k, number, 1.0 - WANTED) < CHANCE
    assert k == 0 or run.more_than(k - 1, number, 1.0 - WANTED) >= CHANCE
    assert f"more than {k} of {number} survive" in rule([(PLACES[0], "killed")] * number)[0]


def test_shares_that_differ_by_room_with_the_wanted_one_in_each_fail_no_more_often() -> None:
    """20,000 draws of 15 of room a, where 5 % survive, and 15 of room b, where 15 % do: 20 may fail; more than 36 fail by chance
    less than once in 1,000. Where half survive, 90 % fail: between 17,700 and 18,300 of them, four standard errors.
    """
    rng, k = random.Random(0), limit(30)

    def fails(*shares: float) -> int:
        return sum(sum(rng.random() < share for share in shares for _ in range(15)) > k for _ in range(20_000))

    assert fails(0.05, 0.15) <= 36
    assert 17_700 < fails(0.5, 0.5) < 18_300


class Fake(Judge):
    """Kills faults of every fourth line; those of line 7 take too long."""

    def __init__(self, folder: Path, doubtful: object) -> None:
        pass

    def __exit__(self, *exception: object) -> None:
        pass

    def killer(self, place: Place, tests: object, end: float = 0.0) -> str | None:
        if place.line == 7:
            raise UndecidedError("time was spent")
        return "tests/test_m.py::test_it" if place.line % 4 == 0 else None


@pytest.mark.parametrize(("limit_s", "status", "counts"), [
    (600.0, 1, {"killed": 4, "survived": 15, "undecided": 2}), (-1.0, 0, {"undecided": 21}),
])  # fmt: skip
def test_several_faults_are_tried_at_once_and_what_is_not_begun_in_time_is_undecided(
    limit_s: float, status: int, counts: dict[str, int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = [place for place in PLACES if 5 <= place.line < 16]
    monkeypatch.setattr(judge, "Judge", Fake)
    monkeypatch.setattr(judge, "copy_of_the_checkout", lambda folder: folder)
    monkeypatch.setattr(run, "drawn", lambda files, number, seed: chosen)
    monkeypatch.setattr(run, "own_tests", lambda place: ["tests/test_m.py"])
    monkeypatch.setattr(run, "asked_for", lambda place, reach: ["tests/test_m.py::test_it"])
    monkeypatch.setattr(run, "kept", lambda workers, fresh: Reach(tests=[], seconds=[], realtime=[], by_block={}))
    monkeypatch.setattr(run, "equivalent", lambda: {chosen[0].key})
    for own, ends, asked in ((None, status, "85%"), (["m.py"], 0, "50%")):
        assert random_run(30, 1, (), own=own, limit_s=limit_s, fresh=False, workers=3) == ends
        said = capsys.readouterr().out
        assert Counter(line.split()[1] for line in said.splitlines() if "/21 " in line) == counts
        assert "fails where more than" in said and f"asked tests see {asked} of" in said


def test_a_run_that_is_to_decide_begins_no_fault_where_it_cannot_fail_any_more(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """At most 17 of 20 may survive: three that are killed decide."""
    chosen = [place for place in PLACES if place.line % 4][:10] + [place for place in PLACES if place.line % 4 == 0][:10]
    monkeypatch.setattr(judge, "Judge", Fake)
    monkeypatch.setattr(judge, "copy_of_the_checkout", lambda folder: folder)
    monkeypatch.setattr(run, "drawn", lambda files, number, seed: chosen)
    monkeypatch.setattr(run, "own_tests", lambda place: ["tests/test_m.py"])
    for decide, killed in ((False, 10), (True, 3)):
        assert random_run(20, 1, (), own=["m.py"], limit_s=600.0, fresh=False, workers=1, decide=decide) == 0
        said = Counter(line.split()[1] for line in capsys.readouterr().out.splitlines() if "/20 " in line)
        assert said["killed"] == killed and sum(said.values()) == 20


@pytest.mark.parametrize(("survivors", "fails"), [(17, False), (18, True)])
def test_a_change_whose_own_tests_see_hardly_anything_fails(survivors: int, fails: bool) -> None:
    """17 of 20 survive where half are seen in 2 of 1,000 draws, more in 2 of 10,000; where a tenth is seen, in two of three."""
    done: list[Tried] = [(PLACES[0], "survived")] * survivors + [(PLACES[0], "killed")] * (20 - survivors)
    assert too_few(done, BY_OWN) is fails
