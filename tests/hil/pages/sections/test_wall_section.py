"""The section of a haptic run: what it shows, and that its pictures say what the run was."""

from __future__ import annotations

import re
from html import escape
from itertools import pairwise, product

import numpy as np
import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.measure.view import view_of
from hil.pages import Scene, Shape
from hil.pages.html.svg import draw_scene, scene_legend
from hil.pages.run_page import render_report
from hil.pages.sections.wall import section as wall_section
from hil.runtime.virtual import simulate
from tests.hil.pages.runs import run_of


def section(name, *changes):
    experiment = load_experiment(name, list(changes))
    run = simulate(compose(experiment, certify=False), 0)
    return run, wall_section(view_of(run, experiment))


def test_a_slide_shows_depth_force_energy_margin_and_both_ways():
    run, found = section("omni-slide", "duration=6")
    blocks = {block.title: block for block in found.blocks}
    assert list(blocks) == [
        "Penetration", "Force of the wall at the device", "Stability in contact, over delay", "How stiff the wall feels",
        "The way over the wall", "The way in space",
    ]  # fmt: skip
    assert found.intro.endswith("the motor gave no energy beyond what the damping took (0 mJ).")  # an axis up to 1 mJ says less
    assert blocks["Penetration"].series[0].y == pytest.approx(1e3 * run.arrays["/plant/measurement"]["position"])
    assert blocks["Force of the wall at the device"].series[0].y.max() > 0.5
    way = blocks["The way over the wall"]
    areas = [shape for shape in way.shapes if shape.filled]
    y, z = np.asarray(way.shapes[-1].points).T
    assert {shape.colour for shape in areas} == {0, 1, 2}
    corners = np.vstack([np.asarray(shape.points) for shape in areas])
    assert corners[:, 0].min() <= y.min() and corners[:, 1].max() >= z.max()  # the way lies on the map
    tiles = [*product(*(range(int(each.min() // 40), int(each.max() // 40) + 1) for each in (y, z)))]
    patches = {0: ((0, 0), (20, 20)), 1: ((20, 0), (40, 20)), 2: ((0, 20), (40, 40))}  # mm, of tiles of 40 mm
    drawn = {(shape.colour, *np.min(shape.points, axis=0), *np.max(shape.points, axis=0)) for shape in areas}
    assert drawn == {
        (colour, 40 * i + low[0], 40 * j + low[1], 40 * i + high[0], 40 * j + high[1])
        for i, j in tiles for colour, (low, high) in patches.items()
    }  # fmt: skip
    assert "first" in way.note and len(areas) == 3 * len(tiles) < 200 and len(tiles) > 3
    shapes = blocks["The way in space"].shapes
    pieces = [np.asarray(shape.points) for shape in shapes if shape.label.startswith("over material")]
    (shadow,) = [shape for shape in shapes if shape.label.startswith("its shadow")]
    assert len(pieces) > 2 and sum(len(piece) - 1 for piece in pieces) == len(shadow.points) - 1  # the whole way
    assert all((one[-1] == other[0]).all() for one, other in pairwise(pieces))


def test_a_haptic_run_opens_with_its_wall_and_has_no_reference() -> None:
    page = render_report(view_of(run_of("omni-push", "duration=2")))
    assert page.index('>At the wall</h2>') < page.index('>Outputs</h2>') and ">Tracking</h2>" not in page
    assert '"label":"reference"' not in page and "largest depth" in page and " mm, behind a delay of 6 samples of 50 ms" in page


@pytest.mark.parametrize(("name", "waits", "samples"), [
    ("omni-push", "false", 6), ("omni-wifi", "true", 12), ("omni-wifi", "false", 10),
])  # fmt: skip
def test_the_page_says_the_delay_that_the_loop_has_and_not_the_largest_that_it_has_rows_for(name, waits, samples):
    coupler = f"controller.coupler={{method='wave',equalise={waits}}}"
    changes = coupler, "network.sc.max_age=7", "duration=0.5", "allow_uncertified=true", "plant.hand.push.force_n=1.0"
    found = wall_section(view_of(run_of(name, *changes, certify=True)))
    (margin,) = [block for block in found.blocks if block.title == "Stability in contact, over delay"]
    assert f"behind a delay of {samples} samples" in found.intro and margin.markers[0].x == samples


def test_the_certificate_knows_the_delay_that_a_clock_makes():
    """A node that sends every third slot: no law has a chain, and the certificate names 6 to 8 samples."""
    tip = "network.nodes={tip={outputs=['position','y','z'],clock={every=3}}}"
    changes = tip, "network.sc.max_age=9", "controller.coupler={method='wave'}", "duration=2", "allow_uncertified=true"
    run = run_of("omni-push", *changes, certify=True)
    assert run.certificate["delays"] == [6, 7, 8]
    assert "behind a delay of 8 samples" in wall_section(view_of(run)).intro


def test_what_a_fault_froze_is_not_said_to_come_of_another_program_alone():
    frozen, whole = "fault=[{at=2,kind='freeze',link='sc',for=0.5}]", "fault=[{at=2,kind='cut',link='sc',for=0.1}]"
    said = [section("omni-push", "duration=4", fault)[1].intro for fault in (frozen, whole)]
    assert "a fault froze what came to the controller" in said[0] and "not those that were logged" not in said[1]


def test_energy_that_was_stored_at_the_start_is_named_beside_what_a_safe_coupler_gives():
    found = section("omni-push", "duration=1", "plant.initial_angle_rad=0.1", "plant.hand.push.force_n=0")[1]
    (note,) = [block.note for block in found.blocks if block.title == "Passivity observer"]
    assert note.endswith("0 behind a safe coupler, but for what is stored where the device begins behind the surface.")


def test_a_wall_over_what_measures_no_position_has_no_margin_over_delay():
    plant = "plant={kind='state-space',A=[[0,1],[0,-2]],B=[[0],[1]],C=[[2,0],[0,0],[0,0]]}"
    found = section("omni-push", plant, "limits={}", "duration=0.5", "allow_uncertified=true", "report.measures=[]")[1]
    assert "Stability in contact, over delay" not in [block.title for block in found.blocks]


def test_the_certificate_is_read_as_sentences_and_numbers_with_units():
    """Lists were shown as JSON, in one line that was cut."""
    run = run_of("omni-push", "duration=2", certify=True)
    view = view_of(run)
    page = render_report(view)
    table = page[page.index("Certificate, from the gains that ran") :]
    first, further = table.split("</table>")[:2]
    table = first + further
    assert "<summary>Further numbers of the certificate</summary>" in further
    for question in ("Verdict", "What is certified", "The number that decides", "How it is decided", "What it assumes"):
        assert f"<td>{question}</td>" in first
    for assumption in run.certificate["assumptions"]:
        assert f"<p>{escape(assumption)}</p>" in table
    assert "<td>delays</td><td>6</td>" in table and "[" not in table and "quot" not in table
    assert "<td>ceiling (N/m)</td>" in table and "<td>static compliance (m/N)</td>" in table
    assert run.certificate["digest"] in table and 'class="pairs"' in table


def test_before_the_first_force_nothing_is_said_of_the_largest():
    assert section("omni-slide", "duration=0.3")[1].intro.startswith("The avatar")


def test_a_push_has_no_way_and_a_motor_no_wall():
    assert not [b for b in section("omni-push", "duration=2")[1].blocks if isinstance(b, Scene)]
    assert section("dc-motor-hinf", "duration=2")[1] is None


def test_a_scene_has_one_scale_and_escapes_its_words():
    square = Shape(points=[(0, 0), (10, 0), (10, 10), (0, 10)], label="<b>", colour=1, filled=True)
    scene = Scene(title="t<", shapes=(square, Shape(points=[(0.0, 0.0), (np.nan, np.nan), (10.0, 10.0)])), labels=((5, 5, "&"),))
    svg = draw_scene(scene)
    corners = [tuple(map(float, pair)) for pair in re.findall(r"[ML](-?[\d.]+) (-?[\d.]+)", svg.split("Z")[0])]
    (left, bottom), (right, _), (_, top), _ = corners
    assert right - left == pytest.approx(bottom - top, abs=0.2)
    assert (left - 50.0, top - 12.0) == pytest.approx((428.0 - right, 342.0 - bottom), abs=0.2), "it stands between its margins"
    assert "<b>" not in svg + scene_legend(scene) and "&amp;" in svg and svg.count("nan") == 0
