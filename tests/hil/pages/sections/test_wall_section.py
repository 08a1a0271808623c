"""The section of a haptic run: what it shows, and that its pictures say what the run was."""

from __future__ import annotations

import numpy as np
import pytest

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.measure.view import view_of
from hil.pages.html.figures import Figure
from hil.pages.sections.wall import section as wall_section
from hil.runtime.virtual import simulate


def section(name, *changes):
    experiment = load_experiment(name, list(changes))
    run = simulate(compose(experiment, certify=False), 0)
    return run, wall_section(view_of(run, experiment))


def test_the_margin_of_the_printed_coupler_ends_where_it_must():
    _, found = section("omni-theorem61", "duration=1", "allow_uncertified=true")
    margin = next(b for b in found.blocks if isinstance(b, Figure) and b.title.startswith("Stability"))
    radii = np.max([s.y for s in margin.series[:-1]], axis=0)
    assert radii[0] < 1.0 and radii[1] == pytest.approx(1.083, abs=1e-3) and radii[6] == pytest.approx(1.153, abs=1e-3)
    assert margin.markers[0].x == 6


def test_a_wall_without_a_coupler_shows_depth_force_and_energy():
    following = ('controller={kind="model-following"}', "allow_uncertified=true", "limits.input=[40.0]", "limits.state.given=1.0")
    run, found = section("omni-push", "duration=20", *following)
    depth, force, energy = found.blocks
    assert [len(block.series) for block in found.blocks] == [1, 1, 1]  # no avatar beside the device
    assert depth.series[0].y == pytest.approx(1e3 * run.arrays["/plant/measurement"]["position"])
    assert depth.series[0].y[-1] == pytest.approx(1.0, abs=0.05) and force.series[0].y[-1] == pytest.approx(1.0, abs=0.05)
    assert energy.series[0].y.max() > 500.0
