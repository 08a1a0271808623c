"""`hil design --can-id`: every place of the loop's packets on its bus, and the one to take."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli.design import command
from hil.design_questions.can_priority import Judged, Place, places_of, recommended
from hil.errors import HilError
from hil.experiment import load_experiment

A, B, C = (f'{{name="{n}", can_id={i:#x}, length=8, period="{p} ms"}}' for n, i, p in (("a", 16, 5), ("b", 17, 5), ("c", 128, 3)))
FEW = f"network.media.bus.traffic=[{A}, {B}, {C}]"


def test_places_keep_the_other_messages_where_there_is_room_and_move_them_up_elsewhere() -> None:
    found = places_of(load_experiment("dc-motor-busy-can", (FEW,)))
    assert [(each.above, each.can_id, each.moved) for each in found] == [(0, 0, 3), (1, 0x11, 2), (2, 0x12, 0), (3, 0x81, 0)]
    moved = found[1].experiment.network.media["bus"].traffic
    assert [message.can_id for message in moved] == [0x10, 0x31, 0xA0]
    assert found[1].experiment.links.control_can_id == 0x21


def test_a_place_is_recommended_by_certificate_deadline_cost_and_then_modesty() -> None:
    places = places_of(load_experiment("dc-motor-busy-can", (FEW,)))
    costs = (10.0, 10.05, 10.06, 14.0)
    judged = [
        Judged(place=place, cost=cost, state="certified", bounds_ms=(1.0, 1.0), in_time=True)
        for place, cost in zip(places, costs)
    ]
    assert recommended(judged, free=False) is judged[2] and recommended(judged, free=True) is judged[2]
    late = [replace(each, in_time=each is judged[3]) for each in judged]
    assert recommended(late, free=False) is late[3]
    doubtful = [replace(each, state="undecided" if each is not judged[1] else "certified") for each in judged]
    assert recommended(doubtful, free=False) is doubtful[1] and recommended(doubtful, free=True) is doubtful[2]
    assert recommended([replace(each, cost=None) for each in judged], free=False) is None


def test_the_place_that_leaves_the_others_theirs_is_said_apart_from_a_better_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def judged(place: Place) -> Judged:
        return Judged(
            place=place, cost=10.0 if place.moved else 14.0, state="certified", bounds_ms=(1.0, 1.0), in_time=True
        )  # fmt: skip

    monkeypatch.setattr("hil.cli.design_pages._judge", judged)
    monkeypatch.setattr(
        "hil.design_questions.can_priority.places_of", lambda e, found=places_of: found(load_experiment(e.name, (FEW,)))
    )
    done = CliRunner().invoke(command, ["--can-id", "dc-motor-busy-can", "--json"], catch_exceptions=False)
    found = json.loads(done.output)
    assert found["recommended"]["moved"] == 0 < found["with_others_moved"]["moved"]
    assert found["recommended"]["cost"] == 14.0 > found["with_others_moved"]["cost"] == 10.0


def test_the_command_runs_every_place_and_writes_a_page(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    shown = load_experiment("dc-motor-busy-can").text
    head, _, rest = shown.partition("traffic = [")
    traffic = 'traffic = [{ name = "a", can_id = 0x40, length = 8, period = "2 ms" }'
    file.write_text(head.replace('duration = "50 s"', 'duration = "3 s"').partition("[[disturbance]]")[0] + "[network]"
                    + head.partition("[network]")[2] + traffic + rest[rest.index("]") :])  # fmt: skip
    page = tmp_path / "place.html"
    done = CliRunner().invoke(command, ["--can-id", str(file), "--json", "-o", str(page)], catch_exceptions=False)
    found = json.loads(done.output)
    first, second = found["places"]
    assert (first["can_id"], second["can_id"]) == (0, 0x41) and first["moved"] == 0
    assert first["sensor_bound_ms"] < second["sensor_bound_ms"] < 50.0 and first["in_time"] and second["in_time"]
    assert first["cost"] > 0 and second["cost"] > 0 and first["certificate"] == "certified"
    assert (
        found["recommended"] == second
        and found["with_others_moved"] in found["places"]
        and "Cost over priority" in page.read_text()
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["dc-motor-hinf", "--can-id"], "no medium of kind 'can'"),
        (["dc-motor-busy-can", "--can-id", "--objective", "h2"], "--objective: not with --can-id"),
    ],
)
def test_what_does_not_fit_is_refused(words: list[str], said: str) -> None:
    with pytest.raises(HilError, match=said):
        CliRunner().invoke(command, words, catch_exceptions=False, standalone_mode=False)
