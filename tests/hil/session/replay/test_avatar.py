"""The avatar that is computed again from a log is the one that the controller had."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec import structs

from hil.compose import compose
from hil.experiment import load_experiment
from hil.measure.view import view_of
from hil.runtime.virtual import simulate
from hil.session.replay import avatar
from hil.session.replay.avatar import avatar_path, wall_loop_of


class Watched:
    """A wall that keeps where its avatar was, slot by slot."""

    def __init__(self, running):
        self._running, self.selection, self.seen = running, running.selection, {}

    def rows(self, k, tau, y, r):
        rows = self._running.rows(k, tau, y, r)
        self.seen[k] = (self._running.contact.avatar_m, self._running.contact.material)
        return rows


@pytest.mark.parametrize(
    ("name", "changes"),
    [("omni-slide", []), ("omni-1khz", ["duration=1"]), ("omni-wifi", []), ("omni-push", ["controller.wall.material=2"])],
)
def test_avatar_and_material_are_those_of_the_run_bit_for_bit(monkeypatch, name, changes):
    experiment = load_experiment(name, [*changes] if any("duration" in c for c in changes) else [*changes, "duration=10"])
    loop = compose(experiment)
    watched = []
    start = type(loop).start_controller
    monkeypatch.setattr(type(loop), "start_controller", lambda self: watched.append(Watched(start(self))) or watched[-1])
    run = simulate(loop, 3)
    monkeypatch.undo()
    view = view_of(run, experiment)
    path = avatar_path(view, wall_loop_of(view))
    seen = watched[0].seen
    slots = np.rint(path.t_s / loop.model.period_s).astype(int)
    assert path.same and slots.tolist() == sorted(seen)
    assert path.depth_m.tolist() == [seen[k][0] for k in slots.tolist()]
    assert path.material.tolist() == [seen[k][1] for k in slots.tolist()]
    assert np.ptp(path.depth_m) > 1e-4
    monkeypatch.setattr(avatar, "MOST_ANSWERS", 40)
    short, n = avatar_path(view, wall_loop_of(view)), int((slots < view.run.arrays["/controller/rows"]["slot"][40]).sum())
    assert short.same and n > 30
    for few, all_of_them in ((short.t_s, path.t_s), (short.depth_m, path.depth_m), (short.material, path.material)):
        assert few.tolist() == all_of_them[:n].tolist()


def test_forces_of_another_program_are_reported():
    experiment = load_experiment("omni-push", ["duration=5"])
    view = view_of(simulate(compose(experiment), 0), experiment)
    softer = load_experiment("omni-push", ["duration=5", "controller.wall.material=1"])
    other = structs.replace(view, experiment=softer, _made={})
    assert avatar_path(view, wall_loop_of(view)).same and not avatar_path(other, wall_loop_of(other)).same


def test_a_restart_forgets_the_avatar_too():
    fault = "fault=[{at=2,kind='controller-restart',for=0.2},{at=3,kind='controller-restart'}]"
    experiment = load_experiment("omni-push", ["duration=5", fault])
    view = view_of(simulate(compose(experiment), 0), experiment)
    assert avatar_path(view, wall_loop_of(view)).same


def test_a_controller_that_does_not_say_what_it_touches_has_no_path(monkeypatch):
    experiment = load_experiment("omni-push", ["duration=2"])
    view = view_of(simulate(compose(experiment), 0), experiment)
    monkeypatch.setattr(avatar, "HasContact", type("Nothing", (), {}))
    assert avatar_path(view, wall_loop_of(view)) is None


def test_other_runs_have_no_wall():
    experiment = load_experiment("dc-motor-hinf", ["duration=2"])
    assert wall_loop_of(view_of(simulate(compose(experiment), 0), experiment)) is None
