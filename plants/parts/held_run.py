"""The joint of the Phantom Omni held by a hand, while it runs: one step of a slot at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from plants.errors import PlantError
from plants.parts.damping_zones import ZoneRun
from plants.parts.events import Source, pass_time
from plants.parts.flow import Flow
from plants.parts.friction import Friction
from plants.parts.hand import Hand
from plants.parts.hand_run import PathRun, PushRun, SlideRun
from plants.parts.linear import NS_PER_S
from plants.parts.rubbing_axis import RubbingAxis

if TYPE_CHECKING:
    from plants.omni import Omni


class HeldRun:
    """The held device while it runs. See `Omni` for the equations."""

    __slots__ = (
        "_applied", "_damping", "_dry", "_flow", "_force", "_given", "_limit", "_now_ns", "_path", "_place", "_push", "_slide",
        "_sources", "_step_m", "_ways", "_x", "_zones",
    )  # fmt: skip

    def __init__(self, omni: Omni, hand: Hand, rng: np.random.Generator) -> None:
        self._push, self._slide = PushRun(hand.push, rng), SlideRun(hand.slide, rng)
        self._zones = ZoneRun(omni.zones)
        self._x = [omni.lever_m * omni.initial_angle_rad, omni.lever_m * omni.initial_speed_rad_s, 0.0]
        self._move_as(omni, hand, PathRun(hand))
        self._place = self._slide.at(0)
        self._limit = math.inf if omni.force_limit_n is None else omni.force_limit_n
        self._step_m = omni.encoder_step_m
        self._now_ns, self._force, self._applied, self._given = 0, 0.0, (0.0,), 0.0

    def _move_as(self, omni: Omni, hand: Hand, path: PathRun) -> None:
        mass, spring = omni.tip_mass_kg, hand.stiffness_n_per_m
        self._ways = []
        for beta in omni.tip_dampings_n_s_per_m:
            # (x, v, p) under (force + push, p')
            drawn = [[0.0, 1.0, 0.0], [-spring / mass, -beta / mass, spring / mass], [0.0, 0.0, 0.0]]
            flow = Flow(drawn, [[0.0, 0.0], [1.0 / mass, hand.damping_n_s_per_m / mass], [0.0, 1.0]])
            dry = RubbingAxis(1.0 / mass, beta / mass, Friction(coulomb_v=omni.coulomb_n)) if omni.coulomb_n else None
            self._ways.append((flow, dry))
        self._flow, self._dry = self._ways[self._zones.at(self._x[0])]
        self._damping, self._path = omni.tip_damping_n_s_per_m, path
        self._sources: tuple[Source, ...] = (self._push, path, self._slide, *self._zones.sources)

    def change(self, omni: Omni, hand: Hand) -> None:
        """Go on with other parameters; the hand leads it from where it is."""
        self._move_as(omni, hand, PathRun(hand, self._now_ns, self._x[2]))

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold the command for dt_ns.

        Args:
            dt_ns: time in nanoseconds, at least 0.
            u: commanded force in N, one entry.
            w: disturbance in N at the tip, one entry or nothing.
        """
        if dt_ns < 0:
            raise PlantError(f"advance: {dt_ns} ns, expected a time that does not run backwards")
        force, limit, slide = u[0], self._limit, self._slide
        force = limit if force > limit else -limit if force < -limit else force
        self._applied = (force,)
        self._force = force + w[0] if w else force
        before, now_ns = self._x[0], self._now_ns
        end_ns = now_ns + dt_ns
        other_ns = min(self._path.next_ns, slide.next_ns, self._zones.next_ns)
        if self._push.next_ns > end_ns < other_ns:  # nothing happens on the way
            if dt_ns:
                self._move(now_ns, end_ns)
        elif dt_ns and self._push.next_ns == end_ns < other_ns:  # at its end the push
            self._move(now_ns, end_ns)
            self._push.fire()
        else:
            pass_time(now_ns, end_ns, self._sources, self._move)
        self._now_ns = end_ns
        if dt_ns:
            self._place = slide.at(end_ns)
            moved = self._x[0] - before
            self._given += moved * (force - self._damping * moved * NS_PER_S / dt_ns)

    def _move(self, begin_ns: int, end_ns: int) -> None:
        if self._zones.looks:
            self._zones.looks = False
            self._flow, self._dry = self._ways[self._zones.at(self._x[0])]
        force = self._force + self._push.force_n
        if self._dry is not None:
            position, speed = self._dry.move(self._x[0], self._x[1], force, (end_ns - begin_ns) / NS_PER_S)
            self._x = [position, speed, 0.0]
        else:
            self._x = self._flow.step(self._x, (force, self._path.speed_m_s), end_ns - begin_ns)

    def measure(self) -> tuple[float, ...]:
        """Return the position in m as the encoder gives it, and the place y, z along the wall in m."""
        position, step = self._x[0], self._step_m
        if step and math.isfinite(position):
            position = step * math.floor(position / step + 0.5)
        return (position, *self._place)

    @property
    def state(self) -> tuple[float, ...]:
        """Position in m, speed in m/s, y and z in m, push in N, energy given in J: the true ones."""
        x, given = self._x, self._given
        return (x[0], x[1], *self._place, self._push.force_n, given if given > 0.0 else max(given, 0.0))

    @property
    def applied(self) -> tuple[float, ...]:
        """Force in N that the actuator put out in the last advance, without the disturbance."""
        return self._applied
