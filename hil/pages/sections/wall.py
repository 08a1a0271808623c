"""A haptic run at its wall: depth of device and avatar, force, energy, the way over the materials, the margin over delay.

Reference: Chapter 6, Figures 6.8 to 6.10.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from design.controllers.rendered_wall import ModelFollower, WallController
from design.controllers.wall import Wall
from hil.log.append_column import whole
from hil.log.topics import PASSIVITY, STATE
from hil.measure.view import APPLIED, MEASUREMENT, RunView
from hil.pages import Block, Cell, Figure, Marker, Scene, Section, Series, Shape, Table
from hil.pages.sections.time_panels import curve, markers
from hil.rig.loop import Array, Loop
from hil.session.replay.avatar import MOST_ANSWERS, AvatarPath, avatar_path, loop_of

PLACE = 5
"""Before everything else: a haptic run is about its wall."""
MOST_CELLS = 40
"""So many cells of the pattern are drawn at most; a longer way is cut."""
MOST_POINTS = 3000
FURTHER = 4
"""Delays beyond the loop's own for which the margin is shown, samples."""
TILT = math.radians(35.0)
DEEP = 0.55
CALM = " The passivity observer: the motor gave no energy beyond what the damping took (0 mJ)."
IDLE = " The passivity controller at the rig added no force."


def section(view: RunView) -> Section | None:
    """Return the section of a run whose controller renders a wall, None for every other run.

    Args:
        view: the run.
    """
    loop = loop_of(view)
    if loop is not None and isinstance(loop.controller, ModelFollower):
        return Section(
            title="At the wall", place=PLACE, blocks=tuple(_over_time(view, None)), columns=2,
            intro="The controller draws the device after a model of the wall: there is no coupler, and so no avatar behind it."
            f"{_calm(view)}",
        )  # fmt: skip
    if loop is None or not isinstance(loop.controller, WallController):
        return None
    path = avatar_path(view, loop)
    blocks = _over_time(view, path)
    margin = _margin(view, loop, loop.controller)
    blocks += [*([] if margin is None else [margin]), _felt(loop.controller)]
    if path is not None and np.ptp(path.y_m) + np.ptp(path.z_m) > 0.0:
        shown = _shown(path, loop.controller.wall)
        blocks += [_map(path, loop.controller.wall, shown), _space(path, shown)]
    part = "" if path is None or len(path.t_s) < MOST_ANSWERS else f" It is followed over the first {path.t_s[-1]:.6g} s."
    said = "computed again from the log" if path is None or path.same else (
        "computed again from the log, but its forces are not those that were logged: another program answered, a fault froze "
        "what came to the controller, or the run was changed"
    )
    return Section(
        title="At the wall", place=PLACE, blocks=tuple(blocks), columns=2,
        intro=f"{_softness(view, loop)}The avatar is the position of the device as the wall computes it, behind delay and "
        f"coupler; it is {said}.{part}{_calm(view)}",
    )  # fmt: skip


SECTIONS = (section,)


def _softness(view: RunView, loop: Loop) -> str:
    """Return how far the wall gives way in this run, and behind which delay: what is safe there decides how stiff it is."""
    tip, force = view.signals.tracked[0], next(iter(view.signals.inputs))
    depth = float(np.nanmax(whole(view.run.arrays[MEASUREMENT], tip), initial=0.0))
    most = float(np.nanmax(-whole(view.run.arrays[APPLIED], force), initial=0.0))
    if most <= 0.0:
        return ""
    return (
        f"The largest force is {most:.3g} {view.signals.inputs[force]}, the largest depth {1e3 * depth:.3g} mm, behind a delay "
        f"of {_delay(view, loop)} samples of {1e3 * loop.model.period_s:g} ms: the shorter, the stiffer a safe wall (hil "
        "stiffness-map). "
    )


def _delay(view: RunView, loop: Loop) -> int:
    """Return the largest delay of a loop, both ways, in samples: of its certificate, or what its rows and gains cover."""
    said = view.run.certificate
    delays = said.get("delays", ()) if said.get("kind") == "passivity" else ()
    return int(max(delays, default=loop.model.tau_max + loop.model.d_max))


def _over_time(view: RunView, path: AvatarPath | None) -> list[Block]:
    run, marks = view.run, view.once(markers)
    measured, applied, state = run.arrays[MEASUREMENT], run.arrays[APPLIED], run.arrays.get(STATE.name)
    tip, force = view.signals.tracked[0], next(iter(view.signals.inputs))
    depth = [curve(measured, lambda some: 1e3 * some[tip], label="device", colour=0)]
    if path is not None:
        depth.append(Series(label="avatar", x=path.t_s, y=1e3 * path.depth_m, colour=1))
    found: list[Block] = [
        Figure(title="Penetration", series=tuple(depth), y_label="depth", y_unit="mm", markers=marks),
        Figure(
            title="Force of the wall at the device",
            series=(curve(applied, lambda some: -some[force], label="force against the hand", style="step", colour=3),),
            y_label="force", y_unit=view.signals.inputs[force], markers=marks,
        ),
    ]  # fmt: skip
    if state is not None and _gave(view):
        energy = curve(state, lambda some: 1e3 * some["given"], label="energy given", colour=4)
        found.append(
            Figure(
                title="Passivity observer", series=(energy,), y_label="energy given", y_unit="mJ", markers=marks,
                note="Energy that the motor gave minus energy that the damping took: 0 behind a safe coupler, but for what is "
                "stored where the device begins behind the surface.",
            )
        )  # fmt: skip
    damper = run.arrays.get(PASSIVITY.name)
    if damper is not None and np.nanmax(damper["damping"], initial=0.0) > 0.0:
        injected = curve(damper, "damping", label="injected damping", style="step", colour=5)
        found.append(
            Figure(
                title="Passivity controller at the rig", series=(injected,), y_label="damping", y_unit="N s/m", markers=marks,
                note="The force that the rig added while the motor had given more energy than allowed.",
            )
        )  # fmt: skip
    return found


def _gave(view: RunView) -> bool | None:
    """Whether the motor gave more energy than the damping took, None where no passivity observer says so."""
    state = view.run.arrays.get(STATE.name)
    if state is None or "given" not in (state.dtype.names or ()):
        return None
    return bool(np.nanmax(whole(state, "given"), initial=0.0) > 0.0)


def _calm(view: RunView) -> str:
    """Return what the passivity observer and the passivity controller have not seen; a plot of 0 says less."""
    damper = view.run.arrays.get(PASSIVITY.name)
    idle = damper is not None and not np.nanmax(damper["damping"], initial=0.0) > 0.0
    return (CALM if _gave(view) is False else "") + (IDLE if idle else "")


def _margin(view: RunView, loop: Loop, controller: WallController) -> Figure | None:
    port = loop.rig.port
    if port is None or port.output != 0:
        return None
    from design.passivity import HapticLoop, HeldDevice

    device = HeldDevice(mass_kg=port.mass, damping_n_s_per_m=port.damping, hand_stiffness_n_per_m=port.stiffness)
    own = _delay(view, loop)
    delays = list(range(own + FURTHER + 1))
    felt = HapticLoop(device=device, coupler=controller.coupler, period_s=loop.model.period_s, sc_max=delays[-1], ca_max=0)
    wall = controller.wall
    curves = [
        Series(
            label=f"{m.stiffness_n_per_m:g} N/m, {m.damping_n_s_per_m:g} N s/m", x=delays,
            y=[felt.radius(m, n, 0) for n in delays], colour=wall.materials.index(m),
        )
        for m in dict.fromkeys(wall.touched)
    ]  # fmt: skip
    limit = Series(label="limit of stability", x=[0, delays[-1]], y=[1.0, 1.0], style="dashed", colour=7)
    return Figure(
        title="Stability in contact, over delay", series=(*curves, limit), x_label="delay, both ways", x_unit="samples",
        y_label="spectral radius", sync=None, markers=(Marker(x=float(own), label="this loop"),),
        note="Device and hand of this run, in contact throughout, at a delay that stays; 1 less the radius is the margin.",
    )  # fmt: skip


def _felt(controller: WallController) -> Table:
    from design.passivity.transparency import felt_n_per_m

    wall = controller.wall
    rows: list[list[Cell]] = [
        [f"material {i + 1}", m.stiffness_n_per_m, m.damping_n_s_per_m, float(f"{felt_n_per_m(m, controller.coupler):.4g}")]
        for i, m in enumerate(wall.materials)
        if m in wall.touched
    ]
    return Table(
        title="How stiff the wall feels", columns=["", "spring (N/m)", "damper (N s/m)", "felt (N/m)"], rows=rows,
        note="Felt: under a constant force, through the coupler.",
    )  # fmt: skip


def _shown(path: AvatarPath, wall: Wall) -> slice:
    """Return the first part of the way that lies over few enough cells of the pattern."""
    if wall.pattern is None:
        return slice(0, len(path.t_s), max(1, len(path.t_s) // MOST_POINTS))
    spans = [np.maximum.accumulate(v) - np.minimum.accumulate(v) for v in (path.y_m, path.z_m)]
    cells = (spans[0] / wall.pattern.width_m + 1.0) * (spans[1] / wall.pattern.height_m + 1.0)
    count = max(int(np.searchsorted(cells, MOST_CELLS)), 2)
    return slice(0, count, max(1, count // MOST_POINTS))


def _until(path: AvatarPath, shown: slice) -> str:
    return "" if shown.stop >= len(path.t_s) else f" The first {path.t_s[shown.stop - 1]:.3g} s of the run."


def _map(path: AvatarPath, wall: Wall, shown: slice) -> Scene:
    y, z = 1e3 * path.y_m[shown], 1e3 * path.z_m[shown]
    areas: list[Shape] = []
    if wall.pattern is not None:
        width, height = 1e3 * wall.pattern.width_m, 1e3 * wall.pattern.height_m
        for i in range(math.floor(y.min() / width), math.floor(y.max() / width) + 1):
            for j in range(math.floor(z.min() / height), math.floor(z.max() / height) + 1):
                for p in wall.pattern.patches:
                    left, low = i * width + 1e3 * p.y_m, j * height + 1e3 * p.z_m
                    right, high = left + 1e3 * p.width_m, low + 1e3 * p.height_m
                    corners = [(left, low), (right, low), (right, high), (left, high)]
                    areas.append(Shape(points=corners, label=f"material {p.material + 1}", colour=p.material, filled=True))
    way = Shape(points=np.column_stack([y, z]), label="avatar")
    return Scene(
        title="The way over the wall", shapes=(*areas, way), x_label="y (mm)", y_label="z (mm)",
        note=f"As the wall saw it, the link's delay late (Figure 6.10).{_until(path, shown)}",
    )  # fmt: skip


def _space(path: AvatarPath, shown: slice) -> Scene:
    """Return the way in space: y to the right, z up, depth away from the eye, each to its own scale."""
    columns = [path.y_m[shown], path.z_m[shown], path.depth_m[shown]]
    low = [float(c.min()) for c in columns[:2]] + [min(float(columns[2].min()), 0.0)]
    high = [float(c.max()) for c in columns[:2]] + [max(float(columns[2].max()), 1e-6)]
    y, z, depth = ((c - a) / max(b - a, 1e-9) for c, a, b in zip(columns, low, high))
    surface = (0.0 - low[2]) / (high[2] - low[2])

    def project(y: Array, z: Array, depth: Array) -> Array:
        return np.column_stack([1.6 * y + DEEP * math.cos(TILT) * depth, z + DEEP * math.sin(TILT) * depth])

    def line(*corners: tuple[float, float, float]) -> Array:
        return project(*(np.array(c) for c in zip(*corners)))

    plane = Shape(
        points=line((0, 0, surface), (1, 0, surface), (1, 1, surface), (0, 1, surface)), label="surface of the wall", colour=7,
        filled=True,
    )  # fmt: skip
    edges = [
        line((0, 0, 0), (1, 0, 0)), line((0, 0, 0), (0, 1, 0)), line((0, 0, 0), (0, 0, 1)), line((1, 0, 0), (1, 0, 1)),
        line((0, 1, 0), (0, 1, 1)), line((0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1), (0, 0, 1)),
    ]  # fmt: skip
    changes = [0, *(np.flatnonzero(np.diff(path.material[shown])) + 1).tolist(), len(y) - 1]
    ways = [
        Shape(points=project(*(c[a : b + 1] for c in (y, z, depth))), label=f"over material {path.material[shown][a] + 1}",
              colour=int(path.material[shown][a]))
        for a, b in pairwise(changes)
    ]  # fmt: skip
    shadow = Shape(points=project(y, z, np.full(len(y), surface)), label="its shadow on the surface", faint=True)
    names = [f"{n} {1e3 * a:.3g} to {1e3 * b:.3g} mm" for n, a, b in zip(("y", "z", "depth"), low, high)]
    below = project(*(np.array([v]) for v in (0.0, -0.1, 0.0)))[0]
    return Scene(
        title="The way in space", axes=False,
        shapes=(*(Shape(points=e, colour=7, faint=True) for e in edges), plane, shadow, *ways),
        labels=((float(below[0]), float(below[1]), f"right: {names[0]}, up: {names[1]}"),
                (float(below[0]), float(below[1]) - 0.08, f"away: {names[2]}")),
        note=f"Where the avatar is (Figure 6.9); every axis has a scale of its own.{_until(path, shown)}",
    )  # fmt: skip
